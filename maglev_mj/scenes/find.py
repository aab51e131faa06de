"""Scenes by name, by file, or from other packages."""

from __future__ import annotations

import copyreg
import hashlib
import os
import sys
from collections.abc import Mapping
from functools import lru_cache
from importlib.util import decode_source
from pathlib import Path
from traceback import walk_tb
from types import ModuleType
from typing import Any, TypeAlias, TypeVar

from maglev_mj.errors import ParameterError, check_instance, choice_message, one_line
from maglev_mj.keywords import checked
from maglev_mj.lazy import loaded
from maglev_mj.scenes.names import BUILT_IN, installed_scenes, scene_names
from maglev_mj.scenes.scene import Scene
from maglev_mj.versions import TEXT, file_of, hash_of

T = TypeVar("T")

_OWN = "maglev_mj_scene_"

SceneLike: TypeAlias = Scene | type[Scene] | str | Path
"""A scene, its class, or a text or file for `find_scene`."""


@checked(own="text")
def find_scene(text: str) -> type[Scene]:
    """Return the class of a scene.

    Args:
        text: NAME, FILE.py, or FILE.py:CLASS if the file defines several. A file is executed.

    Raises:
        ParameterError: If there is no such scene, or a file cannot be read, fails, or defines several.

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
    raise ParameterError(choice_message("scene", scene_names(), text, ", or a file such as my_scene.py"))


def get_scene(scene: SceneLike) -> Scene:
    """Return a scene from a scene, a class or a text.

    Raises:
        ParameterError: If it is none of these, or there is no such scene.
    """
    cls = find_scene(str(scene)) if isinstance(scene, str | Path) else scene
    result = cls() if isinstance(cls, type) and issubclass(cls, Scene) else cls
    if isinstance(result, type) or not hasattr(result, "plants"):  # a SceneStack is accepted
        raise ParameterError(f"scene must be a Scene, or the name of one such as 'drop' (got {one_line(scene)})")
    return result


def reference_of(cls: type[Scene]) -> str:
    """Return the text by which `find_scene` finds a scene class, also in another process."""
    for name, path in BUILT_IN.items():
        if path == f"{cls.__module__}:{cls.__qualname__}":
            return name
    if cls.__module__.startswith(_OWN):
        return f"{sys.modules[cls.__module__].__file__}:{cls.__name__}"
    return f"{cls.__module__}:{cls.__qualname__}"


def source_of(cls: type[Scene]) -> str | None:
    """Return the hash of a user scene's file; None for a scene of a package."""
    if not cls.__module__.startswith(_OWN):
        return None
    return hash_of(text_of(cls))


def text_of(cls: type[Scene]) -> str:
    """Return the text of a scene's file; of a user's file as it was when executed.

    Raises:
        ParameterError: If the scene is not at the top level of a file, such as one typed interactively.
    """
    file = file_of(cls)
    if file is None:
        raise ParameterError(f"scene {cls.__qualname__} must be at the top level of a file, so that others can run it")
    return file[1]


def hash_of_code(cls: type[Scene]) -> str:
    """Return the hash of a scene's text and of the files of its laws in C.

    Raises:
        ParameterError: See `text_of`, or there is no such file.
    """
    return hash_of("\0".join([text_of(cls), *sorted(hashes_of_laws(cls))]))


def hashes_of_laws(cls: type[Scene]) -> set[str]:
    """Return the hashes of the files of the laws in C in a scene's module.

    Raises:
        ParameterError: If there is no such file.
    """
    from maglev_mj.control.laws.c_law import files_of  # loads ctypes

    return {*files_of(vars(sys.modules[cls.__module__]).values())}


def line_of(error: BaseException) -> str | None:
    """Return the file and line of an error in a user's scene, or None."""
    location = None
    for frame, line in walk_tb(error.__traceback__):
        own = frame.f_globals.get("__name__", "").startswith(_OWN)
        if own and not frame.f_code.co_filename.startswith("<"):  # a constructor made by a dataclass
            location = f"{Path(frame.f_code.co_filename).name}, line {line}"
    return location


