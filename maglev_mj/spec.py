"""Table 1 of Salcudean and Vlaar (1997) as data, with unit and source; ASSUMED marks values not in the paper."""

from __future__ import annotations

import math
from dataclasses import dataclass

GRAVITY = 9.81
"""Gravitational acceleration [m/s²], standard value to three digits; the paper does not state its value."""


@dataclass(frozen=True)
class Quantity:
    """Number with unit and source."""

    value: float
    unit: str
    source: str


TABLE = "Table 1"


@dataclass(frozen=True)
class Spec:
    """The UBC maglev joystick as published.

    Source: Salcudean & Vlaar 1997, Table 1 and section 2.
    """

    radius: Quantity = Quantity(0.066, "m", TABLE)
    height: Quantity = Quantity(0.110, "m", TABLE)
    stator_mass: Quantity = Quantity(2.0, "kg", TABLE)
    flotor_mass: Quantity = Quantity(0.65, "kg", TABLE)
    payload: Quantity = Quantity(2.0, "kg", TABLE)
    translation_range: Quantity = Quantity(0.0045, "m", TABLE)
    rotation_range: Quantity = Quantity(6.0, "deg", TABLE)
    translation_resolution: Quantity = Quantity(5e-6, "m", TABLE)
    rotation_resolution: Quantity = Quantity(10e-6, "rad", TABLE)
    translation_bandwidth: Quantity = Quantity(30.0, "Hz", TABLE)
    rotation_bandwidth: Quantity = Quantity(15.0, "Hz", TABLE)
    force_constant: Quantity = Quantity(2.0, "N/A", TABLE)
    continuous_current: Quantity = Quantity(3.0, "A", TABLE)
    peak_current: Quantity = Quantity(10.0, "A", TABLE)
    moving_mass: Quantity = Quantity(0.7, "kg", "section 2, every experiment; the handle included")
    driver_bandwidth: Quantity = Quantity(2000.0, "Hz", "section 2")
    largest_vertical_force: Quantity = Quantity(60.0, "N", "section 2")
    control_rate: Quantity = Quantity(200.0, "Hz", "section 3")
    transport_delay: Quantity = Quantity(0.0015, "s", "section 3")
    spot_resolution: Quantity = Quantity(8e-7, "m", "ASSUMED: gives the resolution of Table 1")
    coil_radius: Quantity = Quantity(0.046, "m", "ASSUMED, from the axis to the vertical coils")
    tilt_inertia: Quantity = Quantity(9.3e-4, "kg m²", "ASSUMED, cylinder-like")
    spin_inertia: Quantity = Quantity(8.2e-4, "kg m²", "ASSUMED, cylinder-like")


INERTIA = (*[Spec.moving_mass.value] * 3, *[Spec.tilt_inertia.value] * 2, Spec.spin_inertia.value)
"""Mass and moments of inertia [kg, kg m²], six."""

ESCAPE = 10.0 * Spec.translation_range.value
"""Distance from the centre at which a simulation counts as diverged [m]."""

RESOLUTION = (*[Spec.translation_resolution.value] * 3, *[Spec.rotation_resolution.value] * 3)
"""Sensor resolution on the six axes [m, rad]."""

MIN_PERIOD, MAX_PERIOD, MAX_DELAY, MAX_DELAY_PERIODS = 1e-6, 0.1, 1.0, 10
"""Bounds of sample periods [s], of delays [s], and of simulated delays in sample periods."""

DEVICE_PERIOD, DEVICE_DELAY = 1e-3, 2e-4
"""Sample period of laws on the device, and delay to their effect [s]; assumed."""

DRIVER_TIME_CONSTANT = 1.0 / (2.0 * math.pi * Spec.driver_bandwidth.value)
"""Time constant of the drivers' first-order lag [s]."""

RANGE = (*[Spec.translation_range.value] * 3, *[math.radians(Spec.rotation_range.value)] * 3)
"""Range of motion of the six axes, to either side of the centre [m, rad]."""

LEVER_ARM = 0.05
"""Lever arm that converts a force of a finger to a torque [m], about the radius of the flotor."""
