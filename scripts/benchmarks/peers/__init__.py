"""The task of `peers.task` in other simulators, a module each.

Each module reads as an example of its own kind, and none imports another's package.
"""

from __future__ import annotations

import importlib
from collections.abc import Iterable

from peers.task import Simulate, Task, Variant

__all__ = ["PEERS", "Simulate", "Task", "Variant", "available"]

PEERS = ("mujoco", "drake", "pybullet", "scipy", "pinocchio", "control", "bdsim")


def available(names: Iterable[str] | None = None) -> tuple[list[Variant], list[str]]:
    """Return installed peers' variants, and a line each missing.

    Args:
        names: Peers from PEERS; None for all.

    Raises:
        ValueError: If there is no peer of such a name.
    """
    variants: list[Variant] = []
    missing: list[str] = []
    for name in PEERS if names is None else names:
        if name not in PEERS:
            raise ValueError(f"peer must be one of {', '.join(PEERS)} (got {name!r})")
        try:
            module = importlib.import_module(f"peers.{name}_peer")
        except ImportError:
            missing.append(f"{name} is not installed and left out: make .venv/.peers")
        else:
            variants += module.variants()
    return variants, missing
