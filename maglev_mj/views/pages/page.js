// What the pages share: canvases, numbers that one drags, the hand, the state in the address, light and dark, frames.
"use strict";

const $ = selector => document.querySelector(selector);
const clamp = (value, least, most) => Math.min(most, Math.max(least, value));
const reduced = matchMedia("(prefers-reduced-motion: reduce)").matches;

// 1. Colours of the style sheet as a canvas takes them, read again when the scheme changes.
let palette = {};
function readColours() {
  const probe = document.body.appendChild(document.createElement("i"));
  for (const name of ["ink", "dim", "line", "ground", "card", "hand", "magnet", "good", "bad", "wall", "pin", "metal", "stem", "shine"]) {
    probe.style.color = `var(--${name})`;
    palette[name] = getComputedStyle(probe).color;
  }
  probe.remove();
}
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", readColours);
readColours();
const faint = (name, percent) => `color-mix(in srgb, ${palette[name]} ${percent}%, transparent)`;

// Inside another page: that page says which scheme it has, "light", "dark" or "light dark", and is told the height.
if (parent !== window) {
  document.documentElement.classList.add("framed");
  new ResizeObserver(() => parent.postMessage({ height: $("main").offsetHeight }, "*")).observe($("main"));
  addEventListener("message", ({ data }) => {
    if (!["light", "dark", "light dark"].includes(data?.scheme)) return;
    document.documentElement.style.colorScheme = data.scheme;
    readColours();
  });
}

// 2. Drawing. `pen` returns a cleared context in CSS pixels, sharp on any screen.
function pen(element, height) {
  const ratio = devicePixelRatio || 1, width = element.clientWidth;
  if (element.width !== Math.round(width * ratio) || element.height !== Math.round(height * ratio)) {
    element.style.height = height + 2 + "px";
    Object.assign(element, { width: Math.round(width * ratio), height: Math.round(height * ratio) });
  }
  const g = element.getContext("2d");
  g.setTransform(ratio, 0, 0, ratio, 0, 0);
  g.clearRect(0, 0, width, height);
  g.lineJoin = g.lineCap = "round";
  return [g, width];
}

function text(g, words, x, y, { colour = "dim", size = 14, weight = 400, align = "left" } = {}) {
  g.font = `${weight} ${size}px system-ui, sans-serif`;
  g.fillStyle = palette[colour];
  g.textAlign = align;
  g.fillText(words, x, y);
}

function line(g, points, colour, width = 2, dash = []) {
  g.setLineDash(dash);
  g.strokeStyle = colour;
  g.lineWidth = width;
  g.beginPath();
  for (const [x, y] of points) g.lineTo(x, y);
  g.stroke();
  g.setLineDash([]);
}

// Points of a quantity that jumps: a level line up to each new value.
const steps = points => points.flatMap(([x, y], i) => i && y !== points[i - 1][1] ? [[x, points[i - 1][1]], [x, y]] : [[x, y]]);

// Arrow from (x, y) by (dx, dy) pixels.
function arrow(g, x, y, dx, dy, colour) {
  const length = Math.hypot(dx, dy);
  if (length < 3) return;
  const head = Math.min(14, length), [a, b] = [dx / length, dy / length], [tx, ty] = [x + dx, y + dy];
  if (length > head) line(g, [[x, y], [tx - a * head * 0.7, ty - b * head * 0.7]], palette[colour], 5);
  g.fillStyle = palette[colour];
  g.beginPath();
  for (const side of [-0.57 * head, 0.57 * head]) g.lineTo(tx - a * head - b * side, ty - b * head + a * side);
  g.lineTo(tx, ty);
  g.fill();
}

function spring(g, x0, x1, y, colour, most = 10, widest = 8) {
  const turns = Math.min(most, Math.floor(Math.abs(x1 - x0) / 14)), size = Math.min(widest, Math.abs(x1 - x0) / 8);
  if (turns < 3) return line(g, [[x0, y], [x1, y]], colour, 2);
  const points = [[x0, y]];
  for (let i = 0; i <= 2 * turns; i++)
    points.push([x0 + (x1 - x0) * (0.08 + 0.84 * i / (2 * turns)), y + (i % 2 ? size : -size) * (i > 0 && i < 2 * turns)]);
  line(g, [...points, [x1, y]], colour, 2);
}

function disc(g, x, y, radius, fill) {
  g.fillStyle = fill;
  g.beginPath();
  g.arc(x, y, radius, 0, 7);
  g.fill();
}

function knob(g, x, y, radius) {
  const shade = g.createRadialGradient(x - radius / 3, y - radius / 2.4, radius / 9, x, y, radius);
  shade.addColorStop(0, palette.shine);
  shade.addColorStop(1, palette.stem);
  disc(g, x, y, radius, shade);
}

