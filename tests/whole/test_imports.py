"""Imports point down, and heavy packages stay in place.

Leaves do not import one another.
"""

from __future__ import annotations

import ast
import inspect
import pkgutil
import pydoc
import re
import subprocess
import sys
from collections.abc import Sequence
from functools import cache
from importlib import import_module
from pathlib import Path

import pytest

import maglev_mj

PACKAGE = Path(maglev_mj.__file__).parent

together = pytest.mark.xdist_group("imports")  # so that each file is parsed once

# floor of each room and loose module; a module imports only from floors below its own, and from its own room
FLOORS = {
    **dict.fromkeys(
        "errors files frames keywords spec versions lazy process colours pictures result terminal".split(), 0
    ),
    **dict.fromkeys(("parameters", "scale"), 1),
    **dict.fromkeys(("control", "device"), 2),
    "plants": 3,
    "theory": 4,
    "scenes": 5,
    "recording": 6,
    "session": 7,
    **dict.fromkeys(("analysis", "studies", "bridge", "interop", "views"), 8),
    "cli": 9,
}
ALLOWED = {
    "mujoco": {"lazy", "plants", "views"},
    "glfw": {"interop", "views"},
    "viser": {"views"},
    "trimesh": {"views"},
    "websockets": {"bridge", "views"},
    "matplotlib": {"pictures", "studies"},  # their pictures.py alone
    "imageio": {"views"},
    "distributed": {"studies"},
    "serial": {"bridge"},
    "argcomplete": {"cli"},
    "mcap": {"recording"},
    "foxglove": {"recording"},
    "gymnasium": {"interop"},
    "pandas": {"result"},
    "pyarrow": {"recording", "studies"},
    "control": {"theory"},
}


@cache
def tree_of(path: Path) -> ast.Module:
    return ast.parse(path.read_text(encoding="utf-8"))


_BLOCKS = ast.stmt, ast.ExceptHandler, ast.match_case


@cache
def nodes_of(path: Path) -> list[ast.Import | ast.ImportFrom]:
    """Return the imports of a file; imports are statements, so that no expression is searched."""
    found, blocks = list[ast.Import | ast.ImportFrom](), list[ast.AST]([tree_of(path)])
    for block in blocks:
        if isinstance(block, ast.Import | ast.ImportFrom):
            found.append(block)
        else:
            blocks += (one for one in ast.iter_child_nodes(block) if isinstance(one, _BLOCKS))
    return found


@pytest.fixture(scope="module", autouse=True)
def parsed() -> None:
    """Parse the package once, for all tests."""
    for path in PACKAGE.rglob("*.py"):
        nodes_of(path)


def imports() -> list[tuple[str, str, str]]:
    """Return package, file and module of every import.

    Those inside functions too.
    """
    found = []
    for path in PACKAGE.rglob("*.py"):
        parts = path.relative_to(PACKAGE).with_suffix("").parts
        room = parts[0]
        for node in nodes_of(path):
            if isinstance(node, ast.Import):
                found += [(room, path.name, alias.name) for alias in node.names]
            else:
                assert node.level == 0, f"{path.name} imports relatively"
                module = node.module or ""
                if module == "maglev_mj":
                    found += [(room, path.name, f"maglev_mj.{alias.name}") for alias in node.names]
                else:
                    found.append((room, path.name, module))
    return found


def test_every_module_has_a_floor() -> None:
    rooms = {path.relative_to(PACKAGE).with_suffix("").parts[0] for path in PACKAGE.rglob("*.py")}
    assert rooms - {"__init__", "__main__"} == set(FLOORS)


@together
def test_imports_point_down() -> None:
    wrong = []
    for room, file, module in imports():
        target = module.split(".")[1] if module.startswith("maglev_mj.") else None
        if room in ("__init__", "__main__") or target is None or target == room:
            continue
        # on the ground floor, errors name frames for the type checker only
        if FLOORS[target] > FLOORS[room] or (FLOORS[target] == FLOORS[room] and FLOORS[room] > 0):
            wrong.append(f"{room} ({file}) imports {module}")
    assert not wrong


