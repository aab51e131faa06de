"""Laws in C: the bits of their twins in Python, in every place where a law is used, and faults as one line."""

from __future__ import annotations

import copy
import os
import pickle
import shutil
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from maglev_mj import (
    AxisLaw,
    CLaw,
    Controller,
    ParameterError,
    Recording,
    Scene,
    Start,
    check_law,
    compare,
    find_scene,
    gain,
    hold,
    judge,
    linearise,
    local_workers,
    param,
    rebuild,
    run,
    sweep,
    verify,
    write_run,
)
from maglev_mj.control.laws import c_law, probe
from maglev_mj.scenes.find import line_of
from maglev_mj.scenes.wall_scene import others
from maglev_mj.session.replay import ATTACHED, UserCode
from tests.theory.test_amplitudes import Fixed

pytestmark = [pytest.mark.needs("own compiler"), pytest.mark.xdist_group("laws in C")]  # compiled once

C = Path(__file__).with_name("c_laws.c")


class CWall(CLaw, library=C.name, symbol="wall"):
    """One-sided PD wall."""

    stiffness: float = gain("", "N/m")
    damping: float = gain("", "N s/m")


class PyWall(AxisLaw):
    """One-sided PD wall."""

    stiffness: float = gain("", "N/m")
    damping: float = gain("", "N s/m")

    def force(self, x: Any, v: Any, gains: Any, state: Any) -> Any:
        return -(gains.stiffness * x + gains.damping * v) * (x < 0.0)


class CSoft(CLaw, library=C.name, symbol="soft", memory=8):
    """Spring and filtered damper."""

    stiffness: float = gain("", "N/m")
    damping: float = gain("", "N s/m")
    share: float = gain("", "", default=0.3)


class PySoft(AxisLaw):
    """Spring and filtered damper."""

    stiffness: float = gain("", "N/m")
    damping: float = gain("", "N s/m")
    share: float = gain("", "", default=0.3)

    def force(self, x: Any, v: Any, gains: Any, state: Any) -> Any:
        speed = 0.0 if state is None else state
        speed = speed + gains.share * (v - speed)
        return -gains.stiffness * x - gains.damping * speed, speed


class CFixed(CLaw, library=C.name, symbol="fixed", memory=12):
    """Spring and damper in fixed point."""

    stiffness: float = gain("", "N/m")
    damping: float = gain("", "N s/m per sample rate")


TWINS = {
    "wall": (CWall, PyWall, {"stiffness": 3000.0, "damping": 40.0}),
    "soft": (CSoft, PySoft, {"stiffness": 3000.0, "damping": 40.0}),
    "fixed": (CFixed, Fixed, {"stiffness": 3000.0, "damping": 8000.0}),
}
twins = pytest.mark.parametrize("kind", TWINS)


def both(kind: str, **changes: Any) -> list[Any]:
    first, second, gains = TWINS[kind]
    return [cls(**{"axes": "x", **gains, **changes}) for cls in (first, second)]


class Rig(Scene):
    """One of the laws in C, or its twin, on x."""

    shown_axis = "x"
    duration: float = param("", "s", default=0.5, above=0.0, at_most=10.0)
    stiffness: float = param("", "N/m", default=3000.0, live=True)
    in_c: bool = param("", default=False)
    kind: str = param("", default="wall", choices=tuple(TWINS))

    def start(self) -> Start:
        return Start(twist=(-0.05, 0, 0, 0, 0, 0), gravity=0.0)

    def laws(self) -> Any:
        return [both(self.kind, stiffness=self.stiffness)[not self.in_c], hold(self, others("x"))]


@twins
def test_a_run_has_the_bits_of_the_twin(kind: str) -> None:
    poses = [run(Rig(kind=kind, in_c=in_c)).line.pose for in_c in (True, False)]
    assert poses[0].any() and poses[0].tobytes() == poses[1].tobytes()


@twins
def test_a_linearisation_has_the_bits_of_the_twin(kind: str) -> None:
    """A law in fixed point has no response to the smallest displacement, and one to ten counts."""
    for amplitude in (None, 1e-5):
        own: Any = {"amplitude": amplitude, "resolution": 1e-6 if amplitude else 0.0}
        near = [linearise(Controller([law], period=0.005), [-1e-3, 0, 0, 0, 0, 0], **own)[0] for law in both(kind)]
        assert near[0].response.tobytes() == near[1].response.tobytes()
        assert near[0].response.any() != (kind == "fixed" and amplitude is None)


