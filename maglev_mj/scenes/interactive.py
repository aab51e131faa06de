"""A scene: laws, where it starts, what a scripted hand does in it, and the MJCF file that shows it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

from numpy.typing import ArrayLike

from maglev_mj.controller import Controller
from maglev_mj.frames import AXES
from maglev_mj.hand import HandForce, Path
from maglev_mj.laws import Friction, Law, Wall
from maglev_mj.parameters import axis_indices
from maglev_mj.plants import MuJoCoPlant
from maglev_mj.scenes.parts import WEIGHT, shared, walls
from maglev_mj.scenes.settings import Settings
from maglev_mj.spec import Spec

__all__ = ["Scene"]

_LIFTED = 0.004


@dataclass(frozen=True, kw_only=True, eq=False)
class Scene:
    """What a person meets on the joystick. The mechanics are the device's: six coils of 10 A each, and metal stops.

    Args:
        name: Its name, which is also that of `model/scenes/NAME.xml`.
        says: What it is, in a few words.
        make: Makes the laws that the settings ask for, with the scene's own walls.
        settings: Those it starts with.
        pose: Where the flotor starts [m, rad].
        axis: Name of the axis that plots show.
        script: Where the scripted hand of a clip pulls to, on all six axes.

    Raises:
        ParameterError: If there is no such axis.
    """

    name: str
    says: str
    make: Callable[[Settings], Sequence[Law]]
    settings: Settings = field(default_factory=Settings)
    pose: tuple[float, ...] = (0.0,) * 6
    axis: str = "z"
    script: Path | None = None

    def __post_init__(self) -> None:
        axis_indices(self.axis)

    @property
    def axis_index(self) -> int:
        """Index into AXES of the axis that plots show."""
        return AXES.index(self.axis)

    @property
    def lifted(self) -> tuple[float, ...]:
        """Where the flotor is let go from [m, rad]: the start, lifted to 4 mm."""
        return (*self.pose[:2], _LIFTED, *self.pose[3:])

    def laws(self, settings: Settings) -> list[Law]:
        """Return the laws that the settings ask for."""
        laws = list(self.make(settings))
        if settings.walls is None or not settings.wall:
            return laws
        gains = shared(settings) if any(isinstance(law, Friction) for law in laws) else settings
        return [law for law in laws if not isinstance(law, Wall)] + walls(gains, settings.walls)

    def controller(self, settings: Settings) -> Controller:
        """Return a controller of the scene's laws."""
        return Controller(self.laws(settings), period=settings.period)

    def plant(
        self,
        settings: Settings,
        *,
        pose: ArrayLike | None = None,
        twist: ArrayLike = (0.0,) * 6,
        wrench: ArrayLike | None = None,
        hand_force: HandForce | None = None,
        **keywords: Any,
    ) -> MuJoCoPlant:
        """Return the device.

        Args:
            settings: Period and delay.
            pose: Where it starts [m, rad], (6,); the scene's by default.
            twist: How fast [m/s, rad/s], (6,).
            wrench: What its coils give until the first command takes effect [N, N m], (6,); by default they carry
                it if the settings say so.
            hand_force: The hand on it.
            keywords: Further ones of `MuJoCoPlant`.
        """
        if wrench is None:
            wrench = WEIGHT if settings.weightless else (0.0,) * 6
        return MuJoCoPlant(
            settings.timing,
            pose=self.pose if pose is None else pose,
            twist=twist,
            wrench=wrench,
            hand_force=hand_force,
            current_limit=Spec.peak_current.value,
            stops=True,
            metered=True,
            **keywords,
        )
