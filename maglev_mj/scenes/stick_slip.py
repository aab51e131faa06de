"""Scene: flotor pulled out of rendered friction by a spring, figure 8 of Salcudean and Vlaar (1997)."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, ClassVar

import numpy as np

from maglev_mj import control
from maglev_mj.control.laws.velocity import Estimator
from maglev_mj.device import PUBLISHED_WALL
from maglev_mj.frames import AXES, Array, unit_of
from maglev_mj.lazy import by_name
from maglev_mj.parameters import param
from maglev_mj.scenes.figures import changes
from maglev_mj.scenes.results import RunResult
from maglev_mj.scenes.scene import Scene, Start
from maglev_mj.scenes.wall_scene import WallScene, hold, others, stepped
from maglev_mj.theory.ideal import FrictionEvent, KarnoppMotion, karnopp

LAWS = by_name(control, control.Friction)
"""Friction laws by name."""

VELOCITIES = by_name(control, Estimator)
"""Velocity estimators by name."""


def _scaled(value: float, power: int, help: str, unit: str, **keywords: Any) -> Any:
    """Declare a parameter along the axis; on a rotation its default scales by a power of the radius of gyration.

    A force scales as the stiffness does, so that the path on which it builds up stays.
    """
    gain = {"N/m": "stiffness", "N": "stiffness", "N s/m": "damping"}.get(unit)

    def derived(scene: Pull) -> float:
        index, inertia = AXES.index(scene.axis), scene.hardware.inertia
        radius = 1.0 if index < 3 else math.sqrt(inertia[index] / inertia[0])
        own = value if gain is None else value * getattr(scene.hardware.wall, gain) / getattr(PUBLISHED_WALL, gain)
        return float(own * radius**power * (scene.hardware.range_ratio[index] if unit in ("m", "N") else 1.0))

    return param(help, unit, default=None, derive=derived, along=True, **keywords)


class Pull(Scene):
    """Pull the flotor out of rendered friction (figure 8).

    A flotor at rest and stuck at 0 is released against a virtual spring whose far end is at `target`. On a rotation the
    defaults are those of a translation at the radius of gyration, and units are N m/rad, rad, N m s/rad, N m and rad/s.
    Gravity is compensated, the other axes are held.
    """

    name: ClassVar[str] = "stick-slip"
    model: ClassVar = "scenes/table"
    figures: ClassVar = ("peak_speed", "stick_time", "stick_position", "final_position", "transitions", "ripple")
    takes_phase: ClassVar[bool] = False
    plots: ClassVar[Mapping[str, str]] = {"stick_slip": "maglev_mj.scenes.pictures:stick_slip"}

    law: str = param("friction law", default="stick-slip", choices=tuple(LAWS))
    velocity: str = param("velocity estimator", default="difference", choices=tuple(VELOCITIES))
    axis: str = param("axis", default="x", choices=AXES)
    quantize: float = WallScene.like("quantize", along=True)
    spring: float = _scaled(1000.0, 2, "stiffness of the virtual spring", "N/m", above=0.0, at_most=1e8)
    target: float = _scaled(0.003, -1, "position of the spring's far end", "m", at_least=-0.5, at_most=0.5)
    stiffness: float = _scaled(
        6000.0, 2, "stiffness of the friction law while stuck", "N/m", above=0.0, at_most=1e8, live=True
    )
    damping: float = _scaled(80.0, 2, "viscous damping", "N s/m", at_least=0.0, at_most=1e6, live=True)
    breakaway: float = _scaled(2.0, 1, "breakaway force", "N", above=0.0, at_most=1e6, live=True)
    v_min: float = _scaled(0.005, -1, "speed below which the flotor sticks", "m/s", above=0.0, at_most=1e3)
    duration: float = param("simulated time", "s", default=0.3, above=0.0, at_most=1000.0)

    def start(self) -> Start:
        """Return a flotor at rest, its weight compensated."""
        return Start(gravity=0.0)

    def laws(self) -> list[control.Law]:
        """Return friction, spring, and hold of the other axes."""
        common = {"axes": self.axis, "stiffness": self.stiffness, "damping": self.damping, "breakaway": self.breakaway}
        friction = LAWS[self.law].of(v_min=self.v_min, period=self.period, **common)
        spring = control.Hold(axes=self.axis, stiffness=self.spring, damping=0.0, target=self.target)
        return [friction, spring, hold(self, others(self.axis))]

    def velocity_estimator(self) -> control.VelocityEstimator:
        """Return the velocity estimator, adapted to the sensor resolution."""
        return VELOCITIES[self.velocity].of(self.quantize)

    def plant_options(self) -> dict[str, Any]:
        """See `Scene`."""
        return {"sensor": stepped(self.axis, self.quantize)}

    def describe(self) -> str:
        """Return a one-line description."""
        stiff, damp = (unit_of(unit, self.axis) for unit in ("N/m", "N s/m"))
        gains = f"{self.stiffness:.6g} {stiff} and {self.damping:.4g} {damp} while stuck"
        return f"{self.law} friction against a spring, as in figure 8; {gains}"

    @property
    def inertia(self) -> float:
        """Inertia on the axis [kg, kg m²]."""
        return float(self.body.inertia[AXES.index(self.axis)])

    def exact(self, time: Array) -> KarnoppMotion:
        """Return the exact motion with ideal friction, and the same spring, mass and damping.

        Ideal friction is Karnopp's for the laws without sliding friction, and Coulomb's for the others. In a motion of
        one direction, Coulomb friction is a constant force, equivalent to the spring's end displaced by f / k.

        Args:
            time: Times [s], (M,).
        """
        target, breakaway, v_min = self.target, self.breakaway, self.v_min
        share = LAWS[self.law].slides_at
        if share > 0.0 and abs(self.spring * target) > breakaway:
            target -= math.copysign(share * breakaway / self.spring, target)
            breakaway, v_min = 1e-9 * breakaway, 1e-9 * v_min
        return karnopp(
            time,
            targets=[(0.0, target)],
            spring=self.spring,
            damping=self.damping,
            breakaway=breakaway,
            v_min=v_min,
            mass=self.inertia,
        )

    def series(self, result: RunResult, time: Array) -> dict[str, Array]:
        """Return position, velocity, stick position, state and force."""
        index = np.clip(np.searchsorted(result.sample_time, time + 1e-12, side="right") - 1, 0, None)
        position, speed, force = result.motion(time)
        return {
            "position": position,
            "velocity": speed,
            "stick_position": result.samples["stick_position"][index, 0],
            "state": np.where(result.samples["stuck"][index, 0], "stuck", "sliding"),
            "force": force,
        }

    def compared(self, result: RunResult) -> Mapping[str, Mapping[str, float]]:
        """Return the figures of the ideal friction."""
        motion = self.exact(result.times(1e-4))
        sticks = [event for event in motion.events if event.kind == "stick"]
        tail = motion.position[motion.time >= self.duration - 0.05]
        figures = {
            "peak_speed": float(np.abs(motion.velocity).max()),
            "stick_time": sticks[-1].time if sticks else math.nan,
            "stick_position": sticks[-1].position if sticks else math.nan,
            "final_position": float(motion.position[-1]),
            "transitions": float(len(motion.events)),
            "ripple": float(np.ptp(tail)),
        }
        return {f"{self.exact_name}, exact": figures}

    @property
    def exact_name(self) -> str:
        """Name of the ideal friction."""
        return "Coulomb" if LAWS[self.law].slides_at else "Karnopp"

    def events(self, result: RunResult) -> list[FrictionEvent]:
        """Return the changes of the friction state, at their samples."""
        index, samples = AXES.index(self.axis), result.samples
        return [
            FrictionEvent(
                float(result.sample_time[k]),
                "stick" if samples["stuck"][k, 0] else "slip",
                float(samples["position"][k, index]),
            )
            for k in changes(result)
        ]

    def extra_json(self, result: RunResult) -> dict[str, Any]:
        """Return the changes of the friction state for JSON."""
        return {"events": [event._asdict() for event in self.events(result)]}
