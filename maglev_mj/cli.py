"""The command line: `maglev-mj info`, `maglev-mj drop`."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Sequence
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np

import maglev_mj
from maglev_mj import charts
from maglev_mj.errors import DivergenceError, MaglevError, ParameterError
from maglev_mj.experiments.drop import PLANTS, DropParameters, DropResult, DropSweep, run_drop, sweep_drop
from maglev_mj.report import device_report, render

__all__ = ["main"]

_PICTURED_PHASES = 50


class _Parser(argparse.ArgumentParser):
    """An argument parser whose complaint is one line."""

    def error(self, message: str) -> Any:
        self.exit(2, f"{self.prog}: {message}\n")


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; return the exit status: 0, 1 for a run that failed, 2 for bad input."""
    parser = _parser()
    options = parser.parse_args(arguments)
    try:
        status: int = options.run(options)
        return status
    except ParameterError as error:
        print(f"maglev-mj {options.command}: {error}", file=sys.stderr)
        return 2
    except (MaglevError, OSError) as error:
        print(f"maglev-mj {options.command}: {error}", file=sys.stderr)
        return 1


def _parser() -> argparse.ArgumentParser:
    parser = _Parser(prog="maglev-mj", description=maglev_mj.__doc__)
    parser.add_argument("--version", action="version", version=f"maglev-mj {maglev_mj.__version__}")
    commands = parser.add_subparsers(dest="command", required=True, metavar="command")
    info = commands.add_parser("info", help="Table 1 of the paper beside what the model yields")
    info.add_argument("--json", metavar="FILE", help="write the figures as JSON; - for standard output")
    info.set_defaults(run=_info)
    drop = commands.add_parser("drop", help="drop the flotor on a stiff wall (figures 3 and 4)")
    _add_drop_options(drop)
    drop.set_defaults(run=_drop)
    return parser


def _add_drop_options(parser: argparse.ArgumentParser) -> None:
    defaults = DropParameters()
    helps = {
        "height": "drop height above the wall [m]",
        "phase": "the samples are at (k + phase) period after release, in [0, 1)",
        "period": "sample period [s]",
        "delay": "from a sample to its command taking effect [s]",
        "stiffness": "wall stiffness [N/m]",
        "damping": "wall damping [N s/m]",
        "pulse": "further damping in the braking pulse [N s/m]; 0 for none",
        "pulse_width": "how long the pulse lasts [s]",
        "mass": "moving mass [kg]",
        "force_limit": "largest force of the actuators along z [N]; the device's is 60",
        "quantize": "resolution of the position sensor [m]",
        "duration": "simulated time from release [s]",
    }
    parser.add_argument("--plant", default=defaults.plant, help=f"{' or '.join(PLANTS)} (default {defaults.plant})")
    for name, text in helps.items():
        default = getattr(defaults, name)
        shown = "none" if default is None else f"{default:g}"
        parser.add_argument(
            f"--{name.replace('_', '-')}", type=_number, default=default, metavar="X", help=f"{text} (default {shown})"
        )
    parser.add_argument(
        "--carry",
        action="store_true",
        help="carry the braking that the force limit cuts off over to the next samples; otherwise it is lost",
    )
    parser.add_argument("--phases", type=_count, metavar="N", help="also sweep N phases, evenly spread over a period")
    parser.add_argument(
        "--json", metavar="FILE", help="write parameters, motion and figures as JSON; - for standard output"
    )
    parser.add_argument("--out", metavar="DIR", type=Path, help="write pictures to this folder")


