"""`maglev-mj stick-slip`: the flotor pulled out of rendered friction."""

from __future__ import annotations

import argparse
from dataclasses import fields
from typing import Any

from maglev_mj import plots
from maglev_mj.cli.options import add_options, add_outputs, add_recording
from maglev_mj.cli.output import check_recording, keep_partial, write_json
from maglev_mj.errors import DivergenceError
from maglev_mj.experiments.stick_slip import StickSlipParameters, run_stick_slip
from maglev_mj.frames import AXES
from maglev_mj.replay import write_experiment
from maglev_mj.scenes.choices import LAWS, PLANTS, VELOCITIES
from maglev_mj.tables import stick_slip_table

__all__ = ["STICK_SLIP_HELPS", "add_command"]

STICK_SLIP_HELPS = {
    "period": "sample period [s]",
    "delay": "from a sample to its command taking effect [s]",
    "quantize": "resolution of the position sensor [m]",
    "spring": "stiffness of the virtual spring [N/m]",
    "target": "where the spring's far end is [m]",
    "stiffness": "stiffness of the friction law while stuck [N/m]",
    "damping": "viscous damping [N s/m]",
    "breakaway": "breakaway force [N]",
    "v_min": "speed below which the flotor sticks [m/s]",
    "duration": "simulated time [s]",
}


def add_command(commands: Any) -> None:
    """Add the command to the parser's."""
    friction = commands.add_parser("stick-slip", help="pull the flotor out of rendered friction (figure 8)")
    _add_stick_slip_options(friction)
    friction.set_defaults(run=_stick_slip)


def _add_stick_slip_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of `maglev-mj stick-slip`."""
    names = {"plant": PLANTS, "law": tuple(LAWS), "velocity": tuple(VELOCITIES), "axis": AXES}
    add_options(parser, names, STICK_SLIP_HELPS, StickSlipParameters)
    add_outputs(parser)
    add_recording(parser)
    parser.epilog = (
        "On a rotation axis values are in N m/rad, rad, N m s/rad, N m and rad/s, and the defaults are those of a "
        "translation at the radius of gyration. Gravity is compensated; the other axes are held."
    )


def _stick_slip(options: argparse.Namespace) -> int:
    parameters = StickSlipParameters(
        **{field.name: getattr(options, field.name) for field in fields(StickSlipParameters)}
    )
    check_recording(options.record)
    recorded = [] if options.record is None else write_experiment(options.record, "stick-slip", parameters)
    try:
        result = run_stick_slip(parameters)
    except DivergenceError as error:
        keep_partial(error, options)
        raise
    if options.json is not None:
        write_json(options.json, result.as_json())
    pictures = []
    if options.out is not None:
        plots.require()
        options.out.mkdir(parents=True, exist_ok=True)
        pictures.append(plots.stick_slip(result, options.out / "stick_slip.png"))
    if options.json != "-":
        print(stick_slip_table(result))
        for path in [*recorded, *pictures]:
            print(f"  wrote {path}")
    return 0
