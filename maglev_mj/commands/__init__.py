"""The commands of `maglev-mj`, one a module: its options and what it runs."""

from maglev_mj.commands import (
    analyse,
    bridge,
    drop,
    export,
    fidelity,
    info,
    press,
    render,
    replay,
    stability,
    stick_slip,
    sweep,
    twin,
    view,
)

__all__ = ["COMMANDS"]

COMMANDS = (
    view,
    render,
    replay,
    analyse,
    export,
    drop,
    press,
    stick_slip,
    stability,
    sweep,
    fidelity,
    twin,
    bridge,
    info,
)
"""In the order in which the help lists them."""