def object_of_text(text: str, name: str, file: str) -> Any:
    """Return a class or function from a file's text, executed as a module once per process.

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
    return _executed(_OWN + hash_of(text), text, file)


def defined_in(module: ModuleType, name: str, file: str) -> Any:
    """Return a class or function defined, not imported, in a module.

    Raises:
        ParameterError: If there is no such name.
    """
    value = getattr(module, name, None)
    if getattr(value, "__module__", None) != module.__name__:
        raise ParameterError(f"{file} must define {name}")
    return value


def scene_from_reference(reference: str, values: Mapping[str, Any]) -> Scene:
    """Return a scene from its reference and values."""
    path, _, _ = reference.rpartition(":")
    cls = find_scene(reference) if reference in BUILT_IN or path.endswith(".py") else _in_module(reference)
    return cls.from_json(values)


def _in_module(path: str) -> type[Scene]:
    cls: type[Scene] = loaded(path)
    return cls


def _installed(entry: Any) -> type[Scene]:
    try:
        cls = entry.load()
    except Exception as error:
        raise ParameterError(f"scene {entry.name} of {entry.value} cannot be loaded: {_message(error)}") from error
    if not (isinstance(cls, type) and issubclass(cls, Scene)):
        raise ParameterError(f"scene {entry.name} of {entry.value} must be a subclass of Scene (got {cls!r})")
    return cls


def class_in_file(text: str, base: type[T]) -> type[T]:
    """Return a subclass defined in a file, which is executed.

    Args:
        text: FILE.py, or FILE.py:CLASS if the file defines several.
        base: Its base class, such as `Scene` or `Law`.

    Raises:
        ParameterError: If there is no such class, or the file cannot be read or fails.
    """
    name, _, class_name = text.partition(".py:") if ".py:" in text else (text.removesuffix(".py"), "", "")
    path, kind = Path(f"{name}.py"), base.__name__
    if not path.is_file():
        raise ParameterError(f"{kind.lower()} file {str(path)!r} does not exist")
    classes = _classes_of(_run(path.resolve(), path.stat().st_mtime_ns), base)
    if class_name:
        if class_name not in classes:
            raise ParameterError(choice_message(f"{kind.lower()} of {path.name}", classes or ["none"], class_name))
        return classes[class_name]
    if len(classes) != 1:
        several = f"several ({', '.join(classes)}); choose one as {path.name}:CLASS" if classes else f"no {kind}"
        raise ParameterError(f"{path.name} defines {several}")
    return next(iter(classes.values()))


def _classes_of(module: ModuleType, base: type[T]) -> dict[str, type[T]]:
    """Return the subclasses defined in a module by name."""
    return {
        value.__name__: value
        for value in vars(module).values()
        if isinstance(value, type) and issubclass(value, base) and value.__module__ == module.__name__
    }


def _reduced(scene: Scene) -> Any:
    return scene_from_reference, (reference_of(type(scene)), scene.independent_values())


@lru_cache(maxsize=16)
def _run(path: Path, written: int) -> ModuleType:
    """Execute a file as a module, again after each change."""
    name = _OWN + hashlib.sha256(str(path).encode()).hexdigest()[:8] + "_" + path.stem
    library, before = os.path.dirname(os.__file__), [*sys.path]
    if (folder := str(path.parent)) not in before:  # as with `python FILE`, also for imports by laws and by workers
        # but after the standard library, whose names files there may have
        places = [before.index(one) for one in (library, os.path.join(library, "lib-dynload")) if one in before]
        sys.path.insert(max(places, default=-1) + 1, folder)
    try:
        return _executed(name, path.read_bytes(), str(path))
    except ParameterError:
        sys.path[:] = before
        raise


def _executed(name: str, text: str | bytes, file: str) -> ModuleType:
    """Execute a file's text as a module."""
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
        if before is not None:  # its scenes may still be in use
            sys.modules[name] = before
        raise ParameterError(f"file {Path(file).name} cannot be read: {_message(error)}") from error
    return module


def recorded_scene(name: Any, values: Mapping[str, Any], own: type[Scene] | None = None) -> Scene:
    """Return the scene named by a recording, without executing recorded code.

    Args:
        name: Its name.
        values: Its parameters.
        own: Its class if it is not built in.

    Raises:
        ParameterError: If there is no such scene here, or a value is outside its bounds.
    """
    if isinstance(name, str) and name in BUILT_IN:  # a file may contain anything
        return find_scene(name).from_json(values)
    if own is None:
        raise ParameterError(choice_message("scene", BUILT_IN, name))
    return own.from_json(values)


def _message(error: Exception) -> str:
    return f"{type(error).__name__}: {' '.join(str(error).split())}"
