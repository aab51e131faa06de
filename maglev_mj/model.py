"""The MJCF device: files, names to indices, and what a compiled model says about itself."""

from __future__ import annotations

import itertools
import math
from copy import copy
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path

import mujoco
import numpy as np

from maglev_mj.coils import CoilMap
from maglev_mj.detail import Detail
from maglev_mj.errors import ModelError, ParameterError
from maglev_mj.frames import AXES, Array
from maglev_mj.hand import Hand
from maglev_mj.parameters import flag, number
from maglev_mj.sensing.geometry import Beams
from maglev_mj.versions import MODELS

__all__ = ["COILS", "Device", "beams", "envelope", "load", "model_path", "scenes"]

COILS = tuple(f"{kind}{arm}" for kind in ("vertical", "horizontal") for arm in range(3))
"""Actuator names, in the order of the six currents."""


def scenes() -> list[str]:
    """Return the names of the models at hand."""
    return sorted(path.stem for path in MODELS.glob("*.xml"))


def model_path(name: str | Path) -> Path:
    """Return the MJCF file of a model.

    Raises:
        ModelError: If there is none of that name.
    """
    path = name if isinstance(name, Path) else MODELS / f"{name}.xml"
    if not path.is_file():
        raise ModelError(f"model must be one of {', '.join(scenes())}, not {name!r}")
    return path


def _written() -> tuple[tuple[str, int], ...]:
    """Return the MJCF files and when each was written, so that one that is changed is read again."""
    return tuple(sorted((str(path), path.stat().st_mtime_ns) for path in MODELS.glob("*.xml")))


@dataclass(frozen=True, eq=False)
class Device:
    """A compiled model with its named parts resolved.

    Attributes:
        model: The compiled model.
        flotor: Body index of the flotor.
        position_address: Index of x in qpos; y, z and the quaternion follow.
        velocity_address: Index of the x velocity in qvel; five more follow.
        coils: Wrench map of the six coils, the first six actuators, at centre; None without coils.
        driver_time_constant: The model's current driver time constant [s], whether or not it is switched on.
    """

    model: mujoco.MjModel
    flotor: int
    position_address: int
    velocity_address: int
    coils: CoilMap | None
    driver_time_constant: float

    @property
    def mass(self) -> float:
        """Moving mass, the handle included [kg]."""
        return float(self.model.body_subtreemass[self.flotor])

    @property
    def inertia(self) -> Array:
        """Moments of inertia of flotor and handle about stator axes through the centre [kg m²], (3,)."""
        data = mujoco.MjData(self.model)
        mujoco.mj_forward(self.model, data)
        mass_matrix = np.zeros((self.model.nv, self.model.nv))
        mujoco.mj_fullM(self.model, data, mass_matrix)
        start = self.velocity_address + 3
        return np.diag(mass_matrix)[start : start + 3].copy()


_MODE = 1000.0
_MODE_DAMPING = 0.01


def load(
    name: str | Path,
    *,
    lean: bool = True,
    driver_lag: bool = False,
    coils: bool = True,
    mass: float | None = None,
    hand: Hand | None = None,
    detail: Detail | None = None,
) -> Device:
    """Compile a model and resolve its names; compiled once, every call gets a copy of its own.

    Args:
        name: A model file's name without its ending, such as "drop"; or a path.
        lean: Leave out the sites that no actuator uses: no equation of motion reads them.
        driver_lag: Give every coil its driver's first-order lag.
        coils: False removes the coils, for an ideal wrench.
        mass: Moving mass in place of the model's [kg], shared out as before; the moments of inertia stay.
        hand: A hand on the flotor; numbers, and translations only.
        detail: What else the device has.

    Raises:
        ModelError: If the file is missing, does not compile, or lacks the flotor, its joints or its coils.
        ParameterError: If the mass is not above 0, or the hand is for a batch or on a rotation.
    """
    lean, driver_lag, coils = flag("lean", lean), flag("driver_lag", driver_lag), flag("coils", coils)
    path = model_path(name)
    moving = None if mass is None else number("mass", mass, above=0.0)
    device = _compiled(path, _written(), lean, driver_lag, coils, moving, hand, detail or Detail())
    return replace(device, model=copy(device.model))


