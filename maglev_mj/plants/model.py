"""Device model in MJCF: files, names and compiled properties."""

from __future__ import annotations

import itertools
import math
import re
from collections.abc import Mapping, Sequence
from copy import copy
from dataclasses import dataclass, replace
from functools import cache, lru_cache
from pathlib import Path
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from maglev_mj.device import Device, coil_names, lag_of, published_device
from maglev_mj.errors import ModelError, ParameterError, check_instance, choice_message
from maglev_mj.files import read_text
from maglev_mj.frames import AXES, Array
from maglev_mj.keywords import checked
from maglev_mj.lazy import mujoco
from maglev_mj.parameters import LAG, flag, number, numbers
from maglev_mj.plants.coils import CoilMap
from maglev_mj.plants.hand import Hand
from maglev_mj.spec import Spec
from maglev_mj.versions import MODELS

JOINTS = ("x", "y", "z", "rotation")
"""Names of the flotor's joints, in order."""


Model: TypeAlias = "str | Path | mujoco.MjSpec | Device"
"""Name of a model of the package, MJCF file (.xml), specification, or description of a device."""


def scenes() -> list[str]:
    """Return the names of the device models."""
    return sorted(path.stem for path in MODELS.glob("*.xml"))


@cache
def model_names() -> tuple[str, ...]:
    """Return all model names of the package, scenes included."""
    return tuple(sorted(path.relative_to(MODELS).with_suffix("").as_posix() for path in MODELS.rglob("*.xml")))


def model_files(model: str | Path) -> tuple[tuple[str, str], ...]:
    """Return names and texts of a model's MJCF files, included files last.

    Raises:
        ModelError: If there is no such model.
    """
    path = model_path(model)
    return _read(path, 0 if model in model_names() else path.stat().st_mtime_ns)


@lru_cache(maxsize=64)
def _read(path: Path, written: int) -> tuple[tuple[str, str], ...]:
    path = path.resolve()
    try:
        text = read_text(path)
    except (OSError, ValueError) as error:
        raise invalid_model(path.name, error) from None
    name = path.relative_to(MODELS.resolve()).as_posix() if path.is_relative_to(MODELS.resolve()) else path.name
    parts = [path.parent / included for included in re.findall(r'<include\s+file="([^"]+)"', text)]
    return ((name, text), *(file for part in parts for file in model_files(part)))


@checked(own="model")
def model_path(model: str | Path) -> Path:
    """Return the MJCF file of a model.

    Args:
        model: Name of a model of the package, or a file.

    Raises:
        ModelError: If there is no such model.

    Example:
        >>> model_path("drop").name
        'drop.xml'
    """
    check_instance("model", model, str | Path, "a name, an MJCF file or an MjSpec")
    if isinstance(model, Path) or model.endswith(".xml"):
        path = Path(model)
        if not path.is_file():
            raise ModelError(f"no such MJCF file: {str(model)!r}")
        return path
    path = MODELS / f"{model}.xml"
    if not path.is_file():
        raise ModelError(choice_message("model", scenes(), model, ", or an MJCF file"))
    return path


def written(folder: Path) -> tuple[tuple[str, int], ...]:
    """Return the MJCF files of a folder with their modification times [ns]."""
    return tuple(sorted((str(path), path.stat().st_mtime_ns) for path in folder.glob("*.xml")))


def drivers_lag(model: Model | None, driver_lag: bool | None, constant: float) -> float:
    """Return the time constant of the drivers that a plant simulates [s]; 0 for none.

    Args:
        model: Device of the plant.
        driver_lag: True for a lag, False for none; None for that of a device file, see `lag_of`.
        constant: Time constant of the model, or in its place [s].

    Raises:
        ModelError: If a lag has no time constant.
    """
    if driver_lag is None:
        lags = isinstance(model, Device) and lag_of(model) > 0.0
    else:
        lags = flag("driver_lag", driver_lag)
    if lags and not constant > 0.0:
        raise ModelError("driver_lag needs a numeric 'driver_time_constant' above 0 in the model")
    return constant if lags else 0.0


