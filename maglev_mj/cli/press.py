"""`maglev-mj press`: a hand that hits the wall several times, then presses against it."""

from __future__ import annotations

import argparse
from dataclasses import fields, replace
from typing import Any

import numpy as np

from maglev_mj import plots
from maglev_mj.cli.options import add_options, add_outputs, add_recording, count
from maglev_mj.cli.output import check_outputs, check_recording, keep_partial, write_json
from maglev_mj.cli.progress import Progress
from maglev_mj.errors import DivergenceError
from maglev_mj.experiments.press import PressParameters, run_press, sweep_press
from maglev_mj.hand import HANDS
from maglev_mj.replay import write_experiment
from maglev_mj.scenes.choices import PLANTS
from maglev_mj.tables import press_table

__all__ = ["PRESS_HANDS", "PRESS_HELPS", "add_command"]

PRESS_HELPS = {
    "interval": "from one hit to the next [s]",
    "height": "height above the wall from which the hand hits [m]",
    "press": "force with which it presses in the end [N]",
    "phase": "the samples are at (k + phase) period after the hand begins, in [0, 1)",
    "period": "sample period [s]",
    "delay": "from a sample to its command taking effect [s]",
    "stiffness": "wall stiffness [N/m]",
    "damping": "wall damping [N s/m]",
    "pulse": "further damping in the braking pulse [N s/m]; 0 for none",
    "pulse_width": "how long the pulse lasts [s]",
    "pulse_gate": "approach speed from which on a pulse is given [m/s]",
    "mass": "moving mass [kg]",
    "force_limit": "largest force of the actuators along z [N]; the device's is 60",
    "quantize": "resolution of the position sensor [m]",
    "duration": "simulated time [s]",
}
PRESS_HANDS = (*(name for name in HANDS if name != "none"), "or MASS,DAMPING,STIFFNESS[,GRIP_DAMPING,GRIP_STIFFNESS]")


def add_command(commands: Any) -> None:
    """Add the command to the parser's."""
    press = commands.add_parser("press", help="a hand hits the wall several times, then presses against it (figure 6)")
    _add_press_options(press)
    press.set_defaults(run=_press)


def _add_press_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of `maglev-mj press`."""
    add_options(parser, {"plant": PLANTS, "hand": PRESS_HANDS}, PRESS_HELPS, PressParameters)
    hits = PressParameters().hits
    parser.add_argument("--hits", type=count, default=hits, metavar="N", help=f"how many hits (default {hits})")
    parser.add_argument("--phases", type=count, metavar="N", help="also sweep N phases, evenly spread over a period")
    add_outputs(parser)
    add_recording(parser)


def _press(options: argparse.Namespace) -> int:
    parameters = PressParameters(**{field.name: getattr(options, field.name) for field in fields(PressParameters)})
    check_recording(options.record)
    recorded = [] if options.record is None else write_experiment(options.record, "press", parameters)
    if options.out is not None:
        plots.require()
    check_outputs(json=options.json, out=options.out)
    try:
        study = _PressStudy(parameters, options.phases, alone=options.json == "-" and options.out is None)
    except DivergenceError as error:
        keep_partial(error, options)
        raise
    if options.json is not None:
        data = study.results[0].as_json()
        if study.sweeps:
            data["sweep"] = study.sweeps[0].as_json()
        write_json(options.json, data)
    pictures = []
    if options.out is not None:
        options.out.mkdir(parents=True, exist_ok=True)
        runs = list(zip(study.labels, study.results, strict=True))
        pictures.append(plots.figure_6(runs, options.out / "press.png"))
    if options.json != "-":
        print(press_table(study.labels, study.results, study.sweeps, study.gap()))
        for path in [*recorded, *pictures]:
            print(f"  wrote {path}")
    return 0


class _PressStudy:
    """A run, the same without its pulse unless it is wanted alone or has none, and their sweeps."""

    def __init__(self, parameters: PressParameters, phases: int | None, *, alone: bool) -> None:
        self.labels, variants = ["with pulse"], [parameters]
        if parameters.pulse == 0.0:
            self.labels = ["no pulse"]
        elif not alone:
            self.labels.append("without pulse")
            variants.append(replace(parameters, pulse=0.0))
        self.results = [run_press(variant) for variant in variants]
        progress = Progress("press")
        try:
            self.sweeps = (
                [] if phases is None else [sweep_press(variant, phases, progress=progress) for variant in variants]
            )
        except DivergenceError as error:
            error.partial = self.results[0]  # the run itself is worth keeping
            raise
        finally:
            progress.close()

    def gap(self) -> float:
        """Return how far the two plants are apart on this run [m]."""
        result = self.results[0]
        other = "exact" if result.parameters.plant == "mujoco" else "mujoco"
        twin = run_press(replace(result.parameters, plant=other))
        return float(np.abs(result.series()["z"] - twin.series()["z"]).max())
