"""A sweep over a grid as text."""

from __future__ import annotations

import numpy as np

from maglev_mj.studies.sweep import Sweep
from maglev_mj.terminal import printable

__all__ = ["sweep_table"]


def sweep_table(found: Sweep, path: str) -> str:
    """Return how many cells were computed and the spread of each figure over them, as text.

    Args:
        found: The sweep.
        path: Where the record is.
    """
    results = found.results
    failed = [result["error"] for result in results if "error" in result]
    over = ", ".join(f"{name} ({len(values)})" for name, values in found.varied.items()) or "nothing"
    lines = [
        f"Sweep of {found.scene.name} over {over}: {len(results)} cells, {found.known} of them already in {path}",
        "",
        f"  {'':<20}{'least':>12}{'median':>12}{'greatest':>12}   cells",
    ]
    good = [result for result in results if "error" not in result]
    for name in good[0] if good else ():
        values = [float(result[name]) for result in good if isinstance(result[name], int | float)]
        if values:
            spread = "".join(f"{share:>12.4g}" for share in np.percentile(values, [0.0, 50.0, 100.0]))
            lines.append(f"  {printable(name):<20}{spread}   {len(values)}")
    if failed:
        lines += ["", f"  {len(failed)} cells failed, the first because {printable(str(failed[0]))}"]
    return "\n".join(lines)
