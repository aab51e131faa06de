"""The command line: `maglev-mj` and its commands."""

from __future__ import annotations

import sys
from collections.abc import Sequence

import maglev_mj
from maglev_mj.commands import COMMANDS
from maglev_mj.errors import MaglevError, ParameterError
from maglev_mj.options import Parser, joined
from maglev_mj.study import StudyInterrupted
from maglev_mj.terminal import say

__all__ = ["main"]


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; return the exit status: 0, 1 for a run that failed, 2 for bad input, 130 for Ctrl-C."""
    parser = _parser()
    options = parser.parse_args(joined(sys.argv[1:] if arguments is None else arguments))
    try:
        status: int = options.run(options)
        return status
    except KeyboardInterrupt as stopped:
        if not isinstance(stopped, StudyInterrupted):  # which has said where its cells are
            print(f"maglev-mj {options.command}: stopped", file=sys.stderr)
        return 130
    except ParameterError as error:
        say(f"maglev-mj {options.command}: {error}", sys.stderr)
        return 2
    except (MaglevError, OSError) as error:
        say(f"maglev-mj {options.command}: {error}", sys.stderr)
        return 1


def _parser() -> Parser:
    parser = Parser(prog="maglev-mj", description=maglev_mj.__doc__)
    parser.add_argument("--version", action="version", version=f"maglev-mj {maglev_mj.__version__}")
    commands = parser.add_subparsers(dest="command", required=True, metavar="command")
    for command in COMMANDS:
        command.add_command(commands)
    return parser


if __name__ == "__main__":
    sys.exit(main())
