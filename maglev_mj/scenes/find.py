"""Scenes by name, by file, or of other packages."""

from __future__ import annotations

import ast
import hashlib
import importlib
import sys
from collections.abc import Iterator, Mapping
from functools import lru_cache
from importlib.util import decode_source
from pathlib import Path
from traceback import walk_tb
from types import ModuleType
from typing import Any

from maglev_mj.errors import ParameterError, not_one_of
from maglev_mj.scenes.names import BUILT_IN, installed_scenes, scene_names
from maglev_mj.scenes.scene import Scene
from maglev_mj.versions import TEXT, file_of, hash_of

__all__ = [
    "defined_in",
    "find_scene",
    "hash_of",
    "line_of",
    "made_again",
    "object_of_text",
    "reference_of",
    "scene_of_text",
    "source_of",
    "text_of",
]

_OWN = "maglev_mj_scene_"


def find_scene(text: str) -> type[Scene]:
    """Return the class of a scene.

    Args:
        text: NAME, FILE.py, or FILE.py:CLASS where the file has several. A file is run, as Python would run it.

    Raises:
        ParameterError: If there is none, or a file cannot be read, fails, or has several.
    """
    if text in BUILT_IN:
        return _in_module(BUILT_IN[text])
    path, _, wanted = text.partition(".py:") if ".py:" in text else (text.removesuffix(".py"), "", "")
    if path != text:
        return _of_file(Path(f"{path}.py"), wanted)
    for entry in installed_scenes():
        if entry.name == text:  # loaded when asked for: a broken package breaks its own scene alone
            return _installed(entry)
    raise ParameterError(not_one_of("scene", scene_names(), text, ", or a file such as my_scene.py"))


def reference_of(cls: type[Scene]) -> str:
    """Return the text by which `find_scene` finds a class again, in another process too."""
    for name, place in BUILT_IN.items():
        if place == f"{cls.__module__}:{cls.__qualname__}":
            return name
    if cls.__module__.startswith(_OWN):
        return f"{sys.modules[cls.__module__].__file__}:{cls.__name__}"
    return f"{cls.__module__}:{cls.__qualname__}"


def source_of(cls: type[Scene]) -> str | None:
    """Return a hash of the file of a user's own scene; None for one of a package."""
    if not cls.__module__.startswith(_OWN):
        return None
    return hash_of(text_of(cls))


def text_of(cls: type[Scene]) -> str:
    """Return the text of the file that a scene is in; of a user's own as it was when it was run.

    Raises:
        ParameterError: If it is at the top of no file, as one that was typed in.
    """
    found = file_of(cls)
    if found is None:
        raise ParameterError(f"scene must be at the top of a file, so that others can run it, not {cls.__qualname__}")
    return found[1]


def line_of(error: BaseException) -> str | None:
    """Return file and line of a user's own scene that an error comes from; None for another's."""
    found = None
    for frame, line in walk_tb(error.__traceback__):
        if frame.f_globals.get("__name__", "").startswith(_OWN):
            found = f"{Path(frame.f_code.co_filename).name}, line {line}"
    return found


@lru_cache(maxsize=16)
def scene_of_text(text: str, name: str) -> type[Scene]:
    """Return a class of the text of a file that need not be on this machine; it is run once a process.

    Raises:
        ParameterError: If the text fails.
    """
    found: type[Scene] = getattr(_made(_OWN + hash_of(text), text, f"{name}.py"), name)
    return found


@lru_cache(maxsize=64)
def object_of_text(text: str, name: str, file: str) -> Any:
    """Return a class or function of the text of a file, of which no more is executed than that needs.

    Args:
        text: The text, such as that of a script whose other lines drive a device.
        name: Name at the top of it.
        file: What to call the file in messages.

    Raises:
        ParameterError: If there is none of that name, or the text fails.
    """
    return defined_in(_made(f"{_OWN}{hash_of(text)}_{name}", text, file, name), name, file)


def defined_in(module: ModuleType, name: str, file: str) -> Any:
    """Return a class or function that a module defines itself, not one that it imports.

    Raises:
        ParameterError: If there is none of that name.
    """
    found = getattr(module, name, None)
    if getattr(found, "__module__", None) != module.__name__:
        raise ParameterError(f"{file} must define {name}")
    return found


