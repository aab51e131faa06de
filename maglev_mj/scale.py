"""Scale of a device: the thresholds of guards, takeoff and landing that follow from its file."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

from maglev_mj.spec import GRAVITY, RANGE, Spec

HAND = 20.0
"""Force of a strong hand [N]."""

OFF_LIFT = 0.25 * 3.0 * Spec.force_constant.value / (Spec.moving_mass.value * GRAVITY)
"""Share of the weight that currents at `Scale.off` lift: 22 %."""

_SLOWEST = 5.0
"""Largest factor on the speed at rest: a noisy sensor must not make motion rest."""


class Sizes(NamedTuple):
    """Sizes of a device from which its thresholds follow, in SI units."""

    mass: float
    gravity: float
    longest: float  # range of motion
    shortest: float
    fall: float  # range along gravity
    tilt: float  # largest range of rotation
    narrowest: float  # smallest
    radius: float  # of gyration
    force: float  # smallest limit of an axis, at most that of a hand
    lift: float  # along gravity, of one ampere in each coil
    noise: float  # of translations
    turning: float  # noise of rotations


@dataclass(frozen=True, kw_only=True)
class Scale:
    """Thresholds of a device, in SI units.

    Those of the published joystick, times the power by which each scales of mass m, gravity g, longest and shortest
    range of motion x and s, distance d along gravity from the centre to the stop, radius of gyration r, force F and
    noise n of the sensor. F is that of a hand of 20 N, or of the coils if they are weaker; g is 9.81 m/s² for a device
    without gravity; a range or a noise that the file does not state is the published joystick's.

    Attributes:
        off: Largest current of a coil that is off [A]; six of them lift 22 % of the weight.
        least: Least change of a coil's current from which a missing force is judged [A]; as `off`, or n / g times it.
        probe: Acceleration by the probe of one coil [m/s²], 4 % of g or, if more, n; see `Residual`.
        drop: Speed of a flotor that falls from the centre to its stop [m/s], sqrt(g d).
        speed: Speed limit [m/s], sqrt(x / m): 84 % of the speed that a hand of 20 N reaches across the range; at least
            twice `drop`.
        spin: Angular speed limit [rad/s], `speed` / r.
        envelope: Position limit, just outside the stops [m]: the range and the path in 1.7 ms at `speed`. A stop yields
            to a tap by as much on any device.
        tilt: Rotation limit, just outside the stops [rad]: the range and the angle in 1.7 ms at `spin`.
        stored: Energy that laws may store without decay [J], F x: a hand's in a spring along the range.
        generated: Limit of generated energy [J], m times the square of `drop`.
        wall_energy: The same of walls on the device [J], half of it.
        reversals: Limit of the force reversals in 0.2 s [N], F; twice the most of good flights, with taps of 20 N.
        capped: Limit of the same sum with each reversal capped [N], F.
        cap: Cap of one reversal [N], F.
        recede: Speed at which the edges of walls recede in a controlled stop [m/s], `drop`.
        edge: Speed limit of a wall's edge [m/s], `drop`.
        lever: Lever arm of the limits of a wall on a rotation [m], r.
        stiffness: Stiffness limit of a wall on the device [N/m], m.
        damping: Damping limit of a wall on the device [N s/m], m.
        rest: Largest speed at rest [m/s], `drop`, or n if that is more; at most five times as `drop`.
        rest_spin: Largest angular speed at rest [rad/s], `drop` / r; the same with the noise of rotations.
        lifted: Distance from the stop of a flotor that has lifted off [m]: d, or n if that is more.
        noise: Noise of a measured pose [m], n.
        path: Largest distance from the path of a takeoff [m], s.
        path_angle: Largest angle from the path of a takeoff [rad], as the smallest range of rotation.
    """

    off: float
    least: float
    probe: float
    drop: float
    speed: float
    spin: float
    envelope: float
    tilt: float
    stored: float
    generated: float
    wall_energy: float
    reversals: float
    capped: float
    cap: float
    recede: float
    edge: float
    lever: float
    stiffness: float
    damping: float
    rest: float
    rest_spin: float
    lifted: float
    noise: float
    path: float
    path_angle: float

    @property
    def reach(self) -> list[float]:
        """Largest pose within the envelope, on every axis [m, rad], six."""
        return [self.envelope] * 3 + [self.tilt] * 3

    @staticmethod
    def of(sizes: Sizes, published: Sizes) -> Scale:
        """Return the scale of a device from its sizes and those of the published joystick; see `Device.scale`."""
        m, g, x, s, d, tilt, narrow, r, force, lift, noise, turning = (a / b for a, b in zip(sizes, published))
        noise, turning = noise or 1.0, turning or 1.0
        drop = math.sqrt(g * d)
        fast = max(math.sqrt(x / m), drop)  # a hand is as strong on any device
        return Scale(
            off=0.25 * m * g / lift,
            least=0.15 * m * max(g, noise) / lift,
            probe=0.4 * max(g, noise),
            drop=0.3 * drop,
            speed=0.6 * fast,
            spin=15.0 * fast / r,
            envelope=RANGE[2] * x + 0.001 * fast,
            tilt=math.radians(6.0 * tilt + 1.5 * fast / r),
            stored=0.045 * force * x,
            generated=0.008 * m * drop**2,
            wall_energy=0.004 * m * drop**2,
            reversals=380.0 * force,
            capped=190.0 * force,
            cap=10.0 * force,
            recede=0.03 * drop,
            edge=0.1 * drop,
            lever=0.03 * r,
            stiffness=1e5 * m,
            damping=400.0 * m,
            rest=5e-3 * min(max(drop, 0.2 * noise), _SLOWEST * drop),
            rest_spin=0.1 * min(max(drop / r, 0.02 * turning), _SLOWEST * drop / r),
            lifted=max(4e-4 * d, 2e-4 * noise),
            noise=3e-6 * noise,
            path=0.002 * s,
            path_angle=math.radians(3.0) * narrow,
        )
