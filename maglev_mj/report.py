"""What the compiled device yields, beside what the paper prints in Table 1."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from maglev_mj.experiments.bandwidth import position_bandwidth
from maglev_mj.model import COILS, Device, envelope, load
from maglev_mj.spec import GRAVITY, Spec

__all__ = ["DeviceReport", "Row", "device_report"]


@dataclass(frozen=True)
class Row:
    """One figure: what the paper prints, what the model yields, in which unit, and a remark."""

    name: str
    paper: str
    model: str
    unit: str
    remark: str = ""


@dataclass(frozen=True)
class DeviceReport:
    """Table 1 and what follows from the model.

    Attributes:
        table: Rows of Table 1 and section 2.
        figures: Figures measured on the model, SI units.
        contradictions: Where the paper does not agree with itself.
    """

    table: tuple[Row, ...]
    figures: dict[str, Any]
    contradictions: tuple[str, ...]


def device_report() -> DeviceReport:
    """Compile the device and measure it.

    Source: Salcudean & Vlaar 1997, Table 1 and section 2.
    """
    figures = _measure(load("maglev", lean=False))
    return DeviceReport(_table(figures), figures, _contradictions(figures))


def _measure(device: Device) -> dict[str, Any]:
    model, coils = device.model, device.coils
    assert coils is not None  # the device is loaded with its coils
    radius, height = envelope(device)
    gains = model.actuator_gainprm[: len(COILS), 0]
    peak = float(model.actuator_ctrlrange[: len(COILS), 1].min())
    arms = np.linalg.norm(np.cross(coils.points, coils.directions), axis=1)
    loop = {"period": 1.0 / Spec.control_rate.value, "delay": Spec.transport_delay.value}
    hover = coils.currents(np.array([0.0, 0.0, device.mass * GRAVITY, 0.0, 0.0, 0.0]))
    return {
        "radius": radius,
        "height": height,
        "stator_mass": float(model.body("stator").mass[0]),
        "flotor_mass": float(model.body("flotor").mass[0]),
        "moving_mass": device.mass,
        "inertia": device.inertia.tolist(),
        "translation_range": float(model.joint("z").range[1]),
        "rotation_range": math.degrees(float(model.joint("rotation").range[1])),
        "translation_bandwidth": position_bandwidth("z", stiffness=6000.0, damping=80.0, **loop),
        "rotation_bandwidth": position_bandwidth("rx", stiffness=8.0, damping=0.1, **loop),
        "driver_bandwidth": 1.0 / (2.0 * math.pi * device.driver_time_constant),
        "force_constant": float(gains.min()),
        "peak_current": peak,
        "hover_current": float(np.abs(hover).max()),
        "largest_at_continuous_current": coils.largest_wrench(Spec.continuous_current.value).tolist(),
        "largest_at_peak_current": coils.largest_wrench(peak).tolist(),
        "wrench_map": coils.wrench_per_current.tolist(),
        "mean_arm": float(arms.mean()),
        "condition_number": coils.condition_number(float(arms.mean())),
        "condition_number_si": coils.condition_number(1.0),
    }


def _table(figures: dict[str, Any]) -> tuple[Row, ...]:
    spec, mm, option = Spec(), 1e3, "an option of the plants"
    moving, strong = figures["moving_mass"], figures["peak_current"]
    largest = figures["largest_at_peak_current"][2]
    hold = "hold 6000 N/m, 80 N s/m at 200 Hz, 1.5 ms"
    return (
        _row("envelope, radius", spec.radius.value * mm, figures["radius"] * mm, "mm"),
        _row("envelope, height", spec.height.value * mm, figures["height"] * mm, "mm", "without handle"),
        _row("stator mass", spec.stator_mass.value, figures["stator_mass"], "kg"),
        _row("flotor mass", spec.flotor_mass.value, figures["flotor_mass"], "kg"),
        _row("moving mass", spec.moving_mass.value, moving, "kg", "handle included"),
        _row("payload, continuous", spec.payload.value, _payload(figures), "kg", "see below"),
        _row("translation range ±", spec.translation_range.value * mm, figures["translation_range"] * mm, "mm"),
        _row("rotation range ±", spec.rotation_range.value, figures["rotation_range"], "deg"),
        _row("resolution, translation", "< 5", None, "µm", option),
        _row("resolution, rotation", "< 10", None, "µrad", option),
        _row("force frequency response", "> 3", figures["driver_bandwidth"] / 1e3, "kHz", "see below"),
        _row("position response, translation", "> 30", figures["translation_bandwidth"], "Hz", hold),
        _row("position response, rotation", "> 15", figures["rotation_bandwidth"], "Hz", "8 N m/rad, 0.1 N m s/rad"),
        _row("actuator force constant", spec.force_constant.value, figures["force_constant"], "N/A"),
        _row("continuous current, per coil", spec.continuous_current.value, None, "A", "a thermal limit"),
        _row("peak current, per coil", spec.peak_current.value, strong, "A"),
        _row("largest force along z", spec.largest_vertical_force.value, largest, "N", "section 2"),
    )


def _row(name: str, paper: float | str, model: float | None, unit: str, remark: str = "") -> Row:
    """Return a row; a dash stands where a rigid-body model has no such figure."""
    printed = paper if isinstance(paper, str) else f"{paper:g}"
    return Row(name, printed, "-" if model is None else f"{model:.4g}", unit, remark)


def _payload(figures: dict[str, Any]) -> float:
    """Return the mass [kg] that can be held up beside the flotor's own at the continuous current."""
    return float(figures["largest_at_continuous_current"][2] / GRAVITY - figures["flotor_mass"])


def _contradictions(figures: dict[str, Any]) -> tuple[str, ...]:
    spec = Spec()
    load_ = (spec.payload.value + spec.flotor_mass.value) * GRAVITY
    per_ampere = figures["largest_at_continuous_current"][2] / spec.continuous_current.value
    payload, flotor, weak = spec.payload.value, spec.flotor_mass.value, spec.continuous_current.value
    needed = load_ / per_ampere
    return (
        f"A payload of {payload:g} kg with the flotor's {flotor:g} kg takes {needed:.2f} A in each vertical "
        f"coil, above the {weak:g} A continuous, at which the payload is {_payload(figures):.2f} kg.",
        "Table 1 gives a force response above 3 kHz; section 2 has the currents controlled to about 2 kHz. "
        "The model's driver lag follows section 2.",
        "Table 1 gives 10 A as the peak per coil; section 2 gives 10 A as the drivers' continuous maximum.",
    )
