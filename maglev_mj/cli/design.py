"""`maglev-mj design`: gains of the stiffest wall under given requirements."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from contextlib import suppress

from maglev_mj.cli.arguments import Parser
from maglev_mj.cli.options import add_outputs, add_parameters, chosen, range_of
from maglev_mj.cli.output import write_result
from maglev_mj.cli.pictures import chosen_pictures
from maglev_mj.cli.progress import Progress
from maglev_mj.cli.scenes import add_scene
from maglev_mj.errors import ParameterError
from maglev_mj.plants.hand import HANDS
from maglev_mj.scenes.scene import Scene
from maglev_mj.studies.designed_wall import Contact, evaluate_wall
from maglev_mj.theory import GOALS, LAWS, WallRequirements, design_wall

_RANGES = "mass", "delay"


def add_options(parser: Parser) -> None:
    """Add the options of the command."""
    parser.description = (
        "Gains of the stiffest wall for uncertain mass, delay and hand; rate, delay and mass may be a scene's."
    )
    needed, wall = parser.group("what the wall must bear"), parser.group("the wall")
    for name in _RANGES:
        one = WallRequirements.parameter(name)
        told = f"{one.help} [{one.unit}]: LOW HIGH, LOW:HIGH, or one value (default {one.default[0]:g})"
        needed.add_argument(f"--{name}", nargs="+", metavar="X", help=told)
    needed.add_argument(
        "--hand",
        action="append",
        metavar="NAMES",
        help=f"hands that it must bear: {', '.join(HANDS)}, several with commas between them, or one as "
        "MASS,DAMPING,STIFFNESS[,GRIP_DAMPING,GRIP_STIFFNESS]; may be given again (default none)",
    )
    needed.add_argument("--held", action="store_true", help="held throughout: leave out the flotor without a hand")
    add_parameters(needed, WallRequirements)
    wall.add_argument("--law", default="pd", choices=LAWS, help="law of the wall (default pd)")
    wall.add_argument(
        "--goal",
        default="static",
        choices=GOALS,
        help="make the stiffness against a slow push largest, or the least at any frequency (default static)",
    )
    add_parameters(parser.group("contact that is simulated"), Contact)
    add_outputs(parser, "the design", "write a picture of the margin to this folder")
    add_scene(parser, options=False, instead=lambda _: None)
    parser.set_defaults(run=_design)


def _required(found: type[Scene] | None) -> WallRequirements:
    """Return the wall requirements of a scene.

    Its sample period, delay and moving mass.
    """
    if found is None:
        return WallRequirements()
    scene, usual = found(), WallRequirements()
    mass = scene.plant_options().get("mass", usual.mass[0])
    return usual.replace(period=scene.period, delay=(scene.delay,) * 2, mass=(mass,) * 2)


def _design(options: argparse.Namespace) -> int:
    ranges = {name: range_of(name, words) for name in _RANGES if (words := getattr(options, name)) is not None}
    hands = _hands(options.hand or ["none"], options.held)
    requirements = chosen(options, _required(options.scene_class), hands=hands, **ranges)
    contact = chosen(options, Contact)
    if chosen_pictures(options) is not None:
        if all(low == high for low, high in (requirements.mass, requirements.delay)):
            raise ParameterError("mass or delay must be a range for a picture, not one value each")
    if contact.pulse and options.law != "pd":
        raise ParameterError(f"pulse must be left out for the {options.law}: it gives none")
    with Progress("design"):
        wall = design_wall(requirements, options.law, goal=options.goal)
        reference = None
        if options.law != "pd":
            with suppress(ParameterError):  # no PD wall bears them
                reference = design_wall(requirements, goal=options.goal)
        result = evaluate_wall(wall, contact, reference)
    write_result(options, result, "design")
    return int(result.grows.any())


def _hands(given: Sequence[str], held: bool) -> tuple[str, ...]:
    """Return the named hands; a free flotor too unless held."""
    hands: list[str] = []
    for text in given:
        names = text.split(",")
        hands += names if all(name in HANDS for name in names) else [text]
    if held:
        return tuple(dict.fromkeys(hand for hand in hands if hand != "none"))
    return tuple(dict.fromkeys(["none", *hands]))
