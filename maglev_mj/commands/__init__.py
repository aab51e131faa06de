"""The commands of `maglev-mj`, one a module: its options and what it runs."""

from maglev_mj.commands import drop, fidelity, info, stability, stick_slip, sweep

__all__ = ["COMMANDS"]

COMMANDS = (info, drop, stick_slip, stability, sweep, fidelity)
"""In the order in which the help lists them."""