@dataclass(frozen=True, eq=False)
class CompiledModel:
    """Compiled model with resolved names.

    Attributes:
        model: Compiled model.
        flotor: Body index of the flotor.
        position_address: Index of x in qpos; y, z and the quaternion follow.
        velocity_address: Index of the x velocity in qvel; five more follow.
        coils: Coil map of the first actuators, at the centre; None without coils.
        driver_time_constant: Time constant of the drivers [s], also with their lag disabled; NaN if the model has none.
    """

    model: mujoco.MjModel
    flotor: int
    position_address: int
    velocity_address: int
    coils: CoilMap | None
    driver_time_constant: float

    @property
    def mass(self) -> float:
        """Moving mass [kg], handle included."""
        return float(self.model.body_subtreemass[self.flotor])

    @property
    def gravity(self) -> Array:
        """The model's gravitational acceleration in stator axes [m/s²], (3,); zero if it disables gravity."""
        options = self.model.opt
        disabled = options.disableflags & mujoco.mjtDisableBit.mjDSBL_GRAVITY
        return np.zeros(3) if disabled else np.array(options.gravity)

    @property
    def current_limit(self) -> float:
        """Smallest current limit of the coils [A]; the published one where they have none."""
        coils = slice(0 if self.coils is None else len(self.coils))
        limited, currents = self.model.actuator_ctrllimited[coils], self.model.actuator_ctrlrange[coils]
        return float(np.where(limited, currents[:, 1], Spec.peak_current.value).min())

    @property
    def mass_matrix(self) -> Array:
        """Mass matrix of the upright flotor at the centre [kg, kg m, kg m²], (6, 6), with a hand in a rigid grip."""
        flotor = slice(self.velocity_address, self.velocity_address + 6)
        return _mass_matrix(self.model)[flotor, flotor].copy()

    @property
    def inertia(self) -> Array:
        """Moments of inertia of flotor and handle about stator axes through the centre [kg m²], (3,)."""
        return np.diag(self.mass_matrix)[3:].copy()

    @property
    def range(self) -> Array:
        """Range of motion: displacement along x, y, z and angle [m, rad], (4,); infinite without a stop."""
        model = self.model
        joints = [model.joint(joint).id for joint in JOINTS]
        limits = np.where(model.jnt_limited[joints], model.jnt_range[joints, 1], np.inf)
        return np.asarray(limits, dtype=np.float64)


_MODE = 1000.0
_MODE_DAMPING = 0.01


@checked(own="coil_map model")
def load_model(
    model: Model = "drop",
    *,
    lean: bool = True,
    driver_time_constant: float | None = None,
    coils: bool = True,
    coil_map: CoilMap | None = None,
    mass: float | None = None,
    inertia: ArrayLike | None = None,
    hand: Hand | None = None,
    flexible: bool = False,
) -> CompiledModel:
    """Compile a model and resolve its names.

    A file is compiled once and cached; every call returns a separate copy.

    Args:
        model: Device with the bodies `flotor` and, on it, `handle`; the flotor's joints `x`, `y`, `z` (slides) and
            `rotation` (ball), in this order; coils as its first actuators, see `maglev_mj.device.coil_names`.
        lean: Remove sensors, and sites without an actuator, which the equations of motion do not use.
        driver_time_constant: Time constant of the drivers [s], instead of the model's; the plants simulate their lag.
        coils: False removes the coils, for an ideal wrench.
        coil_map: Coils instead of the model's.
        mass: Moving mass [kg], instead of the model's, in the same proportions; moments of inertia stay.
        inertia: Moments of inertia of flotor and handle about stator axes [kg m²], (3,), instead of the model's.
        hand: Hand on the flotor, scalar and on translations only.
        flexible: Let the handle swing against the flotor along z, at 1 kHz and a damping ratio of 0.01; the frequency
            is the paper's, shape and damping are assumed.

    Raises:
        ModelError: If the file is missing, does not compile, or lacks the flotor, its joints or its coils.
        ParameterError: If a number is not above 0, the moments of inertia are impossible for the flotor, or the hand
            has a batch shape or acts on a rotation.

    Example:
        >>> from maglev_mj import load_model
        >>> device = load_model("drop", mass=1.0)
        >>> round(device.mass, 3), device.range[:3].tolist()  # [kg], [m]
        (1.0, [0.0045, 0.0045, 0.0045])
    """
    options = _Options(
        lean=flag("lean", lean),
        coils=flag("coils", coils),
        flexible=flag("flexible", flexible),
        lag=None
        if driver_time_constant is None
        else number("driver_time_constant", driver_time_constant, above=0.0, **LAG),
        mass=None if mass is None else number("mass", mass, above=0.0),
        hand=hand,
        inertia=None if inertia is None else tuple(numbers("inertia", inertia, shape="(3,)", above=0.0).tolist()),
    )
    if isinstance(model, Device):
        device = _described(model, options._replace(coils=coils and model.coils is not None))
    elif isinstance(model, mujoco.MjSpec):
        device = _compile(model.modelname, model.copy(), options)
    else:
        path = model_path(model)
        device = _compiled(path, written(path.parent), options)
    device = replace(device, model=copy(device.model))
    if coil_map is not None:
        if device.coils is None:
            raise ParameterError("coil_map needs coils=True")
        check_instance("coil_map", coil_map, CoilMap, "a CoilMap")
        _put_coils(device, coil_map)
        device = replace(device, coils=coil_map)
    return device