def _number(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        raise argparse.ArgumentTypeError(f"must be a number, not {text!r}") from None


def _count(text: str) -> int:
    try:
        return int(text)
    except ValueError:
        raise argparse.ArgumentTypeError(f"must be a whole number, not {text!r}") from None


def _info(options: argparse.Namespace) -> int:
    report = device_report()
    if options.json is not None:
        _write_json(options.json, {"figures": report.figures, "contradictions": report.contradictions})
    if options.json != "-":
        print(render(report))
    return 0


def _drop(options: argparse.Namespace) -> int:
    chosen = {field.name: getattr(options, field.name) for field in fields(DropParameters)}
    parameters = DropParameters(**chosen)
    if options.phases is not None and options.phases < 1:
        raise ParameterError(f"phases must be at least 1, not {options.phases}")
    try:
        result = run_drop(parameters)
    except DivergenceError as error:
        _keep_partial(error, options)
        raise
    sweep = None if options.phases is None else sweep_drop(parameters, options.phases)
    if options.json is not None:
        data = result.as_json()
        if sweep is not None:
            data["sweep"] = sweep.as_json()
        _write_json(options.json, data)
    plain = None
    if parameters.pulse > 0.0 and (options.json != "-" or options.out is not None):
        plain = replace(parameters, pulse=0.0)
    pictures = [] if options.out is None else _pictures(result, plain, sweep, options.out)
    if options.json != "-":
        print(_drop_summary(result, plain, sweep))
        for path in pictures:
            print(f"  wrote {path}")
    return 0


def _keep_partial(error: DivergenceError, options: argparse.Namespace) -> None:
    """Write what was recorded before the run diverged."""
    if isinstance(error.partial, DropResult) and options.json is not None:
        _write_json(options.json, {**error.partial.as_json(), "diverged": str(error)})


def _write_json(target: str, data: dict[str, Any]) -> None:
    text = json.dumps(data, allow_nan=False)
    if target == "-":
        print(text)
    else:
        Path(target).write_text(text + "\n", encoding="utf-8")


def _pictures(result: DropResult, plain: DropParameters | None, sweep: DropSweep | None, folder: Path) -> list[Path]:
    """Draw figures 3 and 4 and the spread over phases, with and without the pulse where there is one."""
    runs, variants = [("with pulse" if plain else "no pulse", result)], [result.parameters]
    if plain is not None:
        runs.append(("without pulse", run_drop(plain)))
        variants.append(plain)
    sweeps = []
    for (label, _), variant in zip(runs, variants, strict=True):
        ready = sweep if variant is result.parameters else None
        count = _PICTURED_PHASES if sweep is None else sweep.phases.size
        sweeps.append((label, ready or sweep_drop(replace(variant, plant="exact"), count)))
    folder.mkdir(parents=True, exist_ok=True)
    return [
        charts.time_series(runs, folder / "drop_time.png"),
        charts.phase_plane(runs, folder / "drop_phase_plane.png"),
        charts.phases(sweeps, folder / "drop_phases.png"),
    ]


def _drop_summary(result: DropResult, plain: DropParameters | None, sweep: DropSweep | None) -> str:
    """Return a table for the terminal: this drop, the one without pulse, the other plant, the spread."""
    parameters = result.parameters
    other = run_drop(replace(parameters, plant="exact" if parameters.plant == "mujoco" else "mujoco"))
    gap = float(np.abs(result.series()[1] - other.series()[1]).max())
    limit = "none" if parameters.force_limit is None else f"{parameters.force_limit:g} N"
    columns = [("with pulse" if plain else "no pulse", result.summary)]
    if plain is not None:
        columns.append(("without", run_drop(plain).summary))
    if sweep is not None:
        spread = sweep.as_json()
    lines = [
        f"Drop of {parameters.height * 1e3:g} mm on a wall of {parameters.stiffness:g} N/m and "
        f"{parameters.damping:g} N s/m, plant {parameters.plant}",
        f"  {1.0 / parameters.period:g} Hz, delay {parameters.delay * 1e3:g} ms, mass {parameters.mass:g} kg, pulse "
        f"{parameters.pulse:g} N s/m for {parameters.pulse_width * 1e3:g} ms, force limit {limit}",
        "",
    ]
    head = "".join(f"{name:>14}" for name, _ in columns)
    if sweep is not None:
        head += f"{'median of ' + str(sweep.phases.size):>18}{'5 to 95 %':>18}"
    lines.append(f"  {'':<20}{head}")
    for name, label, scale, unit in (
        ("penetration", "penetration", 1e3, "mm"),
        ("rebound", "rebound", 1e3, "mm"),
        ("peak_force", "peak force", 1.0, "N"),
        ("settling_time", "settling time, 2 %", 1e3, "ms"),
        ("final_z", "final height", 1e3, "mm"),
    ):
        cells = "".join(f"{_cell(getattr(summary, name), scale):>14}" for _, summary in columns)
        if sweep is not None:
            low, middle, high = (spread[key][name] for key in ("percentile_5", "median", "percentile_95"))
            cells += f"{_cell(middle, scale):>18}{_cell(low, scale) + ' to ' + _cell(high, scale):>18}"
        lines.append(f"  {label:<20}{cells}  {unit}")
    lines += ["", f"  MuJoCo and the exact plant differ by at most {gap:.1e} m"]
    return "\n".join(lines)


def _cell(value: Any, scale: float) -> str:
    return "-" if value is None or not np.isfinite(value) else f"{float(value) * scale:.3f}"


if __name__ == "__main__":
    sys.exit(main())
