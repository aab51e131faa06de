"""Imports point down, leaves do not import one another, and heavy packages stay in their rooms."""

import ast
from pathlib import Path

import maglev_mj

PACKAGE = Path(maglev_mj.__file__).parent

# floor of each module; a module may import only from floors below its own, or its own package
FLOORS = {
    "errors": 0,
    "frames": 0,
    "spec": 0,
    "versions": 0,
    "terminal": 0,
    "colours": 0,
    "parameters": 1,
    "workers": 1,
    "timeline": 1.5,
    "process": 1.5,
    "laws": 2,
    "net": 2,
    "coils": 2,
    "sensing": 2,
    "hand": 2,
    "trace": 2,
    "controller": 3,
    "model": 3,
    "plants": 4,
    "shapes": 4,
    "loop": 5,
    "theory": 5,
    "energy": 5,
    "metrics": 5,
    "recording": 6,
    "scenes": 6,
    "session": 7,
    "display": 7.5,
    "tour": 8,
    "bridge": 8,
    "live": 8,
    "report": 8,
    "spacenav": 8,
    "studies": 8,
    "analysis": 8,
    "viewer": 8,
    "web": 8,
    "hand_devices": 8.5,
    "plots": 9,
    "replay": 9,
    "tables": 9,
    "conformance": 9,
    "playback": 9.5,
    "cli": 10,
    "__main__": 11,
}
ALLOWED = {
    "mujoco": {"model", "plants", "shapes", "versions", "viewer"},
    "glfw": {"hand_devices", "viewer"},
    "viser": {"web"},
    "trimesh": {"web"},
    "websockets": {"web"},
    "matplotlib": {"plots"},
    "imageio": {"viewer"},
    "distributed": {"workers"},
    "serial": {"net"},
    "argcomplete": {"cli"},
    "mcap": {"recording"},
    "foxglove": {"live", "recording"},
    "pyarrow": {"recording"},
    "control": {"theory"},
}


def imports() -> list[tuple[str, str, str]]:
    """Return (room, file, imported module) for every import, those inside functions too."""
    found = []
    for path in PACKAGE.rglob("*.py"):
        parts = path.relative_to(PACKAGE).with_suffix("").parts
        room = parts[0]
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Import):
                found += [(room, path.name, alias.name) for alias in node.names]
            elif isinstance(node, ast.ImportFrom):
                assert node.level == 0, f"{path.name} imports relatively"
                module = node.module or ""
                if module == "maglev_mj":
                    found += [(room, path.name, f"maglev_mj.{alias.name}") for alias in node.names]
                else:
                    found.append((room, path.name, module))
    return found


def test_every_module_has_a_floor() -> None:
    rooms = {path.relative_to(PACKAGE).with_suffix("").parts[0] for path in PACKAGE.rglob("*.py")}
    assert rooms - {"__init__", "model"} == set(FLOORS) - {"model"}


def test_imports_point_down() -> None:
    wrong = []
    for room, file, module in imports():
        target = module.split(".")[1] if module.startswith("maglev_mj.") else None
        if room == "__init__" or target is None or target == room:
            continue
        # on the ground floor, errors name frames for the type checker only
        if FLOORS[target] > FLOORS[room] or (FLOORS[target] == FLOORS[room] and FLOORS[room] > 0):
            wrong.append(f"{room} ({file}) imports {module}")
    assert not wrong


def test_heavy_packages_stay_in_their_rooms() -> None:
    wrong = [
        f"{room} ({file}) imports {module}"
        for room, file, module in imports()
        for package, rooms in ALLOWED.items()
        if module.split(".")[0] == package and room not in rooms
    ]
    assert not wrong


def test_no_module_outgrows_its_room() -> None:
    long = {path.name: count for path in PACKAGE.rglob("*.py") if (count := len(path.read_text().splitlines())) > 500}
    assert not long
