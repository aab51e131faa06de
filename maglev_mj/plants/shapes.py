"""Shapes of a device for any drawing program, and its figures beside Table 1."""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple

import numpy as np

from maglev_mj.control import Hold
from maglev_mj.control.controller import Controller
from maglev_mj.control.loop import drive
from maglev_mj.control.timeline import Timing
from maglev_mj.frames import AXES, Array, Command, Sample
from maglev_mj.lazy import mujoco
from maglev_mj.parameters import axis_indices
from maglev_mj.plants.model import COILS, Device, Model, at_reference, load_model
from maglev_mj.plants.mujoco import MuJoCoPlant
from maglev_mj.result import Result, Table
from maglev_mj.spec import GRAVITY, Spec

ARROW = 0.003
"""Length of an arrow for each newton [m]."""

LEAST_FORCE = 0.05
"""Least force with an arrow [N]."""

GRIP = np.array([0.0, 0.0, 0.079])
"""Middle of the handle's knob in the flotor [m]."""

KNOB = 0.0165, 0.0125
"""Radius and half height of the knob [m]."""

UNDER_KNOB = 0.0676
"""Height of its lower side in the flotor [m]."""

_PLATE, _THIN = 0.024, 0.0002
_KINDS = {
    int(mujoco.mjtGeom.mjGEOM_BOX): "box",
    int(mujoco.mjtGeom.mjGEOM_CYLINDER): "cylinder",
    int(mujoco.mjtGeom.mjGEOM_CAPSULE): "capsule",
    int(mujoco.mjtGeom.mjGEOM_SPHERE): "ellipsoid",
    int(mujoco.mjtGeom.mjGEOM_ELLIPSOID): "ellipsoid",
}
_HIDDEN = 3  # the first group of geoms that is not drawn


class Shape(NamedTuple):
    """Geom of a device with its flotor at the centre.

    Attributes:
        moves: True for a shape of the flotor.
        kind: box, cylinder or ellipsoid.
        half: Half lengths along its own axes; a cylinder is along its z [m], (3,).
        position: Position of its centre, from the flotor's [m], (3,).
        turn: Unit quaternion (w, x, y, z).
        colour: Red, green, blue, opacity, each from 0 to 1.
        material: Name of its material; empty for none.
        part: "handle", or "coil0" to "coil5" for a winding; empty for the rest.
    """

    moves: bool
    kind: str
    half: Array
    position: Array
    turn: Sequence[float]
    colour: Sequence[float]
    material: str = ""
    part: str = ""


def shapes(model: Model) -> list[Shape]:
    """Return the visible geoms of a model.

    Planes and meshes are left out; a capsule is three shapes.

    Raises:
        ModelError: If the file is missing or cannot be used.
    """
    device = load_model(model, lean=False)
    compiled, data = device.model, mujoco.MjData(device.model)
    mujoco.mj_kinematics(compiled, data)
    origin, turn, found = data.xpos[device.flotor], np.zeros(4), []
    moving, coils = {device.flotor}, data.site_xpos[compiled.actuator_trnid[: len(COILS), 0]]
    for body in range(compiled.nbody):  # parents come first
        moving |= {body} if int(compiled.body_parentid[body]) in moving else set()
    for geom in range(compiled.ngeom):
        kind, material = _KINDS.get(int(compiled.geom_type[geom])), compiled.geom_matid[geom]
        colour = compiled.geom_rgba[geom] if material < 0 else compiled.mat_rgba[material]
        if kind is None or compiled.geom_group[geom] >= _HIDDEN or not colour[3]:
            continue
        moves = int(compiled.geom_bodyid[geom]) in moving
        mujoco.mju_mat2Quat(turn, data.geom_xmat[geom])
        place, (radius, half, third) = data.geom_xpos[geom] - origin, compiled.geom_size[geom]
        name = "" if material < 0 else compiled.material(material).name
        part = "handle" if compiled.body(compiled.geom_bodyid[geom]).name == "handle" else ""
        if name == "copper":
            part = f"coil{np.linalg.norm(coils - data.geom_xpos[geom], axis=1).argmin()}"
        about = turn.tolist(), colour.tolist(), name, part
        if kind in ("cylinder", "capsule"):
            found.append(Shape(moves, "cylinder", np.array([radius, radius, half]), place, *about))
            along = half * data.geom_xmat[geom][2::3]
            ends = (place - along, place + along) if kind == "capsule" else ()
            found += [Shape(moves, "ellipsoid", np.full(3, radius), end, *about) for end in ends]
        else:
            found.append(Shape(moves, kind, np.array([radius, half or radius, third or radius]), place, *about))
    return found


