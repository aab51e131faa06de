"""`maglev-mj commission`: sensor and coil tests before the first hover."""

from __future__ import annotations

import argparse
import math
import time
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np

from maglev_mj.bridge.bench.calibration import Calibration
from maglev_mj.bridge.bench.commissioning import CoilCheck, check_coil, mean_pose, record_step, with_offsets
from maglev_mj.bridge.links import open_link
from maglev_mj.bridge.remote import RemotePlant
from maglev_mj.cli.arguments import Parser
from maglev_mj.cli.options import add_bridge, chosen_key, count, number_option
from maglev_mj.cli.progress import Progress
from maglev_mj.errors import ParameterError, SensingError
from maglev_mj.parameters import number
from maglev_mj.result import number_text

_SHOWN = 0.25  # [s] between two lines of spots
_BLOCKED = "  the flotor must be blocked by something soft; nothing is checked for a hand"


def add_options(parser: Parser) -> None:
    """Add the options of the command."""
    parser.add_argument("address", metavar="ADDRESS", help="udp://HOST:PORT, or serial:///PATH?baud=RATE")
    parser.add_argument(
        "test",
        choices=("spots", "coils", "step", "offsets"),
        help="spots: show the diodes while a hand moves the flotor, currents off; coils: polarity and place of each "
        "coil, flotor blocked; step: a coil's current loop, flotor blocked; offsets: write the diodes' offsets, flotor "
        "clamped upright at the centre, currents off",
    )
    test = parser.group("test")
    test.add_argument("--coil", type=count, metavar="K", help="one coil, 0 to 5 (default: all; for step 0)")
    test.add_argument("--current", type=number_option, default=0.2, metavar="X", help="in one coil [A] (default 0.2)")
    told = "calibration file that offsets writes"
    parser.group("output").add_argument("--write", type=Path, metavar="FILE", help=told)
    add_bridge(parser)
    parser.set_defaults(run=_commission)


def _commission(options: argparse.Namespace) -> int:
    seconds = None if options.seconds is None else number("seconds", options.seconds, above=0.0)
    if (options.write is not None) != (options.test == "offsets"):
        raise ParameterError("write must name the file for offsets, and is for offsets alone")
    calibration = Calibration.nominal() if options.calibration is None else Calibration.load(options.calibration)
    number("coil", options.coil or 0, at_least=0, at_most=5)
    number("current", options.current, above=0.0)
    key = chosen_key(options.key)
    with RemotePlant(open_link(options.address, key), calibration=calibration, key=key) as plant:
        if options.test == "spots":
            _show_spots(plant, seconds)
        elif options.test == "offsets":
            with Progress("commission"):
                spots, errors = mean_pose(plant, 1.0 if seconds is None else seconds)
            with_offsets(calibration, spots).save(options.write)
            print(f"  spots within {errors.max() * 1e6:.2f} µm; wrote {options.write}")
        elif options.test == "step":
            print(_BLOCKED)
            with Progress("commission"):
                rows = record_step(plant, options.coil or 0, options.current)
            print(_step_table(rows))
        else:
            print(_BLOCKED)
            return _check_coils(plant, options)
    return 0


def _show_spots(plant: RemotePlant, seconds: float | None) -> None:
    """Print spots and pose without currents.

    Until Ctrl-C, or for `seconds`.
    """
    end = math.inf if seconds is None else time.monotonic() + seconds
    print(f"  {'x and y of the spots on diodes 0, 1, 2 [mm]':<43}{'x y z [mm]':>16}{'rx ry rz [°]':>18}")
    every = max(round(_SHOWN / plant.period), 1)
    with suppress(KeyboardInterrupt):
        while time.monotonic() < end:
            try:
                pose = np.array(plant.read().position)
                found = "".join(f"{part:6.2f}" for part in [*pose[:3] * 1e3, *np.degrees(pose[3:])])
            except SensingError:
                found = " no pose has these spots"
            if plant.samples.tick % every == 0:
                spots = "".join(f"{part * 1e3:7.3f}" for part in plant.report.spots)
                print(f" {spots} {found}", flush=True)


def _check_coils(plant: RemotePlant, options: argparse.Namespace) -> int:
    print("      currents [A]         moved by [µm]       calibrated force [N]")
    print("coil   set  flows others      x     y     z      x      y      z  verdict")
    worst = 0
    with Progress("commission") as progress:
        coils = range(6) if options.coil is None else [options.coil]
        for place, coil in enumerate(coils):
            check = check_coil(plant, coil, options.current)
            with progress.aside():
                print(_coil_row(check), flush=True)
            progress(place + 1, len(coils))
            worst |= check.verdict != "as calibrated"
    return worst


def _coil_row(check: CoilCheck) -> str:
    currents = " ".join(f"{part:6.2f}" for part in (check.current, check.measured, check.others))
    moved = " ".join(f"{number_text(part * 1e6, 3, 2):>5}" for part in check.displacement[:3])
    force = " ".join(f"{part:6.2f}" for part in check.expected[:3])
    return f"  {check.coil} {currents}  {moved} {force}  {check.verdict}"


def _step_table(rows: np.ndarray[Any, Any]) -> str:
    lines = ["  after     current"]
    lines += [f"  {after * 1e3:6.2f} ms  {current:7.3f} A" for after, current in rows]
    return "\n".join(lines)
