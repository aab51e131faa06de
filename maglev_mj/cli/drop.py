"""`maglev-mj drop`: the flotor dropped on a stiff wall."""

from __future__ import annotations

import argparse
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np

from maglev_mj import plots
from maglev_mj.cli.options import add_options, add_outputs, add_recording, count
from maglev_mj.cli.output import check_recording, keep_partial, write_json
from maglev_mj.errors import DivergenceError
from maglev_mj.experiments.drop import DropParameters, drop_variants, run_drop, sweep_drop
from maglev_mj.replay import write_experiment
from maglev_mj.scenes.choices import PLANTS
from maglev_mj.tables import drop_table

__all__ = ["DROP_HELPS", "add_command"]

_PICTURED_PHASES = 50

DROP_HELPS = {
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


def add_command(commands: Any) -> None:
    """Add the command to the parser's."""
    drop = commands.add_parser("drop", help="drop the flotor on a stiff wall (figures 3 and 4)")
    _add_drop_options(drop)
    drop.set_defaults(run=_drop)


def _add_drop_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of `maglev-mj drop`."""
    add_options(parser, {"plant": PLANTS}, DROP_HELPS, DropParameters)
    parser.add_argument(
        "--carry",
        action="store_true",
        help="carry the braking that the force limit cuts off over to the next samples; otherwise it is lost",
    )
    parser.add_argument("--phases", type=count, metavar="N", help="also sweep N phases, evenly spread over a period")
    add_outputs(parser)
    add_recording(parser)


def _drop(options: argparse.Namespace) -> int:
    parameters = DropParameters(**{field.name: getattr(options, field.name) for field in fields(DropParameters)})
    check_recording(options.record)
    recorded = [] if options.record is None else write_experiment(options.record, "drop", parameters)
    try:
        study = _DropStudy(parameters, options.phases, alone=options.json == "-" and options.out is None)
    except DivergenceError as error:
        keep_partial(error, options)
        raise
    if options.json is not None:
        data = study.results[0].as_json()
        if study.sweeps:
            data["sweep"] = study.sweeps[0].as_json()
        write_json(options.json, data)
    pictures = [] if options.out is None else study.draw(options.out)
    if options.json != "-":
        print(drop_table(study.labels, study.results, study.sweeps, study.gap()))
        for path in [*recorded, *pictures]:
            print(f"  wrote {path}")
    return 0


class _DropStudy:
    """A drop, the drops to compare it with unless it is wanted alone, and their sweeps."""

    def __init__(self, parameters: DropParameters, phases: int | None, *, alone: bool) -> None:
        compared = list(drop_variants(parameters).items())
        self.labels, variants = zip(*compared[:1] if alone else compared, strict=True)
        self.results = [run_drop(variants[0])]
        try:
            self.results += [run_drop(variant) for variant in variants[1:]]
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
        plots.require()
        sweeps = self.sweeps or [
            sweep_drop(replace(result.parameters, plant="exact"), _PICTURED_PHASES) for result in self.results
        ]
        folder.mkdir(parents=True, exist_ok=True)
        runs = list(zip(self.labels, self.results, strict=True))
        return [
            plots.time_series(runs, folder / "drop_time.png"),
            plots.phase_plane(runs, folder / "drop_phase_plane.png"),
            plots.phases(list(zip(self.labels, sweeps, strict=True)), folder / "drop_phases.png"),
        ]
