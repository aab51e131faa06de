"""Names of packages, loaded on first use."""

from __future__ import annotations

import os
from importlib import import_module
from types import ModuleType

TYPE_CHECKING = False  # as in typing, whose import would take longer than all else before a program's first line
if TYPE_CHECKING:
    from collections.abc import Callable
    from typing import Any


class _LazyModule(ModuleType):
    """Module that is imported at its first use."""

    def __getattr__(self, name: str) -> Any:
        from maglev_mj.process import interrupts_held

        with interrupts_held():  # its libraries start a program
            value = getattr(_engine(self.__name__), name)
        setattr(self, name, value)  # found at once from then on
        return value


def _engine(name: str) -> ModuleType:
    try:
        return import_module(name)
    except (AttributeError, OSError):  # what MUJOCO_GL names cannot be loaded: that is said where something is drawn
        chosen = os.environ.get("MUJOCO_GL", "")
        os.environ["MUJOCO_GL"] = "off"
        try:
            return import_module(name)
        finally:
            os.environ["MUJOCO_GL"] = chosen


if TYPE_CHECKING:
    import mujoco as mujoco
else:
    mujoco = _LazyModule("mujoco")  # recordings are read, and devices called, without it


def has_engine() -> bool:
    """Return True if MuJoCo is installed: exact plants, laws and theory need none."""
    from importlib.util import find_spec  # half as long to load as the package's face

    return find_spec("mujoco") is not None


def loaded(place: str) -> Any:
    """Return what a text "module:name" names, imported now."""
    module, _, name = place.partition(":")
    return getattr(import_module(module), name)


def attach(package: str, file: str) -> tuple[Callable[[str], Any], Callable[[], list[str]], list[str]]:
    """Return `__getattr__`, `__dir__` and `__all__` of a package.

    Its names and their modules stand in the stub beside the file, one a line: `from MODULE import NAME as NAME`. A name
    must not be that of a module of the package: once loaded, the module would replace it.

    Args:
        package: Its name.
        file: Its `__file__`.
    """
    with open(f"{file}i", encoding="utf-8") as stub:
        home = {words[3]: words[1] for words in map(str.split, stub) if words[:1] == ["from"]}

    def load(name: str) -> Any:
        if name not in home:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        return getattr(import_module(home[name]), name)

    return load, lambda: sorted(home), sorted(home)
