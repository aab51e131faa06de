"""The task as a block diagram in bdsim.

Two integrators, a sampled block for the law and zero-order holds.

Three clocks tick when commands are worked out, take effect and end their pulse, so bdsim integrates from switch to
switch. As in `peers.control_peer` the rotation vector's second derivative is torque over moment of inertia.
"""

from __future__ import annotations

from typing import Any

import bdsim
import numpy as np
from bdsim.components import SampledBlock

from peers.task import Array, Simulate, Task, Variant


def variants() -> list[Variant]:
    """Return the method to simulate the task with bdsim: RK23 at a tolerance of 1."""
    return [Variant("bdsim", "block diagram, RK23, coarse", _diagram, "bdsim")]


class _Law(SampledBlock):  # type: ignore[misc]
    """The control law as a sampled block.

    Args:
        task: The task.
        clock: Ticks at the samples.
    """

    nin = 1
    nout = 1

    def __init__(self, task: Task, clock: Any, **options: Any) -> None:
        # a clock of bdsim ticks from its first period on: the first sample's answer is the state at the start
        super().__init__(clock=clock, x0=_state(*task.law()(task.pose), number=1), **options)
        self.type = "law"
        self._task = task
        self.poses: list[Array] = []

    def start(self, simstate: Any) -> None:
        """Reset, and take the first sample."""
        super().start(simstate)
        self._law = self._task.law()
        self._law(self._task.pose)
        self.poses = [np.array(self._task.pose)]

    def output(self, t: float, inputs: list[Any], x: Array) -> list[Any]:
        """Return the state."""
        return [x]

    def next(self, t: float, inputs: list[Any], x: Array) -> Array:
        """Answer a sample; ticks of other clocks are told apart by the time."""
        if abs(t - len(self.poses) * self._task.period) > 1e-9:
            return x
        self.poses.append(inputs[0].copy())
        force, pulse = self._law(inputs[0].tolist())
        return _state(force, pulse, len(self.poses))


def _state(force: list[float], pulse: list[float] | None, number: int) -> Array:
    return np.array([*(pulse or force), *force, number])


def _wrench(applied: Array, ended: Array) -> Array:
    """Return a command's first wrench, until its number is among the ended ones."""
    return applied[6:12] if ended[12] == applied[12] else applied[:6]


def _diagram(task: Task) -> Simulate:
    """Wire plant and controller up."""
    options = {"method": "RK23", "rtol": 1.0, "atol": 1.0, "first_step": 4e-4}
    simulation = bdsim.BDSim(graphics=False, progress=False, quiet=True, sysargs=False)
    diagram = simulation.blockdiagram()
    offsets = (0.0, task.delay - task.period, task.delay + task.pulse_width - task.period)
    samples, switches, ends = (diagram.clock(task.period, offset=offset) for offset in offsets)
    body, free_fall = np.array(task.body), np.array([0.0, 0.0, -task.gravity, 0.0, 0.0, 0.0])
    law = _Law(task, samples, bd=diagram, name="law")
    applied = diagram.ZOH(switches, x0=np.zeros(13), name="applied")
    ended = diagram.ZOH(ends, x0=np.zeros(13), name="ended")
    acceleration = diagram.FUNCTION(
        lambda first, last: _wrench(first, last) / body + free_fall, nin=2, name="acceleration"
    )
    velocity = diagram.INTEGRATOR(x0=np.zeros(6), name="velocity")
    pose = diagram.INTEGRATOR(x0=np.array(task.pose), name="pose")
    diagram.connect(pose, law)
    diagram.connect(law, applied)
    diagram.connect(applied, ended, acceleration[0])
    diagram.connect(ended, acceleration[1])
    diagram.connect(acceleration, velocity)
    diagram.connect(velocity, pose)
    diagram.compile()

    def run() -> Array:
        out = simulation.run(diagram, T=task.duration, solver_args=options)
        names = [str(name) for name in out.xnames]
        last = out.x[-1][[names.index(name) for name in names if name.startswith("pose")]]
        return np.array([*law.poses[: task.ticks], last])

    return run