@lru_cache(maxsize=32)
def _compiled(
    path: Path,
    written: tuple[tuple[str, int], ...],
    lean: bool,
    driver_lag: bool,
    coils: bool,
    mass: float | None,
    hand: Hand | None,
    detail: Detail,
) -> Device:
    """See `load`."""
    name = path.stem
    try:
        spec = mujoco.MjSpec.from_file(str(path))
        constant = float(spec.numeric("driver_time_constant").data[0])
        if not coils:
            for actuator in list(spec.actuators):
                spec.delete(actuator)
        if driver_lag:
            for actuator in spec.actuators:
                actuator.dyntype = mujoco.mjtDyn.mjDYN_FILTER
                actuator.dynprm[0] = constant
        if lean:
            _leave_out_sites(spec)
        if hand is not None:
            _hold(spec, hand)
        if detail.flexible:
            _bend(spec, mass)
        model = spec.compile()
        flotor = model.body("flotor").id
        joints = [model.joint(joint) for joint in ("x", "y", "z", "rotation")]
        order = [model.actuator(coil).id for coil in COILS] if coils else []
    except (ValueError, KeyError, AttributeError, IndexError) as error:
        raise ModelError(f"model {name!r} cannot be used: {' '.join(str(error).split())}") from error
    addresses = [int(joint.qposadr[0]) for joint in joints]
    first = addresses[0]
    if addresses != [first, first + 1, first + 2, first + 3]:
        raise ModelError(f"model {name!r} must list the flotor's joints as x, y, z, rotation")
    if order != list(range(len(order))):
        raise ModelError(f"model {name!r} must list its coils first, as {', '.join(COILS)}")
    if mass is not None:
        _share_out(model, flotor, mass)
    return Device(
        model=model,
        flotor=flotor,
        position_address=first,
        velocity_address=int(joints[0].dofadr[0]),
        coils=_coil_map(model, flotor) if coils else None,
        driver_time_constant=constant,
    )


def _leave_out_sites(spec: mujoco.MjSpec) -> None:
    """Leave out the sites that no actuator uses."""
    used = {end for actuator in spec.actuators for end in (actuator.target, actuator.refsite)}
    for site in list(spec.sites):
        if site.name not in used:
            spec.delete(site)


def _share_out(model: mujoco.MjModel, flotor: int, mass: float) -> None:
    """Give the flotor and what it carries another mass [kg], shared out as before; moments of inertia stay."""
    carried = np.flatnonzero(model.body_treeid == model.body_treeid[flotor])
    share, data = mass / model.body_subtreemass[flotor], mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    centre = data.subtree_com[flotor]
    # nearer to the common centre of mass, so that mass times distance squared stays
    places = centre + (data.xipos[carried] - centre) / math.sqrt(share) - data.xpos[carried]
    model.body_ipos[carried] = np.einsum("ba,bac->bc", places, data.xmat[carried].reshape(-1, 3, 3))
    model.body_mass[carried] *= share
    mujoco.mj_setConst(model, data)


def _bend(spec: mujoco.MjSpec, mass: float | None) -> None:
    """Let the handle swing against the flotor along z, at the flotor's first mode, for a moving mass [kg]."""
    handle, flotor = spec.body("handle"), spec.body("flotor")
    whole = handle.mass + flotor.mass
    reduced = handle.mass * flotor.mass / whole * (1.0 if mass is None else mass / whole)
    rate = 2.0 * math.pi * _MODE
    joint = handle.add_joint(name="bend", type=mujoco.mjtJoint.mjJNT_SLIDE, axis=[0.0, 0.0, 1.0])
    joint.stiffness[0], joint.damping[0] = reduced * rate**2, 2.0 * _MODE_DAMPING * reduced * rate


def _hold(spec: mujoco.MjSpec, hand: Hand) -> None:
    """Put a hand on the flotor's slides: on the joints themselves in a rigid grip, else as a body on a tendon."""
    if hand.shape or max(hand.indices) > 2:
        raise ParameterError(f"hand must have one mass and lead along x, y or z in MuJoCo, not {hand!r}")
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


def _coil_map(model: mujoco.MjModel, flotor: int) -> CoilMap:
    """Read where each coil's force applies and where it points from the model at its reference pose."""
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    coils, magnets = model.actuator_trnid[: len(COILS)].T
    gear = model.actuator_gear[: len(COILS), :3]
    axes = data.site_xmat[magnets].reshape(-1, 3, 3)
    return CoilMap(
        points=data.site_xpos[coils] - data.subtree_com[flotor],
        directions=np.einsum("jab,jb->ja", axes, gear),
        force_constants=model.actuator_gainprm[: len(COILS), 0].copy(),
    )


def beams() -> Beams:
    """Return the geometry of the device's LEDs and position sensing diodes.

    Raises:
        ModelError: If the model lacks one.
    """
    return _beams(_written())


@lru_cache(maxsize=1)
def _beams(written: tuple[tuple[str, int], ...]) -> Beams:
    """See `beams`."""
    try:
        spec = mujoco.MjSpec.from_file(str(model_path("maglev")))
        model = spec.compile()
        flotor = model.body("flotor").id
        leds, diodes = ([model.site(f"{kind}{arm}").id for arm in range(3)] for kind in ("led", "psd"))
    except (ValueError, KeyError) as error:
        raise ModelError(f"model 'maglev' cannot be used: {' '.join(str(error).split())}") from error
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    centre = data.subtree_com[flotor]
    axes = data.site_xmat.reshape(-1, 3, 3)
    return Beams(
        leds=data.site_xpos[leds] - centre,
        directions=axes[leds][:, :, 2],
        diodes=data.site_xpos[diodes] - centre,
        across=axes[diodes][:, :, :2].swapaxes(1, 2).copy(),
    )


def envelope(device: Device) -> tuple[float, float]:
    """Return radius and height [m] of the upright cylinder that holds the device without its handle."""
    model = device.model
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
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
