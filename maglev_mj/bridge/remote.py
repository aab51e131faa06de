"""Device at the other end of a wire: its takeoff and landing."""

from __future__ import annotations

import gc
import math
from collections.abc import Callable, Sequence
from typing import NoReturn, TypeAlias

from maglev_mj.bridge.flight_guards import shown
from maglev_mj.bridge.guarded import GuardedPlant
from maglev_mj.bridge.landing import TOLERATED, LandingReport, Leader, Motion, Swing, straight
from maglev_mj.bridge.wire import Fault, State
from maglev_mj.control.loop import ControlLoop
from maglev_mj.errors import PlantError, SensingError
from maglev_mj.frames import ZERO
from maglev_mj.parameters import flag, number
from maglev_mj.plants.hand import Trajectory
from maglev_mj.spec import Spec

_ON_STOP = 0.6 * Spec.translation_range.value

_TRY = 0.15
_TRIES = [7e-4, 0.0, 0.0, 0.0, 0.0, 0.007], [-3.5e-4, 6e-4, 0.0, 0.0, 0.0, -0.007], ZERO
"""Poses around the centre that need each coil [m, rad], and time to each [s]."""

_SETTLING, _WATCHING = 0.3, 0.2
"""Longest wait for rest before disarming, and observation after it [s]."""

_Watch: TypeAlias = Callable[[], object]