def modules() -> dict[str, Path]:
    """Return the file of each module of the package by its name."""
    paths = {path.relative_to(PACKAGE.parent).with_suffix("").parts: path for path in PACKAGE.rglob("*.py")}
    return {".".join(parts[:-1] if parts[-1] == "__init__" else parts): path for parts, path in paths.items()}


def circles(graph: dict[str, set[str]]) -> set[str]:
    """Return the modules that a chain of imports leads from, back to themselves."""
    reached = {one: set(targets) for one, targets in graph.items()}
    for middle in graph:
        for one in graph:
            if middle in reached[one]:
                reached[one] |= reached[middle]
    return {one for one in graph if one in reached[one]}


PICTURES = {name for name in modules() if name.endswith(".pictures") and name != "maglev_mj.pictures"}


@together
def test_pictures_are_imported_where_one_is_drawn() -> None:
    """A result's `plot` imports the pictures that import the result, so that pictures alone may do so at their top."""
    early = {
        name: node.module
        for name, path in modules().items()
        if name not in PICTURES
        for node in tree_of(path).body
        if isinstance(node, ast.ImportFrom) and node.module in PICTURES
    }
    assert PICTURES and not early


def exports(package: Path) -> dict[str, str]:
    """Return the module of each name that a package gives, by its stub."""
    stub = package.with_suffix(".pyi")
    lines = ast.parse(stub.read_text(encoding="utf-8")).body if package.stem == "__init__" and stub.exists() else []
    return {one.name: node.module or "" for node in lines if isinstance(node, ast.ImportFrom) for one in node.names}


@cache
def graph() -> dict[str, set[str]]:
    """Return the modules of the package that each one imports, anywhere in it; a package's name is in its module."""
    named, targets = modules(), {}
    homes = {name: exports(path) for name, path in named.items()}
    for name, path in named.items():
        nodes = nodes_of(path)
        froms = [
            (node.module or "", one.name) for node in nodes if isinstance(node, ast.ImportFrom) for one in node.names
        ]
        plain = {one.name for node in nodes if isinstance(node, ast.Import) for one in node.names}
        parts = {
            f"{module}.{one}" if f"{module}.{one}" in named else homes.get(module, {}).get(one, module)
            for module, one in froms
        }
        targets[name] = (parts | plain) & named.keys() - {"maglev_mj"}
    return targets


@together
def test_no_imports_go_in_a_circle() -> None:
    """Not within a package either, and not by an import in a function."""
    assert not circles(graph())
    assert graph()["maglev_mj.scenes.scene"] > {"maglev_mj.scenes.results", "maglev_mj.plants.exact"}
    assert circles({"a": {"b"}, "b": {"c"}, "c": {"a"}, "d": {"a"}}) == {"a", "b", "c"}


def reached(start: str) -> set[str]:
    """Return the packages that the modules of a package lead to, by imports of imports too."""
    seen, open_ends = set[str](), {name for name in graph() if name.split(".")[1:2] == [start]}
    assert open_ends, start
    while open_ends:
        seen |= open_ends
        open_ends = set().union(*(graph()[name] for name in open_ends)) - seen
    return {name.split(".")[1] for name in seen}


@together
@pytest.mark.parametrize("other", ["studies", "analysis", "views", "interop"])
def test_what_flies_a_device_and_what_studies_it_are_independent(other: str) -> None:
    assert other not in reached("bridge") and "bridge" not in reached(other)
    assert {other, "bridge"} <= reached("cli")  # the search finds what there is


READING = PACKAGE.parent / "docs/explanation/architecture.md"


@together
def test_modules_in_reading_order_need_those_before_them() -> None:
    rows = re.findall(r"^\| \d+ \| `(maglev_mj/[\w/]+)\.py`", READING.read_text(encoding="utf-8"), re.MULTILINE)
    order = [row.replace("/", ".") for row in rows]
    late = [(one, need) for at, one in enumerate(order) for need in graph()[one] & {*order[at + 1 :]}]
    assert len(order) > 15 and not late


