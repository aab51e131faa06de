"""A gantry moved by the joystick through a virtual coupling.

It goes to a block, presses on it and feels it.

Prints how stable the coupling is by its eigenvalues, how the contact went, and where the energy went; with --out it
writes pictures, with --sweep and --limits it looks at many contacts, and at where they fail.
"""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Sequence
from dataclasses import replace
from itertools import product

if __name__ == "__main__":
    from maglev_mj.views.window.backend import drawing_library

    os.environ["MUJOCO_GL"] = drawing_library()  # before the engine is imported

import numpy as np

from gantry.pictures import balance, limits, motion, scenes
from gantry.run import GRIPS, History, Ledger, bodies, carry_out, contacts, growth, ledger, measured_boundary
from gantry.task import DELAY_SHARE, NO_GAINS, Coupling, Gains, Task, stiffest_coupling
from maglev_mj.cli.declare import Parser, number_option
from maglev_mj.cli.output import add_pictures, chosen_pictures
from maglev_mj.errors import MaglevError, ParameterError
from maglev_mj.frames import Array
from maglev_mj.parameters import number
from maglev_mj.pictures import PictureFolder

_LIGHTEST = 1.0  # what the slave moves along z [kg]
_APPROACHES = ((0.01, 1.0), (0.02, 3.0), (0.05, 5.0))
_UNDERWAY = {"position": (0.5, "drawn aside"), "rate": (1.7, "in rate mode along x")}
_ROWS = {
    "put in": {
        "hand": "the hand's muscles",
        "drift": "the rate that drives the target on",
        "made": "made by sampling and delay",
    },
    "stored": {"motion": "motion of joystick, hand and slave", "springs": "springs of coupling and arm"},
    "lost": {
        "arm": "the arm's damper",
        "friction": "stick-slip",
        "damper": "the coupling's damper",
        "block": "the block, with what it stores",
    },
}


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the chosen parts of the study."""
    try:
        options = _parser().parse_args(arguments)
        task = _task(options)
        pictures = chosen_pictures(options)
        _tell(task, pictures)
        if options.sweep:
            _sweep(task)
        if options.limits:
            _limits(task, pictures)
    except MaglevError as error:
        print(f"teleoperation.py: {error}", file=sys.stderr)
        return 2 if isinstance(error, ParameterError) else 1
    return 0


def _parser() -> Parser:
    parser = Parser(prog="teleoperation.py", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--mode", choices=("position", "rate"), default="position", help="default position")
    parser.add_argument("--rate", type=number_option, default=200.0, metavar="X", help="samples a second (default 200)")
    parser.add_argument(
        "--delay", type=number_option, metavar="X", help="of commands [s] (default 0.3 periods, at 200 Hz the paper's)"
    )
    parser.add_argument("--press", type=number_option, default=5.0, metavar="X", help="of the hand [N] (default 5)")
    parser.add_argument(
        "--phase", type=number_option, default=0.0, metavar="X", help="of the sampler, 0 to 1 (default 0)"
    )
    parser.add_argument("--sweep", action="store_true", help="also contacts over hands, phases, speeds and forces")
    parser.add_argument("--limits", action="store_true", help="also growth of oscillations beside the eigenvalues")
    add_pictures(parser)
    return parser


def _task(options: argparse.Namespace) -> Task:
    """Return the task that is asked for."""
    period = 1.0 / number("rate", options.rate, at_least=200.0, at_most=2000.0)
    delay = DELAY_SHARE * period if options.delay is None else options.delay
    return Task(mode=options.mode, period=period, delay=delay, phase=options.phase, press=options.press)


def _tell(task: Task, pictures: PictureFolder | None) -> None:
    """Do the task and print its figures."""
    history = carry_out(task)
    energies = ledger(history)
    print(_heading(history))
    print(_margins(task, history))
    print(_contact(history))
    print(_balance(history, energies))
    if pictures is not None:
        name = f"teleoperation_{task.mode}_{1.0 / task.period:g}"
        print("wrote", motion(history, pictures.path(name)))
        print("wrote", balance(history, energies, pictures.path(f"{name}_energy")))
        pressed = history.pressed + 0.5 * task.hold
        moments = [
            (0.0, "at the start"),
            _UNDERWAY[task.mode],
            (pressed, f"pressing with {history.press:.0f} N"),
        ]
        print("wrote", scenes(history, moments, pictures.path(f"{name}_slave")))


def _heading(history: History) -> str:
    task, coupling, mass = history.task, history.coupling, history.slave_mass
    most = stiffest_coupling(task.timing, coupling.felt * float(mass.min()))
    return "\n".join(
        (
            f"{task.mode} mode, {1.0 / task.period:g} Hz, delay {task.delay * 1e3:g} ms",
            f"  slave      {coupling.scale:g} times the way, {1.0 / coupling.reflection:g} times the force; "
            f"moves {', '.join(f'{part:g}' for part in mass)} kg along x, y, z; block {task.block * 1e-3:g} kN/m",
            f"  coupling   {coupling.stiffness:.0f} N/m, {coupling.damping:.1f} N s/m; the stiffest stable one between "
            f"two free bodies: {most.stiffness:.0f} N/m, {most.damping:.1f} N s/m",
        )
    )


def _margins(task: Task, history: History) -> str:
    """Return the coupling's stability in each hand, with the slave free and on the block."""
    coupling = history.coupling
    gains = Gains(coupling.stiffness, coupling.damping)
    friction = task.friction if task.mode == "rate" else NO_GAINS
    lines = [
        "",
        "largest modulus of the eigenvalues, and times the stiffness at which the coupling would fail",
        f"  {'hand':<12}{'slave free':>18}{'slave on the block':>24}",
    ]
    for name, hand in GRIPS.items():
        cells = []
        for mode in ("free", "touching"):
            joined = bodies(replace(task, mode=mode, hand=hand), coupling, float(history.slave_mass[2]))
            joined = replace(joined, friction=friction)
            margin = joined.boundary(gains.damping) / gains.stiffness
            cells.append(f"{joined.modulus(gains):.4f}  {margin:.1f} x")
        lines.append(f"  {name:<12}{cells[0]:>18}{cells[1]:>24}")
    return "\n".join(lines)