def drawn_model(model: Model, device: Device | None = None) -> CompiledModel:
    """Compile a scene's model for display, with a device in place of the published joystick.

    Raises:
        ModelError: If the file is missing or invalid.
    """
    if device is None or device.published or not isinstance(model, str | Path):
        return load_model(model, lean=False)
    files = dict(model_files(model))
    if "maglev.xml" not in files:
        return load_model(model, lean=False)
    first, *_ = files
    files["maglev.xml"] = device.mjcf()
    spec = mujoco.MjSpec.from_string(files[first], include={name: text.encode() for name, text in files.items()})
    if (ring := spec.geom("ring")) is not None:
        spec.delete(ring)  # a part of the published stator
    return load_model(spec, lean=False, coils=device.coils is not None)


def check_model(model: Model, device: Device) -> None:
    """Check a model against a device within 0.1 %: mass, inertia, range and coils.

    Raises:
        ModelError: If a value differs; the first one is named. See also `load_model`.
    """
    loaded, part = load_model(model, coils=device.coils is not None), device.coils
    range_ = [*device.reach[:3], device.reach[3:].min()]
    values: dict[str, tuple[Any, Any, str]] = {
        "mass": (loaded.mass, device.mass, "kg"),
        "inertia": (loaded.inertia, device.body.inertia, "kg m²"),
        "range": (loaded.range, range_ if device.range.stops else loaded.range, "m, rad"),
    }
    if part is not None and (coils := loaded.coils) is not None:
        values["number of coils"] = len(coils), len(part.points), ""
        for index, name in enumerate(coil_names(min(len(coils), len(part.points)))):
            point = np.array(part.points[index]) - device.body.centre_of_mass
            values[f"point of coil {name} from the centre of mass"] = coils.points[index], point, "m"
            values[f"direction of coil {name}"] = coils.directions[index], part.directions[index], ""
            values[f"force constant of coil {name}"] = coils.force_constants[index], part.force_constants[index], "N/A"
        values["current limit"] = loaded.current_limit, part.current_limit, "A"
    for name, (own, stated, unit) in values.items():
        if not np.allclose(own, stated, rtol=0.0, atol=1e-3 * np.abs(np.nan_to_num(stated, posinf=0.0)).max()):
            texts = [", ".join(f"{x:.6g}" for x in np.ravel(value)) for value in (stated, own)]
            raise ModelError(f"{name} must be that of the device, {texts[0]} {unit}".rstrip() + f" (got {texts[1]})")


class Flotor(NamedTuple):
    """Flotor and limits of a device.

    Attributes:
        inertia: Mass and moments of inertia [kg, kg m²], (6,).
        gravity: Gravitational acceleration in stator axes [m/s²], (3,).
        range: Range of motion to either side [m, rad], (6,); infinite without a stop.
        force_limit: Largest force along z at the current limit [N]; infinite without coils.
    """

    inertia: Array
    gravity: Array
    range: Array
    force_limit: float

    @property
    def load(self) -> Array:
        """Weight in stator axes [N, N m], (6,)."""
        return np.append(self.inertia[0] * self.gravity, np.zeros(3))

    @property
    def bounded(self) -> Flotor:
        """The same device, with the published range and force limit where its own are infinite."""
        published = published_device()
        limit = self.force_limit if math.isfinite(self.force_limit) else float(published.force_limit[2])
        return self._replace(range=np.where(np.isfinite(self.range), self.range, published.reach), force_limit=limit)


