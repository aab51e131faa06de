"""Command-line options: what the commands share, each complaint one line."""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

__all__ = ["Parser", "add_options", "add_outputs", "count", "joined"]


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


def add_options(
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


def add_outputs(parser: argparse.ArgumentParser) -> None:
    """Add --json and --out."""
    parser.add_argument(
        "--json", metavar="FILE", help="write parameters, motion and figures as JSON; - for standard output"
    )
    parser.add_argument("--out", metavar="DIR", type=Path, help="write pictures to this folder")


def _number(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        raise argparse.ArgumentTypeError(f"must be a number, not {text!r}") from None


def count(text: str) -> int:
    """Return an option's whole number."""
    try:
        return int(text)
    except ValueError:
        raise argparse.ArgumentTypeError(f"must be a whole number, not {text!r}") from None
