"""Each numeric key of a device file moves some figure, or its page says that none does."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from maglev_mj import Device
from maglev_mj.bridge.commissioning.calibration import Calibration
from maglev_mj.bridge.safety import limits_of
from maglev_mj.bridge.twin.twin import Twin, TwinParameters
from maglev_mj.control.loop import drive
from maglev_mj.device import _SECTIONS
from maglev_mj.errors import ParameterError
from maglev_mj.scenes.drop import Drop
from maglev_mj.session.segment import live_plant
from maglev_mj.studies.card import DeviceFigures
from maglev_mj.theory.loop import Loop

PAGE = Path(__file__).parents[1] / "docs" / "howto" / "describe_your_device.md"


def verdict(device: Device) -> Any:
    """Stability of each axis, and the default gains of walls."""
    gains = {"stiffness": 3000.0, "damping": 30.0}
    loops = [Loop.of(device, axis=axis, **gains)[0] for axis in device.axes]
    return [loop.spectral_radius for loop in loops], tuple(device.wall)


def simulation(device: Device) -> Any:
    """Motion of a drop against the device's stops, with its limits."""
    scene = Drop(device=device.toml())
    plant = live_plant(scene, twist=[0.0, 0.0, 0.0, 9.0, 0.0, 0.0])
    with plant:
        drive(plant, scene.controller(), 30)
        pose, twist = plant.state()
    return pose.tolist(), twist.tolist()


def table1(device: Device) -> Any:
    """Figures of `card --table1`."""
    found = DeviceFigures(device)
    parts = [found.inertia, found.range, found.force_limit, found.hover, found.critical_stiffness]
    return str(found.warnings), *(part.tolist() for part in parts)


def header(device: Device) -> Any:
    """Profile of the firmware, without the digest of all keys."""
    if device.coils is None or isinstance(guards(device), str):
        return None
    text = TwinParameters(calibration=Calibration.of(device)).profile.header()
    return re.sub(r"calibration = [{][^}]*[}]", "", text)


def twin(device: Device) -> Any:
    """Return what the twin reads, where it starts and how it moves."""
    if device.coils is None or isinstance(guards(device), str):
        return None
    truth = Calibration.of(device)
    own = TwinParameters(calibration=truth)
    spots = truth.beams.spots(np.array([1e-4, 2e-4, -1e-4, 1e-3, -2e-3, 3e-3]))
    parts = spots, truth.spot_offsets, own.quantum, own.noise, own.pose, truth.hover
    body = Twin(own).plant
    for _ in range(3):
        body.read()
        body.drive([0.5, 0.4, 0.3, 0.2, 0.1, 0.0])
    return [np.ravel(part).tolist() for part in (*parts, *body.state())], own.period, own.delay, own.latency


def guards(device: Device) -> Any:
    """Thresholds of a flight, or why the device is refused."""
    if device.coils is None:
        return None
    try:
        return device.scale, limits_of(device)
    except ParameterError as error:
        return str(error)


def views(device: Device) -> Any:
    """Knob as it is drawn and dragged."""
    return device.knob.centre.tolist(), device.knob.half.tolist()


FIGURES: dict[str, Callable[[Device], Any]] = {
    one.__name__: one for one in (verdict, simulation, table1, header, twin, guards, views)
}

WIDER = {"current_limit": 0.8, "continuous_current": 0.8, "translation": 0.8, "rotation_deg": 0.8, "gravity": 0.8}
FIRST = {
    **{"centre_of_mass": 1e-3, "noise": 3e-6, "resolution": 3e-6, "latency": 1e-4, "offsets": 1e-5, "meter": 1.0},
    **{"time_constant": 3e-4, "resistance": 2.0},
}
"""Values of keys that may be 0."""


def changed(section: str, key: str, device: Device) -> Device:
    """Return a device with another value of one key."""
    value = getattr(getattr(device, section), key)
    if key in ("directions", "across"):
        angle = 0.02
        turn = np.array([[np.cos(angle), -np.sin(angle), 0.0], [np.sin(angle), np.cos(angle), 0.0], [0.0, 0.0, 1.0]])
        tilt = np.array([[1.0, 0.0, 0.0], [0.0, np.cos(angle), -np.sin(angle)], [0.0, np.sin(angle), np.cos(angle)]])
        return device.change(section, **{key: (np.array(value) @ turn @ tilt).tolist()})
    other = np.array(0.0 if value is None else value, dtype=float)
    other = np.where(other == 0.0, FIRST.get(key, 0.0), other * WIDER.get(key, 1.1))
    return device.change(section, **{key: float(other) if other.ndim == 0 else other.tolist()})


def keys() -> Iterator[tuple[str, str]]:
    for section, kind in _SECTIONS.items():
        for item in kind.parameters():
            if item.name not in ("kind", "stops"):
                yield section, item.name


@cache
def base(section: str, key: str) -> Device:
    if section == "force":
        return Device.load("arm")
    spots = section == "sensor" and key in ("leds", "directions", "diodes", "across", "offsets")
    # not the published joystick itself, whose model is a file
    return Device.load("ubc").change("coils", thermal_time=11.0) if spots else Device.load("stage")


@cache
def figures(device: Device) -> dict[str, Any]:
    return {name: figure(device) for name, figure in FIGURES.items()}


def moved(section: str, key: str) -> list[str]:
    device = base(section, key)
    before, after = figures(device), figures(changed(section, key, device))
    names = ["guards"] if isinstance(after["guards"], str) else FIGURES
    return [name for name in names if before[name] != after[name]]


def stated() -> dict[str, str]:
    """Return what the page says that each key moves."""
    rows = [line.split("|") for line in PAGE.read_text().splitlines() if re.match(r"[|] `[a-z]+[.`]", line)]
    found = {}
    for row in rows:
        if len(row) == 7:
            found.update({key: row[4].strip() for key in re.findall(r"`([a-z]+[.][a-z_]+)`", row[1])})
    return found


@pytest.mark.parametrize(("section", "key"), list(keys()))
def test_a_key_moves_what_its_page_says(section: str, key: str) -> None:
    assert stated()[f"{section}.{key}"] == (", ".join(moved(section, key)) or "not used by any figure")
