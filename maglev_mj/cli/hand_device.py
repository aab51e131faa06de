"""Options for a gamepad or 3D mouse as hand."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from typing import Any

from maglev_mj.cli.arguments import Container
from maglev_mj.cli.options import add_parameters, chosen
from maglev_mj.errors import ParameterError
from maglev_mj.interop.hand_devices.device import HAND_MAPPING, HandDevice
from maglev_mj.interop.hand_devices.find import AUTO, described_devices, open_device
from maglev_mj.plants.hand import SpringHand
from maglev_mj.terminal import say

_LIST, _PREFIX = "list", "hand-"


class _Device(argparse.Action):
    """Keep a name, or print the devices and exit."""

    def __call__(self, parser: argparse.ArgumentParser, namespace: Any, values: Any, option: str | None = None) -> None:
        """See `argparse.Action`."""
        if values != _LIST:
            setattr(namespace, self.dest, values)
            return
        found = described_devices() or ["no 3D mouse and no gamepad"]
        print("\n".join(f"  {line}" for line in found))
        parser.exit()


def add_hand_device(parser: Container) -> None:
    """Add --hand-device, and an option for each parameter of `AxisMapping`."""
    parser.add_argument(
        "--hand-device",
        nargs="?",
        action=_Device,
        const=AUTO,
        metavar="NAME",
        help="a gamepad or 3D mouse as the hand: part of its name, spacenav, a socket's path, or auto for the first; "
        "list prints all",
    )
    add_parameters(parser, HAND_MAPPING, _PREFIX)


@contextmanager
def chosen_hand_device(
    options: argparse.Namespace, hand: SpringHand, tell: Callable[[str], object] = say
) -> Iterator[list[HandDevice]]:
    """Open the chosen device; close it at the end.

    Empty without a choice.

    Args:
        options: Parsed options.
        hand: The hand moved by the device.
        tell: Function that prints the device's name.

    Raises:
        ParameterError: If an option is wrong, is given without --hand-device, or the device is not there.
    """
    mapping = chosen(options, HAND_MAPPING, _PREFIX)
    if options.hand_device is None:
        if mapping != HAND_MAPPING:
            raise ParameterError(f"{_PREFIX}gain and the like are for --hand-device")
        yield []
        return
    device = open_device(options.hand_device)
    tell(f"  the hand: {device.name}")
    with closing(HandDevice(device, hand, mapping)) as opened:
        yield [opened]
