"""The commands of `maglev-mj`, one a module: its options and what it runs."""

from maglev_mj.commands import drop, fidelity, info, press, render, replay, stability, stick_slip, sweep, view

__all__ = ["COMMANDS"]

COMMANDS = (view, render, replay, drop, press, stick_slip, stability, sweep, fidelity, info)
"""In the order in which the help lists them."""
