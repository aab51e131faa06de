"""Remote device as a plant, with takeoff and landing."""

from __future__ import annotations

import gc
import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import TypeAlias

import numpy as np

from maglev_mj.bridge.flight_guards import Alarm, DeviceSample, When, shown
from maglev_mj.bridge.guarded import GuardedPlant
from maglev_mj.bridge.landing import LANDING_DELAY, LandingReport, Leader, RecentMotion, Swing, straight
from maglev_mj.bridge.wire import Fault
from maglev_mj.control.loop import ControlLoop
from maglev_mj.errors import PlantError, SensingError
from maglev_mj.frames import ZERO
from maglev_mj.keywords import checked
from maglev_mj.parameters import flag, number
from maglev_mj.plants.hand import Trajectory

_ON_STOP = 0.6
"""Share of the range beyond which the flotor lies on its lower stop."""

_TRY = 0.15
_TRIES = [7e-4, 0.0, 0.0, 0.0, 0.0, 0.007], [-3.5e-4, 6e-4, 0.0, 0.0, 0.0, -0.007], ZERO
"""Time to each pose [s], and poses around the centre that together load every coil [m, rad].

For the range of the published joystick.
"""

_SETTLING, _OBSERVATION = 0.3, 0.2
"""Longest wait for rest before disarming, and observation time after it [s]."""

_Watch: TypeAlias = Callable[[], object]


