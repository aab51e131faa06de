"""Arguments as a person gives them to the public functions.

A name, a class or an address is understood; anything else is one line that names the value and what is allowed.
"""

from __future__ import annotations

import socket
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import maglev_mj
from maglev_mj import ParameterError
from maglev_mj.bridge.fault import HandshakeError

m: Any = maglev_mj
"""Wrong arguments are of wrong types."""

DROP = m.find_scene("drop")(duration=0.05)
COILS = m.load_model("maglev").coils


def controller() -> maglev_mj.Controller:
    """Return a controller of 5 ms."""
    return maglev_mj.Controller([maglev_mj.Bias([0.0] * 6)], period=0.005)


UNDERSTOOD: Mapping[str, tuple[Callable[[], Any], Callable[[], Any]]] = {
    "a hand by its name": (
        lambda: m.largest_stable_stiffness(80.0, hand="arm"),
        lambda: m.largest_stable_stiffness(80.0, hand=m.Hand(mass=0.554, damping=6.45, stiffness=135.0)),
    ),
    "a run by name": (
        lambda: m.run("drop").figures["penetration"],
        lambda: m.run(m.find_scene("drop")()).figures["penetration"],
    ),
    "a sweep by name": (
        lambda: m.sweep("drop", {"height": [0.001]}, plant="exact").figure("penetration"),
        lambda: m.sweep(m.find_scene("drop")(), {"height": [0.001]}, plant="exact").figure("penetration"),
    ),
    "one hand of a design": (lambda: m.WallRequirements(hand="arm").hands, lambda: ("arm",)),
    "a run by path": (
        lambda: m.run(Path(__file__).parents[2] / "scripts" / "examples" / "detents.py", plant="exact").trace.pose,
        lambda: m.run(str(Path(__file__).parents[2] / "scripts" / "examples" / "detents.py"), plant="exact").trace.pose,
    ),
    "coils by lists": (
        lambda: m.CoilMap(COILS.points.tolist(), COILS.directions.tolist(), [2.0] * 6).wrench_per_current,
        lambda: m.CoilMap(COILS.points, COILS.directions, np.full(6, 2.0)).wrench_per_current,
    ),
}


@pytest.mark.parametrize("case", UNDERSTOOD)
def test_that_a_name_is_as_good_as_the_thing(case: str) -> None:
    given, made = UNDERSTOOD[case]
    np.testing.assert_array_equal(given(), made())


def test_that_a_file_may_be_a_text(tmp_path: Path) -> None:
    path = str(tmp_path / "run.maglev")
    assert m.write_run(path, DROP, plant="exact") == [Path(path)]
    recording = m.Recording.load(path)
    table = str(tmp_path / "run.csv")
    m.export(recording, "csv", table)
    assert len(Path(table).read_text().splitlines()) == recording.ticks + 1
    file = m.open_recording(str(tmp_path / "own.maglev"))
    with m.ExactPlant() as plant:
        m.drive(plant, controller(), 5, record=file.begin(plant, controller()))
    assert file.close() == tmp_path / "own.maglev"


def test_that_a_device_is_found_by_its_address() -> None:
    server = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)  # a port of ours that no device answers
    server.bind(("127.0.0.1", 0))
    address = f"udp://127.0.0.1:{server.getsockname()[1]}"
    with server:
        with pytest.raises(HandshakeError, match="no device answered"):
            m.RemotePlant(address, patience=0.05)
        assert not m.estop(address, patience=0.05).confirmed


