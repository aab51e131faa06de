"""Frame rate of the window with and without shadows, in turns; under Xvfb the processor draws.

xvfb-run -a python scripts/benchmarks/bench_window.py [--seconds X] [--turns N]
"""

from __future__ import annotations

import argparse

from maglev_mj.session import Session
from maglev_mj.views.window.window import show

parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
parser.add_argument("--seconds", type=float, default=8.0, help="of each turn (default 8)")
parser.add_argument("--turns", type=int, default=3, help="of each kind (default 3)")
options = parser.parse_args()
for turn in range(options.turns):
    for shadows in (True, False):
        report = show(Session(), duration=options.seconds, shadows=shadows)
        words = "with shadows" if shadows else "without"
        rate, cost = report.frames / report.wall_time, 1e3 * report.frame_cost
        print(f"{turn + 1}  {words:12}  {rate:5.1f} frames a second, {cost:4.0f} ms each, {report.missed} ticks missed")
