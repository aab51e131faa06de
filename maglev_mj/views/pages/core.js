// Physics of the pages: one axis under a sampled, delayed and held force. Units: m, s, kg, N. No drawing; runs in node too.
"use strict";

const MASS = 0.7;           // flotor with its handle
const STOP = 4.5e-3;        // metal stops at -STOP and +STOP
const RESTITUTION = 0.3;    // speed after a stop / speed before it
const REST = 1e-3;          // speed after a stop below which it is 0 [m/s]
const MOST_HITS = 60;       // of the stops between two switches of the force; see `glide`
const NO_HAND = { stiffness: 0, target: 0 };

// 1. Motion between two switches of the force, in closed form.
//
// A constant force F and a hand, which is a spring k with its far end at p:
//     m x" = F + k (p - x).
// Without a hand    x(t) = x0 + v0 t + F t² / 2m.
// With one          x(t) = c + (x0 - c) cos wt + (v0 / w) sin wt,   w² = k / m,   c = p + F / k.
function move(x, v, force, hand, mass, t) {
  if (hand.stiffness === 0) return [x + v * t + force / mass * t * t / 2, v + force / mass * t];
  const w = Math.sqrt(hand.stiffness / mass), centre = hand.target + force / hand.stiffness;
  const cos = Math.cos(w * t), sin = Math.sin(w * t);
  return [centre + (x - centre) * cos + v / w * sin, v * cos - w * (x - centre) * sin];
}

// First time at which this motion reaches `stop` from below; Infinity if it does not. At the stop itself: 0 if it is pushed or
// moves outwards, else the time of its return. The lower stop is the upper one of the mirrored motion.
function reaches(stop, x, v, force, hand, mass) {
  const gap = stop - x, a = (force + hand.stiffness * (hand.target - x)) / mass;
  if (gap <= 0 && (v > 0 || (v === 0 && a > 0))) return 0;
  if (hand.stiffness === 0) {
    const square = v * v + 2 * a * gap;
    if (square < 0 || (v <= 0 && a <= 0)) return Infinity;
    return v > 0 ? 2 * gap / (v + Math.sqrt(square)) : (Math.sqrt(square) - v) / a;
  }
  const w = Math.sqrt(hand.stiffness / mass), centre = hand.target + force / hand.stiffness;
  const size = Math.hypot(x - centre, v / w), share = (stop - centre) / size;      // x = centre + size cos(wt - start)
  if (!(share <= 1)) return Infinity;
  const turn = Math.atan2(v / w, x - centre) - Math.acos(Math.max(-1, share));
  if (gap <= 0) return (Math.min(turn, 0) + 2 * Math.PI) / w;                       // it leaves
  if (turn >= 0) return turn / w;
  return v > 0 && turn > -1e-6 ? 0 : (turn + 2 * Math.PI) / w;                      // just before the stop, by rounding past it
}

// 2. The loop: sample k is taken at (k + phase) T; its command acts from `delay` later until the next one does.
//
// A law answers position x and finite difference (x[k] - x[k-1]) / T with { force, pulse, width }:
// the force to hold, and a force `pulse` on top of it for the first `width` seconds.
class Loop {
  constructor({ law, period, delay = 0, phase = 0, mass = MASS, load = 0, stop = STOP, x = 0, v = 0 }) {
    Object.assign(this, { law, period, delay, mass, load, stop, x, v });
    this.time = 0;            // now
    this.force = 0;           // held by the actuator
    this.extra = 0;           // pulse on top of it
    this.extraEnds = Infinity;
    this.origin = phase * period;
    this.tick = 0;
    this.last = null;         // position at the last sample
    this.waiting = [];        // commands on their way
    this.hits = 0;            // of a metal stop in the last glide
  }

  // Continue with another period and delay, from now.
  retime(period, delay) {
    Object.assign(this, { period, delay, origin: this.time, tick: 0, waiting: [] });
  }

  run(until, hand = NO_HAND) {
    for (;;) {
      const sample = this.origin + this.tick * this.period;
      const command = this.waiting.length ? this.waiting[0].at : Infinity;
      const next = Math.min(until, sample, command, this.extraEnds);
      this.glide(next, hand);
      if (next === sample) this.sample(sample);
      else if (next === command) this.act(this.waiting.shift());
      else if (next === this.extraEnds) this.endPulse();
      else return;
    }
  }

  sample(now) {
    const speed = this.last === null ? 0 : (this.x - this.last) / this.period;
    this.waiting.push({ at: now + this.delay, ...this.law.answer(this.x, speed) });
    this.last = this.x;
    this.tick += 1;
  }

  act({ at, force, pulse = 0, width = 0 }) {
    this.force = force;
    this.extra = pulse;
    this.extraEnds = pulse ? at + width : Infinity;
  }

