"""Table of the commands: groups, summaries, examples."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple


class Command(NamedTuple):
    """Command, which is a function; see `declare`.

    Attributes:
        summary: Purpose in a few words.
        example: Arguments of an example.
        function: Name of the function; empty if it is that of the command.
    """

    summary: str
    example: str
    function: str = ""


GROUPS: Mapping[str, Mapping[str, Command]] = {
    "feel it": {
        "view": Command("feel a scene in a window: pull with the mouse", "box --stiffness 4000 --friction"),
        "tour": Command("walls and friction in eight steps, guided", "--out tour"),
        "render": Command("a picture or a clip of a scene, without a window", "corner --out corner.png --size 800x500"),
        "serve-spacenav": Command("a scene as the 3D mouse of other programs", "joystick --axes rate --seconds 60"),
    },
    "compute": {
        "drop": Command("drop the flotor on a stiff wall (figures 3, 4)", "--pulse 0 --phases 20 --out figures", "run"),
        "press": Command("a hand hits a wall, then presses (figure 6)", "--hand stylus --hits 2 --json -", "run"),
        "stick-slip": Command("pull out of rendered friction (figure 8)", "--law lugre --record run.npz", "run"),
        "run": Command("run any scene: of this package, or a file of yours", "twist --plant exact --json run.json"),
        "stability": Command("where a wall is stable (figure 2), or a scene", "--hand arm --delay 0.002 --grid 20"),
        "design": Command("the stiffest wall for what is uncertain", "--mass 0.56:0.84 --hand arm,stylus"),
        "sweep": Command("any scene over a grid of its parameters", "drop --vary height=1e-3:4e-3:4 --workers 2"),
        "fidelity": Command("the cheapest model that will do for a scene", "let-go --duration 0.02 --phases 2"),
        "info": Command("Table 1 of the paper, and what the model yields", "--json table1.json"),
    },
    "device": {
        "twin": Command("a simulated device behind the wire of a real one", "--rate 1000 --fault dead-coil:2@3 --view"),
        "bridge": Command("a scene on a device", "udp://127.0.0.1:5678 --scene box --view --record flight.mcap"),
        "estop": Command("stop a device, also in the session of another host", "udp://192.168.1.20:5678 --key lab.key"),
        "commission": Command("diodes and coils of a new device, before it hovers", "udp://127.0.0.1:5678 coils"),
        "conform": Command("test a device's side of the protocol", "udp://127.0.0.1:5678 --json report.json"),
        "fault": Command("what happened before a fault, from its file", "maglev-fault-20260101-120000.json --all"),
    },
    "recordings": {
        "replay": Command("show a recording, or check it bit for bit", "run.mcap --check"),
        "analyse": Command("figures of a recording beside its simulation", "run.mcap --from 0.1 --out figures"),
        "export": Command("a recording as a table for other programs", "run.mcap --to csv"),
    },
}
"""Commands in the order of the help."""

COMMANDS: Mapping[str, Command] = {name: command for group in GROUPS.values() for name, command in group.items()}

MODULES: Mapping[str, str] = {
    name: module
    for module, names in {
        "views": "view tour render serve-spacenav",
        "run": "drop press stick-slip run",
        "sweep": "sweep",
        "studies": "stability design fidelity",
        "twin": "twin",
        "bridge": "bridge",
        "device": "info estop commission conform",
        "recordings": "fault replay analyse export",
    }.items()
    for name in names.split()
}
"""Module of this package that has the function of each command."""