class RemotePlant(GuardedPlant):
    """Plant at the other end of a wire.

    It has the interface of `MuJoCoPlant`, for one thread. The device is the clock: `read` waits for its next sample. A
    lost sample leaves a gap in the tick numbers. Six currents leave through one output limiter: finite, wrench limit,
    current limit, temperatures. A failure ends in zero currents, a fault until `reset`, and a file of the last cycles.

    Args:
        link: The wire, or its address; see `open_link`. It is closed with the plant, or if the handshake fails.
        calibration: Calibration of the device; the device must have its hash.
        key: Authentication key of the frames; None for none.
        limits: Limits of the host; the smaller of these and the device's apply.
        patience: Longest wait for an answer or a sample [s].
        folder: Folder of the files of last cycles.

    Attributes:
        rest: Pose before takeoff and target of the landing [m, rad]. Further ones are those of `GuardedPlant`.

    Raises:
        HandshakeError: If no device answers, another host flies it, its version or calibration differs, or its
            numbers are not sane or do not carry the weight.
        LinkError: If the link has failed.
        ParameterError: If a value is outside its bounds, or the host's own limits do not carry the weight.

    Example:
        >>> from maglev_mj.bridge import Twin, TwinParameters
        >>> from maglev_mj.bridge.twin import simulated_links
        >>> RemotePlant(simulated_links.VirtualLink(Twin(TwinParameters()))).period
        0.005
    """

    rest: Sequence[float] = ZERO

    def _prepare(self) -> None:
        self._leader, self._tolerant = (Leader(self.calibration, self.period, one) for one in (self.delay, TOLERATED))

    def takeoff(self, duration: float = 0.6, *, watch: _Watch | None = None, tries: bool = False) -> None:
        """Check rest, arm, and move the flotor to the centre.

        Untouched for 0.1 s, it must rest: up to 5 mm/s and 0.1 rad/s. Slow work is done before the currents flow.

        Args:
            duration: Time of the motion [s].
            watch: Called after each sample of the motion; True ends it early.
            tries: True to move by 0.7 mm and 7 mrad around the centre in 0.45 s more, which tries each coil.

        Raises:
            DeviceFault: If the flotor does not follow, or another fault occurs.
            PlantError: If the flotor moves, is not on its lower stop or not measured: the device is not armed; or if a
                coil that was tried is not as calibrated: it has landed.
        """
        flag("tries", tries)
        self.require_inactive()
        leader, loop = self._leader, ControlLoop(self, self._leader)
        gc.collect()
        motion = self._observed(0.0)
        if self.doubt or not motion.full:
            raise PlantError(f"no takeoff: {self.doubt or 'the flotor is not measured'}")
        rest = motion.pose
        if not motion.at_rest:
            raise PlantError(f"no takeoff: the flotor moves at {motion}, and must rest")
        gravity = self.calibration.gravity.tolist()
        # with respect to gravity; without any no pose is off the lower stop
        if sum(one * other for one, other in zip(rest, gravity)) < _ON_STOP * math.hypot(*gravity):
            raise PlantError(f"no takeoff: the flotor is at {shown(rest)}, and must lie on its lower stop")

        def astray(pose: Sequence[float]) -> NoReturn:
            why = (said := self.coils.fault(lost=True)) and f"; {said}"
            self.fail(Fault.NOT_FOLLOWING, f"the flotor is at {shown(pose)}, not where it is led{why}")

        leader.aim(straight(rest, rest, duration))
        loop.cycle(2)  # the device ignores these answers; slow first calls are done
        poses = [rest, ZERO, *(_TRIES if tries else ())]
        times = [0.0, *(number("duration", duration, above=0.0) + _TRY * leg for leg in range(len(poses) - 1))]
        leader.aim(Trajectory(times, poses), astray)
        self.arm()
        self.rest, self.guided = rest, True
        try:
            ended = self._lead(loop, times[-1], watch)
            why = self.coils.fault() if tries and not ended else ""
        finally:
            self.guided = False
        if why:
            self._landed(leader, duration, None)
            raise PlantError(f"no flight: {why}; landed again: keep hands off while it takes off, or calibrate it anew")

    def land(self, duration: float = 0.6, *, watch: _Watch | None = None, reason: str = "") -> LandingReport:
        """Move the flotor back to its rest pose and disarm.

        Args:
            duration: Time of the motion [s]; up to 0.3 s more until it rests.
            watch: As for `takeoff`.
            reason: Why the flight is ended early; "" if it is not. Then a softer hold leads, stable up to 50 ms
                of delay, and the cycles before are written to a file; a flotor that still swings is cut.

        Returns:
            Pose and motion 0.2 s later.

        Raises:
            DeviceFault: As for `takeoff`.
        """
        if not reason:
            return self._landed(self._leader, duration, watch)
        swing, cycles = Swing(), self.cycles.mark(Fault(0), reason, self._about())

        def calm() -> bool:
            if self.state is State.ACTIVE and (speed := swing.check(self.pose, self.samples.tick * self.period)):
                self.fail(Fault.HOST, f"{reason}; in the landing it still moved at {speed:.2f} m/s")
            return watch is not None and bool(watch())

        report = self._landed(self._tolerant, duration, calm)
        return report._replace(reason=reason, path=self.cycles.write(cycles))

    def _landed(self, leader: Leader, duration: float, watch: _Watch | None) -> LandingReport:
        """Lead the flotor back to its rest pose and disarm."""
        loop, self.guided = ControlLoop(self, leader), True
        leader.aim(straight(self.pose, self.rest, duration))
        self._lead(loop, duration, watch)
        end = self.samples.tick + round(_SETTLING / self.period)
        while self.samples.tick < end and not leader.motion.at_rest:
            loop.cycle()
        self.disarm()
        motion = self._observed(_WATCHING)
        rests = motion.at_rest and not self.doubt
        return LandingReport(math.dist(motion.pose[:3], self.rest[:3]), *motion.speeds, rests)

    def _lead(self, loop: ControlLoop, duration: float, watch: _Watch | None) -> bool:
        """Run a loop for a time [s]; return True if it was ended early."""
        end = self.samples.tick + max(round(duration / self.period), 1)
        while self.samples.tick < end:
            loop.cycle()
            if watch is not None and watch():
                return True
        return False

    def _observed(self, duration: float) -> Motion:
        """Observe motion for `duration` [s] and until known or doubtful."""
        motion, self.doubt = Motion(self.period), ""
        end = self.samples.tick + round(duration / self.period)
        while self.samples.tick < end or not (motion.full or self.doubt):
            try:
                motion.add(self.read())
            except SensingError as error:
                self.doubt = str(error)
        return motion