def wall_plate(face: tuple[int, float, float]) -> tuple[Array, Array] | None:
    """Return centre and half lengths of a wall's plate [m].

    (3,) each; the knob meets this plate. None for a rotation.

    Args:
        face: Index into AXES, normal (1 or -1), edge [m, rad].
    """
    axis, normal, edge = face
    if axis > 2:
        return None
    radius, half_height = KNOB
    centre, size = GRIP.copy(), np.array([_PLATE, _PLATE, half_height + 0.004])
    size[axis] = _THIN
    if axis < 2:
        centre[axis] = edge - normal * (radius + _THIN)
    else:
        centre[2] = edge + (UNDER_KNOB - _THIN if normal > 0.0 else GRIP[2] + half_height + _THIN)
    return centre, size


def arrow_start(knob: Array, force: Array) -> Array:
    """Return the start of a force arrow [m], (3,).

    It is on the surface of the knob.
    """
    radius, half_height = KNOB
    return np.asarray(knob + force / np.linalg.norm(force / [radius, radius, half_height]))


def envelope(device: Device) -> tuple[float, float]:
    """Return radius and height of the device's envelope [m].

    It is an upright cylinder around the device without its handle.
    """
    model = device.model
    data = at_reference(model)
    handle = model.body("handle").id
    radius, low, high = 0.0, math.inf, -math.inf
    signs = np.array(list(itertools.product((-1.0, 1.0), repeat=3)))
    for geom in np.flatnonzero(model.geom_bodyid != handle):
        turn, centre = data.geom_xmat[geom].reshape(3, 3).T, data.geom_xpos[geom]
        bounds = model.geom_aabb[geom]
        corners = (bounds[:3] + signs * bounds[3:]) @ turn + centre
        low, high = min(low, corners[:, 2].min()), max(high, corners[:, 2].max())
        size = model.geom_size[geom]
        if model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_BOX:
            reach = np.hypot(corners[:, 0], corners[:, 1]).max()
        else:  # round about its own z axis: the ends of the axis, and the radius beyond them
            ends = centre[:2] + np.outer((-size[1], size[1]), turn[2, :2])
            reach = np.hypot(ends[:, 0], ends[:, 1]).max() + size[0]
        radius = max(radius, float(reach))
    return radius, float(high - low)


_HEAD = "figure", "paper", "model", "unit", "remark"


@dataclass(frozen=True, eq=False)
class DeviceReport(Result):
    """Figures of the compiled device, beside those of Table 1.

    Attributes:
        figures: Figures measured on the model, SI units.
    """

    figures: Mapping[str, Any]
    derived: ClassVar = ("contradictions",)
    units: ClassVar[Mapping[str, str]] = {}  # each row has its own

    def columns(self) -> dict[str, Any]:
        """Return the figures of Table 1 and of the model."""
        return dict(zip(_HEAD, map(np.array, zip(*_rows(self.figures)))))

    @property
    def contradictions(self) -> list[str]:
        """Contradictions within the paper."""
        spec, figures = Spec(), self.figures
        payload, flotor, weak = spec.payload.value, spec.flotor_mass.value, spec.continuous_current.value
        per_ampere = figures["largest_at_continuous_current"][2] / weak
        needed = (payload + flotor) * GRAVITY / per_ampere
        return [
            f"A payload of {payload:g} kg with the flotor's {flotor:g} kg takes {needed:.2f} A in each vertical "
            f"coil, above the {weak:g} A continuous, at which the payload is {_payload(figures):.2f} kg.",
            "Table 1 gives a force response above 3 kHz; section 2 has the currents controlled to about 2 kHz. "
            "The model's driver lag follows section 2.",
            "Table 1 gives 10 A as the peak per coil; section 2 gives 10 A as the drivers' continuous maximum.",
        ]

    def table(self) -> Table:
        """Return Table 1 beside the model, its largest wrenches and what the currents do."""
        figures = self.figures
        inertia = ", ".join(f"{value * 1e4:.2f}" for value in figures["inertia"])
        note = (
            f"inertia about x, y, z with handle {inertia} 1e-4 kg m² (assumed)\n"
            f"hover current, each vertical coil {figures['hover_current']:.2f} A at {figures['moving_mass']:g} kg"
        )
        largest = [
            (f"at {Spec.continuous_current.value:g} A", *figures["largest_at_continuous_current"]),
            (f"at {figures['peak_current']:g} A", *figures["largest_at_peak_current"]),
        ]
        coils = [(axis, *row) for axis, row in zip(AXES, np.round(figures["wrench_map"], 12).tolist(), strict=True)]
        condition = (
            f"condition number {figures['condition_number']:.2f} (torques over the mean arm, "
            f"{figures['mean_arm'] * 1e3:.1f} mm), {figures['condition_number_si']:.1f} in SI units"
        )
        below = [
            Table("largest pure wrench [N, N m]", ("", *AXES), largest),
            Table(
                "wrench of one ampere in each coil [N/A, N m/A]; coil places are assumed",
                ("", *COILS),
                coils,
                condition,
            ),
            Table("where the paper contradicts itself", (), (), "\n".join(self.contradictions)),
        ]
        title = "The UBC maglev joystick: what the paper prints, what the compiled model yields"
        return Table(title, ("", *_HEAD[1:]), _rows(figures), note, below)


