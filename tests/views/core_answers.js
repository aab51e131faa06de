// node core_answers.js CORE < cases.json > answers.json: what core.js of the pages computes, for tests/views/test_pages.py.
"use strict";
const core = require(process.argv[2]);
const { loops, walls, glides, pulls } = JSON.parse(require("fs").readFileSync(0, "utf8"));

function positions({ law, gains, hand, ticks, ...timing }) {
  const loop = new core.Loop({ ...timing, law: new core[law](gains), stop: Infinity });
  return Array.from({ length: ticks }, (_, tick) => {
    loop.run((tick + timing.phase) * timing.period, { stiffness: hand, target: 0 });
    return loop.x;
  });
}

// Ends of a motion between two switches, with the metal stops; and how far outside it would be without them.
function glide({ force, hand, time, ...start }) {
  const loop = new core.Loop({ law: null, period: 1, ...start });
  loop.force = force;
  loop.glide(time, hand);
  let outside = -Infinity;
  for (let i = 0; i <= 1000; i++) {
    const [x] = core.move(start.x, start.v, force, hand, core.MASS, time * i / 1000);
    outside = Math.max(outside, Math.abs(x) - core.STOP);
  }
  return { x: loop.x, v: loop.v, time: loop.time, hits: loop.hits, outside };
}

// Position [m] and state after each change of a friction that is pulled at 4 mm/s by a spring of 2000 N/m.
function pull({ rate, breakaway }) {
  const law = new core.StickSlip({ stiffness: 6000, damping: 60, breakaway, slow: 5e-3 });
  const loop = new core.Loop({ law, period: 1 / rate, delay: 0.0015 }), changes = [];
  for (let t = 0, stuck = true; t < 1.2; t += 1e-4) {
    loop.run(t, { stiffness: 2000, target: 4e-3 * t });
    if (law.stuck !== stuck) changes.push([loop.x, stuck = law.stuck]);
  }
  return changes;
}

process.stdout.write(JSON.stringify({
  positions: loops.map(positions),
  radii: walls.map(wall => core.spectralRadius(wall, wall)),
  critical: walls.map(wall => core.criticalStiffness(wall.damping, wall)),
  glides: glides.map(glide),
  pulls: pulls.map(pull),
  stop: core.STOP,
  mostHits: core.MOST_HITS,
}));