def body_of(keywords: Mapping[str, Any]) -> Flotor:
    """Return the device of a plant's keywords; without a model, the published joystick.

    Raises:
        ModelError: If its model is invalid.
    """
    model = keywords.get("model") or published_device()
    if isinstance(model, Device):
        body = Flotor(model.inertia.copy(), np.array(model.body.gravity), model.reach, float(model.force_limit[2]))
    else:
        device = load_model(model, **{name: keywords[name] for name in ("coils", "coil_map") if name in keywords})
        limits = () if device.coils is None else device.coils.largest_wrench(device.current_limit)[2:3]
        inertia = np.array([device.mass] * 3 + device.inertia.tolist())
        body = Flotor(inertia, device.gravity, device.range[[0, 1, 2, 3, 3, 3]], float(min(limits, default=math.inf)))
    for name, axes in (("mass", slice(3)), ("inertia", slice(3, None))):
        if keywords.get(name) is not None:
            body.inertia[axes] = keywords[name]
    gravity = keywords.get("gravity")
    return body if gravity is None else body._replace(gravity=acceleration(gravity))


def acceleration(gravity: ArrayLike) -> Array:
    """Return gravity, along -z or in stator axes (3,), as an acceleration in stator axes [m/s²], (3,)."""
    vector = numbers("gravity", gravity, shape="() or (3,)")
    return vector if vector.ndim else np.array([0.0, 0.0, -float(vector)])


class _Options(NamedTuple):
    """Options of `load_model` that affect the compiled model."""

    lean: bool
    coils: bool
    flexible: bool
    lag: float | None
    mass: float | None
    hand: Hand | None
    inertia: tuple[float, ...] | None


@lru_cache(maxsize=32)
def _described(device: Device, options: _Options) -> CompiledModel:
    """Compile the generated model of a device; see `load_model`."""
    return _compile(device.name, mujoco.MjSpec.from_string(device.mjcf()), options)


@lru_cache(maxsize=32)
def _compiled(path: Path, written: tuple[tuple[str, int], ...], options: _Options) -> CompiledModel:
    """Compile a file; see `load_model`."""
    name = path.stem if path.parent == MODELS else path.name
    try:
        spec = mujoco.MjSpec.from_file(str(path))
    except (ValueError, KeyError) as error:
        model_files(path)  # raises a clearer error if it is no text
        raise invalid_model(name, error) from error
    return _compile(name, spec, options)


def invalid_model(name: str, error: object) -> ModelError:
    """Return the error for an invalid model."""
    return ModelError(f"model {name!r} is invalid: {' '.join(str(error).split())}")


def _compile(name: str, spec: mujoco.MjSpec, options: _Options) -> CompiledModel:
    """Compile a specification; see `load_model`."""
    _check_names(name, spec, options)
    numeric = spec.numeric("driver_time_constant")
    constant = math.nan if numeric is None else float(numeric.data[0])
    constant = constant if options.lag is None else options.lag
    try:
        if not options.coils:
            for actuator in list(spec.actuators):
                spec.delete(actuator)
        for key in list(spec.keys):  # keyframes lack the coordinates of a hand or flexible handle
            spec.delete(key)
        if options.lean:
            _delete_sensors_and_sites(spec)
        if options.hand is not None:
            _hold(spec, options.hand)
        if options.flexible:
            _bend(spec, options.mass)
        model = spec.compile()
        if options.inertia is not None:
            _give_inertia(spec, model, options.inertia)
            model = spec.compile()
        flotor = model.body("flotor").id
        joints = [model.joint(joint) for joint in JOINTS]
        names = coil_names(coil_count(model))
        order = [model.actuator(coil).id for coil in names] if options.coils else []
    except ParameterError:
        raise
    except (ValueError, KeyError) as error:
        raise invalid_model(name, error) from error
    addresses = [int(joint.qposadr[0]) for joint in joints]
    first = addresses[0]
    if addresses != [first, first + 1, first + 2, first + 3]:
        raise ModelError(f"model {name!r} must define the flotor's joints in the order {', '.join(JOINTS)}")
    if order != list(range(len(order))):
        raise ModelError(f"model {name!r} must define its coils first, in the order {', '.join(names)}")
    if options.mass is not None:
        _share_out(model, flotor, options.mass)
    device = CompiledModel(
        model=model,
        flotor=flotor,
        position_address=first,
        velocity_address=int(joints[0].dofadr[0]),
        coils=_coil_map(model, flotor, len(order)) if order else None,
        driver_time_constant=constant,
    )
    hand, inertia = options.hand, options.inertia
    held = hand is None or not hand.soft or model.body("hand").mass[0] == hand.mass
    if not held or (inertia is not None and not np.allclose(device.inertia, inertia, rtol=1e-9)):
        raise invalid_model(name, "its compiler options change the requested inertia or the mass of the hand")
    return device


