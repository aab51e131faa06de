"""Commands for a device without a flight of a scene: estop, conform, commission."""

from __future__ import annotations

import math
import sys
import time
from collections.abc import Sequence
from contextlib import ExitStack, closing, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from maglev_mj.cli.declare import option
from maglev_mj.cli.options import Address, DeviceFile, Key, Realtime, Seconds
from maglev_mj.cli.output import Progress
from maglev_mj.errors import MaglevError, ParameterError
from maglev_mj.terminal import say, wrapped

if TYPE_CHECKING:
    import numpy as np

    from maglev_mj.bridge.commissioning.coil_check import CoilCheck
    from maglev_mj.bridge.conformance import CheckResult
    from maglev_mj.bridge.remote import RemotePlant
    from maglev_mj.result import Table

_WORDS = {True: "pass", False: "FAIL", None: "skip"}
_COIL_ROW = "  {:<4} {:>4} {:>6} {:>6}  {:>5} {:>5} {:>5}  {:>5} {:>5} {:>5}  {}"
_COIL_HEAD = (
    f"{'currents [A]':^32}{'moved [µm]':^12}{'calibrated force [N]':>20}",
    _COIL_ROW.format("coil", "set", "actual", "others", *"xyz", *"xyz", "verdict"),
)
_FORMAT = "maglev_mj conformance 1"
_SHOWN = 0.25  # interval between printed lines of spots [s]
_TESTS = {
    "spots": "spots and pose, currents off, flotor moved by hand",
    "coils": "polarity and position of each coil, flotor blocked by soft foam",
    "step": "step response of a coil, flotor blocked by soft foam",
    "offsets": "offsets of the spots, currents off, flotor clamped upright at the centre",
}
_BLOCKED = "  block the flotor with soft foam; hands off: this test does not detect a hand"


