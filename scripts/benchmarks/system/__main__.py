"""Run a benchmark of the program around the loop.

    python scripts/benchmarks/system SECTION [--quick] [options of the section]

On a shared machine, compare medians within a run, and best values between runs.
"""

from __future__ import annotations

import argparse
import inspect
import json
import sys
from importlib import import_module
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))  # a folder that is run has only itself on the path

from maglev_mj.versions import versions
from speed_tables import aligned
from system import SECTIONS


def main() -> None:
    """Measure one section, and print its tables."""
    titles = "\n".join(f"  {name:<10}{title}" for name, title in SECTIONS.items())
    form: dict[str, Any] = {"formatter_class": argparse.RawDescriptionHelpFormatter}
    first = argparse.ArgumentParser(description=f"{__doc__}\n{titles}", add_help=len(sys.argv) < 3, **form)
    first.add_argument("section", choices=SECTIONS, metavar="SECTION")
    name = first.parse_known_args()[0].section
    measure = import_module(f"system.{name}").measure
    parser = argparse.ArgumentParser(prog=f"system {name}", description=inspect.getdoc(measure), **form)
    parser.add_argument("--quick", action="store_true", help="a small case, for a test")
    for flag, parameter in list(inspect.signature(measure).parameters.items())[1:]:
        default = parameter.default
        kind = float if isinstance(default, tuple) else type(default)
        more = {"action": "store_true"} if kind is bool else {"type": kind, "metavar": "X", "default": default}
        parser.add_argument(f"--{flag}", **more | ({"nargs": "*"} if isinstance(default, tuple) else {}))
    for title, table in measure(**vars(parser.parse_args(sys.argv[2:]))).items():
        print(aligned(title, table), end="\n\n", flush=True)
    print(json.dumps({"versions": versions()}))


if __name__ == "__main__":
    main()
