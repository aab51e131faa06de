"""Charts of teleoperation: motion, force, energy, limits, slave."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from gantry.run import Growth, History, Ledger
from gantry.task import Slave
from maglev_mj.colours import GRID, HAND, REFERENCE, SERIES, STOP, TOUCHED
from maglev_mj.frames import Array
from maglev_mj.pictures import BESIDE, FIRST, SECOND, TITLE, name_curves, new_figure, save
from maglev_mj.views.window.backend import DisplayError

_PARTS = {
    "springs": ("springs of coupling\nand arm", SERIES[0]),
    "arm": ("the arm's damper", SERIES[1]),
    "friction": ("stick-slip", SERIES[2]),
    "damper": ("the coupling's damper", SERIES[3]),
    "block": ("the block", SERIES[4]),
    "motion": ("motion", SERIES[5]),
}


def motion(history: History, path: Path) -> Path:
    """Draw the slave's position, and both forces."""
    figure, panels = new_figure(2, 1, 6.8, sharex=True)
    _draw_places(panels[0], history)
    _draw_forces(panels[1], history)
    return _finished(figure, panels, history, path)


def balance(history: History, energies: Ledger, path: Path) -> Path:
    """Draw the energy balance."""
    figure, panels = new_figure(2, 1, 6.8, sharex=True)
    _draw_balance(panels[0], energies)
    made = panels[1]
    made.plot(energies.time, 1e3 * energies.damper, color=FIRST, linewidth=1.6, label="taken by the\ncoupling's damper")
    made.plot(energies.time, 1e3 * energies.made, color=SECOND, linewidth=1.6, label="made by sampling\nand delay")
    order = {"color": REFERENCE, "linestyle": ":", "label": "first order:\nK (T/2 + delay)"}
    made.plot(energies.time, 1e3 * energies.foreseen, **order)
    made.set_title("what sampling makes, and what the damper takes (mJ)", **TITLE)
    return _finished(figure, panels, history, path)


def _finished(figure: Any, panels: Sequence[Any], history: History, path: Path) -> Path:
    """Add time, title and legends, and write the figure."""
    task = history.task
    for panel in panels:
        panel.legend(**BESIDE)
    panels[-1].set_xlabel("time (s)")
    panels[-1].set_xlim(0.0, float(history.time[-1]))
    figure.suptitle(
        f"{task.mode} mode, {1.0 / task.period:g} Hz, delay {task.delay * 1e3:g} ms, coupling "
        f"{history.coupling.stiffness:.0f} N/m and {history.coupling.damping:.1f} N s/m",
        fontsize=11.0,
    )
    return save(figure, path)


def _draw_places(panel: Any, history: History) -> None:
    """Draw slave, target and rate-mode intervals."""
    ticks = np.arange(len(history.target)) * history.task.period
    for axis, name, color in ((0, "x", FIRST), (2, "z", SECOND)):
        panel.plot(history.time, history.slave[0][:, axis] * 1e3, color=color, linewidth=1.6, label=f"slave, {name}")
        target = history.target[:, axis] * 1e3
        panel.plot(ticks, target, color=color, linewidth=1.2, linestyle=":", label=f"target, {name}")
    for axis, color in ((0, FIRST), (2, SECOND)):
        low, high = panel.get_ylim()
        panel.fill_between(ticks, low, high, where=history.rate[:, axis], color=color, alpha=0.10, linewidth=0.0)
        panel.set_ylim(low, high)
    shaded = "; shaded: rate mode" if history.rate.any() else ""
    panel.set_title(f"place of the slave (mm){shaded}", **TITLE)


def _draw_forces(panel: Any, history: History) -> None:
    """Draw the slave's and the hand's forces."""
    felt = -history.force[:, 2] / history.coupling.reflection
    block = history.contact[:, 2]
    panel.plot(history.time, block, color=FIRST, linewidth=1.5, label="of the block, on the slave")
    panel.plot(
        history.time, felt, color=SECOND, linewidth=1.3, linestyle="--", label="of the coupling,\non the joystick"
    )
    panel.set_title("forces along z, as at the slave (N)", **TITLE)


def _draw_balance(panel: Any, energies: Ledger) -> None:
    """Draw energy put in over its uses."""
    names = [name for name in _PARTS if np.abs(getattr(energies, name)).max() > 1e-9]
    labels, colours = zip(*(_PARTS[name] for name in names), strict=True)
    parts = [1e3 * getattr(energies, name) for name in names]
    panel.stackplot(energies.time, parts, labels=labels, colors=colours, alpha=0.55, linewidth=0.0)
    panel.plot(energies.time, 1e3 * energies.put_in, color=STOP, linewidth=1.5, label="put in, all")
    panel.plot(energies.time, 1e3 * energies.hand, color=STOP, linewidth=1.2, linestyle=":", label="by the hand")
    panel.set_title("energy put in, and what became of it (mJ)", **TITLE)