def made_again(reference: str, values: Mapping[str, Any]) -> Scene:
    """Return a scene of a reference and its values: how one is unpickled."""
    path, _, _ = reference.rpartition(":")
    cls = find_scene(reference) if reference in BUILT_IN or path.endswith(".py") else _in_module(reference)
    return cls.from_json(values)


def _in_module(place: str) -> type[Scene]:
    module, _, name = place.partition(":")
    found: type[Scene] = getattr(importlib.import_module(module), name)
    return found


def _installed(entry: Any) -> type[Scene]:
    try:
        found = entry.load()
    except Exception as error:
        raise ParameterError(f"scene {entry.name} of {entry.value} cannot be loaded: {_said(error)}") from error
    if not (isinstance(found, type) and issubclass(found, Scene)):
        raise ParameterError(f"scene {entry.name} of {entry.value} must be a class of Scene, not {found!r}")
    return found


def _of_file(path: Path, wanted: str) -> type[Scene]:
    if not path.is_file():
        raise ParameterError(f"scene must be a file that is there, not {str(path)!r}")
    module = _run(path.resolve(), path.stat().st_mtime_ns)
    found = {
        value.__name__: value
        for value in vars(module).values()
        if isinstance(value, type) and issubclass(value, Scene) and value.__module__ == module.__name__
    }
    if wanted:
        if wanted not in found:
            raise ParameterError(not_one_of(f"scene of {path.name}", found or ["none"], wanted))
        return found[wanted]
    if len(found) != 1:
        several = f"has {', '.join(found)}: name one as {path.name}:CLASS" if found else "has no class of Scene"
        raise ParameterError(f"scene must be one of its file, but {path.name} {several}")
    return next(iter(found.values()))


@lru_cache(maxsize=16)
def _run(path: Path, written: int) -> ModuleType:
    """Run a file as a module, anew where it was written since."""
    name = _OWN + hashlib.sha256(str(path).encode()).hexdigest()[:8] + "_" + path.stem
    sys.path.insert(0, str(path.parent))  # as `python FILE` has it, so that it finds its neighbours
    try:
        return _made(name, path.read_bytes(), str(path))
    finally:
        sys.path.remove(str(path.parent))


def _made(name: str, text: str | bytes, file: str, only: str = "") -> ModuleType:
    """Run the text of a file as a module of some name; only what one of its names needs, where that is told."""
    module = ModuleType(name)
    module.__file__ = file
    sys.modules[name] = module
    try:
        text = text if isinstance(text, str) else decode_source(text)
        setattr(module, TEXT, text)
        tree = ast.parse(text, file)
        tree.body = list(_needed(tree, only)) if only else tree.body
        exec(compile(tree, file, "exec"), module.__dict__)
    except Exception as error:
        del sys.modules[name]
        raise ParameterError(f"scene {Path(file).name} cannot be read: {_said(error)}") from error
    return module


def _needed(tree: ast.Module, name: str) -> Iterator[ast.stmt]:
    """Yield the statements that a name at the top needs, and those that say how to read the others."""
    binds = [_bound(statement) for statement in tree.body]
    wanted, kept = {"*", name}, set[int]()
    while more := {place for place, names in enumerate(binds) if names & wanted} - kept:
        kept |= more
        used = [node for place in more for node in ast.walk(tree.body[place])]
        wanted |= {node.id for node in used if isinstance(node, ast.Name)}
    yield from (tree.body[place] for place in sorted(kept))


def _bound(statement: ast.stmt) -> set[str]:
    """Return the names that a statement gives a value; * for one that may give any."""
    if isinstance(statement, ast.FunctionDef | ast.ClassDef):
        return {statement.name}
    if isinstance(statement, ast.ImportFrom) and statement.module == "__future__":
        return {"*"}
    nodes = list(ast.walk(statement))
    stored = {node.id for node in nodes if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store)}
    named = {node.name for node in nodes if isinstance(node, ast.FunctionDef | ast.ClassDef)}
    aliases = [alias for node in nodes if isinstance(node, ast.Import | ast.ImportFrom) for alias in node.names]
    return stored | named | {alias.asname or alias.name.partition(".")[0] for alias in aliases}


def _said(error: Exception) -> str:
    return f"{type(error).__name__}: {' '.join(str(error).split())}"
