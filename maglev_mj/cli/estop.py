"""`maglev-mj estop`: emergency stop of a device."""

from __future__ import annotations

import argparse
import sys

from maglev_mj.bridge.connection import estop
from maglev_mj.cli.arguments import Parser
from maglev_mj.cli.options import add_key, chosen_key
from maglev_mj.errors import MaglevError, ParameterError
from maglev_mj.terminal import say


def add_options(parser: Parser) -> None:
    """Add the options of the command."""
    parser.description = (
        "Cut the currents of a device in any state and any session, and latch the fault ESTOP there. "
        "`maglev-mj bridge ADDRESS --reset` shows and clears it."
    )
    parser.epilog = (
        "Exit status: 0 where the device confirms that its currents are zero; otherwise cut the power. A serial line "
        "has one user: stop that one by its window's Escape or by Ctrl-C twice."
    )
    parser.add_argument("address", metavar="ADDRESS", help="udp://HOST:PORT, or serial:///PATH?baud=RATE")
    add_key(parser)
    parser.set_defaults(run=_estop)


def _estop(options: argparse.Namespace) -> int:
    key = chosen_key(options.key)
    try:
        report = estop(options.address, key)
    except ParameterError:
        raise
    except (MaglevError, OSError) as error:
        raise MaglevError(f"not confirmed: cut the power ({error})") from None
    say(f"  {options.address} {report}", None if report.confirmed else sys.stderr)
    return 0 if report.confirmed else 1
