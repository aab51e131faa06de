"""Scenes by name, by file, or from other packages."""

from __future__ import annotations

import copyreg
import hashlib
import sys
from collections.abc import Mapping
from functools import lru_cache
from importlib.util import decode_source
from pathlib import Path
from traceback import walk_tb
from types import ModuleType
from typing import Any, TypeAlias, TypeVar

from maglev_mj.errors import ParameterError, check_instance, not_one_of, one_line
from maglev_mj.lazy import loaded
from maglev_mj.scenes.names import BUILT_IN, installed_scenes, scene_names
from maglev_mj.scenes.scene import Scene
from maglev_mj.versions import TEXT, file_of, hash_of

T = TypeVar("T")

_OWN = "maglev_mj_scene_"

SceneLike: TypeAlias = Scene | type[Scene] | str | Path
"""A scene, its class, or a text or file for `find_scene`."""


def find_scene(text: str) -> type[Scene]:
    """Return the class of a scene.

    Args:
        text: NAME, FILE.py, or FILE.py:CLASS if the file has several. A file is run, as Python would run it.

    Raises:
        ParameterError: If there is no such scene, or a file cannot be read, fails, or has several.

    Example:
        >>> from maglev_mj import find_scene
        >>> find_scene("drop")(height=0.002).height
        0.002
    """
    check_instance("scene", text, str, "a name, FILE.py or FILE.py:CLASS")
    if text in BUILT_IN:
        return _in_module(BUILT_IN[text])
    if text.endswith(".py") or ".py:" in text:
        return class_in_file(text, Scene)
    for entry in installed_scenes():
        if entry.name == text:  # loaded on demand: a broken package breaks only its own scene
            return _installed(entry)
    raise ParameterError(not_one_of("scene", scene_names(), text, ", or a file such as my_scene.py"))


def get_scene(scene: SceneLike) -> Scene:
    """Return a scene, also from its class or text.

    Raises:
        ParameterError: If it is none of these, or there is no such scene.
    """
    found = find_scene(str(scene)) if isinstance(scene, str | Path) else scene
    made = found() if isinstance(found, type) and issubclass(found, Scene) else found
    if isinstance(made, type) or not hasattr(made, "plants"):  # a stack of scenes is as good as one
        raise ParameterError(f"scene must be a Scene, or the name of one such as 'drop', not {one_line(scene)}")
    return made


def reference_of(cls: type[Scene]) -> str:
    """Return the reference text of a scene class.

    `find_scene` finds the class by it again, in another process too.
    """
    for name, place in BUILT_IN.items():
        if place == f"{cls.__module__}:{cls.__qualname__}":
            return name
    if cls.__module__.startswith(_OWN):
        return f"{sys.modules[cls.__module__].__file__}:{cls.__name__}"
    return f"{cls.__module__}:{cls.__qualname__}"


def source_of(cls: type[Scene]) -> str | None:
    """Return the hash of a user scene's file, or None.

    None is for a scene of a package.
    """
    if not cls.__module__.startswith(_OWN):
        return None
    return hash_of(text_of(cls))


def text_of(cls: type[Scene]) -> str:
    """Return the text of a scene's file.

    That of a user's own scene is as it was when it was run.

    Raises:
        ParameterError: If the scene is not at the top level of a file, as one typed interactively.
    """
    found = file_of(cls)
    if found is None:
        raise ParameterError(f"scene must be at the top of a file, so that others can run it, not {cls.__qualname__}")
    return found[1]


def line_of(error: BaseException) -> str | None:
    """Return an error's file and line in user code.

    None if the error is not from a user's own scene.
    """
    found = None
    for frame, line in walk_tb(error.__traceback__):
        if frame.f_globals.get("__name__", "").startswith(_OWN):
            found = f"{Path(frame.f_code.co_filename).name}, line {line}"
    return found


def scene_of_text(text: str, name: str) -> type[Scene]:
    """Return a scene class from a file's text, which need not be on this machine.

    Raises:
        ParameterError: If the text fails.
    """
    found: type[Scene] = object_of_text(text, name, f"{name}.py")
    return found


def object_of_text(text: str, name: str, file: str) -> Any:
    """Return a class or function from a file's text.

    The text is run as a module, once per process.

    Args:
        text: The text.
        name: Name at its top level.
        file: Name of the file in messages.

    Raises:
        ParameterError: If there is no such name, or the text fails.
    """
    return defined_in(_module_of_text(text, file), name, file)


@lru_cache(maxsize=16)
def _module_of_text(text: str, file: str) -> ModuleType:
    return _made(_OWN + hash_of(text), text, file)


