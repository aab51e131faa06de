"""Options of other programs and input devices: live server, 3D mouse, hand."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple, TypeAlias

from maglev_mj.cli.arguments import Parser, count, number_option
from maglev_mj.cli.declare import Shared
from maglev_mj.cli.options import add_parameters, chosen
from maglev_mj.errors import ParameterError, check_one_of
from maglev_mj.terminal import say

if TYPE_CHECKING:
    from maglev_mj.hand_devices.device import HandDevice
    from maglev_mj.live import LiveServer
    from maglev_mj.plants.hand import SpringHand
    from maglev_mj.session import Publisher
    from maglev_mj.spacenav import AxisMapping, SpacenavMapping, SpacenavServer

LIVE_PORT = 8765
"""Default port of the live server: that of `maglev_mj.live`, which loads arrays."""

_PROGRAMS = "other programs"
_AXES = "pose", "rate"
_SPACENAV, _HAND = "spacenav-", "hand-"
_LIST = "list"


class SpacenavOptions(NamedTuple):
    """Chosen 3D mouse for other programs.

    Attributes:
        spacenav: True if there is one.
        socket: Its path; None for the usual one.
        axes: What it reports, of `pose` and `rate`; None for the pose.
        mapping: Settings of its axes.
    """

    spacenav: bool
    socket: Path | None
    axes: str | None
    mapping: SpacenavMapping

    def open(self, say: Callable[[str], object] = print) -> list[SpacenavServer]:
        """Start and return the chosen server, in a list.

        Empty without a choice.

        Args:
            say: Function that prints its address.

        Raises:
            ParameterError: If an option is wrong, or is given without --spacenav.
        """
        from maglev_mj.spacenav import PoseAxes, RateAxes, SpacenavMapping, SpacenavServer, Taps

        if not self.spacenav:
            for name in ("socket", "axes"):
                if getattr(self, name) is not None:
                    raise ParameterError(f"{name} is for --spacenav")
            if self.mapping != SpacenavMapping():
                raise ParameterError(f"{_SPACENAV}gain and the like are for --spacenav")
            return []
        check_one_of("axes", _AXES, self.axes or _AXES[0])
        axes: type[PoseAxes | RateAxes] = RateAxes if self.axes == "rate" else PoseAxes
        buttons = None if self.mapping.press is None else Taps(self.mapping.press)
        server = SpacenavServer(self.socket, axes=axes(mapping=self.mapping), buttons=buttons)
        say("  a 3D mouse; for the programs that are to have it:")
        say(f"    export SPNAV_SOCKET={server.path.resolve()}")
        return [server]


def add_spacenav(parser: Parser, *, always: bool = False) -> None:
    """Add the options of the 3D mouse.

    --spacenav, --socket, --axes, and an option for each parameter of `SpacenavMapping`.

    Args:
        parser: Parser of the command.
        always: True if the command always is a 3D mouse, without --spacenav.
    """
    from maglev_mj.spacenav import SpacenavMapping

    group = parser.group("3D mouse of other programs")
    if always:
        parser.set_defaults(spacenav=True)
    else:
        group.add_argument("--spacenav", action="store_true", help="be a 3D mouse to other programs")
    group.add_argument(
        "--socket",
        metavar="PATH",
        type=Path,
        help="where those find it (default: $SPNAV_SOCKET, or one in $XDG_RUNTIME_DIR)",
    )
    group.add_argument(
        "--axes",
        metavar="WHAT",
        help="what those are told: pose, the deflection; or rate, the motion of a slave (default pose)",
    )
    add_parameters(group, SpacenavMapping, _SPACENAV)


def chosen_spacenav(options: argparse.Namespace) -> SpacenavOptions:
    """Return the chosen 3D mouse, which is not yet open.

    Raises:
        ParameterError: If a setting is outside its bounds.
    """
    from maglev_mj.spacenav import SpacenavMapping

    mapping = chosen(options, SpacenavMapping, _SPACENAV)
    return SpacenavOptions(options.spacenav, options.socket, options.axes, mapping)


def add_foxglove(parser: Parser) -> None:
    """Add --foxglove."""
    parser.group(_PROGRAMS).add_argument(
        "--foxglove",
        nargs="?",
        type=_port,
        const=LIVE_PORT,
        metavar="PORT",
        help=f"serve every sample to programs on this machine that read the Foxglove protocol (default {LIVE_PORT})",
    )


def _port(text: str) -> int:
    from maglev_mj.net.addresses import check_port

    try:
        return check_port(count(text))
    except ParameterError as error:  # before a window is asked for
        raise argparse.ArgumentTypeError(str(error)) from None


def open_foxglove(port: int | None) -> LiveServer | None:
    """Start and return the live server at a port; None without one.

    Raises:
        LiveServerError: See `LiveServer`.
    """
    if port is None:
        return None
    from maglev_mj.live import LiveServer

    live = LiveServer(port)
    say(f"  live at ws://127.0.0.1:{live.port}, as Foxglove opens it")
    return live


class OpenPublishers(NamedTuple):
    """Opened connections to other programs.

    Attributes:
        publishers: All publishers.
        live: The live server; None for none.
    """

    publishers: list[Publisher]
    live: LiveServer | None


class PublisherOptions(NamedTuple):
    """Chosen connections to other programs.

    Attributes:
        foxglove: Port of the live server; None for none.
        step_force: Largest step of force that new settings may make [N].
        mouse: The 3D mouse.
    """

    foxglove: int | None
    step_force: float
    mouse: SpacenavOptions

    @contextmanager
    def open(self) -> Iterator[OpenPublishers]:
        """Open them; close them at the end.

        Raises:
            ParameterError: If an option is wrong.
            MaglevError: If a port or a socket cannot be opened.
        """
        from maglev_mj.parameters import number

        number("step-force", self.step_force, above=0.0)
        with ExitStack() as last:
            publishers: list[Publisher] = []
            for server in self.mouse.open(say):
                last.callback(server.close)
                publishers.append(server)
            if (live := open_foxglove(self.foxglove)) is not None:
                last.callback(live.close)
                publishers.append(live)
            yield OpenPublishers(publishers, live)


def _add_publishers(parser: Parser) -> None:
    from maglev_mj.session import STEP_FORCE

    add_foxglove(parser)
    parser.group(_PROGRAMS).add_argument(
        "--step-force",
        type=number_option,
        default=STEP_FORCE,
        metavar="X",
        help=f"largest step of force where the flotor is that new settings may make [N] (default {STEP_FORCE:g})",
    )
    add_spacenav(parser)


def _chosen_publishers(options: argparse.Namespace) -> PublisherOptions:
    return PublisherOptions(options.foxglove, options.step_force, chosen_spacenav(options))


class HandOptions(NamedTuple):
    """Chosen gamepad or 3D mouse as the hand.

    Attributes:
        name: Its name; None for none.
        mapping: Settings of its axes.
    """

    name: str | None
    mapping: AxisMapping

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
        from maglev_mj.hand_devices.device import HAND_MAPPING, HandDevice
        from maglev_mj.hand_devices.find import open_device

        if self.name is None:
            if self.mapping != HAND_MAPPING:
                raise ParameterError(f"{_HAND}gain and the like are for --hand-device")
            yield []
            return
        device = open_device(self.name)
        tell(f"  the hand: {device.name}")
        with closing(HandDevice(device, hand, self.mapping)) as opened:
            yield [opened]


class _Device(argparse.Action):
    """Keep a name, or print the devices and exit."""

    def __call__(self, parser: argparse.ArgumentParser, namespace: Any, values: Any, option: str | None = None) -> None:
        """See `argparse.Action`."""
        if values != _LIST:
            setattr(namespace, self.dest, values)
            return
        from maglev_mj.hand_devices.find import described_devices

        for line in described_devices() or ["no 3D mouse and no gamepad"]:
            print(f"  {line}")
        parser.exit()


def _add_hand(parser: Parser) -> None:
    from maglev_mj.hand_devices.device import HAND_MAPPING
    from maglev_mj.hand_devices.find import AUTO

    group = parser.group("gamepad or 3D mouse as the hand")
    group.add_argument(
        "--hand-device",
        nargs="?",
        action=_Device,
        const=AUTO,
        metavar="NAME",
        help="a gamepad or 3D mouse as the hand: part of its name, spacenav, a socket's path, or auto for the first; "
        "list prints all",
    )
    add_parameters(group, HAND_MAPPING, _HAND)


def _chosen_hand(options: argparse.Namespace) -> HandOptions:
    from maglev_mj.hand_devices.device import HAND_MAPPING

    return HandOptions(options.hand_device, chosen(options, HAND_MAPPING, _HAND))


Mouse: TypeAlias = Annotated[SpacenavOptions, Shared(lambda parser: add_spacenav(parser, always=True), chosen_spacenav)]
Foxglove: TypeAlias = Annotated[int | None, Shared(add_foxglove, lambda options: options.foxglove)]
Publishing: TypeAlias = Annotated[PublisherOptions, Shared(_add_publishers, _chosen_publishers)]
InputHand: TypeAlias = Annotated[HandOptions, Shared(_add_hand, _chosen_hand)]
