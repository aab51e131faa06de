"""The device as its amplifiers see it: six currents in, at any instant; the pose is for a sensor to measure."""

from __future__ import annotations

import math
import struct
from collections.abc import Sequence
from functools import partial
from typing import Any

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from maglev_mj.coils import CoilMap
from maglev_mj.errors import ParameterError, PlantError
from maglev_mj.frames import Array, Command
from maglev_mj.model import COILS
from maglev_mj.parameters import numbers
from maglev_mj.plants.mujoco import Drive, MuJoCoPlant
from maglev_mj.timeline import Timing

__all__ = ["CoilDrivenPlant"]

_NO_CURRENTS = (0.0,) * 6


class CoilDrivenPlant(MuJoCoPlant):
    """`MuJoCoPlant` that is driven by currents instead of wrenches.

    Whoever commands it has to know its coils: what they are in truth may be given, and differ from what is known. Where
    a switch of the currents falls between two samples is free, and where it falls as a wrench's would, and the currents
    are those that `MuJoCoPlant` computes, the motion is the same to the last bit.

    Args:
        timing: As for `MuJoCoPlant`; the delay is from a sample to a switch that does not say when it is.
        coils: What the coils are; the model's by default.
        gravity: Acceleration of free fall in stator axes [m/s²], (3,); the model's by default. Not along z where the
            base is not level.
        keywords: Those of `MuJoCoPlant`, but for wrench, wrench_limit, current_limit and sensor: who knows the coils
            knows the sensor too.

    Raises:
        ParameterError: If gravity is not (3,), or a keyword is one of those, or as for `MuJoCoPlant`.
    """

    def __init__(
        self,
        timing: Timing | None = None,
        *,
        coils: CoilMap | None = None,
        gravity: ArrayLike | None = None,
        **keywords: Any,
    ) -> None:
        if wrong := {"wrench", "wrench_limit", "current_limit", "sensor"} & set(keywords):
            raise ParameterError(f"a plant driven by currents takes no {', '.join(sorted(wrong))}")
        super().__init__(timing, **keywords)
        self._map = coils or self.device.coils
        if coils is not None:
            self._put_coils(coils)
        if gravity is not None:
            falling = numbers("gravity", gravity)
            if falling.shape != (3,):
                raise ParameterError(f"gravity must be (3,), not {falling.shape}")
            self._model.opt.gravity[:] = falling
        self._inverse_map = np.eye(len(COILS))  # from what is commanded, currents, to currents
        self._upright = math.inf
        self._fill = partial(struct.pack_into, "6d", self._currents.data, 0)
        self._timeline.acting = self._prepare(_NO_CURRENTS)

    def drive(
        self,
        currents: Sequence[float],
        pulsed: Sequence[float] | None = None,
        width: float = 0.0,
        *,
        after: float | None = None,
    ) -> None:
        """Switch the currents; what was to be switched later than that is not.

        Args:
            currents: Currents from then on [A], six.
            pulsed: In place of them for the first `width` seconds [A], six.
            width: How long [s]; 0 for no pulse.
            after: When, since the last sample [s]; the timing's delay by default.

        Raises:
            PlantError: If a current is not finite, or no sample was read.
        """
        if self._tick < 0 or not math.isfinite(sum(currents) + sum(pulsed or ()) + width):
            raise PlantError(f"currents must be finite and follow a sample, not {tuple(currents)} for {width:g} s")
        held = self._prepare(currents)
        ahead = held if pulsed is None else self._prepare(pulsed)
        self._timeline.answer(self._tick, held, ahead, width, after=after)

    def write(self, command: Command) -> Command:
        """Refuse: a wrench needs somebody who knows the coils.

        Raises:
            PlantError: Always.
        """
        raise PlantError("a plant driven by currents takes drive(), not write()")

    @property
    def applied_currents(self) -> tuple[float, ...]:
        """Currents that are held at the last sample, or pulsed where a pulse is on [A], six."""
        return tuple(self._timeline.now()[0])

    @property
    def segments(self) -> list[tuple[float, Sequence[float]]]:
        """Currents from the sample before the last one to that: how long each flowed [s], and six [A]."""
        return [(duration, drive[0]) for duration, drive in self._segments]

    def open_coil(self, coil: int) -> None:
        """Let a coil, 0 to 5, give no force from now on, as one whose wire is broken."""
        self._model.actuator_gainprm[coil, 0] = 0.0

    def _put_coils(self, coils: CoilMap) -> None:
        """Make the model's coils those."""
        model, known = self._model, self.device.coils
        assert known is not None  # the model is loaded with them
        data = mujoco.MjData(model)
        mujoco.mj_forward(model, data)
        sites, magnets = model.actuator_trnid[: len(COILS)].T
        model.site_pos[sites] += coils.points - known.points
        axes = data.site_xmat[magnets].reshape(-1, 3, 3)
        model.actuator_gear[: len(COILS), :3] = np.einsum("jba,jb->ja", axes, coils.directions)
        model.actuator_gainprm[: len(COILS), 0] = coils.force_constants

    def _apply(self, drive: Drive) -> None:
        """Hand currents to the engine."""
        self._applied = drive
        self._fill(*drive[0])

    def _state(self, drive: Drive) -> tuple[Array, Array, Array]:
        pose, twist, currents = super()._state(drive)
        assert self._map is not None
        wrench = np.asarray(np.linalg.solve(self._map.inverse_at(self._rotation), currents), dtype=np.float64)
        return pose, twist, wrench
