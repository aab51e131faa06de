"""Table 1 of Salcudean and Vlaar (1997) as data: each figure with its unit and where it comes from.

ASSUMED marks what the paper does not say.
"""

from __future__ import annotations

from dataclasses import dataclass

__all__ = ["GRAVITY", "Quantity", "Spec"]

GRAVITY = 9.81
"""Standard acceleration of free fall to three figures [m/s²]; the paper does not print the value it used."""


@dataclass(frozen=True)
class Quantity:
    """A number, its unit, and where it comes from."""

    value: float
    unit: str
    source: str


def _table(value: float, unit: str) -> Quantity:
    return Quantity(value, unit, "Table 1")


@dataclass(frozen=True)
class Spec:
    """The UBC maglev joystick as published.

    Source: Salcudean & Vlaar 1997, Table 1 and section 2.
    """

    radius: Quantity = _table(0.066, "m")
    height: Quantity = _table(0.110, "m")
    stator_mass: Quantity = _table(2.0, "kg")
    flotor_mass: Quantity = _table(0.65, "kg")
    payload: Quantity = _table(2.0, "kg")
    translation_range: Quantity = _table(0.0045, "m")
    rotation_range: Quantity = _table(6.0, "deg")
    translation_resolution: Quantity = _table(5e-6, "m")
    rotation_resolution: Quantity = _table(10e-6, "rad")
    force_frequency_response: Quantity = _table(3000.0, "Hz")
    translation_bandwidth: Quantity = _table(30.0, "Hz")
    rotation_bandwidth: Quantity = _table(15.0, "Hz")
    force_constant: Quantity = _table(2.0, "N/A")
    continuous_current: Quantity = _table(3.0, "A")
    peak_current: Quantity = _table(10.0, "A")
    moving_mass: Quantity = Quantity(0.7, "kg", "section 2, every experiment; the handle included")
    driver_bandwidth: Quantity = Quantity(2000.0, "Hz", "section 2")
    largest_vertical_force: Quantity = Quantity(60.0, "N", "section 2")
    control_rate: Quantity = Quantity(200.0, "Hz", "section 3")
    transport_delay: Quantity = Quantity(0.0015, "s", "section 3")
    tilt_inertia: Quantity = Quantity(9.3e-4, "kg m²", "ASSUMED, cylinder-like")
    spin_inertia: Quantity = Quantity(8.2e-4, "kg m²", "ASSUMED, cylinder-like")
