"""The commands of `maglev-mj`, one a module: its options and what it runs."""

from maglev_mj.commands import (
    analyse,
    bridge,
    design,
    drop,
    export,
    fidelity,
    info,
    press,
    render,
    replay,
    serve_spacenav,
    stability,
    stick_slip,
    sweep,
    twin,
    view,
)

__all__ = ["COMMANDS"]

_SCENES = view, render, serve_spacenav
_RECORDINGS = replay, analyse, export
_EXPERIMENTS = drop, press, stick_slip, stability, design, sweep, fidelity
_DEVICE = twin, bridge, info

COMMANDS = (*_SCENES, *_RECORDINGS, *_EXPERIMENTS, *_DEVICE)
"""In the order in which the help lists them."""
