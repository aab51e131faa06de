"""Options of input devices and other programs: hand, 3D mouse, publishers."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, NamedTuple

from maglev_mj.cli.arguments import Parser
from maglev_mj.cli.declare import Shared, option
from maglev_mj.cli.options import parameters
from maglev_mj.cli.web import Foxglove, open_foxglove
from maglev_mj.errors import ParameterError, check_one_of
from maglev_mj.interop.foxglove import LiveServer
from maglev_mj.interop.hand_devices import AUTO, HAND_MAPPING, HandDevice, described_devices, open_device
from maglev_mj.interop.spacenav import AxisMapping, PoseAxes, RateAxes, SpacenavMapping, SpacenavServer, Taps
from maglev_mj.plants.hand import SpringHand
from maglev_mj.session import STEP_FORCE, Publisher
from maglev_mj.terminal import say

_REPORTS: dict[str, Callable[..., Any]] = {"pose": PoseAxes, "rate": RateAxes}
"""Reported axes by name."""

_MOUSE, _HAND = "3D mouse of other programs", "gamepad or 3D mouse as the hand"


@dataclass(frozen=True, kw_only=True)
class ServedMouse:
    """Chosen settings of a 3D mouse for other programs."""

    socket: Annotated[
        Path | None,
        option("where those find it (default: $SPNAV_SOCKET, or one in $XDG_RUNTIME_DIR)", _MOUSE, "PATH"),
    ] = None
    axes: Annotated[
        str | None,
        option(
            "what those are told: pose, the deflection; or rate, the motion of a slave (default pose)", _MOUSE, "WHAT"
        ),
    ] = None
    mapping: Annotated[SpacenavMapping, parameters(SpacenavMapping, _MOUSE, "spacenav-")]

    def open(self, say: Callable[[str], object] = say) -> SpacenavServer:
        """Start and return the server.

        Args:
            say: Function that prints its address.

        Raises:
            ParameterError: If an option is wrong.
        """
        axes = "pose" if self.axes is None else self.axes
        check_one_of("axes", _REPORTS, axes)
        buttons = None if self.mapping.press is None else Taps(self.mapping.press)
        server = SpacenavServer(self.socket, axes=_REPORTS[axes](mapping=self.mapping), buttons=buttons)
        say("  a 3D mouse; for the programs that are to have it:")
        say(f"    export SPNAV_SOCKET={server.path.resolve()}")
        return server


@dataclass(frozen=True, kw_only=True)
class MouseOptions:
    """Chosen 3D mouse for other programs, or none."""

    spacenav: Annotated[bool, option("be a 3D mouse to other programs", _MOUSE)] = False
    mouse: ServedMouse

    def open(self, say: Callable[[str], object] = say) -> list[SpacenavServer]:
        """Start and return the chosen server, in a list.

        Empty without a choice.

        Args:
            say: Function that prints its address.

        Raises:
            ParameterError: If an option is wrong, or is given without --spacenav.
        """
        if self.spacenav:
            return [self.mouse.open(say)]
        for name in ("socket", "axes"):
            if getattr(self.mouse, name) is not None:
                raise ParameterError(f"{name} is for --spacenav")
        if self.mouse.mapping != SpacenavMapping():
            raise ParameterError("spacenav-gain and the like are for --spacenav")
        return []


class OpenPublishers(NamedTuple):
    """Opened connections to other programs.

    Attributes:
        publishers: All publishers.
        live: The live server; None for none.
    """

    publishers: list[Publisher]
    live: LiveServer | None


@dataclass(frozen=True, kw_only=True)
class PublisherOptions:
    """Chosen connections to other programs."""

    foxglove: Foxglove = None
    step_force: Annotated[
        float,
        option(
            "largest step of force where the flotor is that new settings may make [N]",
            "other programs",
            name="step-force",
            above=0.0,
        ),
    ] = STEP_FORCE
    spacenav: MouseOptions

    @contextmanager
    def open(self) -> Iterator[OpenPublishers]:
        """Open them; close them at the end.

        Raises:
            ParameterError: If an option is wrong.
            MaglevError: If a port or a socket cannot be opened.
        """
        with ExitStack() as last:
            publishers: list[Publisher] = []
            for server in self.spacenav.open():
                last.callback(server.close)
                publishers.append(server)
            if (live := open_foxglove(self.foxglove)) is not None:
                last.callback(live.close)
                publishers.append(live)
            yield OpenPublishers(publishers, live)


class _Device(argparse.Action):
    """Keep a name, or print the devices and exit."""

    def __call__(self, parser: argparse.ArgumentParser, namespace: Any, values: Any, option: str | None = None) -> None:
        """See `argparse.Action`."""
        if values != "list":
            setattr(namespace, self.dest, values)
            return
        for line in described_devices() or ["no 3D mouse and no gamepad"]:
            print(f"  {line}")
        parser.exit()


def _add_hand_device(parser: Parser) -> None:
    parser.group(_HAND).add_argument(
        "--hand-device",
        nargs="?",
        action=_Device,
        const=AUTO,
        metavar="NAME",
        help="a gamepad or 3D mouse as the hand: part of its name, spacenav, a socket's path, or auto for the first; "
        "list prints all",
    )


@dataclass(frozen=True, kw_only=True)
class HandOptions:
    """Chosen gamepad or 3D mouse as the hand."""

    name: Annotated[str | None, Shared(_add_hand_device, lambda options: options.hand_device)] = None
    mapping: Annotated[AxisMapping, parameters(HAND_MAPPING, _HAND, "hand-")]

    @contextmanager
    def open(self, hand: SpringHand, tell: Callable[[str], object] = say) -> Iterator[list[HandDevice]]:
        """Open the chosen device; close it at the end.

        Empty without a choice.

        Args:
            hand: The hand moved by the device.
            tell: Function that prints the device's name.

        Raises:
            ParameterError: If an option is given without --hand-device, or the device is not there.
        """
        if self.name is None:
            if self.mapping != HAND_MAPPING:
                raise ParameterError("hand-gain and the like are for --hand-device")
            yield []
            return
        device = open_device(self.name)
        tell(f"  the hand: {device.name}")
        with closing(HandDevice(device, hand, self.mapping)) as opened:
            yield [opened]