@twins
def test_one_device_and_a_batch_have_equal_bits(kind: str) -> None:
    check_law(both(kind)[0])


@twins
def test_devices_with_gains_of_their_own_have_the_bits_of_the_twin(kind: str) -> None:
    stiffness = np.array([[1000.0], [2000.0], [3500.0]])
    laws, random = both(kind, stiffness=stiffness), np.random.default_rng(1)
    states = [law.start() for law in laws]
    for _ in range(50):
        position, velocity = [random.uniform(-3e-3, 3e-3, 3), *[0.0] * 5], [random.uniform(-0.1, 0.1, 3), *[0.0] * 5]
        wrenches = [[0.0] * 6, [0.0] * 6]
        for index, law in enumerate(laws):
            states[index] = law(position, velocity, states[index], wrenches[index])[0]
        assert np.asarray(wrenches[0][0]).tobytes() == np.asarray(wrenches[1][0]).tobytes()


def test_compare_prints_the_row_of_the_twin() -> None:
    rows = [compare("drop", [law], phases=2).table().rows[-1][1:] for law in (CWall, PyWall)]
    assert rows[0] == rows[1]


def test_verdicts_are_those_of_the_twin() -> None:
    verdicts = [judge(Controller([law], period=0.005), delay=0.0015).as_json() for law in both("soft")]
    assert verdicts[0] == verdicts[1] and verdicts[0]["stable"] is not None


def test_a_state_is_a_value() -> None:
    """A run can be repeated from any sample: rewound, copied, pickled, for one device and for several."""
    law, still = both("soft")[0], [0.0] * 5
    for position in ([1e-3, *still], [np.array([1e-3, 2e-3]), *still]):
        speed: list[Any] = [0.1, *still]
        state = law(position, speed, law.start(), [0.0] * 6)[0]
        kept, wrenches = copy.deepcopy(state), list[Any]()
        for before in (state, state, kept, pickle.loads(pickle.dumps(kept))):
            wrench: list[Any] = [0.0] * 6
            law(position, speed, before, wrench)
            wrenches.append(np.asarray(wrench[0]).tobytes())
        assert len({*wrenches}) == 1


def test_a_law_is_pickled_with_its_gains() -> None:
    law, _ = both("wall")
    again, wrench = pickle.loads(pickle.dumps(law)), [0.0] * 6
    again([-1e-3, *[0.0] * 5], [0.0] * 6, again.start(), wrench)
    assert wrench[0] == 3.0


FAULTS = {
    "crash": "crashes: SIGSEGV",
    "stop": "crashes: SIGABRT",
    "leave": "ends its process, exit code 0x3",
    "loop": "does not return within 0.3 s of processor time",
    "sleeps": "does not return within 1 s",
    "wild": "writes outside its memory of 8 bytes",
    "below": "writes outside its memory of 8 bytes",
    "gains": "writes to its gains",
    "beside": "writes beside its force",
    "more": "it has 1 gains, and what it reads beyond is NaN",
    "nothing": "sets no finite force at x = ",
    "infinite": r"sets no finite force at x = -?0\.0, .*\(got -?inf\)$",
    "counts": "returns another force for equal samples: it keeps values outside its memory of 8 bytes",
    "shared": "returns another force for equal samples: it keeps values outside its memory of 8 bytes",
    "absent": "is not in the library: declare it without static",
}


def law_of(symbol: str, /, **keywords: Any) -> Any:
    """Return a law of one gain in a new class."""

    class Mine(CLaw, **{"library": C, "symbol": symbol, "memory": 8} | keywords):
        stiffness: float = gain("", "N/m")

    return Mine(axes="x", stiffness=100.0)