def _check_names(name: str, spec: mujoco.MjSpec, options: _Options) -> None:
    """Raise ModelError for missing or wrong bodies, joints and actuators."""
    flotor = spec.body("flotor")
    if flotor is None:
        raise invalid_model(name, "no body 'flotor'")
    if options.flexible and spec.body("handle") is None:
        raise invalid_model(name, "a flexible handle needs a body 'handle'")
    kinds = [mujoco.mjtJoint.mjJNT_SLIDE] * 3 + [mujoco.mjtJoint.mjJNT_BALL]
    types = {joint.name: joint.type for joint in flotor.joints}
    for joint, kind in zip(JOINTS, kinds, strict=True):
        if types.get(joint) != kind:
            label = "ball" if kind == mujoco.mjtJoint.mjJNT_BALL else "slide"
            raise invalid_model(name, f"the flotor has no {label} joint {joint!r}")
    names = [actuator.name for actuator in spec.actuators]
    if missing := [coil for coil in coil_names(0) if options.coils and coil not in names]:
        raise invalid_model(name, f"no actuator {', '.join(missing)} among its {len(names)} actuators")


def _delete_sensors_and_sites(spec: mujoco.MjSpec) -> None:
    """Delete the sensors, and the sites without an actuator."""
    for sensor in list(spec.sensors):
        spec.delete(sensor)
    used = {end for actuator in spec.actuators for end in (actuator.target, actuator.refsite)}
    for site in list(spec.sites):
        if site.name not in used:
            spec.delete(site)


def _share_out(model: mujoco.MjModel, flotor: int, mass: float) -> None:
    """Set the moving mass [kg]; keep the moments of inertia."""
    carried = np.flatnonzero(model.body_treeid == model.body_treeid[flotor])
    share, data = mass / model.body_subtreemass[flotor], reference_state(model)
    centre = data.subtree_com[flotor]
    # scale distances from the common centre of mass, so that mass times distance squared stays
    positions = centre + (data.xipos[carried] - centre) / math.sqrt(share) - data.xpos[carried]
    model.body_ipos[carried] = np.einsum("ba,bac->bc", positions, data.xmat[carried].reshape(-1, 3, 3))
    model.body_mass[carried] *= share
    mujoco.mj_setConst(model, data)


def _give_inertia(spec: mujoco.MjSpec, model: mujoco.MjModel, inertia: Sequence[float]) -> None:
    """Set the moments of inertia [kg m²] of flotor and handle."""
    body, turn = spec.body("flotor"), np.zeros(9)
    address = int(model.joint("rotation").dofadr[0])
    difference = np.diag(inertia) - _mass_matrix(model)[address : address + 3, address : address + 3]
    if np.isfinite(body.fullinertia).all():
        xx, yy, zz, xy, xz, yz = body.fullinertia
        own = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    else:
        mujoco.mju_quat2Mat(turn, body.iquat)
        own = turn.reshape(3, 3) @ np.diag(body.inertia) @ turn.reshape(3, 3).T
    moments, axes = np.linalg.eigh(own + difference)
    if not (moments[0] > 0.0 and moments[0] + moments[1] >= moments[2]):
        raise ParameterError(
            f"inertia {list(inertia)} kg m² is impossible: the flotor without its handle would not be a rigid body"
        )
    quaternion = np.zeros(4)
    mujoco.mju_mat2Quat(quaternion, (axes * np.linalg.det(axes)).ravel())  # a rotation, not a reflection
    body.inertia, body.iquat, body.fullinertia = moments, quaternion, np.full(6, np.nan)


