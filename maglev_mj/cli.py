"""The command line: `maglev-mj info`, `maglev-mj drop`, `maglev-mj stick-slip`."""

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
from maglev_mj.experiments.drop import DropParameters, run_drop, sweep_drop
from maglev_mj.experiments.stick_slip import StickSlipParameters, run_stick_slip
from maglev_mj.options import Parser, add_drop_options, add_stick_slip_options, joined
from maglev_mj.report import device_report
from maglev_mj.tables import device_table, drop_table, stick_slip_table

__all__ = ["main"]

_PICTURED_PHASES = 50


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; return the exit status: 0, 1 for a run that failed, 2 for bad input."""
    parser = _parser()
    options = parser.parse_args(joined(sys.argv[1:] if arguments is None else arguments))
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
    parser = Parser(prog="maglev-mj", description=maglev_mj.__doc__)
    parser.add_argument("--version", action="version", version=f"maglev-mj {maglev_mj.__version__}")
    commands = parser.add_subparsers(dest="command", required=True, metavar="command")
    info = commands.add_parser("info", help="Table 1 of the paper beside what the model yields")
    info.add_argument("--json", metavar="FILE", help="write the figures as JSON; - for standard output")
    info.set_defaults(run=_info)
    drop = commands.add_parser("drop", help="drop the flotor on a stiff wall (figures 3 and 4)")
    add_drop_options(drop)
    drop.set_defaults(run=_drop)
    friction = commands.add_parser("stick-slip", help="pull the flotor out of rendered friction (figure 8)")
    add_stick_slip_options(friction)
    friction.set_defaults(run=_stick_slip)
    return parser


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


def _stick_slip(options: argparse.Namespace) -> int:
    parameters = StickSlipParameters(
        **{field.name: getattr(options, field.name) for field in fields(StickSlipParameters)}
    )
    try:
        result = run_stick_slip(parameters)
    except DivergenceError as error:
        _keep_partial(error, options)
        raise
    if options.json is not None:
        _write_json(options.json, result.as_json())
    pictures = []
    if options.out is not None:
        charts.require()
        options.out.mkdir(parents=True, exist_ok=True)
        pictures.append(charts.stick_slip(result, options.out / "stick_slip.png"))
    if options.json != "-":
        print(stick_slip_table(result))
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
    if error.partial is not None and options.json is not None:
        _write_json(options.json, {**error.partial.as_json(), "diverged": str(error)})


def _write_json(target: str, data: dict[str, Any]) -> None:
    text = json.dumps(data, allow_nan=False)
    if target == "-":
        print(text)
    else:
        Path(target).write_text(text + "\n", encoding="utf-8")


if __name__ == "__main__":
    sys.exit(main())