@pytest.mark.parametrize("symbol", FAULTS)
def test_a_fault_is_one_line(symbol: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(c_law, "_PROBE_TIME", 0.3)
    monkeypatch.setattr(c_law, "_PROBE_TIMEOUT", 1.0 if symbol == "sleeps" else 60.0)
    with pytest.raises(ParameterError, match=f"^law Mine: {symbol} of c_laws.c .*{FAULTS[symbol]}") as caught:
        law_of(symbol)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("symbol", ["talks", "ends"])
def test_what_is_no_fault_is_accepted(symbol: str) -> None:
    law, wrench = law_of(symbol), [0.0] * 6
    law([1e-3, *[0.0] * 5], [0.0] * 6, law.start(), wrench)
    assert wrench[0] == -0.1


def test_the_probe_finds_too_small_a_memory() -> None:
    function = probe.function_of(str(c_law._compiled("Mine", C, "here")), "fixed")
    assert probe.fault(function, 12, [[1.0, 1.0]]) == ""
    assert probe.fault(function, 8, [[1.0, 1.0]]) == "writes outside its memory of 8 bytes"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("void step(double x) { x = ; }\n", "mine.c does not compile: mine.c:1:27: error: expected expression"),
        (
            '#include "none.h"\n',
            r"mine.c does not compile: mine.c:1:10: fatal error: .*none.h",
        ),
        ("void step(void) { unknown(); }\n", "unknown"),
    ],
)
def test_an_error_of_the_compiler_is_one_line(text: str, message: str, tmp_path: Path) -> None:
    tmp_path.joinpath("mine.c").write_text(text)
    with pytest.raises(ParameterError, match=message) as caught:
        law_of("step", library=tmp_path / "mine.c")
    assert "\n" not in str(caught.value)


def test_a_header_beside_the_file_is_found(tmp_path: Path) -> None:
    tmp_path.joinpath("mine.h").write_text("#define SIGN -1.0\n")
    law = "void step(double x, double v, const double *g, void *m, double *f) { *f = SIGN * g[0] * x; }\n"
    tmp_path.joinpath("mine.c").write_text(f'#include "mine.h"\n{law}')
    mine, wrench = law_of("step", library=tmp_path / "mine.c", memory=0), [0.0] * 6
    mine([1e-3, *[0.0] * 5], [0.0] * 6, mine.start(), wrench)
    assert wrench[0] == -0.1