  endPulse() {
    this.extra = 0;
    this.extraEnds = Infinity;
  }

  // Move under the present force. A metal stop returns RESTITUTION of the speed, below REST none, and holds what is pushed.
  //
  // It ends: the force has a potential, so that a handle returns to a stop no faster than it left, and after a few hits is
  // slower than REST. It then rests, or leaves for a swing of the hand's spring. MOST_HITS is more than a page can reach.
  glide(until, hand) {
    const force = this.force + this.extra + this.load, mirrored = { ...hand, target: -hand.target };
    this.hits = 0;
    while (this.time < until) {
      const left = until - this.time;
      const up = reaches(this.stop, this.x, this.v, force, hand, this.mass);
      const down = reaches(this.stop, -this.x, -this.v, -force, mirrored, this.mass);
      const time = Math.min(up, down), side = up <= down ? 1 : -1;
      if (time > left || !Number.isFinite(time)) {
        const [x, v] = move(this.x, this.v, force, hand, this.mass, left);
        Object.assign(this, { x: Math.max(-this.stop, Math.min(this.stop, x)), v, time: until });
        return;
      }
      const speed = Math.abs(move(this.x, this.v, force, hand, this.mass, time)[1]) * RESTITUTION;
      const pushed = side * (force + hand.stiffness * (hand.target - side * this.stop)) >= 0;
      Object.assign(this, { x: side * this.stop, v: speed < REST ? 0 : -side * speed, time: this.time + time });
      this.hits += 1;
      if ((this.v === 0 && pushed) || this.hits >= MOST_HITS) Object.assign(this, { v: 0, time: until });
    }
  }

  get atStop() { return Math.abs(this.x) === this.stop && this.v === 0; }
}

// 3. Laws.

// Wall at x >= edge:  f = -K (x - edge) - B v.  If the last sample was outside, f = -(pulse + B) v for `width` first.
// Outside, a soft spring leads home; inside, its force is constant, so that stability is that of the wall alone.
class Wall {
  constructor(gains) {
    this.gains = gains;       // { edge, stiffness, damping, pulse, width, home, homeDamping }
    this.free = false;        // whether the last sample was outside
  }

  answer(x, v) {
    const { edge, stiffness, damping, pulse = 0, width = 0, home = 0, homeDamping = 0 } = this.gains;
    const inside = x >= edge, entered = inside && this.free && v >= 0;
    this.free = !inside;
    if (!inside) return { force: -home * x - homeDamping * v };
    const spring = -stiffness * (x - edge) - damping * v, lead = -home * edge;
    return { force: spring + lead, pulse: entered && pulse ? -(pulse + damping) * v - spring : 0, width };
  }
}

// Stick-slip after Karnopp.  Stuck at a:  f = k (a - x) - B v,  until |k (a - x)| > breakaway.
// Slipping:  f = -B v,  until |v| < slow; it then sticks where it is.
class StickSlip {
  constructor(gains) {
    Object.assign(this, { gains, stuck: true, anchor: null });
  }

  answer(x, v) {
    const { stiffness, damping, breakaway, slow } = this.gains;
    if (this.anchor === null) this.anchor = x;
    const pull = stiffness * (this.anchor - x);
    const holds = this.stuck && Math.abs(pull) <= breakaway;
    const sticks = !this.stuck && Math.abs(v) < slow;
    if (!holds) this.anchor = x;
    this.stuck = holds || sticks;
    return { force: (holds ? pull : 0) - damping * v };
  }
}

// 4. Stability of the wall, { stiffness K, damping B }, in a loop { period T, delay, mass, hand }, `hand` the stiffness of a
//    hand that is a spring, or 0.
//
// Let the delay be n T + r. In one period the force before the last acts for r seconds, the last one for e = T - r. Of 1 N from
// rest let p(t) be the path, and s(t) = m p'(t) the path of a push of 1 N s times m; c = cos wT of the hand's spring. Then
//     x / f = N(z) / (z^n (z² - 2 c z + 1)),   N = (z - c) (p0 + p1 / z) + s(T) (s0 + s1 / z) / m,
//     p0 = p(e),  p1 = p(T) - p(e),  s0 = s(e),  s1 = s(T) - s(e),
// and the loop closes with  1 + x/f (K + B (1 - 1/z) / T) = 0.  On the boundary of stability z = exp(i u), where
//     -f/x = Q exp(i q),   Q = 2 (c - cos u) / |N|,   q = (n + 1) u - arg N.
// Imaginary and real part give both gains:  B = T Q sin q / sin u,   K = Q cos q - B (1 - cos u) / T.
function responses({ period: T, delay, mass: m = MASS, hand: k = 0 }) {
  const n = Math.floor(delay / T + 1e-9), e = T - Math.max(0, delay - n * T), w = Math.sqrt(k / m);
  const path = t => k ? 2 * Math.sin(w * t / 2) ** 2 / k : t * t / 2 / m;
  const push = t => k ? Math.sin(w * t) / w : t;
  return { n, m, w, c: Math.cos(w * T), S: push(T), p0: path(e), p1: path(T) - path(e), s0: push(e), s1: push(T) - push(e) };
}