// A handle at x with its stem in the slot of the base plate, which is the metal stop.
function handle(g, x, y, radius, at, width, height) {
  const stem = radius * 0.24, floor = height - 32;
  for (const [from, to] of [[0, at(-STOP) - stem], [at(STOP) + stem, width]]) {
    g.save();
    g.beginPath();
    g.rect(from, floor, to - from, 32);
    g.clip();
    g.fillStyle = faint("metal", 35);
    g.fillRect(from, floor, to - from, 32);
    for (let s = from - 32; s < to; s += 8) line(g, [[s, height], [s + 32, floor]], palette.metal, 1);
    g.restore();
  }
  g.fillStyle = palette.stem;
  g.fillRect(x - stem, y, 2 * stem, height - y);
  knob(g, x, y, radius);
  const words = width < 500 ? "stop" : "metal stop";
  g.font = "400 14px system-ui, sans-serif";
  g.fillStyle = palette.card;
  g.fillRect(width - 18 - g.measureText(words).width, floor + 6, g.measureText(words).width + 12, 20);
  text(g, words, width - 12, height - 11, { align: "right" });
}

// Grid and labels of one plot; returns the two scales. Names stand above it and ticks beside it, so nothing overlaps.
function axes(g, { left, top, width, height }, [x0, x1], [y0, y1], xTicks, yTicks) {
  const X = x => left + (x - x0) / (x1 - x0) * width, Y = y => top + height - (y - y0) / (y1 - y0) * height;
  const digits = [0, 1, 2].find(d => yTicks.every(y => Math.abs(y - +y.toFixed(d)) < 1e-9)) ?? 3;
  for (const y of yTicks) {
    line(g, [[left, Y(y)], [left + width, Y(y)]], palette.line, 1);
    text(g, y.toFixed(digits).replace("-", "−"), left - 7, Y(y) + 4.5, { size: 13, align: "right" });
  }
  for (const x of xTicks) text(g, String(+x.toPrecision(6)).replace("-", "−"), X(x), top + height + 17, { size: 13, align: "center" });
  return [X, Y];
}

// Multiples of the least 1, 2 or 5 times a power of ten that divides a range into at most `most` parts.
function ticks(low, high, most) {
  const rough = (high - low) / most, power = 10 ** Math.floor(Math.log10(rough));
  const step = [1, 2, 5, 10].map(f => f * power).find(s => s >= rough * 0.999);
  const found = [];
  for (let i = Math.ceil(low / step - 1e-9); i * step <= high + 1e-9 * step; i++) found.push(i * step);
  return found;
}

function clipped(g, { left, top, width, height }, draw) {
  g.save();
  g.beginPath();
  g.rect(left, top, width, height);
  g.clip();
  draw();
  g.restore();
}

// 3. Numbers in the text: drag them, or use the arrow keys. With `log` one pixel is 1 %.
const grouped = (value, digits = 0) => value.toFixed(digits).replace(/\B(?=(\d{3})+(?!\d))/g, "\u202f");
const greatest = ({ most }) => typeof most === "function" ? most() : most;

function numbers(state, limits, change) {
  const all = document.querySelectorAll(".number");
  const put = (key, value) => {
    state[key] = clamp(Math.round(value / limits[key].step) * limits[key].step, limits[key].least, greatest(limits[key]));
    change();
  };
  all.forEach(element => {
    const key = element.dataset.key, { label, log, pixels = 4, step, least } = limits[key];
    for (const [name, value] of Object.entries({ role: "slider", tabindex: 0, "aria-label": label, "aria-valuemin": least,
      title: "drag, or use the arrow keys" }))
      element.setAttribute(name, value);
    let from = 0, start = 0;
    element.addEventListener("pointerdown", event => {
      element.setPointerCapture(event.pointerId);
      [from, start] = [event.clientX, state[key]];
    });
    element.addEventListener("pointermove", event => {
      if (!element.hasPointerCapture(event.pointerId)) return;
      const moved = event.clientX - from;
      put(key, log ? start * 1.01 ** moved : start + step * Math.round(moved / pixels));
    });
    element.addEventListener("keydown", event => {
      const way = { ArrowUp: 1, ArrowRight: 1, ArrowDown: -1, ArrowLeft: -1, PageUp: 10, PageDown: -10 }[event.key];
      if (!way) return;
      event.preventDefault();
      put(key, state[key] + way * (log ? Math.max(step, 0.02 * state[key]) : step));
    });
  });
  return () => all.forEach(element => {
    const limit = limits[element.dataset.key], value = state[element.dataset.key];
    element.textContent = grouped(value, limit.digits);
    element.setAttribute("aria-valuenow", value.toFixed(limit.digits ?? 0));
    element.setAttribute("aria-valuemax", greatest(limit));
  });
}

