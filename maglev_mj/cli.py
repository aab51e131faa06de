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
from maglev_mj.experiments.drop import PLANTS, DropParameters, DropResult, run_drop, sweep_drop
from maglev_mj.report import device_report
from maglev_mj.tables import device_table, drop_table

__all__ = ["main"]

_PICTURED_PHASES = 50


class _Parser(argparse.ArgumentParser):
    """An argument parser whose complaint is one line."""

    def error(self, message: str) -> Any:
        self.exit(2, f"{self.prog}: {message}\n")


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; return the exit status: 0, 1 for a run that failed, 2 for bad input."""
    parser = _parser()
    options = parser.parse_args(_joined(sys.argv[1:] if arguments is None else arguments))
    try:
        status: int = options.run(options)
        return status
    except ParameterError as error:
        print(f"maglev-mj {options.command}: {error}", file=sys.stderr)
        return 2
    except (MaglevError, OSError) as error:
        print(f"maglev-mj {options.command}: {error}", file=sys.stderr)
        return 1


def _joined(arguments: Sequence[str]) -> list[str]:
    """Join an option and a negative number after it: argparse takes -1e-3 and -inf for options of their own."""
    joined: list[str] = []
    for argument in arguments:
        if joined and joined[-1].startswith("--") and "=" not in joined[-1] and _is_negative_number(argument):
            joined[-1] += f"={argument}"
        else:
            joined.append(argument)
    return joined


def _is_negative_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return text.startswith("-")


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
        print(device_table(report))
    return 0


def _drop(options: argparse.Namespace) -> int:
    parameters = DropParameters(**{field.name: getattr(options, field.name) for field in fields(DropParameters)})
    try:
        study = _DropStudy(parameters, options.phases, alone=options.json == "-" and options.out is None)
    except DivergenceError as error:
        _keep_partial(error, options)
        raise
    if options.json is not None:
        data = study.results[0].as_json()
        if study.sweeps:
            data["sweep"] = study.sweeps[0].as_json()
        _write_json(options.json, data)
    pictures = [] if options.out is None else study.draw(options.out)
    if options.json != "-":
        print(drop_table(study.labels, study.results, study.sweeps, study.gap()))
        for path in pictures:
            print(f"  wrote {path}")
    return 0


class _DropStudy:
    """A drop, the same without its pulse unless it is wanted alone or has none, and their sweeps."""

    def __init__(self, parameters: DropParameters, phases: int | None, *, alone: bool) -> None:
        self.labels, variants = ["with pulse"], [parameters]
        if parameters.pulse == 0.0:
            self.labels = ["no pulse"]
        elif not alone:
            self.labels.append("without pulse")
            variants.append(replace(parameters, pulse=0.0))
        self.results = [run_drop(variant) for variant in variants]
        try:
            self.sweeps = [] if phases is None else [sweep_drop(variant, phases) for variant in variants]
        except DivergenceError as error:
            error.partial = self.results[0]  # the drop itself is worth keeping
            raise

    def gap(self) -> float:
        """Return how far the two plants are apart on this drop [m]."""
        result = self.results[0]
        other = "exact" if result.parameters.plant == "mujoco" else "mujoco"
        twin = run_drop(replace(result.parameters, plant=other))
        return float(np.abs(result.series()[1] - twin.series()[1]).max())

    def draw(self, folder: Path) -> list[Path]:
        """Draw figures 3 and 4 and the spread over phases; return the files."""
        charts.require()
        sweeps = self.sweeps or [
            sweep_drop(replace(result.parameters, plant="exact"), _PICTURED_PHASES) for result in self.results
        ]
        folder.mkdir(parents=True, exist_ok=True)
        runs = list(zip(self.labels, self.results, strict=True))
        return [
            charts.time_series(runs, folder / "drop_time.png"),
            charts.phase_plane(runs, folder / "drop_phase_plane.png"),
            charts.phases(list(zip(self.labels, sweeps, strict=True)), folder / "drop_phases.png"),
        ]


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


if __name__ == "__main__":
    sys.exit(main())