def reference_state(model: mujoco.MjModel) -> mujoco.MjData:
    """Return the state of a model at its reference pose."""
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    return data


def _mass_matrix(model: mujoco.MjModel) -> Array:
    """Return a model's mass matrix at its reference pose."""
    data = reference_state(model)
    matrix = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, matrix)
    return matrix


def _bend(spec: mujoco.MjSpec, mass: float | None) -> None:
    """Make the handle flexible along z, at 1 kHz."""
    handle, flotor = spec.body("handle"), spec.body("flotor")
    total = handle.mass + flotor.mass
    reduced = handle.mass * flotor.mass / total * (1.0 if mass is None else mass / total)
    frequency = 2.0 * math.pi * _MODE
    joint = handle.add_joint(name="bend", type=mujoco.mjtJoint.mjJNT_SLIDE, axis=[0.0, 0.0, 1.0])
    joint.stiffness[0], joint.damping[0] = reduced * frequency**2, 2.0 * _MODE_DAMPING * reduced * frequency


def _hold(spec: mujoco.MjSpec, hand: Hand) -> None:
    """Add a hand to the joints, or by tendons for a soft grip."""
    if hand.shape or max(hand.indices) > 2:
        raise ParameterError(f"a hand in MuJoCo must have scalar values and act on x, y or z (got {hand!r})")
    mass, damping, stiffness, grip_damping, grip_stiffness = (float(value) for value in hand.values)
    body = spec.worldbody.add_body(name="hand", gravcomp=1.0) if hand.soft else None
    if body is not None:
        body.mass, body.inertia, body.explicitinertial = mass, [mass * 1e-4] * 3, True
    for index in hand.indices:
        axis = AXES[index]
        joint = spec.joint(axis)
        if body is not None:
            tendon = spec.add_tendon(name=f"grip_{axis}", springlength=[0.0, 0.0])
            tendon.damping[0], tendon.stiffness[0] = grip_damping, grip_stiffness
            tendon.wrap_joint(axis, 1.0)
            joint = body.add_joint(name=f"hand_{axis}", type=mujoco.mjtJoint.mjJNT_SLIDE, axis=joint.axis)
            tendon.wrap_joint(joint.name, -1.0)
        else:
            joint.armature = mass
        joint.damping[0], joint.stiffness[0] = damping, stiffness


def coil_count(model: mujoco.MjModel) -> int:
    """Return the number of a model's coils, by the names of its actuators."""
    names = {model.actuator(index).name for index in range(model.nu)}
    return next(count for count in itertools.count(len(coil_names(0))) if f"coil{count}" not in names)


def _coil_map(model: mujoco.MjModel, flotor: int, count: int) -> CoilMap:
    """Return the coil map at the model's reference pose."""
    data = reference_state(model)
    coils, magnets = model.actuator_trnid[:count].T
    gear = model.actuator_gear[:count, :3]
    axes = data.site_xmat[magnets].reshape(-1, 3, 3)
    return CoilMap(
        points=data.site_xpos[coils] - data.subtree_com[flotor],
        directions=np.einsum("jab,jb->ja", axes, gear),
        force_constants=model.actuator_gainprm[:count, 0].copy(),
    )


def _put_coils(device: CompiledModel, coils: CoilMap) -> None:
    """Replace the model's coils by a coil map."""
    model, present = device.model, device.coils
    assert present is not None
    if len(coils) != len(present):
        raise ParameterError(f"coil_map must have the model's {len(present)} coils (got {len(coils)})")
    data, own = reference_state(model), slice(len(coils))
    sites, magnets = model.actuator_trnid[own].T
    model.site_pos[sites] += coils.points - present.points
    axes = data.site_xmat[magnets].reshape(-1, 3, 3)
    model.actuator_gear[own, :3] = np.einsum("jba,jb->ja", axes, coils.directions)
    model.actuator_gainprm[own, 0] = coils.force_constants
