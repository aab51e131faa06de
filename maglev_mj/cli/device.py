"""Commands for a device without a flight of a scene: info, estop, conform, commission."""

from __future__ import annotations

import math
import signal
import sys
import time
from collections.abc import Sequence
from contextlib import ExitStack, closing, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from maglev_mj.cli.declare import option
from maglev_mj.cli.options import Address, CalibrationFile, Json, Key, Realtime, Seconds
from maglev_mj.cli.output import Progress, write_result
from maglev_mj.errors import MaglevError, ParameterError
from maglev_mj.terminal import say, wrapped

if TYPE_CHECKING:
    import numpy as np

    from maglev_mj.bridge.commissioning.coil_check import CoilCheck
    from maglev_mj.bridge.conformance import CheckResult
    from maglev_mj.bridge.remote import RemotePlant

_WORDS = {True: "pass", False: "FAIL", None: "skip"}
_FORMAT = "maglev_mj conformance 1"
_SHOWN = 0.25  # [s] between two lines of spots
_BLOCKED = "  the flotor must be blocked by something soft; nothing is checked for a hand"


def info(*, json: Json = None) -> int:
    """Table 1 of the paper, and what the model yields."""
    from maglev_mj.plants.shapes import device_report

    write_result(json, device_report())
    return 0


def estop(*, address: Address, key: Key = None) -> int:
    """Cut the currents of a device in any state and session, and latch its fault ESTOP.

    `maglev-mj bridge ADDRESS --reset` shows and clears it.

    Returns:
        Exit status: 0 where the device confirms that its currents are zero; otherwise cut the power. A serial line has
        one user: stop that one by its window's Escape or by Ctrl-C twice.
    """
    from maglev_mj.bridge.connection import estop

    try:
        report = estop(address, key)
    except ParameterError:
        raise
    except (MaglevError, OSError) as error:
        raise MaglevError(f"not confirmed: cut the power ({error})") from None
    say(f"  {address} {report}", None if report.confirmed else sys.stderr)
    return 0 if report.confirmed else 1


def conform(
    *,
    address: Address,
    calibration: CalibrationFile,
    key: Key = None,
    no_flight: Annotated[bool, option("leave out the checks that fly")] = False,
    json: Annotated[Path | None, option("write the report here as well", "output")] = None,
) -> int:
    """Test a device against docs/reference/protocol.md.

    First with at most half the currents that carry its flotor, then in flight, where the flotor is dropped onto its
    stops. Keep hands off. Ctrl-C lands and cuts. Exit status 0 if every check passes, 1 if one fails.
    """
    from maglev_mj.bridge.conformance import checks, conform
    from maglev_mj.bridge.links import open_link, parse_url
    from maglev_mj.bridge.realtime import realtime

    for name in ("SIGTERM", "SIGHUP"):  # as Ctrl-C: a flight is landed
        if hasattr(signal, name):
            signal.signal(getattr(signal, name), signal.default_int_handler)
    with ExitStack() as last:
        peers = 2 if parse_url(address).scheme == "udp" else 1
        links = [last.enter_context(closing(open_link(address, key))) for _ in range(peers)]
        for complaint in last.enter_context(realtime("ignore")):
            say(f"  not in real time: {complaint}", sys.stderr)
        progress = last.enter_context(Progress("conform"))
        every, results = len(checks()), list["CheckResult"]()

        def tell(result: CheckResult) -> None:
            results.append(result)
            with progress.aside():
                _print_check(result)
            progress(len(results), every)

        conform(links, calibration, key, flight=not no_flight, tell=tell)
    counts = {word: sum(one.passed is value for one in results) for value, word in _WORDS.items()}
    say("  " + ", ".join(f"{count} {word}" for word, count in counts.items()))
    if json is not None:
        _write_report(json, address, counts, results)
    return 1 if counts["FAIL"] else 0


def _print_check(result: CheckResult) -> None:
    for line in wrapped(f"{_WORDS[result.passed]}  {result.name}: {result.expected}; {result.seen}", further=" " * 8):
        say(line)


def _write_report(path: Path, address: str, counts: dict[str, int], results: list[CheckResult]) -> None:
    import json

    from maglev_mj.versions import versions

    report = {"format": _FORMAT, "address": address, "versions": versions(), "counts": counts}
    checked = [one._asdict() for one in results]
    path.write_text(json.dumps({**report, "checks": checked}, indent=1) + "\n", "utf-8")


