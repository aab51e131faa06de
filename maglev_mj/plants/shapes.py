"""Shapes of a device for rendering, and its measured figures compared with Table 1 of the paper."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple, TypeAlias

import numpy as np

from maglev_mj.control import Hold
from maglev_mj.control.controller import Controller
from maglev_mj.control.loop import drive
from maglev_mj.control.timeline import Timing
from maglev_mj.device import COILS, Device, Knob
from maglev_mj.frames import AXES, Array, Command, Sample
from maglev_mj.lazy import mujoco
from maglev_mj.parameters import axis_indices
from maglev_mj.plants.model import CompiledModel, Model, coil_count, drawn_model, load_model, reference_state
from maglev_mj.plants.mujoco import MuJoCoPlant
from maglev_mj.result import Result, Table
from maglev_mj.spec import GRAVITY, Spec

ARROW = 0.006
"""Length of a force arrow per newton [m/N]."""

MIN_ARROW_FORCE = 0.05
"""Smallest force drawn as an arrow [N]."""

RIM = 0.72, 0.073
"""Radius and half height of the ring under the knob, visible on contact with a wall of a rotation, in its radii."""

Face: TypeAlias = tuple[int, float, float]
"""Wall: index into AXES, normal (1 or -1), edge [m, rad]."""

_PLATE, _THIN = 16.0 / 11.0, 0.0002
"""Half side of a drawn wall in radii of the knob; its half thickness [m]."""
_DOWN, _BESIDE = -0.8, np.array([8.0 / 11.0, 0.0, -0.52])
"""Vertical component below which the stem would hide an arrow; start of such an arrow beside the stem, in radii."""

_WARM, _LIMIT = np.array([1.0, 0.89, 0.22]), (1.0, 0.05, 0.05)
_KINDS = {
    int(mujoco.mjtGeom.mjGEOM_BOX): "box",
    int(mujoco.mjtGeom.mjGEOM_CYLINDER): "cylinder",
    int(mujoco.mjtGeom.mjGEOM_CAPSULE): "capsule",
    int(mujoco.mjtGeom.mjGEOM_SPHERE): "ellipsoid",
    int(mujoco.mjtGeom.mjGEOM_ELLIPSOID): "ellipsoid",
}
_HIDDEN = 3  # first geom group that is not drawn


class Shape(NamedTuple):
    """Geom of a device with its flotor at the centre.

    Attributes:
        moves: True for a shape of the flotor.
        kind: "box", "cylinder" (along its z axis) or "ellipsoid".
        half: Half lengths along its own axes [m], (3,).
        position: Centre, relative to the flotor's [m], (3,).
        turn: Orientation, as a unit quaternion (w, x, y, z).
        colour: Red, green, blue, opacity, each from 0 to 1.
        material: Name of the material; empty for none.
        coil: "coil0" and so on for a winding; otherwise empty.
    """

    moves: bool
    kind: str
    half: Array
    position: Array
    turn: Sequence[float]
    colour: Sequence[float]
    material: str = ""
    coil: str = ""


def shapes(model: Model, own: Device | None = None) -> list[Shape]:
    """Return the visible geoms of a model; a capsule is three shapes, planes and meshes are skipped.

    Args:
        model: The model.
        own: Device in place of the published joystick.

    Raises:
        ModelError: If the file is missing or invalid.
    """
    device = drawn_model(model, own)
    compiled, data = device.model, mujoco.MjData(device.model)
    mujoco.mj_kinematics(compiled, data)
    origin, visible = data.xpos[device.flotor], []
    moving, coils = {device.flotor}, coil_geoms(compiled, data)
    for body in range(compiled.nbody):  # parents come first
        moving |= {body} if int(compiled.body_parentid[body]) in moving else set()
    for geom in range(compiled.ngeom):
        if (shape := shape_of(compiled, data, geom)) is None:
            continue
        capsule = int(compiled.geom_type[geom]) == mujoco.mjtGeom.mjGEOM_CAPSULE
        moves, centre = int(compiled.geom_bodyid[geom]) in moving, data.geom_xpos[geom] - origin
        shape = shape._replace(moves=moves, position=centre, coil=f"coil{coils[geom]}" if geom in coils else "")
        along = shape.half[2] * data.geom_xmat[geom][2::3]
        ends = (centre - along, centre + along) if capsule else ()
        ball = shape._replace(kind="ellipsoid", half=np.full(3, shape.half[0]))
        visible += [shape, *(ball._replace(position=end) for end in ends)]
    return visible


def shape_of(model: mujoco.MjModel, data: mujoco.MjData, geom: int, *, meshes: bool = False) -> Shape | None:
    """Return the shape of a geom at the origin, without the ends of a capsule; None for one that is not drawn.

    Args:
        model: Compiled model.
        data: Its state, which sets the orientation.
        geom: Index of the geom.
        meshes: True to return a mesh as the ellipsoid of its size.
    """
    kinds = {**_KINDS, int(mujoco.mjtGeom.mjGEOM_MESH): "ellipsoid"} if meshes else _KINDS
    kind, material = kinds.get(int(model.geom_type[geom])), model.geom_matid[geom]
    colour = model.geom_rgba[geom] if material < 0 else model.mat_rgba[material]
    if kind is None or model.geom_group[geom] >= _HIDDEN or not colour[3]:
        return None
    turn, (radius, half, third) = np.zeros(4), model.geom_size[geom]
    mujoco.mju_mat2Quat(turn, data.geom_xmat[geom])
    round_ = kind in ("cylinder", "capsule")
    size = np.array([radius, radius, half] if round_ else [radius, half or radius, third or radius])
    name = "" if material < 0 else model.material(material).name
    return Shape(False, "cylinder" if round_ else kind, size, np.zeros(3), turn.tolist(), colour.tolist(), name)


def coil_geoms(model: mujoco.MjModel, data: mujoco.MjData) -> dict[int, int]:
    """Return the coil of each geom of copper, the nearest one.

    Args:
        model: Compiled model.
        data: Its state, with the flotor centred.
    """
    places = data.site_xpos[model.actuator_trnid[: coil_count(model), 0]]
    windings = np.flatnonzero(model.geom_matid == model.material("copper").id).tolist()
    return {geom: int(np.linalg.norm(places - data.geom_xpos[geom], axis=1).argmin()) for geom in windings}


def coil_colour(copper: Sequence[float], current: float, device: Device) -> tuple[float, float, float]:
    """Return the colour of a coil: copper without current, yellow, red at the current limit.

    Args:
        copper: Red, green and blue of the winding's material.
        current: Current [A]; NaN as 0.
        device: Device, for its limit.
    """
    limit = math.inf if device.coils is None else device.coils.current_limit
    share = round(abs(current) / limit, 2) if math.isfinite(current) else 0.0
    cold = np.asarray(copper[:3])
    red, green, blue = (cold + share * (_WARM - cold)).tolist() if share < 1.0 else _LIMIT
    return red, green, blue


def wall_box(
    faces: Iterable[Face], knob: Knob
) -> tuple[dict[Face, tuple[Array, Array]], list[tuple[Array, list[Face]]]]:
    """Return the plates that the knob touches at walls, and their edges: together one box; rotations have none.

    Args:
        faces: Walls: index into AXES, normal (1 or -1), edge [m, rad].
        knob: The knob.

    Returns:
        Centre and half lengths [m], (3,) each, of each plate; the ends [m], (2, 3), of each edge with its walls.
    """
    sides = knob.centre + np.array([-knob.half, knob.half])  # lower, upper
    sides[0, 2] = knob.bottom
    box = knob.centre + np.array([[-1.0], [1.0]]) * knob.radius * [_PLATE, _PLATE, 1.0]
    places = {face: sides[int(face[1] < 0.0), face[0]] + face[2] for face in faces if face[0] < 3}
    for (axis, normal, _), place in places.items():
        box[int(normal < 0.0), axis] = place
    plates, edges = {}, dict[Any, tuple[Array, list[Face]]]()
    for face, place in places.items():
        axis, normal, _ = face
        centre, half = box.mean(axis=0), 0.5 * np.abs(box[1] - box[0])
        centre[axis], half[axis] = place - normal * _THIN, _THIN
        plates[face] = centre, half
        for across, side in itertools.product({0, 1, 2} - {axis}, (0, 1)):
            ends = box.copy()
            ends[:, axis], ends[:, across] = place, box[side, across]
            edges.setdefault(tuple(ends.round(9).ravel()), (ends, []))[1].append(face)
    return plates, list(edges.values())


def arrow_start(place: Array, force: Array, knob: Knob) -> Array:
    """Return the start of a force arrow on the surface of the knob [m], (3,); of a downward one beside the stem.

    Args:
        place: Centre of the knob [m], (3,).
        force: The force [N], (3,).
        knob: The knob.
    """
    if force[2] < _DOWN * np.linalg.norm(force):
        return np.asarray(place + _BESIDE * knob.radius)
    return np.asarray(place + force / np.linalg.norm(force / knob.half))


def envelope(device: CompiledModel) -> tuple[float, float]:
    """Return radius and height [m] of the upright cylinder around the device without its handle."""
    model = device.model
    data = reference_state(model)
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
        else:  # cylinder about its z axis: ends of the axis, plus the radius
            ends = centre[:2] + np.outer((-size[1], size[1]), turn[2, :2])
            reach = np.hypot(ends[:, 0], ends[:, 1]).max() + size[0]
        radius = max(radius, float(reach))
    return radius, float(high - low)


_HEAD = "figure", "paper", "model", "unit", "remark"


@dataclass(frozen=True, eq=False)
class DeviceReport(Result):
    """Figures of the compiled device, compared with Table 1 of the paper.

    Attributes:
        figures: Figures measured on the model, in SI units.
    """

    figures: Mapping[str, Any]
    derived: ClassVar = ("contradictions",)
    units: ClassVar[Mapping[str, str]] = {}  # a unit per row

    def _headline(self) -> str:
        figures = self.figures
        lift = f"{figures['largest_at_peak_current'][2]:.3g} N vertically at {figures['peak_current']:g} A"
        return f"The model lifts {lift} and hovers at {figures['hover_current']:.2f} A per coil"

    def columns(self) -> dict[str, Any]:
        """Return the figures of Table 1 and of the model."""
        return dict(zip(_HEAD, map(np.array, zip(*_rows(self.figures)))))

    @property
    def contradictions(self) -> list[str]:
        """Contradictions within the paper."""
        spec, figures = Spec(), self.figures
        payload, flotor, current = spec.payload.value, spec.flotor_mass.value, spec.continuous_current.value
        per_ampere = figures["largest_at_continuous_current"][2] / current
        needed = (payload + flotor) * GRAVITY / per_ampere
        return [
            f"Payload: {payload:g} kg plus the flotor's {flotor:g} kg need {needed:.2f} A per vertical coil, above the "
            f"continuous current of {current:g} A, which carries a payload of {_payload(figures):.2f} kg.",
            "Force bandwidth: above 3 kHz in Table 1, current control to about 2 kHz in section 2. "
            "The model's driver lag follows section 2.",
            "10 A per coil: peak current in Table 1, continuous maximum of the drivers in section 2.",
        ]

    def table(self) -> Table:
        """Return Table 1 compared with the model, its largest wrenches and its coil map."""
        figures = self.figures
        inertia = ", ".join(f"{value * 1e4:.2f}" for value in figures["inertia"])
        note = (
            f"moments of inertia about x, y, z, handle included: {inertia} 1e-4 kg m² (assumed)\n"
            f"hover current per vertical coil: {figures['hover_current']:.2f} A at {figures['moving_mass']:g} kg"
        )
        largest = [
            (f"at {Spec.continuous_current.value:g} A", *figures["largest_at_continuous_current"]),
            (f"at {figures['peak_current']:g} A", *figures["largest_at_peak_current"]),
        ]
        coils = [(axis, *row) for axis, row in zip(AXES, np.round(figures["wrench_map"], 12).tolist(), strict=True)]
        condition = (
            f"condition number: {figures['condition_number']:.2f} (torques divided by the mean arm, "
            f"{figures['mean_arm'] * 1e3:.1f} mm), {figures['condition_number_si']:.1f} in SI units"
        )
        below = [
            Table("largest force or torque on a single axis [N, N m]", ("", *AXES), largest),
            Table(
                "coil map: wrench per ampere [N/A, N m/A] (coil positions assumed)",
                ("", *COILS),
                coils,
                condition,
            ),
            Table("contradictions within the paper", (), (), "\n".join(self.contradictions)),
        ]
        title = "UBC maglev joystick: paper and compiled model"
        return Table(title, ("", *_HEAD[1:]), _rows(figures), note, below)


def device_report() -> DeviceReport:
    """Compile the device and measure its figures.

    Source: Salcudean & Vlaar 1997, Table 1 and section 2.
    """
    return DeviceReport(_measure(load_model("maglev", lean=False)))


def _measure(device: CompiledModel) -> dict[str, Any]:
    model, coils = device.model, device.coils
    assert coils is not None  # loaded with coils
    radius, height = envelope(device)
    gains = model.actuator_gainprm[: len(COILS), 0]
    peak = device.current_limit
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
    """Return the rows: name, figure of the paper, figure of the model, unit, remark."""
    spec, mm, option = Spec, 1e3, "optional in the plants"
    moving, peak = figures["moving_mass"], figures["peak_current"]
    largest = figures["largest_at_peak_current"][2]
    hold = "hold 6000 N/m, 80 N s/m at 200 Hz, 1.5 ms"
    return [
        ("outer radius", spec.radius.value * mm, figures["radius"] * mm, "mm", ""),
        ("outer height", spec.height.value * mm, figures["height"] * mm, "mm", "without handle"),
        ("stator mass", spec.stator_mass.value, figures["stator_mass"], "kg", ""),
        ("flotor mass", spec.flotor_mass.value, figures["flotor_mass"], "kg", ""),
        ("moving mass", spec.moving_mass.value, moving, "kg", "handle included"),
        ("continuous payload", spec.payload.value, _payload(figures), "kg", "see below"),
        ("translation range ±", spec.translation_range.value * mm, figures["translation_range"] * mm, "mm", ""),
        ("rotation range ±", spec.rotation_range.value, figures["rotation_range"], "deg", ""),
        ("sensor resolution, translation", "< 5", math.nan, "µm", option),
        ("sensor resolution, rotation", "< 10", math.nan, "µrad", option),
        ("force bandwidth, coil drivers", "> 3", figures["driver_bandwidth"] / 1e3, "kHz", "see below"),
        ("position bandwidth, translation", "> 30", figures["translation_bandwidth"], "Hz", hold),
        ("position bandwidth, rotation", "> 15", figures["rotation_bandwidth"], "Hz", "8 N m/rad, 0.1 N m s/rad"),
        ("force constant", spec.force_constant.value, figures["force_constant"], "N/A", ""),
        ("continuous current per coil", spec.continuous_current.value, math.nan, "A", "thermal limit"),
        ("peak current per coil", spec.peak_current.value, peak, "A", ""),
        ("force limit along z", spec.largest_vertical_force.value, largest, "N", "section 2"),
    ]


def _payload(figures: Mapping[str, Any]) -> float:
    """Return the payload [kg] at the continuous current, in addition to the flotor."""
    return float(figures["largest_at_continuous_current"][2] / GRAVITY - figures["flotor_mass"])


def position_bandwidth(
    axis: str, *, stiffness: float, damping: float, period: float, delay: float, step: float = 1e-4
) -> float:
    """Return the -3 dB bandwidth [Hz] from the target of a hold to the position.

    Measured on the MuJoCo device without gravity: the frequency response is the Fourier transform of the differenced
    step response.

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
