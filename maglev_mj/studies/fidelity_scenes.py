"""Scenes that model levels are compared in: the experiments themselves, and three of the body alone."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np

from maglev_mj.controller import Controller
from maglev_mj.experiments.drop import DropParameters, drop_parts
from maglev_mj.experiments.press import PressParameters, press_parts
from maglev_mj.experiments.stick_slip import StickSlipParameters, stick_slip_parts
from maglev_mj.hand import Hand
from maglev_mj.laws import Hold
from maglev_mj.parameters import number
from maglev_mj.plants import SampledPlant, Timing
from maglev_mj.scenes.choices import PlantMaker
from maglev_mj.spec import GRAVITY, INERTIA, Spec

__all__ = ["FIDELITY_SCENES", "CentringParameters", "FidelityScene", "FreeParameters"]

_MOST_TICKS = 1_000_000


@dataclass(frozen=True, kw_only=True)
class FreeParameters:
    """A flotor without any law.

    Attributes:
        period: Sample period [s].
        delay: From a sample to its command taking effect [s].
        duration: Simulated time [s]; at most a million periods.

    Raises:
        ParameterError: If a value is outside its bounds.
    """

    period: float = 1.0 / Spec.control_rate.value
    delay: float = Spec.transport_delay.value
    duration: float = 0.08

    def __post_init__(self) -> None:
        object.__setattr__(self, "period", number("period", self.period, at_least=1e-6, at_most=1.0))
        object.__setattr__(self, "delay", number("delay", self.delay, at_least=0.0, at_most=1.0))
        most = _MOST_TICKS * self.period
        object.__setattr__(self, "duration", number("duration", self.duration, above=0.0, at_most=most))

    @property
    def ticks(self) -> int:
        """Samples to answer."""
        return math.ceil(self.duration / self.period - 1e-9)


@dataclass(frozen=True, kw_only=True)
class CentringParameters(FreeParameters):
    """A flotor held at the centre by a spring and a damper on all six axes.

    The gains of rotations are those of translations times the square of the radius of gyration.

    Attributes:
        stiffness: Stiffness of the hold [N/m]; None for the soft one that period and delay allow.
        damping: Damping of the hold [N s/m]; likewise.

    Raises:
        ParameterError: If a value is outside its bounds.
    """

    duration: float = 0.3
    stiffness: float | None = None
    damping: float | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        soft = Hold.critically_damped("x", inertia=INERTIA[0], period=self.period, delay=self.delay)
        for name, most in (("stiffness", 1e8), ("damping", 1e6)):
            given = getattr(self, name)
            value = float(np.asarray(getattr(soft, name))) if given is None else given
            object.__setattr__(self, name, number(name, value, at_least=0.0, at_most=most))


@dataclass(frozen=True, kw_only=True, eq=False)
class FidelityScene:
    """One scene, and how well it is to be known.

    Attributes:
        name: Its name.
        describe: Returns a line on what happens, from the parameters.
        tolerance: Greatest displacement of a coil that does not matter [m].
        reason: Where the tolerance is from.
        kind: Class of the experiment's parameters.
        values: Those that are not the class's defaults.
        parts: Makes plant, controller and the number of samples from the parameters and a maker of plants.
    """

    name: str
    describe: Callable[[Any], str]
    tolerance: float
    reason: str
    parts: Callable[..., tuple[SampledPlant, Controller, int]]
    kind: type[Any]
    values: Mapping[str, Any] = field(default_factory=dict)

    def changed(self, **values: Any) -> FidelityScene:
        """Return the scene with other values of its parameters.

        Raises:
            ParameterError: If a value is outside its bounds.
        """
        return replace(self, values={**self.values, **values})

    @cached_property
    def parameters(self) -> Any:
        """Parameters of the experiment.

        Raises:
            ParameterError: If a value is outside its bounds.
        """
        return self.kind(**self.values)

    @property
    def has_gains(self) -> bool:
        """True if stiffness and damping are among the parameters."""
        return hasattr(self.parameters, "stiffness")

    @property
    def has_phase(self) -> bool:
        """True if the samples' phase is among the parameters."""
        return hasattr(self.parameters, "phase")

    @property
    def period(self) -> float:
        """Sample period [s]."""
        return float(self.parameters.period)

    @property
    def hand(self) -> Hand | None:
        """Hand on the flotor."""
        return self.parameters.impedance if isinstance(self.parameters, PressParameters) else None

    @property
    def longest_step(self) -> float | None:
        """Longest step that the hand asks for [s]; None where there is none."""
        return self.parameters.longest_step if isinstance(self.parameters, PressParameters) else None