REFUSED: Mapping[str, tuple[Callable[[], Any], str]] = {
    "hand, unknown": (lambda: m.largest_stable_stiffness(80.0, hand="leg"), "hand must be one of none, arm, .*'leg'"),
    "hand of a plant": (lambda: m.ExactPlant(hand="arm"), "hand must be a Hand, .*(not|got) 'arm'"),
    "muscles of a hand": (lambda: m.ExactPlant(hand_force=3), "hand_force must be a function .*(not|got) 3"),
    "model": (lambda: m.load_model("moon"), r"model must be one of .*got 'moon'\)"),
    "timing of a plant": (lambda: m.ExactPlant(0.005), r"timing must be a Timing, .*(not|got) 0\.005"),
    "scene, misspelt": (lambda: m.run("drp"), "scene must be one of .*'drp'.; did you mean drop"),
    "scene, a number": (lambda: m.run(3), "scene must be a Scene, .*(not|got) 3"),
    "values first": (lambda: m.sweep({"height": [0.001]}, "drop"), "scene must be a Scene, .*height"),
    "values, a name": (lambda: m.sweep(DROP, "height"), "vary must be a mapping of .*(not|got) 'height'"),
    "no values": (lambda: m.sweep(DROP, {"height": []}), r"vary must give a list of values for height.*(not|got) \[\]"),
    "range of a fidelity": (lambda: m.measure_fidelity(DROP, over=4), "over must be a Range, .*(not|got) 4"),
    "cells": (lambda: m.run_cells(list, 3), "cells must be a list of cells.*(not|got) 3"),
    "number of an axis": (lambda: m.Wall(axes=2, lower=0.0, stiffness=1.0, damping=1.0), "axis must be .*(not|got) 2"),
    "file as record": (
        lambda: m.drive(m.ExactPlant(), controller(), 5, record="x.maglev"),
        r"record must be a function, such as open_recording",
    ),
    "time of a session": (lambda: m.Session("box").tick("1"), r"elapsed must be a number \(got '1'"),
    "a scene to be found": (lambda: m.find_scene(DROP), "scene must be a name, .*(not|got) Drop"),
    "requirements": (lambda: m.design_wall("pd"), "requirements must be .*WallRequirements.*(not|got) 'pd'"),
    "a file to analyse": (lambda: m.analyse("f.maglev"), "segment must be a Segment, .*(not|got) 'f.maglev'"),
    "a file to verify": (lambda: m.verify("f.maglev", m.rebuild), "recording must be .*load.*(not|got) 'f.maglev'"),
    "a file to export": (
        lambda: m.export("f.maglev", "csv", "f.csv"),
        "recording must be .*load.*(not|got) 'f.maglev'",
    ),
    "a number as file": (lambda: m.Recording.load(3), r"path must be a file path \(got 3"),
    "a setup": (lambda: m.rebuild("drop", None), "setup must be an object.*(not|got) 'drop'"),
    "controller first": (
        lambda: m.drive(controller(), m.ExactPlant(), 5),
        r"plant must have .* read\(\) .*Controller",
    ),
    "scene to be driven": (lambda: m.drive(m.ExactPlant(), DROP, 5), r"controller must have a method step\(\) .*Drop"),
    "number of samples": (lambda: m.drive(m.ExactPlant(), 5, controller()), "ticks must be .*Controller"),
    "address of a device": (lambda: m.RemotePlant("upd://127.0.0.1:5"), "address must be udp://.*'upd://127.0.0.1:5'"),
    "link to be stopped": (lambda: m.estop(None), "link must be an address .*(not|got) None"),
    "twin": (lambda: m.Twin(3), r"parameters must be TwinParameters.*(not|got) 3"),
    "target, three numbers": (lambda: m.SpringHand(target=[0, 0, 0]), r"target must have shape \(6,\) \(got \(3,\)"),
    "target of a device": (
        lambda: m.SpringHand(device_target=[0.0, 1.0]),
        r"device_target must have shape \(6,\) \(got \(2,\)",
    ),
}


@pytest.mark.parametrize("case", REFUSED)
def test_that_anything_else_is_one_line(case: str) -> None:
    call, said = REFUSED[case]
    with pytest.raises(ParameterError, match=said) as caught:
        call()
    assert "\n" not in str(caught.value)


def test_that_a_long_value_is_cut() -> None:
    with pytest.raises(ParameterError) as caught:
        m.analyse(range(10**200, 10**201))
    assert str(caught.value).endswith("…)") and len(str(caught.value)) < 300