def commission(
    *,
    address: Address,
    test: Annotated[
        Literal["spots", "coils", "step", "offsets"],
        option(
            "spots: show the diodes while a hand moves the flotor, currents off; coils: polarity and place of each "
            "coil, flotor blocked; step: a coil's current loop, flotor blocked; offsets: write the diodes' offsets, "
            "flotor clamped upright at the centre, currents off",
            "",
        ),
    ],
    coil: Annotated[
        int | None, option("one coil, 0 to 5 (default: all; for step 0)", "test", "K", at_least=0, at_most=5)
    ] = None,
    current: Annotated[float, option("in one coil [A]", "test", above=0.0)] = 0.2,
    write: Annotated[Path | None, option("calibration file that offsets writes", "output")] = None,
    calibration: CalibrationFile,
    key: Key = None,
    seconds: Seconds = None,
    realtime: Realtime = "ignore",
) -> int:
    """Diodes and coils of a new device, before it hovers."""
    from maglev_mj.bridge.commissioning.coil_check import mean_pose, record_step, with_offsets
    from maglev_mj.bridge.links import open_link
    from maglev_mj.bridge.remote import RemotePlant

    if (write is not None) != (test == "offsets"):
        raise ParameterError("write must name the file for offsets, and is for offsets alone")
    with RemotePlant(open_link(address, key), calibration=calibration, key=key) as plant:
        if test == "spots":
            _show_spots(plant, seconds)
        elif write is not None:
            with Progress("commission"):
                spots, errors = mean_pose(plant, 1.0 if seconds is None else seconds)
            with_offsets(calibration, spots).save(write)
            print(f"  spots within {errors.max() * 1e6:.2f} µm; wrote {write}")
        elif test == "step":
            print(_BLOCKED)
            with Progress("commission"):
                rows = record_step(plant, coil or 0, current)
            print(_step_table(rows))
        else:
            print(_BLOCKED)
            return _check_coils(plant, range(6) if coil is None else [coil], current)
    return 0


def _show_spots(plant: RemotePlant, seconds: float | None) -> None:
    """Print spots and pose without currents.

    Until Ctrl-C, or for `seconds`.
    """
    import numpy as np

    from maglev_mj.errors import SensingError

    end = math.inf if seconds is None else time.monotonic() + seconds
    print(f"  {'x and y of the spots on diodes 0, 1, 2 [mm]':<43}{'x y z [mm]':>16}{'rx ry rz [°]':>18}")
    every = max(round(_SHOWN / plant.period), 1)
    with suppress(KeyboardInterrupt):
        while time.monotonic() < end:
            try:
                pose = np.array(plant.read().position)
                text = "".join(f"{part:6.2f}" for part in [*pose[:3] * 1e3, *np.degrees(pose[3:])])
            except SensingError:
                text = " no pose has these spots"
            if plant.samples.tick % every == 0:
                spots = "".join(f"{part * 1e3:7.3f}" for part in plant.report.spots)
                print(f" {spots} {text}", flush=True)


def _check_coils(plant: RemotePlant, coils: Sequence[int], current: float) -> int:
    from maglev_mj.bridge.commissioning.coil_check import check_coil

    print("      currents [A]         moved by [µm]       calibrated force [N]")
    print("coil   set  flows others      x     y     z      x      y      z  verdict")
    worst = 0
    with Progress("commission") as progress:
        for place, coil in enumerate(coils):
            check = check_coil(plant, coil, current)
            with progress.aside():
                print(_coil_row(check), flush=True)
            progress(place + 1, len(coils))
            worst |= check.verdict != "as calibrated"
    return worst


def _coil_row(check: CoilCheck) -> str:
    from maglev_mj.result import number_text

    currents = " ".join(f"{part:6.2f}" for part in (check.current, check.measured, check.others))
    moved = " ".join(f"{number_text(part * 1e6, 3, 2):>5}" for part in check.displacement[:3])
    force = " ".join(f"{part:6.2f}" for part in check.expected[:3])
    return f"  {check.coil} {currents}  {moved} {force}  {check.verdict}"


def _step_table(rows: np.ndarray[Any, Any]) -> str:
    lines = ["  after     current"]
    lines += [f"  {after * 1e3:6.2f} ms  {current:7.3f} A" for after, current in rows]
    return "\n".join(lines)