@checked
class RemotePlant(GuardedPlant):
    """Remote device as a plant.

    Same interface as `MuJoCoPlant`; use from one thread. The device is the clock: `read` waits for its next sample. A
    lost sample leaves a gap in the tick numbers. All commands pass one output limiter: finite values, wrench,
    currents, coil temperatures. A failure ends the currents, latches a fault until `reset`, and writes the last
    cycles to a file.

    Args:
        link: Link to the device, or its address; see `open_link`. Closed with the plant or if the handshake fails.
        calibration: Calibration of the device; the device must have the same.
        key: Authentication key of the frames; None for none.
        limits: Limits of the host; the smaller of these and the device's apply.
        patience: Longest wait for an answer or a sample [s].
        folder: Folder of the files of last cycles.

    Attributes:
        rest: Pose before takeoff and target of the landing [m, rad]. For the others see `GuardedPlant`.

    Raises:
        HandshakeError: If no device answers, another host uses it, its version or calibration differs, or its limits
            are not sane or do not allow hovering.
        LinkError: If the link has failed.
        ParameterError: If a value is outside its bounds, or the host's limits do not allow hovering.

    Example:
        >>> from maglev_mj.bridge import Twin, TwinParameters
        >>> from maglev_mj.bridge.twin import simulated_links
        >>> RemotePlant(simulated_links.VirtualLink(Twin(TwinParameters()))).period
        0.005
    """

    rest: Sequence[float] = ZERO

    def _prepare(self) -> None:
        self._leader, self._tolerant = (Leader(self.calibration, self.period, x) for x in (self.delay, LANDING_DELAY))

    def takeoff(self, duration: float = 0.6, *, watch: _Watch | None = None, check_coils: bool = False) -> None:
        """Check that the flotor is at rest, arm, and move it to the centre.

        At rest: up to `Scale.rest` and `Scale.rest_spin` over 0.1 s. Slow work is done before the currents flow.

        Args:
            duration: Duration of the motion [s].
            watch: Called after each sample of the motion; True ends it early.
            check_coils: True to check each coil: moves by 0.7 mm and 7 mrad times the range, 0.45 s longer.

        Raises:
            DeviceFault: If the flotor does not follow, or another fault occurs.
            PlantError: If the flotor moves, is not on its lower stop or its pose is not measured (not armed), or if a
                coil that was checked is not as calibrated (landed).
        """
        flag("check_coils", check_coils)
        duration = number("duration", duration, above=0.0)
        self.require_inactive()
        leader, loop = self._leader, ControlLoop(self, self._leader)
        gc.collect()
        motion = self._observed(0.0)
        if self.alarm or not motion.full:
            raise PlantError(f"no takeoff: {self.alarm or 'flotor pose not measured'}")
        rest = motion.pose
        if not motion.at_rest:
            raise PlantError(f"no takeoff: the flotor moves at {motion}; it must be at rest")
        gravity, base = self.calibration.gravity.tolist(), self.calibration.base
        # along gravity; without gravity every pose counts as on the lower stop
        if sum(x * g for x, g in zip(rest, gravity)) < _ON_STOP * base.reach[2] * math.hypot(*gravity):
            raise PlantError(f"no takeoff: the flotor is at {shown(rest)}; it must lie on its lower stop")

        def off_path(pose: Sequence[float]) -> None:
            coil = (fault := self.coils.fault(lost=True)) and f"; {fault}"
            self.end(Alarm(Fault.NOT_FOLLOWING, f"the flotor is at {shown(pose)}, off the takeoff path{coil}"))

        leader.aim(straight(rest, rest, duration))
        loop.cycle(2)  # warm-up of slow first calls; the device ignores these answers
        poses = [rest, ZERO, *((np.array(_TRIES) * base.range_ratio).tolist() if check_coils else ())]
        times = [0.0, *(duration + _TRY * leg for leg in range(len(poses) - 1))]
        leader.aim(Trajectory(times, poses, "minimum-jerk"), off_path)
        self.arm()
        self.rest, self.guided, self._hand.check_coils = rest, True, True
        try:
            ended, fault = self._lead(loop, times[-1] - check_coils * self.period, watch), ""
            if check_coils and not ended:
                fault = self.coils.fault()  # takes up to 30 ms, as does what follows: a sample is answered between
                loop.cycle()
        finally:
            self.guided = self._hand.check_coils = False
        if fault:
            self._landed(leader, duration, None)
            raise PlantError(f"no flight: {fault}; landed. Keep hands off during takeoff, or recalibrate")

    def weigh(self) -> str:
        """Land, and take off next, with the mass and inertia that the takeoff has found.

        Returns:
            Message if the limits do not allow hovering with them; "" if they do.
        """
        known, coils = self.calibration, self._hand.coils
        known = replace(known, mass=coils.mass * known.mass, inertia=coils.inertia * known.inertia)
        self._hand.weigh(known)
        return self._carry(known)

    def land(self, duration: float = 0.6, *, watch: _Watch | None = None, reason: str = "") -> LandingReport:
        """Move the flotor back to its rest pose and disarm.

        Args:
            duration: Duration of the motion [s]; up to 0.3 s longer until the flotor is at rest.
            watch: As for `takeoff`.
            reason: Reason of an early end; "" without. With one, a softer hold is used, stable up to 50 ms of delay,
                the last cycles are written to a file, and a flotor that still oscillates is cut.

        Returns:
            Pose and motion 0.2 s later.

        Raises:
            DeviceFault: As for `takeoff`.
        """
        if not reason:
            return self._landed(self._leader, duration, watch)
        swing, cycles = Swing(self.scale.drop), self.cycles.mark(Fault(0), reason, self._about())

        def swinging(sample: DeviceSample) -> Alarm | None:
            if not sample.active or sample.error is not None:
                return None
            speed = swing.check(sample.pose, self.samples.tick * self.period)
            return Alarm(Fault.HOST, f"{reason}; still moving at {speed:.2f} m/s in the landing") if speed else None

        self.guards.append((When.SAMPLED, swinging))
        try:
            report = self._landed(self._tolerant, duration, watch)
        finally:
            self.guards.pop()
        return report._replace(reason=reason, path=self.cycles.write(cycles))

    def _landed(self, leader: Leader, duration: float, watch: _Watch | None) -> LandingReport:
        """Move the flotor back to its rest pose and disarm; with a delayed sensor by the hold of an early landing."""
        loop, self.guided = ControlLoop(self, leader), True
        leader.aim(straight(self.pose, self.rest, duration))

        def delayed() -> bool:
            return self.sensor_delay > 0.0 and leader is not self._tolerant

        if self._lead(loop, duration, lambda: delayed() or (watch is not None and watch())) and delayed():
            return self._landed(self._tolerant, duration, watch)
        end = self.samples.tick + round(_SETTLING / self.period)
        while self.samples.tick < end and not leader.motion.at_rest:
            loop.cycle()
        self.disarm()
        motion = self._observed(_OBSERVATION)
        at_rest = motion.at_rest and not self.alarm
        return LandingReport(math.dist(motion.pose[:3], self.rest[:3]), *motion.speeds, at_rest)

    def _lead(self, loop: ControlLoop, duration: float, watch: _Watch | None) -> bool:
        """Run a loop for a duration [s]; return True if it ended early."""
        end = self.samples.tick + max(round(duration / self.period), 1)
        while self.samples.tick < end:
            loop.cycle()
            if watch is not None and watch():
                return True
        return False

    def _observed(self, duration: float) -> RecentMotion:
        """Observe the motion for at least `duration` [s], until it covers 0.1 s or a guard raises alarm."""
        motion, self.alarm = RecentMotion(self.period, self.scale), ""
        end = self.samples.tick + round(duration / self.period)
        while self.samples.tick < end or not (motion.full or self.alarm):
            try:
                motion.add(self.read())
            except SensingError as error:
                self.alarm = str(error)
        return motion