@together
def test_heavy_packages_stay_in_their_rooms() -> None:
    wrong = [
        f"{room} ({file}) imports {module}"
        for room, file, module in imports()
        for package, rooms in ALLOWED.items()
        if module.split(".")[0] == package
        and (room not in rooms or (package == "matplotlib" and file != "pictures.py"))
    ]
    assert not wrong


def test_no_module_outgrows_its_room() -> None:
    """At most 1200 lines: a module is as long as its one idea needs; a limit of 700 split single ideas."""
    long = {path.name: count for path in PACKAGE.rglob("*.py") if (count := len(path.read_text().splitlines())) > 1200}
    assert not long


FACES = [".".join(path.relative_to(PACKAGE.parent).parent.parts) for path in PACKAGE.rglob("__init__.pyi")]


@pytest.mark.parametrize("package", FACES)
def test_a_name_that_is_loaded_late_is_the_one_that_is_typed(package: str) -> None:
    face = import_module(package)
    nodes = ast.parse(Path(f"{face.__file__}i").read_text(encoding="utf-8")).body
    lines = [node for node in nodes if isinstance(node, ast.ImportFrom)]
    typed = {str(line.names[0].asname): f"{line.module}" for line in lines}
    assert all(len(line.names) == 1 for line in lines) and len(typed) == len(lines)
    assert sorted(typed) == dir(face) == face.__all__
    for module in pkgutil.iter_modules(face.__path__):  # a module that is loaded would take the name's place
        import_module(f"{package}.{module.name}") if module.name in typed else None
    for name, home in typed.items():
        assert inspect.unwrap(getattr(face, name)) is inspect.unwrap(getattr(import_module(home), name))
    with pytest.raises(AttributeError, match="has no attribute 'nothing'"):
        getattr(face, "nothing")  # noqa: B009


def test_the_help_of_the_package_is_its_table_of_contents() -> None:
    rows = re.findall(r"^    (\w+) +\S", maglev_mj.__doc__ or "", re.MULTILINE)
    assert sorted(rows) == sorted(dir(maglev_mj))
    page = pydoc.plain(pydoc.render_doc(maglev_mj))
    assert page.index(rows[-1]) < page.index("PACKAGE CONTENTS")  # before the page of each class


LIGHT = "numpy", "mujoco", "importlib.metadata"
OTHERS = "asyncio", "multiprocessing", "matplotlib", "mujoco.batch", "numpy.polynomial"
UNUSED = [f"maglev_mj.{name}" for name in "recording session studies bridge analysis".split()]
STEPS: list[tuple[str, Sequence[str]]] = [
    ("import maglev_mj", [*LIGHT, "maglev_mj.errors"]),
    ("from maglev_mj.cli import main; main(['--version'])", LIGHT),
    ("main(['drop'])", [*OTHERS, *UNUSED, "maglev_mj.theory.design", "maglev_mj.control.laws.friction"]),
]
ENGINELESS: list[tuple[str, Sequence[str]]] = [
    ("from maglev_mj import Controller, Recording, RemotePlant, Scene, sweep", ("mujoco", "glfw")),
    ("from maglev_mj.cli import main; main('estop udp://127.0.0.1:9'.split())", ("mujoco", "glfw")),
]


@pytest.mark.parametrize("steps", [STEPS, pytest.param(ENGINELESS, marks=pytest.mark.machine)], ids=["start", "engine"])
def test_each_step_loads_what_it_needs(steps: list[tuple[str, Sequence[str]]]) -> None:
    # One program, step by step: what an earlier one has loaded stays.
    ask = "import contextlib, sys\n"
    for step, _ in steps:
        ask += f"with contextlib.suppress(SystemExit):\n    {step}\nprint('LOADED', *sys.modules)\n"
    done = subprocess.run([sys.executable, "-c", ask], capture_output=True, text=True, check=True)
    found = [set(line.split()) for line in done.stdout.splitlines() if line.startswith("LOADED")]
    for (step, absent), loaded in zip(steps, found, strict=True):
        assert sorted(loaded.intersection(absent)) == [], step