def test_a_compiled_library_needs_no_compiler(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    library = tmp_path / "laws.so"
    shutil.copy(c_law._compiled("Mine", C, "here"), library)
    monkeypatch.setattr(c_law, "COMPILERS", ("no-such-compiler",))
    law, wrench = law_of("talks", library=library), [0.0] * 6
    law([1e-3, *[0.0] * 5], [0.0] * 6, law.start(), wrench)
    assert wrench[0] == -0.1
    other = shutil.copy(C, tmp_path / "other.c")
    message = r"law Mine: other.c needs a C compiler \(no-such-compiler\): install one, or name a library compiled"
    with pytest.raises(ParameterError, match=message):
        law_of("talks", library=other)


def test_a_library_is_looked_for_beside_the_class_and_where_imports_are(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    shutil.copy(C, tmp_path / "elsewhere.c")
    with pytest.raises(ParameterError, match=r"law Mine: elsewhere.c does not exist in .*control"):
        law_of("talks", library="elsewhere.c")
    monkeypatch.syspath_prepend(tmp_path)
    law_of("talks", library="elsewhere.c")


def test_the_hash_of_a_file_can_be_required(tmp_path: Path) -> None:
    law, _ = both("wall")
    assert CWall(axes="x", stiffness=1.0, damping=0.0, code=law.code).code == law.code
    with pytest.raises(ParameterError, match=f"law CWall: c_laws.c has changed: its hash must be 0 .got {law.code}"):
        CWall(axes="x", stiffness=1.0, damping=0.0, code="0")


@pytest.mark.parametrize(
    ("keywords", "message"),
    [
        ({"symbol": "no name"}, "symbol must be the name of a function in C"),
        ({"memory": -1}, "memory must be 0 to 1048576 bytes"),
        ({"memory": 8.5}, "memory must be 0 to 1048576 bytes"),
    ],
)
def test_a_wrong_declaration_is_refused(keywords: Any, message: str) -> None:
    with pytest.raises(ParameterError, match=message):
        law_of("talks", **keywords)


def test_a_class_without_a_library_is_a_base(monkeypatch: pytest.MonkeyPatch) -> None:
    class Base(CLaw):
        stiffness: float = gain("", "N/m")

    class Mine(Base, library=C, symbol="talks"):
        """Its gains are those of its base."""

    assert Mine(axes="x", stiffness=1.0).per_device == ("stiffness",)
    with pytest.raises(ParameterError, match=r"Base of test_c_law.py must name its library, as in class Mine\(CLaw,"):
        Base(axes="x", stiffness=1.0)


def test_a_gain_cannot_have_the_name_of_the_hash() -> None:
    with pytest.raises(ParameterError, match="Mine must not have a gain called code"):

        class Mine(CLaw, library=C):
            code: float = gain("")  # type: ignore[assignment]


RIG = """
from maglev_mj import CLaw, Scene, Start, figure, gain, hold, param
from maglev_mj.scenes.wall_scene import others


class Soft(CLaw, library="mine.c", symbol="soft", memory=8):
    stiffness: float = gain("", "N/m")
    damping: float = gain("", "N s/m")
    share: float = gain("", "", default=0.3)


@figure("mm", "deepest position", scale=1e3)
def deepest(result):
    return float(result.line.pose[:, 0].min())


class Rig(Scene):
    shown_axis, figures = "x", (deepest,)
    duration: float = param("", "s", default=0.1, above=0.0, at_most=10.0)
    stiffness: float = param("", "N/m", default=3000.0, live=True)

    def start(self):
        return Start(twist=(-0.05, 0, 0, 0, 0, 0), gravity=0.0)

    def laws(self):
        return [Soft(axes="x", stiffness=self.stiffness, damping=40.0), hold(self, others("x"))]
"""
RIG_LAWS = '        return [Soft(axes="x", stiffness=self.stiffness, damping=40.0), hold(self, others("x"))]'


@pytest.fixture
def rig(tmp_path: Path) -> Path:
    """Return the file of a scene with a law in C, which includes a header."""
    tmp_path.joinpath("mine.c").write_text(f'#include "mine.h"\n{C.read_text()}')
    tmp_path.joinpath("mine.h").write_text("/* for the board */\n")
    tmp_path.joinpath("rig.py").write_text(RIG)
    return tmp_path / "rig.py"


def test_an_error_names_the_line_of_the_scene(rig: Path) -> None:
    rig.with_name("mine.c").write_text("void soft(double x) { x = ; }")
    with pytest.raises(ParameterError, match=r"law Soft: mine.c does not compile: mine.c:1:27: error: ") as caught:
        find_scene(str(rig))().controller()
    assert line_of(caught.value) == f"rig.py, line {1 + RIG.splitlines().index(RIG_LAWS)}"


def test_a_recording_contains_the_files_in_c(
    rig: Path, tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch
) -> None:
    (path,) = write_run(tmp_path_factory.mktemp("elsewhere") / "run.maglev", str(rig), plant="exact")
    recording = Recording.load(path)
    digest = recording.segments[0].setup["controller"]["laws"][0]["code"]
    own = {name: data for name, data in recording.attachments.items() if f"/{digest}/" in name}
    assert own == {f"source/{digest}/{name}": (rig.parent / name).read_bytes() for name in ("mine.c", "mine.h")}
    monkeypatch.chdir(path.parent)
    for name in ("mine.c", "mine.h", "rig.py"):
        rig.with_name(name).unlink()
    path.parent.joinpath("mine.c").write_text("not this one")
    code = UserCode(ATTACHED, recording)
    assert verify(recording, partial(rebuild, own=code)).same and not code.changed


def test_a_recording_names_a_changed_file_in_c(rig: Path, tmp_path: Path) -> None:
    (path,) = write_run(tmp_path / "run.maglev", str(rig), plant="exact")
    assert not UserCode(f"{rig}:Rig", Recording.load(path)).changed
    rig.with_name("mine.h").write_text("/* for another board */\n")
    rig.write_text(RIG)
    os.utime(rig, ns=(0, 0))  # a file is executed again once it has changed
    assert UserCode(f"{rig}:Rig", Recording.load(path)).changed


def test_cells_of_a_sweep_differ_by_the_files_in_c(rig: Path) -> None:
    names = []
    for text in ("", "/* changed */"):
        rig.with_name("mine.h").write_text(text)
        os.utime(rig, ns=(len(text), 0))
        names.append(sweep(str(rig), {"stiffness": [1000.0]}, plant="exact").cells[0]["scene"])
    assert names[0] != names[1]


@pytest.mark.machine
def test_workers_find_the_files_in_c(rig: Path) -> None:
    results = [
        sweep(str(rig), {"stiffness": [1000.0, 2000.0]}, plant="exact", workers=workers).results
        for workers in (None, local_workers(2))
    ]
    assert results[0] == results[1], results[1]
    assert all(result["deepest"] < 0.0 for result in results[0]), results[0]