def estop(*, address: Address, key: Key = None) -> int:
    """Emergency stop: cut a device's currents and latch the fault ESTOP.

    Works in any state, whichever host is flying. `maglev-mj bridge ADDRESS --reset` shows and clears the fault.

    Returns:
        Exit status: 0 if the device confirmed that its currents are off, or in lockstep the fault alone; otherwise cut
        the power. A serial link has one user only: stop that flight with Escape in its window, or Ctrl-C twice.
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
    calibration: DeviceFile,
    key: Key = None,
    no_flight: Annotated[bool, option("skip the checks that fly")] = False,
    json: Annotated[Path | None, option("report file", "output")] = None,
) -> int:
    """Test a device against docs/reference/protocol.md.

    First with at most half the hover currents, then in flight, where the flotor is dropped onto its stops. Keep hands
    off. Ctrl-C lands, then cuts the currents. Exit status: 0 if no check fails, else 1.
    """
    from maglev_mj.bridge.conformance import checks, conform
    from maglev_mj.bridge.links import open_link, parse_url
    from maglev_mj.bridge.realtime import interrupt, realtime, stopping

    with ExitStack() as last:
        last.enter_context(stopping(interrupt))  # lands, and is raised again by a second Ctrl-C
        peers = 2 if parse_url(address).scheme == "udp" else 1
        links = [last.enter_context(closing(open_link(address, key))) for _ in range(peers)]
        for complaint in last.enter_context(realtime("ignore")):
            say(f"  not in real time: {complaint}", sys.stderr)
        progress = last.enter_context(Progress("conform"))
        total, results = len(checks()), list["CheckResult"]()

        def tell(result: CheckResult) -> None:
            results.append(result)
            with progress.aside():
                _print_check(result)
            progress(len(results), total)

        conform(links, calibration, key, flight=not no_flight, tell=tell)
    say("")
    counts = {word: sum(result.passed is value for result in results) for value, word in _WORDS.items()}
    say("  " + ", ".join(f"{count} {word}" for word, count in counts.items()))
    if json is not None:
        _write_report(json, address, counts, results)
    return 1 if counts["FAIL"] else 0


def _print_check(result: CheckResult) -> None:
    requirement = wrapped(f"{_WORDS[result.passed]}  {result.name}: {result.expected}", further=" " * 8)
    for line in [*requirement, *wrapped(f"result: {result.seen}", " " * 8)]:
        say(line)


def _write_report(path: Path, address: str, counts: dict[str, int], results: list[CheckResult]) -> None:
    import json

    from maglev_mj.files import write_text
    from maglev_mj.versions import versions

    report = {"format": _FORMAT, "address": address, "versions": versions(), "counts": counts}
    checked = [result._asdict() for result in results]
    write_text(path, json.dumps({**report, "checks": checked}, indent=1) + "\n")


def commission(
    *,
    address: Address,
    test: Annotated[
        Literal["spots", "coils", "step", "offsets"],
        option("spots, coils, step or offsets", "", "TEST", meanings=_TESTS),
    ],
    coil: Annotated[
        int | None, option("coil index, 0 to 5 (default: all; for step, 0)", "test", "K", at_least=0, at_most=5)
    ] = None,
    current: Annotated[
        float | None,
        option("test current [A] (default: 0.8 of the largest that counts as off; 0.2 on ubc)", "test", above=0.0),
    ] = None,
    write: Annotated[Path | None, option("device file written by offsets", "output")] = None,
    calibration: DeviceFile,
    key: Key = None,
    seconds: Seconds = None,
    realtime: Realtime = "ignore",
) -> int:
    """Check diodes and coils of a new device before its first hover."""
    from maglev_mj.bridge.commissioning.coil_check import mean_pose, record_step, with_offsets
    from maglev_mj.bridge.links import open_link
    from maglev_mj.bridge.realtime import interrupt, stopping
    from maglev_mj.bridge.remote import RemotePlant

    if (write is not None) != (test == "offsets"):
        raise ParameterError("offsets needs --write FILE; the other tests do not take it")
    with (
        stopping(interrupt, lambda: None),
        RemotePlant(open_link(address, key), calibration=calibration, key=key) as plant,
    ):
        if test == "spots":
            _show_spots(plant, seconds)
        elif write is not None:
            with Progress("commission"):
                spots, errors = mean_pose(plant, 1.0 if seconds is None else seconds)
            with_offsets(calibration, spots).save(write)
            print(f"  standard error of the spots up to {errors.max() * 1e6:.2f} µm; wrote {write}")
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
    """Print spots and pose, currents off, for `seconds` or until Ctrl-C."""
    import numpy as np

    from maglev_mj.errors import SensingError

    end = math.inf if seconds is None else time.monotonic() + seconds
    print(f"  {'spots x, y on diodes 0, 1, 2 [mm]':<43}{'x y z [mm]':>16}{'rx ry rz [°]':>18}")
    every = max(round(_SHOWN / plant.period), 1)
    with suppress(KeyboardInterrupt):
        while time.monotonic() < end:
            try:
                pose = np.array(plant.read().position)
                text = "".join(f"{part:6.2f}" for part in [*pose[:3] * 1e3, *np.degrees(pose[3:])])
            except SensingError:
                text = " no pose matches these spots"
            if plant.samples.tick % every == 0:
                spots = "".join(f"{part * 1e3:7.3f}" for part in plant.report.spots)
                print(f" {spots} {text}", flush=True)


def _check_coils(plant: RemotePlant, coils: Sequence[int], current: float | None) -> int:
    from maglev_mj.bridge.commissioning.coil_check import check_coil

    print(*_COIL_HEAD, sep="\n")
    worst = 0
    with Progress("commission") as progress:
        for index, coil in enumerate(coils):
            check = check_coil(plant, coil, current)
            with progress.aside():
                print(_coil_row(check), flush=True)
            progress(index + 1, len(coils))
            worst |= check.verdict != "as calibrated"
    return worst


def _coil_row(check: CoilCheck) -> str:
    from maglev_mj.result import number_text

    currents = [f"{part:.2f}" for part in (check.current, check.measured, check.others)]
    moved = [number_text(part * 1e6, 3, 2) for part in check.displacement[:3]]
    force = [f"{part:.2f}" for part in check.expected[:3]]
    return _COIL_ROW.format(str(check.coil), *currents, *moved, *force, check.verdict)


def _step_table(rows: np.ndarray[Any, Any]) -> Table:
    from maglev_mj.result import Table

    texts = [(f"{time * 1e3:.2f}", f"{current:.3f}") for time, current in rows]
    return Table("", ("time [ms]", "current [A]"), texts)
