"""Store the outputs of cases.json: python -m tests.golden.make [GROUP ...].

All groups without an argument.
"""

from __future__ import annotations

import sys
from typing import Any

from tests.golden.outputs import (
    HERE,
    KEYS,
    as_kept,
    cases,
    differences,
    keep,
    kept,
    outcome,
    pressed,
)


def main() -> None:
    """Run the cases; name those with a changed output."""
    groups = list(dict.fromkeys(name.split("/")[0] for name in cases()))
    for group in sys.argv[1:] or [*groups, KEYS]:
        if group == KEYS:
            found: dict[str, Any] = {"pressed": pressed()}
        else:
            found = {name: outcome(line) for name, line in cases().items() if name.split("/")[0] == group}
        before = kept(group) if (HERE / "expected" / f"{group}.json.gz").exists() else {}
        for name, said in found.items():
            if lines := differences(group, before.get(name), as_kept(said)):
                print(f"{name}: {len(lines)} differences, the first: {lines[0]}")
        keep(group, found)


if __name__ == "__main__":
    main()