def _twist(p: FreeParameters, *, make: PlantMaker) -> tuple[SampledPlant, Controller, int]:
    pose, twist = (0.0, 0.0, 0.0, -0.04, 0.03, -0.02), (0.0, 0.0, 0.0, 2.0, -1.5, 2.7)
    plant = make(Timing(period=p.period, delay=p.delay), pose=pose, twist=twist, gravity=0.0)
    return plant, Controller([], period=p.period), p.ticks


def _let_go(p: FreeParameters, *, make: PlantMaker) -> tuple[SampledPlant, Controller, int]:
    plant = make(Timing(period=p.period, delay=p.delay), pose=(0.0,) * 6, gravity=GRAVITY)
    return plant, Controller([], period=p.period), p.ticks


def _centring(p: CentringParameters, *, make: PlantMaker) -> tuple[SampledPlant, Controller, int]:
    share = np.array(INERTIA) / INERTIA[0]
    assert p.stiffness is not None and p.damping is not None  # derived when made
    hold = Hold(stiffness=p.stiffness * share, damping=p.damping * share)
    pose = (0.003, -0.002, 0.003, 0.06, -0.04, 0.05)
    plant = make(Timing(period=p.period, delay=p.delay), pose=pose, gravity=0.0)
    return plant, Controller([hold], period=p.period), p.ticks


def _gains(p: Any) -> str:
    return f"{p.stiffness:.6g} N/m and {p.damping:.4g} N s/m"


def _drop_words(p: DropParameters) -> str:
    pulse = f"a braking pulse of {p.pulse:g} N s/m" if p.pulse else "no pulse"
    return f"a drop of {p.height * 1e3:g} mm on a wall of {_gains(p)}, {pulse}"


def _press_words(p: PressParameters) -> str:
    hits = f"a hand ({p.hand}) hits a wall of {_gains(p)} from {p.height * 1e3:g} mm"
    return f"{hits}, then presses by {p.press:g} N"


FIDELITY_SCENES: Mapping[str, FidelityScene] = {
    scene.name: scene
    for scene in (
        FidelityScene(
            name="drop",
            describe=_drop_words,
            tolerance=1e-3,
            reason="less than the sampler's phase alone does to the penetration",
            kind=DropParameters,
            parts=drop_parts,
        ),
        FidelityScene(
            name="drop-no-pulse",
            describe=_drop_words,
            tolerance=1e-4,
            reason="what the paper's figure 3 can be read to",
            kind=DropParameters,
            values={"pulse": 0.0},
            parts=drop_parts,
        ),
        FidelityScene(
            name="press",
            describe=_press_words,
            tolerance=1e-5,
            reason="two steps of the sensor",
            kind=PressParameters,
            values={"hits": 1, "interval": 0.2, "height": 0.001, "press": 1.0, "pulse": 0.0, "duration": 0.5},
            parts=press_parts,
        ),
        FidelityScene(
            name="stick-slip",
            describe=lambda p: f"pulled out of {p.law} friction by a spring, as in figure 8; {_gains(p)} while stuck",
            tolerance=1e-5,
            reason="two steps of the sensor",
            kind=StickSlipParameters,
            parts=stick_slip_parts,
        ),
        FidelityScene(
            name="twist",
            describe=lambda p: "a free flotor that turns at 3.7 rad/s about all three axes",
            tolerance=1e-5,
            reason="two steps of the sensor",
            kind=FreeParameters,
            values={"duration": 0.04},
            parts=_twist,
        ),
        FidelityScene(
            name="six-axes",
            describe=lambda p: f"drawn back to the centre from 3 mm and 3.4 degrees on all six axes, by {_gains(p)}",
            tolerance=1e-5,
            reason="two steps of the sensor",
            kind=CentringParameters,
            parts=_centring,
        ),
        FidelityScene(
            name="let-go",
            describe=lambda p: "the currents off at centre: the flotor falls on its stop",
            tolerance=1e-4,
            reason="well below the 0.5 mm over which the stop gives",
            kind=FreeParameters,
            parts=_let_go,
        ),
    )
}
"""Scenes by name, each with its default parameters."""