def defined_in(module: ModuleType, name: str, file: str) -> Any:
    """Return a class or function defined in a module.

    An imported one does not count.

    Raises:
        ParameterError: If there is no such name.
    """
    found = getattr(module, name, None)
    if getattr(found, "__module__", None) != module.__name__:
        raise ParameterError(f"{file} must define {name}")
    return found


def scene_again(reference: str, values: Mapping[str, Any]) -> Scene:
    """Return a scene from its reference and values."""
    path, _, _ = reference.rpartition(":")
    cls = find_scene(reference) if reference in BUILT_IN or path.endswith(".py") else _in_module(reference)
    return cls.from_json(values)


def _in_module(place: str) -> type[Scene]:
    found: type[Scene] = loaded(place)
    return found


def _installed(entry: Any) -> type[Scene]:
    try:
        found = entry.load()
    except Exception as error:
        raise ParameterError(f"scene {entry.name} of {entry.value} cannot be loaded: {_said(error)}") from error
    if not (isinstance(found, type) and issubclass(found, Scene)):
        raise ParameterError(f"scene {entry.name} of {entry.value} must be a class of Scene, not {found!r}")
    return found


def class_in_file(text: str, base: type[T]) -> type[T]:
    """Return the class of a kind in a file.

    The file is run, as Python would run it.

    Args:
        text: FILE.py, or FILE.py:CLASS if the file has several.
        base: Its base class, such as `Scene` or `Law`.

    Raises:
        ParameterError: If there is no such class, or the file cannot be read or fails.
    """
    name, _, wanted = text.partition(".py:") if ".py:" in text else (text.removesuffix(".py"), "", "")
    path, kind = Path(f"{name}.py"), base.__name__
    if not path.is_file():
        raise ParameterError(f"{kind.lower()} must be a file that is there, not {str(path)!r}")
    found = _classes_of(_run(path.resolve(), path.stat().st_mtime_ns), base)
    if wanted:
        if wanted not in found:
            raise ParameterError(not_one_of(f"{kind.lower()} of {path.name}", found or ["none"], wanted))
        return found[wanted]
    if len(found) != 1:
        several = f"has {', '.join(found)}: name one as {path.name}:CLASS" if found else f"has no class of {kind}"
        raise ParameterError(f"{kind.lower()} must be one of its file, but {path.name} {several}")
    return next(iter(found.values()))


def _classes_of(module: ModuleType, base: type[T]) -> dict[str, type[T]]:
    """Return the classes of a kind that a module defines, by name."""
    return {
        value.__name__: value
        for value in vars(module).values()
        if isinstance(value, type) and issubclass(value, base) and value.__module__ == module.__name__
    }


def _reduced(scene: Scene) -> Any:
    return scene_again, (reference_of(type(scene)), scene.independent_values())


@lru_cache(maxsize=16)
def _run(path: Path, written: int) -> ModuleType:
    """Run a file as a module, again after each change."""
    name = _OWN + hashlib.sha256(str(path).encode()).hexdigest()[:8] + "_" + path.stem
    sys.path.insert(0, str(path.parent))  # as with `python FILE`, for imports of files beside it
    try:
        return _made(name, path.read_bytes(), str(path))
    finally:
        sys.path.remove(str(path.parent))


def _made(name: str, text: str | bytes, file: str) -> ModuleType:
    """Run a file's text as a module."""
    module, before = ModuleType(name), sys.modules.get(name)
    module.__file__ = file
    sys.modules[name] = module
    try:
        text = text if isinstance(text, str) else decode_source(text)
        setattr(module, TEXT, text)
        exec(compile(text, file, "exec"), module.__dict__)
        for cls in _classes_of(module, Scene).values():
            copyreg.pickle(cls, _reduced)  # no other process has this module
    except Exception as error:
        del sys.modules[name]
        if before is not None:  # whose scenes go on
            sys.modules[name] = before
        raise ParameterError(f"file {Path(file).name} cannot be read: {_said(error)}") from error
    return module


def recorded_scene(name: Any, values: Mapping[str, Any], own: type[Scene] | None = None) -> Scene:
    """Return the scene named by a recording; code of others is never run.

    Args:
        name: Its name.
        values: Its parameters.
        own: Its class if it is not of this package.

    Raises:
        ParameterError: If there is no such scene here, or a value is outside its bounds.
    """
    if isinstance(name, str) and name in BUILT_IN:  # of a file it may be anything
        return find_scene(name).from_json(values)
    if own is None:
        raise ParameterError(not_one_of("scene", BUILT_IN, name))
    return own.from_json(values)


def _said(error: Exception) -> str:
    return f"{type(error).__name__}: {' '.join(str(error).split())}"
