"""Command-line options: what the commands share, each complaint one line."""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from maglev_mj.experiments.choices import LAWS, PLANTS, VELOCITIES
from maglev_mj.experiments.drop import DropParameters
from maglev_mj.experiments.stick_slip import StickSlipParameters
from maglev_mj.frames import AXES

__all__ = ["Parser", "add_drop_options", "add_stick_slip_options", "joined"]


class Parser(argparse.ArgumentParser):
    """An argument parser whose complaint is one line."""

    def error(self, message: str) -> Any:
        """Print one line and exit with status 2."""
        self.exit(2, f"{self.prog}: {message}\n")


def joined(arguments: Sequence[str]) -> list[str]:
    """Join an option and a negative number after it: argparse takes -1e-3 and -inf for options of their own."""
    result: list[str] = []
    for argument in arguments:
        if result and result[-1].startswith("--") and "=" not in result[-1] and _is_negative_number(argument):
            result[-1] += f"={argument}"
        else:
            result.append(argument)
    return result


def _is_negative_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return text.startswith("-")


def add_drop_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of `maglev-mj drop`."""
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
    _add_options(parser, {"plant": PLANTS}, helps, DropParameters)
    parser.add_argument(
        "--carry",
        action="store_true",
        help="carry the braking that the force limit cuts off over to the next samples; otherwise it is lost",
    )
    parser.add_argument("--phases", type=_count, metavar="N", help="also sweep N phases, evenly spread over a period")
    _add_outputs(parser)


def add_stick_slip_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of `maglev-mj stick-slip`."""
    helps = {
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
    names = {"plant": PLANTS, "law": tuple(LAWS), "velocity": tuple(VELOCITIES), "axis": AXES}
    _add_options(parser, names, helps, StickSlipParameters)
    _add_outputs(parser)
    parser.epilog = (
        "On a rotation axis values are in N m/rad, rad, N m s/rad, N m and rad/s, and the defaults are those of a "
        "translation at the radius of gyration. Gravity is compensated; the other axes are held."
    )


def _add_options(
    parser: argparse.ArgumentParser, names: Mapping[str, Sequence[str]], helps: Mapping[str, str], parameters: type[Any]
) -> None:
    """Add an option for each name to choose and each number to give, with its default in the help text."""
    made = parameters()
    for name, choices in names.items():
        default = getattr(made, name)
        parser.add_argument(f"--{name}", default=default, help=f"{', '.join(choices)} (default {default})")
    for name, text in helps.items():
        # a default that depends on other options is the class's to fill in: None here, its value in the help
        default = parameters.__dataclass_fields__[name].default
        shown = "none" if getattr(made, name) is None else f"{getattr(made, name):g}"
        option = f"--{name.replace('_', '-')}"
        parser.add_argument(option, type=_number, default=default, metavar="X", help=f"{text} (default {shown})")


def _add_outputs(parser: argparse.ArgumentParser) -> None:
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