function boundaryAt(u, loop) {
  const { n, m, w, c, S, p0, p1, s0, s1 } = responses(loop), T = loop.period, cos = Math.cos(u), sin = Math.sin(u);
  const re = (p0 - c * p1) * cos + p1 - c * p0 + S * (s0 + s1 * cos) / m, im = (p0 + c * p1 - S * s1 / m) * sin;
  const size = 4 * (Math.sin(u / 2) ** 2 - Math.sin(w * T / 2) ** 2) / Math.hypot(re, im);
  const angle = (n + 1) * u - Math.atan2(im, re);
  const damping = T * size * Math.sin(angle) / sin;
  return { damping, stiffness: size * Math.cos(angle) - damping * (1 - cos) / T };
}

// At z = -1 both gains are real:  K + 2 B / T = -f/x.
function alternating(loop) {
  const { n, m, c, S, p0, p1, s0, s1 } = responses(loop);
  return -2 * (1 + c) * (n % 2 ? -1 : 1) / ((-1 - c) * (p0 - p1) + S * (s0 - s1) / m);
}

// All points where u -> left(boundary) crosses zero.
function crossings(loop, left) {
  const found = [], count = 300 * (responses(loop).n + 2);
  let before = 1e-4, sign = Math.sign(left(boundaryAt(before, loop)));
  for (let i = 1; i < count; i++) {
    const after = Math.PI * i / count, next = Math.sign(left(boundaryAt(after, loop)));
    if (next !== sign) {
      let [low, high] = [before, after];
      for (let j = 0; j < 50; j++) {
        const middle = (low + high) / 2;
        if (Math.sign(left(boundaryAt(middle, loop))) === sign) low = middle; else high = middle;
      }
      found.push(boundaryAt(low, loop));
    }
    [before, sign] = [after, next];
  }
  return found;
}

// Largest damping with which a very soft wall is stable.
function largestDamping(loop) {
  const line = alternating(loop) * loop.period / 2;
  return Math.min(...crossings(loop, point => point.stiffness).map(point => point.damping).concat(line).filter(B => B > 0));
}

// Critical stiffness: all softer walls are stable; 0 if none is. With a hand, a softer wall is asked for its spectral radius: a
// long delay lets the hand's spring swing up by itself.
function criticalStiffness(damping, loop, most = loop.hand ? Infinity : largestDamping(loop)) {
  if (damping <= 0 || damping >= most) return 0;
  const line = alternating(loop) - 2 * damping / loop.period;
  const all = crossings(loop, point => point.damping - damping).map(point => point.stiffness).concat(line).filter(K => K > 0 && K < Infinity);
  if (!all.length || (loop.hand && spectralRadius({ stiffness: Math.min(...all) / 2, damping }, loop) >= 1)) return 0;
  return Math.min(...all);
}

// Spectral radius of one period, by squaring its matrix: stable below 1.
// The state is x, v, x of the last sample, and the forces on their way.
function spectralRadius({ stiffness: K, damping: B }, loop) {
  const { n, m, w, c, S, p0, p1, s0, s1 } = responses(loop), T = loop.period, size = n + 4;
  let A = Array.from({ length: size }, () => new Array(size).fill(0));
  const law = [-(K + B / T), 0, B / T];                      // f = law · (x, v, last x)
  A[0][0] = A[1][1] = c;
  A[0][1] = S;
  A[1][0] = -w * w * S;
  A[2][0] = 1;
  law.forEach((gain, i) => { A[3][i] = gain; });             // the force of this sample
  for (let i = 4; i < size; i++) A[i][i - 1] = 1;            // the others grow older
  const add = (row, age, share) => age === 0
    ? law.forEach((gain, i) => { A[row][i] += share * gain; })
    : (A[row][2 + age] += share);
  add(0, n, p0);
  add(0, n + 1, p1);
  add(1, n, s0 / m);
  add(1, n + 1, s1 / m);
  let log = 0;
  for (let power = 1, i = 0; i < 40; i++, power *= 2) {
    const largest = Math.max(...A.flat().map(Math.abs));
    log += Math.log(largest) / power;
    A = A.map(row => row.map(value => value / largest));
    A = A.map(row => A[0].map((_, j) => row.reduce((sum, value, k) => sum + value * A[k][j], 0)));
  }
  return Math.exp(log);
}

if (typeof module !== "undefined") {
  module.exports = { MASS, STOP, MOST_HITS, Loop, Wall, StickSlip, criticalStiffness, largestDamping, spectralRadius, move };
}