def _contact(history: History) -> str:
    bounces, losses = history.losses
    way = history.slave[0][:, 2].min() * 1e3
    return "\n".join(
        (
            "",
            "contact, the slave's forces",
            f"  block        pressed with {history.press:.2f} N in the last half second of the hold, rms about that "
            f"{history.ripple:.1e} N",
            f"  hand         presses with {history.pull / history.coupling.reflection:.2f} N, as at the slave",
            f"  bounces      {bounces} on landing, {losses} in the hold; deepest {way:.2f} mm",
        )
    )


def _balance(history: History, energies: Ledger) -> str:
    """Return the energy balance as a table."""
    held = int(np.flatnonzero(history.held())[-1])
    lines = ["", f"{'energy, as at the joystick (mJ)':<42}{'pressing':>10}{'at the end':>12}"]

    def line(label: str, values: Array) -> str:
        now, end = (round(1e3 * float(value), 3) + 0.0 for value in values[[held, -1]])  # no sign on a zero
        return f"{label:<42}{now:>10.3f}{end:>12.3f}"

    for group, rows in _ROWS.items():
        lines.append(f"  {group}")
        lines += [line(f"    {label}", getattr(energies, name)) for name, label in rows.items()]
    lines.append(line("  put in, all", energies.put_in))
    lines.append(line("  stored and lost, all", energies.kept_or_lost))
    lines.append(line("  through the coupling: from the joystick", energies.taken))
    lines.append(line("                        to the slave", energies.given))
    lines.append(line("  made, to first order K (T/2 + delay)", energies.foreseen))
    return "\n".join(lines)


def _sweep(task: Task) -> None:
    """Print how contacts go over hands, phases, speeds and forces."""
    hands = tuple(GRIPS) if task.mode == "position" else ("firm",)
    approaches = _APPROACHES if task.mode == "position" else ((0.02, 3.0), (0.02, 5.0))
    phases = (0.0, 0.25, 0.5, 0.75)
    print()
    print(f"contacts at {len(phases)} phases; least to greatest")
    head = f"  {'hand':<12}{'mm/s':>6}{'asked N':>9}{'pressed N':>18}{'greatest rms N':>16}"
    print(f"{head}{'bounces':>9}{'in the hold':>13}")
    for hand, approach in product(hands, approaches):
        found = list(contacts(task, [hand], phases, [approach]))
        press = [one.press for one in found]
        speed = f"{approach[0] * 1e3:g}" if task.mode == "position" else "-"
        asked = f"{found[0].asked:.0f}" if task.mode == "position" else "-"
        print(
            f"  {hand:<12}{speed:>6}{asked:>9}{f'{min(press):.2f} to {max(press):.2f}':>18}"
            f"{max(one.ripple for one in found):>16.1e}{max(one.bounces for one in found):>9}"
            f"{max(one.losses for one in found):>13}"
        )


def _limits(task: Task, pictures: PictureFolder | None) -> None:
    """Print and draw growth around the failing stiffness."""
    shares = [0.94, 0.97, 1.0, 1.03, 1.06]
    print()
    print("growth from sample to sample with the coupling's damping, measured (by the eigenvalues), at parts of the")
    print("stiffness at which the eigenvalues have it fail; and where it is measured to")
    print(f"  {'slave':<14}{'fails at':>9}" + "".join(f"{share:>17g}" for share in shares) + f"{'measured':>10}")
    rows = []
    for mode, label in (("free", "free"), ("touching", "on the block")):
        near = replace(task, mode=mode, press=3.0, phase=0.0)
        coupling = near.chosen(_LIGHTEST)
        edge = bodies(near, coupling, _LIGHTEST).boundary(coupling.damping)
        found = [growth(replace(near, coupling=replace(coupling, stiffness=share * edge))) for share in shares]
        cells = "".join(f"{f'{one.measured:.4f} ({one.foreseen:.4f})':>17}" for one in found)
        print(f"  {label:<14}{edge:>9.0f}{cells}{measured_boundary(shares, found) * edge:>10.0f}")
        if mode == "touching":
            _fails(near, coupling, edge)
        rows.append((f"slave {label}, {1.0 / task.period:g} Hz: {edge:.0f} N/m", shares, found))
    if pictures is not None:
        print("wrote", limits(rows, pictures.path(f"teleoperation_limits_{1.0 / task.period:g}")))


def _fails(near: Task, coupling: Coupling, edge: float) -> None:
    """Print the pin's contact around the failing stiffness."""
    for share in (0.85, 1.15):
        history = carry_out(replace(near, hold=2.0, coupling=replace(coupling, stiffness=share * edge)))
        print(
            f"    at {share:g} of that, pressed for 2 s: rms {history.ripple:.1e} N about {history.press:.1f} N, "
            f"the pin leaves the block {history.losses[1]} times"
        )


if __name__ == "__main__":
    sys.exit(main())
