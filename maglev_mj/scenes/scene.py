"""Base class of scenes: parameters, laws, start, hand, and figures of a run."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Self

import numpy as np

from maglev_mj.control import Law, VelocityEstimator
from maglev_mj.control.controller import Controller
from maglev_mj.control.stack import content
from maglev_mj.device import OnDevice, command_delay, sample_period
from maglev_mj.errors import ParameterError, check_instance, named, one_line
from maglev_mj.frames import AXES, ZERO, Array, Component
from maglev_mj.keywords import checked, rate_of
from maglev_mj.parameters import Turn, axis_indices, store
from maglev_mj.plants import ExactPlant, MuJoCoPlant, SampledPlant, Timing
from maglev_mj.plants.hand import GuidedHand, HandForce, SpringHand, Trajectory
from maglev_mj.plants.model import Flotor, body_of
from maglev_mj.scenes.figures import figures_named
from maglev_mj.scenes.results import RunResult
from maglev_mj.spec import MAX_DELAY, MAX_DELAY_PERIODS

if TYPE_CHECKING:  # which loads MuJoCo
    from maglev_mj.plants.shapes import Shape

RATE = Turn(among=(50.0, 100.0, 200.0, 500.0, 1000.0, 2000.0), inverse=True, word="rate")
"""Key steps of the sample rate."""

DELAY = Turn(add=0.0005, least=0.0, most=0.02, word="delay")
"""Key steps of the delay."""

_MOST_PERIODS = 1_000_000

PlantMaker = Callable[..., SampledPlant]
"""Function from timing and keywords to a plant."""

PLANTS: Mapping[str, PlantMaker] = {"exact": ExactPlant, "mujoco": MuJoCoPlant}
"""Plants by name."""


class OneDevice:
    """Function that makes MuJoCo plants, and starts its last one again where only start, timing and hand force differ.

    The plant is bit for bit a new one, for a fraction of its cost; the plant before it has then ended.
    """

    def __init__(self) -> None:
        self._plant: SampledPlant | None = None
        self._options: bytes | None = None

    def __call__(self, timing: Timing, *, hand_force: HandForce | None = None, **options: Any) -> SampledPlant:
        """Return the plant at release; see `MuJoCoPlant`."""
        start = {name: options.pop(name) for name in ("pose", "twist") if name in options}
        alike, self._options = self._options, content(options)
        if self._plant is None or self._options is None or self._options != alike:
            self.close()
            self._plant = MuJoCoPlant(timing, hand_force=hand_force, **start, **options)
        else:
            self._plant.restart(**start, timing=timing)
            self._plant.hold(hand_force)
        return self._plant

    def close(self) -> None:
        """Close the last plant."""
        if self._plant is not None:
            self._plant.close()
            self._plant = None


RESERVED = frozenset(
    "version plant phase phases json out format record seconds size fps workers scheduler vary set scene plots".split()
)
"""Option names of every command, reserved."""


@checked
@dataclass(frozen=True, kw_only=True)
class Start:
    """State at release.

    Attributes:
        pose: Pose [m, rad], (6,).
        twist: Velocity [m/s, rad/s], (6,).
        wrench: Wrench of the coils until the first command takes effect [N, N m], (6,).
        gravity: Acceleration of free fall along -z, or in stator axes (3,) [m/s²]; None for the device's, 9.81 m/s².

    Example:
        >>> from maglev_mj import Start
        >>> Start(pose=(0.0, 0.0, 0.002, 0.0, 0.0, 0.0), gravity=0.0).gravity  # weight compensated
        0.0
    """

    pose: Sequence[float] = ZERO
    twist: Sequence[float] = ZERO
    wrench: Sequence[float] = ZERO
    gravity: float | Sequence[float] | None = None

    def __post_init__(self) -> None:
        for name in ("pose", "twist", "wrench"):
            if np.shape(values := getattr(self, name)) != (len(AXES),):
                raise ParameterError(f"start {name} must have shape (6,) (got {one_line(values)})")


@checked
class Scene(OnDevice):
    """Base class of scenes, which are simulated experiments with the flotor.

    Subclass it, declare parameters with `param`, and define `laws`.

    Class attributes:
        name: Name on the command line; the class name in kebab-case by default.
        title: Title of tables; the first line of the docstring by default.
        shown_axis: Axis of plots and figures.
        figures: Figures of a run: names of stock figures, or `Figure` objects; a mapping sets other JSON keys.
        plants: Names of supported plants, the default first.
        takes_phase: True if results depend on the sampling phase.
        tolerance: Negligible displacement of a coil [m], for `fidelity`.
        tolerance_reason: Reason for that value.
        model: MJCF file for display: a path, or the name of a model of the package.
        plots: User-defined plots: file name without suffix -> "module:function" that draws `Variants`.
        run_figures: User-defined method (plant, phase) that returns the figures of a run; None for the default.
        figures_together: User-defined class method (scenes, plant, phases) that returns those of many runs; None for
            batches.
        band_phases: Number of sampling phases in the bands of the plots; 0 for none.

    Raises:
        ParameterError: If a parameter is outside its bounds, or a run has more than a million periods.

    Example:
        >>> from maglev_mj import Hold, Scene, Start, param, run
        >>> class Release(Scene):
        ...     "Release the flotor beside the setpoint of a hold."
        ...
        ...     shown_axis = "x"
        ...     offset: float = param("offset at release", "m", default=0.001, above=0.0, at_most=0.004)
        ...     duration: float = param("simulated time", "s", default=0.5, above=0.0)
        ...
        ...     def start(self):
        ...         return Start(pose=(self.offset, 0, 0, 0, 0, 0), gravity=0.0)
        ...
        ...     def laws(self):
        ...         return [Hold(axes="x", stiffness=2000.0, damping=60.0)]
        >>> result = run(Release(offset=0.002))
        >>> bool(abs(result.motion(0.5)[0]) < 1e-5)  # settled after half a second
        True
    """

    name: ClassVar[str] = ""
    title: ClassVar[str] = ""
    shown_axis: ClassVar[str] = "z"
    figures: ClassVar[Any] = ()
    plants: ClassVar[Sequence[str]] = ("mujoco", "exact")
    takes_phase: ClassVar[bool] = True
    tolerance: ClassVar[float] = 1e-5
    tolerance_reason: ClassVar[str] = "twice the sensor resolution"
    plots: ClassVar[Mapping[str, str]] = {}
    band_phases: ClassVar[int] = 0
    run_figures: ClassVar[Any] = None
    figures_together: ClassVar[Any] = None
    model: ClassVar[str | Path] = "scenes/joystick"

    period: float = sample_period(live=RATE)
    rate: float = rate_of("period")
    delay: float = command_delay(at_most=MAX_DELAY, live=DELAY)

    def __init_subclass__(cls, **keywords: Any) -> None:
        for name, value in vars(cls).items():
            if name in RESERVED and "param" in getattr(value, "metadata", ()):
                raise TypeError(f"{cls.__name__}.{name} cannot be a parameter: it is an option of every command")
        if "title" not in vars(cls) and (doc := vars(cls).get("__doc__")):
            cls.title = doc.strip().split("\n")[0].rstrip(".")
        super().__init_subclass__(**keywords)
        if "name" not in cls.__dict__:
            cls.name = "".join(f"-{c.lower()}" if c.isupper() else c for c in cls.__name__).strip("-")
        axis_indices(cls.shown_axis)
        cls.figures = figures_named(cls.figures)

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.end / self.period > _MOST_PERIODS:
            raise ParameterError(f"duration must be at most {_MOST_PERIODS} periods (got {self.end:g} s)")

    # --- defined by a scene ---------------------------------------------------------------------

    def laws(self) -> Sequence[Law | Callable[..., Any]]:
        """Return the laws, whose wrenches are summed.

        A function f(position, velocity) is a law too; see `Controller`.
        """
        raise ParameterError(f"{named(type(self))} must define laws()")

    def start(self) -> Start:
        """Return the state at release."""
        return Start()

    def scripted_hand(self, phase: float = 0.0) -> HandForce | None:
        """Return the scripted hand, or None; its optional attribute `hand` is its impedance."""
        return None

    def velocity_estimator(self) -> VelocityEstimator | None:
        """Return the velocity estimator; None for the finite difference."""
        return None

    def timing(self, phase: Component = 0.0) -> Timing:
        """Return the timing of samples and commands."""
        return Timing(period=self.period, delay=self.delay, phase=phase)

    @property
    def device_clock(self) -> tuple[float, float]:
        """Sample period and delay of walls on the device [s], also at a delay that no plant simulates."""
        simulated = self.delay <= MAX_DELAY_PERIODS * self.period
        return (self if simulated else self.replace(delay=0.0)).timing().device

    def plant_options(self) -> dict[str, Any]:
        """Return keywords of the plant: mass, limits, sensor; `longest_step` may be a function of the plant's name."""
        return {}

    def variants(self) -> Mapping[str, Self]:
        """Return scenes to compare by label, this one first."""
        return {self.name: self}

    def describe(self) -> str:
        """Return a one-line description."""
        return self.title or self.name

    def beside(self) -> Sequence[Shape]:
        """Return shapes that are drawn beside the device, such as those of a robot that follows."""
        return ()

    def beside_poses(self, states: Any) -> Array:
        """Return centres [m] and unit quaternions of these shapes, (N, 7), by the states of the laws."""
        return np.zeros((0, 7))

    @property
    def axis(self) -> str:
        """Axis of plots and figures."""
        return self.shown_axis

    @property
    def axis_index(self) -> int:
        """Index into AXES of the shown axis."""
        return AXES.index(self.axis)

    @property
    def body(self) -> Flotor:
        """Flotor and limits of the device in use."""
        return body_of({"gravity": self.start().gravity} | self.device_options())

    def device_options(self) -> dict[str, Any]:
        """Return keywords of the plant that make it the scene's device, and `plant_options`, which override them."""
        own, device = self.plant_options(), self.hardware
        options = device.keywords | own
        if device.coils is None and options.get("model") is device:  # it exerts no torque
            limit = math.inf if own.get("wrench_limit") is None else own["wrench_limit"]
            options["wrench_limit"] = np.minimum(limit, [math.inf] * 3 + [0.0] * 3)
        return options

    @property
    def has_pulses(self) -> bool:
        """True if a law exerts force pulses."""
        widths = ((law, getattr(law, "pulse_width", 0.0)) for law in self.laws())
        return any(width > 0.0 and np.any(getattr(law, "pulse", True)) for law, width in widths)

    @property
    def end(self) -> float:
        """End of a run [s]: the parameter `duration`, or 1 s."""
        return float(getattr(self, "duration", 1.0))

    def series(self, result: RunResult, time: Array) -> dict[str, Array]:
        """Return the JSON series by name on a time grid (M,), (M,) each."""
        pose, twist, wrench = result.trace.at(time)
        index = AXES.index(self.axis)
        return {"position": pose[:, index], "velocity": twist[:, index], "force": wrench[:, index]}

    def extra_json(self, result: RunResult) -> dict[str, Any]:
        """Return additional JSON entries of a run."""
        return {}

    def compared(self, result: RunResult) -> Mapping[str, Mapping[str, float]]:
        """Return reference figures, such as those of a closed form, by label and name."""
        return {}

    def guided(self, path: Trajectory) -> Self:
        """Return the scene with a hand that moves along a path, with the impedance of its own hand if it has one."""
        impedance, scene = getattr(self.scripted_hand(), "hand", None), self.replace()
        force: HandForce = SpringHand(target=path) if impedance is None else GuidedHand(hand=impedance, path=path)
        store(scene, script=path, scripted_hand=lambda phase=0.0: force)
        return scene

    # --- derived from it --------------------------------------------------------------------------

    def controller(self) -> Controller:
        """Return a new controller of the laws."""
        return Controller(self.laws(), period=self.period, velocity=self.velocity_estimator())

    def ticks(self, timing: Timing) -> int:
        """Return the number of samples until the end."""
        return max(math.ceil(self.end / self.period - float(np.min(timing.phase)) + 1e-9), 1)

    def plant(
        self,
        plant: str | PlantMaker = "mujoco",
        *,
        phase: float = 0.0,
        hand_force: HandForce | None = None,
        timing: Timing | None = None,
        make: PlantMaker | None = None,
        **keywords: Any,
    ) -> SampledPlant:
        """Return the plant at release, with the scripted hand or another.

        Args:
            plant: Name from PLANTS, or a function that returns a plant.
            phase: Sampling phase, in [0, 1).
            hand_force: Hand in place of the scripted one; `hand`, among the keywords, is an impedance.
            timing: Timing in place of the scene's own.
            make: Function that makes the plant of that name, such as a `OneDevice`.
            keywords: Keywords of the plant; they override the scene's.

        Raises:
            KeywordError: If the plant does not accept a keyword.
        """
        scripted = self.scripted_hand(phase)
        options = self.plant_keywords(plant, scripted) | keywords
        if isinstance(plant, str):
            plant = make or PLANTS[plant]
        return plant(timing or self.timing(phase), hand_force=hand_force or scripted, **options)

    def plant_keywords(self, plant: str | PlantMaker, hand_force: HandForce | None) -> dict[str, Any]:
        """Return all keywords of a plant at release, including `plant_options`.

        Args:
            plant: Name from PLANTS, or a function that returns a plant.
            hand_force: The scripted hand, whose impedance acts on the flotor.
        """
        start = self.start()
        check_instance(f"start() of {named(type(self))}", start, Start, "a Start")
        options: dict[str, Any] = {
            "pose": list(start.pose),
            "gravity": start.gravity,
            "escape": (self.hardware.escape, 1.0),
        }
        if any(start.twist):
            options["twist"] = start.twist
        if any(start.wrench):
            options["wrench"] = start.wrench
        if (impedance := getattr(hand_force, "hand", None)) is not None:
            options["hand"] = impedance
        options |= self.device_options()
        if callable(step := options.get("longest_step")):
            options["longest_step"] = step(plant)
        return options