// Buttons that set all numbers: data-state="6000,80,200,1.5".
function presets(state, change) {
  document.querySelectorAll("[data-state]").forEach(button => button.addEventListener("click", () => {
    button.dataset.state.split(",").forEach((value, i) => { state[Object.keys(state)[i]] = Number(value); });
    change();
  }));
}

// 4. The address holds the state, "#13000,80,200,1.5", so that one can send it.
let remembering;
function remember(state) {
  clearTimeout(remembering);
  remembering = setTimeout(() => {
    try {
      history.replaceState(null, "", "#" + Object.values(state).map(v => +v.toFixed(4)).join(","));
    } catch {}                                                 // a frame without an address, as in a notebook
  }, 300);
}

function recall(state, limits, change = () => {}) {
  const read = () => {
    const values = location.hash.slice(1).split(",").map(Number), keys = Object.keys(state);
    if (values.length !== keys.length || !values.every(Number.isFinite)) return;
    keys.forEach((key, i) => { state[key] = values[i]; });
    for (const key of keys) state[key] = clamp(state[key], limits[key].least, greatest(limits[key]));
  };
  read();
  addEventListener("hashchange", () => { read(); change(); });
}

// 5. Pointers. A finger that does not start at `near(x, y)` scrolls the page instead.
function drags(element, { near = () => true, down, move, up }) {
  let dragged = false;                                         // a finger is captured even where it scrolls
  element.addEventListener("touchstart", event => {
    const { left, top } = element.getBoundingClientRect(), { clientX, clientY } = event.touches[0];
    if (near(clientX - left, clientY - top) && !element.classList.contains("level")) event.preventDefault();
  }, { passive: false });
  element.addEventListener("pointerdown", event => {
    if (event.button || (event.pointerType === "touch" && !near(event.offsetX, event.offsetY))) return;
    element.setPointerCapture(event.pointerId);
    dragged = true;
    down(event.offsetX, event.offsetY);
  });
  element.addEventListener("pointermove", event => {
    if (dragged) move(event.offsetX, event.offsetY);
  });
  element.addEventListener("lostpointercapture", () => {
    if (dragged) up();
    dragged = false;
  });
}

// The hand: a pointer or the arrow keys pull to the side; before anybody does, a ghost plays.
class Pull {
  constructor(element, { toTarget, keyStep, ghost }) {
    Object.assign(this, { target: null, ghost: !reduced, play: ghost, time: 0 });
    const place = x => { this.ghost = false; this.target = toTarget(x); };
    const release = () => { if (!this.ghost) this.target = null; };
    drags(element, { down: place, move: place, up: release });
    element.addEventListener("blur", release);
    const keys = { ArrowRight: 1, ArrowLeft: -1 };
    element.addEventListener("keydown", event => {
      if (!(event.key in keys)) return;
      event.preventDefault();
      this.ghost = false;
      this.target = keyStep(keys[event.key], this.target);
    });
    element.addEventListener("keyup", event => { if (event.key in keys) release(); });
  }

  advance(time) {
    this.time += time;
    if (this.ghost) this.target = this.play(this.time);
  }

  hand(stiffness) { return this.target === null ? NO_HAND : { stiffness, target: this.target }; }
}

// 6. Buttons that stay pressed; one step per picture.
function toggle(selector, act) {
  const button = $(selector);
  button.setAttribute("aria-pressed", "false");
  button.addEventListener("click", () => button.setAttribute("aria-pressed", String(act())));
}

function animate(step) {
  let last = null;
  const frame = now => {
    step(last === null ? 0 : clamp((now - last) / 1000, 0, 0.05));
    last = now;
    requestAnimationFrame(frame);
  };
  requestAnimationFrame(frame);
}

// Run a page with a hand: sound, slow motion and ghost by its buttons. `advance(seconds)` returns the forces meanwhile. With
// reduced motion it shows the ghost's pull after `pose` seconds, still, until one acts.
function live(pull, pose, advance, draw) {
  const sound = forceSound();
  let slower = 1, still = reduced;
  toggle("#sound", () => sound.toggle());
  toggle("#slow", () => (slower = slower === 1 ? 10 : 1) > 1);
  $("#play").addEventListener("click", () => Object.assign(pull, { ghost: true, time: 0 }));
  if (still) {
    pull.ghost = true;
    advance(pose);
    pull.ghost = false;
    for (const name of ["pointerdown", "keydown"]) addEventListener(name, () => {
      if (still) pull.target = null;
      still = false;
    }, { capture: true });
  }
  animate(passed => {
    const forces = still ? [] : advance(passed / slower);
    sound.play(forces, passed);
    draw();
  });
  return sound;
}