def device_report() -> DeviceReport:
    """Compile the device and measure it.

    Source: Salcudean & Vlaar 1997, Table 1 and section 2.
    """
    return DeviceReport(_measure(load_model("maglev", lean=False)))


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


def _rows(figures: Mapping[str, Any]) -> list[tuple[str, float | str, float, str, str]]:
    """Return name, figure of the paper, of the model, unit and remark of each row."""
    spec, mm, option = Spec, 1e3, "an option of the plants"
    moving, strong = figures["moving_mass"], figures["peak_current"]
    largest = figures["largest_at_peak_current"][2]
    hold = "hold 6000 N/m, 80 N s/m at 200 Hz, 1.5 ms"
    return [
        ("envelope, radius", spec.radius.value * mm, figures["radius"] * mm, "mm", ""),
        ("envelope, height", spec.height.value * mm, figures["height"] * mm, "mm", "without handle"),
        ("stator mass", spec.stator_mass.value, figures["stator_mass"], "kg", ""),
        ("flotor mass", spec.flotor_mass.value, figures["flotor_mass"], "kg", ""),
        ("moving mass", spec.moving_mass.value, moving, "kg", "handle included"),
        ("payload, continuous", spec.payload.value, _payload(figures), "kg", "see below"),
        ("translation range ±", spec.translation_range.value * mm, figures["translation_range"] * mm, "mm", ""),
        ("rotation range ±", spec.rotation_range.value, figures["rotation_range"], "deg", ""),
        ("resolution, translation", "< 5", math.nan, "µm", option),
        ("resolution, rotation", "< 10", math.nan, "µrad", option),
        ("force frequency response", "> 3", figures["driver_bandwidth"] / 1e3, "kHz", "see below"),
        ("position response, translation", "> 30", figures["translation_bandwidth"], "Hz", hold),
        ("position response, rotation", "> 15", figures["rotation_bandwidth"], "Hz", "8 N m/rad, 0.1 N m s/rad"),
        ("actuator force constant", spec.force_constant.value, figures["force_constant"], "N/A", ""),
        ("continuous current, per coil", spec.continuous_current.value, math.nan, "A", "a thermal limit"),
        ("peak current, per coil", spec.peak_current.value, strong, "A", ""),
        ("largest force along z", spec.largest_vertical_force.value, largest, "N", "section 2"),
    ]


def _payload(figures: Mapping[str, Any]) -> float:
    """Return the payload [kg] at the continuous current.

    It is in addition to the flotor's own mass.
    """
    return float(figures["largest_at_continuous_current"][2] / GRAVITY - figures["flotor_mass"])


def position_bandwidth(
    axis: str, *, stiffness: float, damping: float, period: float, delay: float, step: float = 1e-4
) -> float:
    """Return the -3 dB bandwidth of a hold [Hz].

    It is that of the response to the hold's target.

    It is measured on the MuJoCo device without gravity: the target steps, the sampled positions are
    differenced, and their Fourier transform is the frequency response.

    Args:
        axis: Name from AXES.
        stiffness: Stiffness of the hold [N/m, N m/rad].
        damping: Damping of the hold [N s/m, N m s/rad].
        period: Sample period [s].
        delay: Transport delay [s].
        step: Size of the step [m, rad].

    Returns:
        The bandwidth; NaN if the response does not fall to -3 dB below half the sample rate.
    """
    (index,) = axis_indices(axis)
    positions: list[float] = []

    def observe(sample: Sample, _: Command) -> None:
        positions.append(sample.position[index])

    ticks = max(math.ceil(1.0 / period), 100)
    others = [name for name in AXES if name != axis]
    with MuJoCoPlant(Timing(period=period, delay=delay), gravity=0.0) as plant:
        inertia = np.delete([plant.device.mass] * 3 + plant.device.inertia.tolist(), index)
        laws = [
            Hold(axes=axis, stiffness=stiffness, damping=damping, target=step),
            Hold.critically_damped(others, inertia=inertia, period=period, delay=delay),
        ]
        drive(plant, Controller(laws, period=period), ticks, observe=observe)
    response = np.abs(np.fft.rfft(np.diff(positions, append=positions[-1]), 8 * ticks)) / step
    frequencies = np.fft.rfftfreq(8 * ticks, period)
    below = np.flatnonzero(response < math.sqrt(0.5))
    return float(frequencies[below[0]]) if below.size else math.nan
