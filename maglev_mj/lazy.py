"""Lazy import of names and of MuJoCo."""

from __future__ import annotations

import os
import sys
from importlib import import_module
from types import ModuleType

TYPE_CHECKING = False  # importing typing would dominate the start-up time
if TYPE_CHECKING:
    from collections.abc import Callable
    from typing import Any, TypeVar

    _T = TypeVar("_T")


class _LazyModule(ModuleType):
    """Module imported on first attribute access."""

    def __getattr__(self, name: str) -> Any:
        from maglev_mj.process import interrupts_held

        with interrupts_held():  # its libraries start a subprocess
            engine = _engine(self.__name__)
        if _profiler_stopped:
            _clear_timer(engine)
        value = getattr(engine, name)
        setattr(self, name, value)  # cache: bypasses __getattr__
        return value


def _engine(name: str) -> ModuleType:
    try:
        return import_module(name)
    except (AttributeError, OSError):  # the MUJOCO_GL backend cannot be loaded; rendering reports that
        backend = os.environ.get("MUJOCO_GL", "")
        os.environ["MUJOCO_GL"] = "off"
        try:
            return import_module(name)
        finally:
            os.environ["MUJOCO_GL"] = backend


if TYPE_CHECKING:
    import mujoco as mujoco
else:
    mujoco = _LazyModule("mujoco")  # recordings and devices work without it


_profiler_stopped = False


def stop_profiler() -> None:
    """Stop MuJoCo's profiler in this process, for a program that does not read `MjData.timer`.

    MuJoCo's Python bindings install a clock, `mjcb_time`, that is read at every stage of a step: half the time of a
    step of one body. Results are the same to the last bit; `MjData.timer` stays 0. A timer that a program sets by
    `mujoco.set_mjcb_time`, before or after, is used. The clock is global to the process, so a program may call this
    (as the commands do) and a library should not; call it before threads step models. MuJoCo is not imported: if it is
    not loaded yet, its profiler is stopped when this package loads it. Where the symbol cannot be found, as on
    Windows, nothing happens.
    """
    global _profiler_stopped
    _profiler_stopped = True
    if "mujoco" in sys.modules:
        _clear_timer(sys.modules["mujoco"])


def _clear_timer(engine: Any) -> None:
    """Set the engine's `mjcb_time` to NULL, its default in C, unless a program has set its own."""
    if engine.get_mjcb_time() is not None:
        return
    try:
        import ctypes

        # the bindings offer no way: set_mjcb_time(None) brings their own clock back
        ctypes.c_void_p.in_dll(ctypes.CDLL(engine._functions.__file__), "mjcb_time").value = None
    except (AttributeError, ImportError, OSError, ValueError):  # no such symbol here: everything stays as it is
        return


def has_engine() -> bool:
    """Return True if MuJoCo is installed; exact plants, laws and theory do not need it."""
    from importlib.util import find_spec  # imported here: slow

    return find_spec("mujoco") is not None


def loaded(reference: str) -> Any:
    """Import and return the object "module:name"."""
    module, _, name = reference.partition(":")
    return getattr(import_module(module), name)


def public(package: ModuleType, kind: type[_T]) -> tuple[type[_T], ...]:
    """Return the public classes of a package that derive from one, without bases of others, in order of definition."""
    parts = [part for name in package.__all__ if isinstance(part := getattr(package, name), type)]
    parts = [part for part in parts if kind in part.__mro__[1:]]
    bases = {base for part in parts for base in part.__mro__[1:]}
    order = {part: [*vars(sys.modules[part.__module__])].index(part.__name__) for part in parts}
    return tuple(sorted(order.keys() - bases, key=lambda part: (part.__module__, order[part])))


def by_name(package: ModuleType, kind: type[_T]) -> dict[str, type[_T]]:
    """Return the classes of `public` by their own attribute `called`, without those whose name is "".

    Raises:
        TypeError: If a class does not state its name, or two have the same.
    """
    names: dict[str, type[_T]] = {}
    for part in public(package, kind):
        name = vars(part).get("called")
        if name is None:
            raise TypeError(f"{part.__name__} must state its name: called = ...")
        if name in names:
            raise TypeError(f"{part.__name__} and {names[name].__name__} are both called {name!r}")
        if name:
            names[name] = part
    return names


def attach(package: str, file: str) -> tuple[Callable[[str], Any], Callable[[], list[str]], list[str]]:
    """Return `__getattr__`, `__dir__` and `__all__` of a package with lazy imports.

    Names are listed in the stub next to the file, one per line: `from MODULE import NAME as NAME`. A name must not
    equal a module of the package, which would replace it once imported.

    Args:
        package: `__name__` of the package.
        file: `__file__` of the package.
    """
    with open(f"{file}i", encoding="utf-8") as stub:
        home = {words[3]: words[1] for words in map(str.split, stub) if words[:1] == ["from"]}

    cache: dict[str, Any] = {}

    def load(name: str) -> Any:
        if name not in home:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        if name not in cache:
            cache[name] = getattr(import_module(home[name]), name)
        return cache[name]

    return load, lambda: sorted(home), sorted(home)