def limits(rows: Sequence[tuple[str, Sequence[float], Sequence[Growth]]], path: Path) -> Path:
    """Draw growth over stiffness, measured and by the eigenvalues.

    Args:
        rows: For each panel its title, stiffnesses in parts of the boundary's, and the growths there.
        path: File to write.
    """
    figure, panels = new_figure(1, len(rows), 3.6)
    for panel, (title, shares, found) in zip(panels, rows, strict=True):
        panel.axhline(1.0, color=GRID, linewidth=2.0)
        panel.plot(shares, [one.foreseen for one in found], color=REFERENCE, linewidth=1.6, label="eigenvalues")
        measured = [one.measured for one in found]
        panel.plot(shares, measured, color=SECOND, linestyle="", marker="o", markersize=5, label="measured")
        panel.set_title(title, **TITLE)
        panel.set_xlabel("stiffness over the boundary's")
    panels[0].set_ylabel("growth from sample to sample")
    name_curves(figure, panels)
    return save(figure, path)


def scenes(history: History, moments: Sequence[tuple[float, str]], path: Path) -> Path:
    """Draw the slave at some moments.

    Its target as a ball, the block's force as an arrow.

    Args:
        history: What was seen.
        moments: Times [s] and what to write over them.
        path: File to write.

    Raises:
        MissingPackageError: If matplotlib is not installed.
        DisplayError: If there is no library to draw with.
    """
    pictures = _rendered(history, [time for time, _ in moments])
    figure, panels = new_figure(1, len(pictures), 2.5)
    for panel, (time, label), image in zip(panels, moments, pictures, strict=True):
        panel.imshow(image)
        panel.set_axis_off()
        panel.set_title(f"{time:.1f} s: {label}", **TITLE)
    return save(figure, path)


def _rendered(history: History, times: Sequence[float]) -> list[Array]:
    """Return pictures, (600, 740, 3) each."""
    slave = Slave(history.task.timing, history.task.block_top)
    model, data = slave.model, slave.data
    camera = mujoco.MjvCamera()
    mujoco.mjv_defaultFreeCamera(model, camera)
    camera.lookat[:] = 0.06, 0.04, 0.19
    camera.distance, camera.azimuth, camera.elevation = 0.86, 108.0, -14.0
    try:
        renderer = mujoco.Renderer(model, 600, 740)
    except (ImportError, AttributeError, OSError, RuntimeError, mujoco.FatalError) as error:
        raise DisplayError(f"pictures need OSMesa or EGL; MUJOCO_GL chooses: {error}") from error
    pictures = []
    with renderer:
        for time in times:
            step = int(np.searchsorted(history.time, time - 1e-9))
            tick = min(int(time / history.task.period), len(history.target) - 1)
            data.qpos[:] = history.slave[0][step]
            mujoco.mj_forward(model, data)
            renderer.update_scene(data, camera)
            tip = model.body("along_x").pos + history.slave[0][step]
            _add_ball(renderer.scene, model.body("along_x").pos + history.target[tick])
            _add_arrow(renderer.scene, tip + np.array([0.04, -0.04, 0.0]), history.contact[step])
            pictures.append(renderer.render())
    return pictures


def _add_ball(scene: Any, place: Array) -> None:
    """Add a ball, seen through."""
    geom = scene.geoms[scene.ngeom]
    size, colour = np.array([0.012, 0.0, 0.0]), np.array([*HAND, 0.9], dtype=np.float32)
    mujoco.mjv_initGeom(geom, mujoco.mjtGeom.mjGEOM_SPHERE, size, place, np.eye(3).ravel(), colour)
    scene.ngeom += 1


def _add_arrow(scene: Any, tail: Array, force: Array) -> None:
    """Add a force arrow, 3 mm a newton."""
    if np.linalg.norm(force) < 0.5:
        return
    geom = scene.geoms[scene.ngeom]
    colour = np.array([*TOUCHED, 1.0], dtype=np.float32)
    mujoco.mjv_initGeom(geom, mujoco.mjtGeom.mjGEOM_ARROW, np.zeros(3), np.zeros(3), np.eye(3).ravel(), colour)
    mujoco.mjv_connector(geom, mujoco.mjtGeom.mjGEOM_ARROW, 0.009, tail, tail + 0.003 * force)
    scene.ngeom += 1
