"""Scene: drop of the flotor on a stiff wall, figures 3 and 4 of Salcudean and Vlaar (1997)."""

from __future__ import annotations

import math
from collections.abc import Mapping
from operator import attrgetter
from typing import Any, ClassVar, Self

from maglev_mj.control import Law
from maglev_mj.device import PUBLISHED_WALL
from maglev_mj.errors import ParameterError
from maglev_mj.frames import Array
from maglev_mj.parameters import number, param
from maglev_mj.scenes.scene import Start
from maglev_mj.scenes.wall_scene import WallScene, hold, others
from maglev_mj.theory.ideal import analog_wall


class Drop(WallScene):
    """Drop the flotor on a stiff wall (figures 3, 4)."""

    title: ClassVar = "Drop the flotor on a stiff wall (figures 3 and 4)"
    model: ClassVar = "scenes/drop"
    figures: ClassVar = ("penetration", "rebound", "peak_force", "settling_time", "final_z")
    tolerance: ClassVar[float] = 1e-3
    tolerance_reason: ClassVar[str] = "below the effect of the sampling phase on the penetration"
    plots: ClassVar[Mapping[str, str]] = {
        "drop_time": "maglev_mj.scenes.pictures:time_series",
        "drop_phase_plane": "maglev_mj.scenes.pictures:phase_plane",
        "drop_phases": "maglev_mj.scenes.pictures:spread",
    }
    band_phases: ClassVar[int] = 100

    height: float = param(
        "drop height above the wall", "m", default=None, derive=attrgetter("hardware.height"), above=0.0
    )
    carry: bool = param("carry impulse clipped by the force limit over to later samples", default=False)
    duration: float = param("simulated time from release", "s", default=0.4, above=0.0, at_most=1000.0)

    def check(self) -> None:
        """See `Scene`."""
        super().check()
        if not self.height < self.hardware.escape:
            number("height", self.height, below=self.hardware.escape, unit="m")
        if self.carry and not self.force_limit:
            raise ParameterError("carry needs a force_limit above 0, which clips the pulse")

    def start(self) -> Start:
        """Return a flotor at rest above the wall."""
        return Start(pose=(0.0, 0.0, self.height, 0.0, 0.0, 0.0))

    def laws(self) -> list[Law]:
        """Return the wall and the hold of the other axes."""
        # without a limit there is no clipped impulse to carry over
        limit = self.force_limit if self.force_limit and self.carry else math.inf
        return [self.wall(force_limit=limit), *self.damper(), hold(self, others("z"))]

    def variants(self) -> Mapping[str, Self]:
        """Return the drops to compare: this one, first, and the one without a pulse, last.

        The paper's equation (9) adds the pulse of 220 N s/m to the damping, but its figure 3 matches a total of
        220 N s/m. A drop with the published pulse has that reading in between.

        Source: Salcudean & Vlaar 1997, eq. (9) and figure 3.
        """
        if (without := self.unpulsed()) is None:
            return super().variants()
        variants = {f"+{self.pulse:g} N s/m ({self.damping + self.pulse:g} total)": self}
        if self.pulse == PUBLISHED_WALL.pulse and 0.0 < self.damping < self.pulse:
            variants[f"{self.pulse:g} N s/m total"] = self.replace(pulse=self.pulse - self.damping)
        return variants | {"no pulse": without}

    def describe(self) -> str:
        """Return a one-line description."""
        pulse = f"a braking pulse of {self.pulse:g} N s/m" if self.unpulsed() else "no pulse"
        wall = f"a wall of {self.stiffness:.6g} N/m and {self.damping:.4g} N s/m"
        return f"a drop of {self.height * 1e3:.4g} mm on {wall}, {pulse}"

    @property
    def rest(self) -> float:
        """Equilibrium height on the wall [m]; NaN without stiffness."""
        body = self.body
        return float(body.inertia[2] * body.gravity[2]) / self.stiffness if self.stiffness > 0.0 else math.nan

    def analog(self, time: Array) -> tuple[Array, Array, Array]:
        """Return z [m], velocity [m/s] and force [N] of this drop on the ideal analog wall; see `analog_wall`."""
        device: Any = {"mass": self.body.inertia[2], "gravity": -self.body.gravity[2]}
        return analog_wall(time, height=self.height, stiffness=self.stiffness, damping=self.damping, **device)
