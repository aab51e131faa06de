// Of the page of a running scene: the spring from knob to pointer, drags sent at each move, the strip at the contact, sound.
//
// `live.hear(data)` takes the program's data, see live.py. `live.replaces(message)` sees each message that viser sends, and is
// true for one that this script sends itself; `live.hides(message)` is true for one of the program that viser must not see.
// `live.connect(send, show)` gives it the functions that send a message and that have viser show one.
"use strict";

const live = (() => {
  const svg = (name) => document.createElementNS("http://www.w3.org/2000/svg", name);
  const sound = forceSound();
  const pull = svg("svg"), strip = document.createElement("section");
  pull.id = "pull";
  strip.id = "strip";
  strip.ariaLabel = "last half second at the contact";
  strip.innerHTML = '<button type="button" aria-pressed="false">sound</button><svg role="img"></svg>';
  const [button, plot] = strip.children;
  button.title = "the force of the device as sound";
  button.onclick = () => button.setAttribute("aria-pressed", String(sound.toggle()));

  // Both are drawn once in a frame, however many moves and states arrive.
  const due = new Set();
  function draw(...parts) {
    if (!due.size) requestAnimationFrame(() => { for (const part of due) due.delete(part), part(); });
    for (const part of parts) due.add(part);
  }

  // 1. Camera and drag, as viser reports them; both stay when the page is redrawn.
  let camera = null, drag = null, pointer = null, knob = null, send, show, view = { left: 0, top: 0, width: 1, height: 1 };
  const turned = ([w, x, y, z], [a, b, c]) => {
    const [p, q, r] = [2 * (y * c - z * b), 2 * (z * a - x * c), 2 * (x * b - y * a)];
    return [a + w * p + y * r - z * q, b + w * q + z * p - x * r, c + w * r + x * q - y * p];
  };
  const scale = () => view.height / 2 / Math.tan(camera.fov / 2); // pixels per unit at a distance of one
  const difference = (a, b) => a.map((value, i) => value - b[i]);
  const product = (a, b) => a.reduce((sum, value, i) => sum + value * b[i], 0);

  // Pixel in the view of a point [m], and its distance along the line of sight.
  function projected(point) {
    const [w, ...axis] = camera.wxyz;
    const [x, y, z] = turned([w, ...axis.map((part) => -part)], difference(point, camera.position));
    return [view.width / 2 + (scale() * x) / z, view.height / 2 + (scale() * y) / z, z];
  }

  // Point under a pixel of the view, on the plane through a point that faces the camera.
  function under(x, y, point) {
    const ray = turned(camera.wxyz, [(x - view.width / 2) / scale(), (y - view.height / 2) / scale(), 1]);
    const ahead = turned(camera.wxyz, [0, 0, 1]);
    const share = product(difference(point, camera.position), ahead) / product(ray, ahead);
    return camera.position.map((value, i) => value + share * ray[i]);
  }

  // viser would send a drag at most 20 times a second
  addEventListener("pointermove", (event) => {
    if (!drag || !camera || !event.isPrimary) return;
    pointer = [event.clientX - view.left, event.clientY - view.top];
    send({ ...drag, phase: "update", end_position: under(...pointer, drag.end_position) });
    draw(drawPull);
  }, true);

  const HAND = ["/forces/hand", "/numbers/hand"]; // in the 3D view

  // 2. The hand: a spring from the knob to the pointer, drawn at each move and at each state of the scene.
  const wire = pull.appendChild(svg("path")), end = pull.appendChild(svg("circle")), words = pull.appendChild(svg("text"));
  end.setAttribute("r", 5);
  words.setAttribute("dy", 4);
  function drawPull() {
    const shown = drag && pointer && camera && knob;
    pull.style.display = shown ? "" : "none";
    if (!shown) return;
    const [x, y] = projected(knob.place), [px, py] = pointer, length = Math.hypot(px - x, py - y);
    const turns = Math.min(14, Math.floor(length / 12)), size = Math.min(7, length / 8), [a, b] = [(px - x) / length, (py - y) / length];
    let path = `M${x.toFixed(1)} ${y.toFixed(1)}`;
    for (let i = 1; turns > 2 && i < 2 * turns; i++) {
      const along = length * (0.08 + (0.84 * i) / (2 * turns)), aside = i % 2 ? size : -size;
      path += `L${(x + a * along - b * aside).toFixed(1)} ${(y + b * along + a * aside).toFixed(1)}`;
    }
    wire.setAttribute("d", `${path}L${px.toFixed(1)} ${py.toFixed(1)}`);
    end.setAttribute("cx", px.toFixed(1));
    end.setAttribute("cy", py.toFixed(1));
    if (words.textContent !== knob.words) words.textContent = knob.words;
    const room = 12 + 8 * knob.words.length, starts = (px >= x && px + room < view.width) || px < room; // away from the knob
    words.setAttribute("text-anchor", starts ? "start" : "end");
    words.setAttribute("x", (px + (starts ? 12 : -12)).toFixed(1));
    words.setAttribute("y", Math.min(Math.max(py + (py < y ? -14 : 14), 14), view.height - 8).toFixed(1));
  }

  // 3. The strip: position above, forces below, on one time axis; at the right the knob in the scale of the position.
  const KNOB = 58;
  let data = null;
  const text = (x, y, written, more = "") => `<text x="${x}" y="${y}" ${more}>${written}</text>`;
  function drawStrip() {
    const width = plot.clientWidth, height = plot.clientHeight, left = 46, right = width - KNOB - 14;
    if (!width || !data) return;
    plot.ariaLabel = data.state;
    if (!data.charts) return (plot.innerHTML = text(10, 15, data.state, 'class="state"'));
    const half = (height - 62) / 2, tops = [26, 54 + half], ends = right + KNOB;
    const scales = data.charts.map(({ up: [low, high] }, i) => (value) => tops[i] + half - ((value - low) / (high - low)) * half);
    const edge = Math.min(Math.max(scales[0](0), tops[0]), tops[0] + half), [from, to] = data.normal > 0 ? [edge, tops[0] + half] : [tops[0], edge];
    const [at, beside] = width < 430 ? [right, tops[1] - 8] : [width - 76, 15]; // where no title reaches
    let drawn = text(at, beside, data.state, `text-anchor="end" class="state${data.bad ? " bad" : ""}"`);
    if (data.normal) drawn += `<rect class="wall" x="${left}" y="${from}" width="${ends - left}" height="${to - from}"/>`;
    data.charts.forEach(({ title, lines, across: [first], ticks }, i) => {
      const Y = scales[i], stride = Math.ceil((ticks.length - 1) / Math.max(1, Math.floor(half / 18)));
      const kept = ticks.filter((_, k) => k % stride === 0);
      const digits = [0, 1, 2].find((d) => kept.every((tick) => Math.abs(tick - tick.toFixed(d)) < 1e-9)) ?? 3;
      for (const tick of kept) {
        drawn += `<path class="grid" d="M${left} ${Y(tick).toFixed(1)}H${right}"/>`;
        drawn += text(left - 6, (Y(tick) + 4).toFixed(1), tick.toFixed(digits).replace("-", "−"), 'text-anchor="end"');
      }
      const spans = (width < 340 ? title.slice(0, 1) : title).map(([words, colour]) => `<tspan style="fill:${colour}">${words} </tspan>`).join("");
      drawn += text(10, tops[i] - 11 + 3 * i, spans, 'class="title"');
      drawn += `<svg x="${left}" y="${tops[i] - 2}" width="${right - left}" height="${half + 4}" viewBox="${left} ${tops[i] - 2} ${right - left} ${half + 4}">`;
      for (const { colour, dashed, points } of lines.filter((line) => line.points.length)) {
        const path = points.map(([t, value]) => `${(right - (t / first) * (right - left)).toFixed(1)} ${Y(value).toFixed(1)}`).join("L");
        drawn += `<path d="M${path}" style="stroke:${colour}"${dashed ? ' stroke-dasharray="4 3"' : ""}/>`;
      }
      drawn += "</svg>";
    });
    // the knob touches the wall where the line ends; beside it what it did within a tenth of a second
    const run = data.charts[0].lines.at(-1).points, recent = run.filter(([t]) => t >= -0.1).map(([, value]) => scales[0](value));
    const radius = 24, x = right + KNOB / 2 + 4, place = recent.at(-1) - (data.normal > 0 ? radius : data.normal < 0 ? -radius : 0);
    drawn += `<svg x="${right}" y="${tops[0]}" width="${KNOB}" height="${half}" viewBox="${right} ${tops[0]} ${KNOB} ${half}">`;
    drawn += `<circle class="knob" cx="${x}" cy="${place.toFixed(1)}" r="${radius}"/>`;
    drawn += `<path class="range" d="M${right + 5} ${Math.min(...recent).toFixed(1)}V${Math.max(...recent).toFixed(1)}"/></svg>`;
    if (camera && knob) {
      const [low, high] = data.charts[0].up, ratio = half / (high - low) / (scale() / projected(knob.place)[2] / 1000);
      drawn += text(x, tops[1] - 8, `×${ratio < 10 ? ratio.toFixed(1) : ratio.toFixed(0)}`, 'text-anchor="middle"');
    }
    plot.innerHTML = drawn;
    plot.ariaLabel = `${data.charts[0].title.map(([words]) => words).join(" ")}: ${data.state}`;
  }

  // Forces since the last strip, for the listener's time
  function play(passed) {
    if (!sound.on || !(passed > 0) || passed > 0.3 || !data.device?.length) return;
    const duration = passed / data.pace, forces = [];
    for (let i = 0, k = 0, count = Math.ceil(duration * 4000); i < count; i++) {
      const t = -passed + (i / count) * passed;
      while (k + 1 < data.device.length && data.device[k + 1][0] <= t) k++;
      forces.push(data.device[k][1]);
    }
    sound.play(forces, duration);
  }

  // 4. The place in viser's page, which it may draw anew.
  function settle() {
    const canvas = document.querySelector("canvas[data-engine]"), host = canvas?.closest('[style*="inset"]');
    if (!host) return;
    if (strip.parentElement !== host) host.append(pull, strip);
    const { left, top, width, height } = canvas.getBoundingClientRect();
    view = { left, top, width, height };
    draw(drawStrip, drawPull);
  }
  setInterval(settle, 250);
  addEventListener("resize", () => requestAnimationFrame(settle));

  return {
    connect(...functions) { [send, show] = functions; },
    hear({ knob: place, strip: newest }) {
      knob = place;
      draw(drawPull);
      if (!newest) return;
      const passed = newest.now - data?.now;
      data = newest;
      play(passed);
      draw(drawStrip);
    },
    hides: ({ type, name, visible }) => Boolean(drag && camera) && type === "SetSceneNodeVisibilityMessage" && visible && HAND.includes(name),
    replaces(message) {
      if (message.type === "ViewerCameraMessage") (camera = message), draw(drawPull);
      if (message.type !== "SceneNodeDragMessage") return false;
      if (message.phase === "update") return Boolean(drag && camera);
      drag = message.phase === "start" ? message : null;
      pointer = null;
      // the spring stands for the arrow of the hand
      if (drag) for (const name of HAND) show({ type: "SetSceneNodeVisibilityMessage", name, visible: false });
      draw(drawPull);
      return false;
    },
  };
})();
