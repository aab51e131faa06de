"""Control laws in C: the function that the firmware runs, as an `AxisLaw`."""

from __future__ import annotations

import ctypes
import hashlib
import json
import math
import os
import re
import shutil
import signal
import sys
import threading
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import field
from functools import cache
from itertools import repeat
from pathlib import Path
from typing import Any, ClassVar, NamedTuple, Self

import numpy as np

from maglev_mj.control.laws import probe
from maglev_mj.control.laws.base import AxisLaw
from maglev_mj.errors import MaglevError, ParameterError, named
from maglev_mj.files import temporary_folder
from maglev_mj.frames import Array, Component
from maglev_mj.keywords import checked, every_tick
from maglev_mj.parameters import store

COMPILERS = "cc", "gcc", "clang"
"""Compilers in the order in which they are looked for."""
FLAGS = "-std=gnu11", "-O2", "-ffp-contract=off", "-fPIC", "-shared"
"""Flags of a build: with -ffp-contract=off no multiply-add is fused, so that the board's bits are those here."""

_PROBE_TIME, _PROBE_TIMEOUT = 5.0, 60.0
"""Processor time of a probe, and time in which it must end [s]: 100 times what a law of 10 µs needs."""
_MOST_ROWS = 50
"""Rows of gains that are probed, of a law for many devices; effort alone."""
_MOST_MEMORY = 1 << 20
"""Largest memory of a law on one axis [bytes]."""
_DOUBLE = ctypes.sizeof(ctypes.c_double)


class _Source(NamedTuple):
    """Function of a library, as declared by a class.

    Attributes:
        label: Name of the law in messages.
        folder: Folder of the file that defines the class.
        library: Path of the library, or of the C file.
        symbol: Name of the function.
        memory: Size of its memory [bytes].
    """

    label: str
    folder: Path
    library: str
    symbol: str
    memory: int

    @property
    def path(self) -> Path:
        """Path of the library: beside the file of the class, or on the path of imports, as a worker finds it.

        Raises:
            ParameterError: If there is no such file.
        """
        for folder in (self.folder, *map(Path, sys.path)):
            if (path := folder / self.library).is_file():
                return path.resolve()
        raise ParameterError(f"law {self.label}: {self.library} does not exist in {self.folder}")

    def files(self) -> dict[str, bytes]:
        """Return the files of the law by name: the library, or the C file with what it includes in quotes.

        Raises:
            ParameterError: If there is no such file.
        """
        first = self.path
        files, left = dict[str, bytes](), [first]
        for path in left:
            name = path.relative_to(first.parent).as_posix()
            if name not in files:
                files[name] = path.read_bytes()
                if first.suffix == ".c":
                    included = re.findall(rb'^\s*#\s*include\s*"([^"]+)"', files[name], re.MULTILINE)
                    beside = (path.parent / os.fsdecode(one) for one in included)
                    left += [one for one in beside if one.is_file() and first.parent in one.parents]
        return files

    @property
    def place(self) -> str:
        """Law, file and function, for messages."""
        return f"law {self.label}: {self.symbol} of {Path(self.library).name}"


class _Loaded(NamedTuple):
    """Function of a class in this process.

    Attributes:
        function: The function.
        files: Its files by name.
        digest: First 16 digits of the SHA-256 of its files.
        words: Size of its memory [numbers of 8 bytes].
        buffer: Type of its memory.
    """

    function: Callable[..., None]
    files: Mapping[str, bytes]
    digest: str
    words: int
    buffer: Any


@checked(own="axes")
class CLaw(AxisLaw):
    """Law with independent axes whose force is a function in C, such as the firmware's own.

    The function has the form ::

        void step(double x, double v, const double *gains, void *memory, double *force);

    with the position x [m, rad] and the velocity v [m/s, rad/s] on one axis, the gains in the order of their
    declaration, a memory of the declared size, zeros at the first sample, and the force to set [N, N m]. The memory
    belongs to the caller and is aligned for a double, so that one function serves all axes and devices, and a run can
    be repeated, rewound and replayed; a static variable is refused.

    A class states in its first line `library`, a shared library or a .c file, which the system's compiler builds once
    per process, with ``-ffp-contract=off``; `symbol`, the name of the function, "step" by default; and `memory`, the
    size of its memory [bytes], 0 by default. A relative path of the library is looked for beside the file of the
    class, then on the path of imports.

    Before its first use in a process the law runs some thousand samples in a process of its own: a crash, an endless
    loop, a write outside the memory or a force that is not finite is an error there. A crash on a path that these
    samples do not take ends this process.

    Args:
        axes: Names from AXES; all six by default.
        code: Hash of the library, or of the C file and what it includes, that is required, as a recording states it.

    Raises:
        ParameterError: If a gain is outside its bounds, the file does not exist, is not compiled or not the required
            one, or the probe finds a fault.

    Example:
        >>> from maglev_mj import CLaw, gain
        >>> class Wall(CLaw, library="wall.c", symbol="wall"):
        ...     stiffness: float = gain("stiffness", "N/m")
        ...     damping: float = gain("damping", "N s/m")
        >>> Wall.per_device
        ('stiffness', 'damping')
    """

    code: str = ""

    _rows: Array = field(init=False, repr=False)
    """Gains as the function takes them, (..., gains)."""
    _packed: bytes | None = field(init=False, repr=False)
    """The same as bytes, for one device."""
    _source: ClassVar[_Source | None] = None

    def __init_subclass__(
        cls, *, library: str | os.PathLike[str] | None = None, symbol: str = "step", memory: int = 0, **keywords: Any
    ) -> None:
        super().__init_subclass__(**keywords)
        if "code" in cls.per_device:
            raise ParameterError(f"{cls.__name__} must not have a gain called code: it is the hash of the library")
        if library is None:
            return
        if not symbol.isidentifier():
            raise ParameterError(f"{cls.__name__}: symbol must be the name of a function in C (got {symbol!r})")
        if not isinstance(memory, int) or not 0 <= memory <= _MOST_MEMORY:
            raise ParameterError(f"{cls.__name__}: memory must be 0 to {_MOST_MEMORY} bytes (got {memory!r})")
        file = getattr(sys.modules.get(cls.__module__), "__file__", None)
        folder = Path(file).resolve().parent if file else Path.cwd()
        cls._source = _Source(cls.__name__, folder, os.fspath(library), symbol, memory)

    def __post_init__(self) -> None:
        super().__post_init__()
        if self._source is None:
            raise ParameterError(f"{named(type(self))} must name its library, as in class Mine(CLaw, library='law.c')")
        for _, law in self._each:
            rows = np.stack(np.broadcast_arrays(*(getattr(law, name) for name in self.per_device), np.zeros(())), -1)
            rows = np.ascontiguousarray(rows[..., :-1], dtype=np.float64)
            store(law, _rows=rows, _packed=None if rows.ndim > 1 else rows.tobytes())
        loaded = _loaded(type(self), [law._rows for _, law in self._each])
        if self.code not in ("", loaded.digest):
            file = Path(self._source.library).name
            raise ParameterError(
                f"law {type(self).__name__}: {file} has changed: its hash must be {self.code} (got {loaded.digest})"
            )
        store(self, code=loaded.digest)

    @classmethod
    def files(cls) -> dict[str, bytes]:
        """Return the library by its name, or the C file and those that it includes in quotes, as they were loaded.

        Empty for a base class without a library.

        Raises:
            ParameterError: If there is no such file.
        """
        if cls in _LOADED:
            return dict(_LOADED[cls].files)
        return {} if cls._source is None else cls._source.files()

    @every_tick
    def force(self, x: Component, v: Component, gains: Self, state: Any) -> Any:
        """Return the force on one axis, and its memory if it has one, as bytes or an array; see `AxisLaw`."""
        function, *_, words, buffer = _LOADED.get(type(self)) or _loaded(type(self), [gains._rows])
        if gains._packed is None or x.__class__ is not float or v.__class__ is not float:
            if shape := np.broadcast_shapes(np.shape(x), np.shape(v), gains._rows.shape[:-1]):
                return self._forces(x, v, gains._rows, state, shape)
            return self.force(float(x), float(v), gains, state)
        force = ctypes.c_double(math.nan)
        if not words:
            function(x, v, gains._packed, None, ctypes.byref(force))
            return force.value
        memory = buffer() if state is None else buffer.from_buffer_copy(state)
        function(x, v, gains._packed, memory, ctypes.byref(force))
        return force.value, bytes(memory)

    def _forces(self, x: Any, v: Any, rows: Array, state: Any, shape: tuple[int, ...]) -> Any:
        """Return the forces on one axis of N devices, and their memories, (..., words): the function once for each."""
        function, *_, words, _ = _LOADED[type(self)]
        count = math.prod(shape)
        before = (
            np.frombuffer(state, np.uint64) if isinstance(state, bytes) else np.uint64(0) if state is None else state
        )
        memories = np.array(np.broadcast_to(before, (*shape, words)), order="C")
        gains = np.array(np.broadcast_to(rows, (*shape, rows.shape[-1])), order="C")
        forces = np.full(count, math.nan)
        sizes = (gains, _DOUBLE * gains.shape[-1]), (memories, _DOUBLE * words), (forces, _DOUBLE)
        starts = [
            range(first := array.ctypes.data, first + count * size, size) if size else repeat(array.ctypes.data)
            for array, size in sizes
        ]
        positions, speeds = (np.broadcast_to(part, shape).ravel().tolist() for part in (x, v))
        for each in zip(positions, speeds, *starts):
            function(*each)
        result = forces.reshape(shape)
        return (result, memories) if words else result


def digest_of(files: Mapping[str, bytes]) -> str:
    """Return the first 16 digits of the SHA-256 of a law's files; see `CLaw.files`."""
    parts = [part for name in sorted(files) for part in (name.encode(), b"\0", files[name], b"\0")]
    return hashlib.sha256(b"".join(parts)).hexdigest()[:16]


def files_of(things: Iterable[Any]) -> dict[str, Mapping[str, bytes]]:
    """Return the files of those among some objects that are laws in C, by their hash; see `CLaw.files`."""
    each = [files for one in things if isinstance(one, type) and issubclass(one, CLaw) and (files := one.files())]
    return {digest_of(files): files for files in each}


_LOADED: dict[type[CLaw], _Loaded] = {}
"""Functions of classes in this process."""

_LOCK = threading.Lock()


def _loaded(cls: type[CLaw], rows: Sequence[Array]) -> _Loaded:
    """Return the function of a class; at first compile, probe and load its library.

    Args:
        cls: The class.
        rows: Gains of each axis, (..., gains), with which it is probed.

    Raises:
        ParameterError: If that fails.
    """
    with _LOCK:  # a page has a thread for each of its users
        if cls not in _LOADED:
            source = cls._source
            assert source is not None
            path, words = source.path, -(-source.memory // _DOUBLE)
            digest = digest_of(files := source.files())
            library = _compiled(source.label, path, digest) if path.suffix == ".c" else path
            some = [part.reshape(math.prod(part.shape[:-1]), part.shape[-1])[:_MOST_ROWS].tolist() for part in rows]
            _probe(source, str(library), [row for part in some for row in part])
            try:
                function = probe.function_of(str(library), source.symbol)
            except (OSError, AttributeError) as error:
                raise ParameterError(f"{source.place} cannot be loaded: {error}") from None
            _LOADED[cls] = _Loaded(function, files, digest, words, ctypes.c_double * words)
        return _LOADED[cls]


@cache
def _compiled(label: str, path: Path, digest: str) -> Path:
    """Return the library of a C file, built by the system's compiler.

    Args:
        label: Name of the law in messages.
        path: The C file.
        digest: Its hash.

    Raises:
        ParameterError: If there is no compiler, or an error in the file, with the compiler's first message.
    """
    import subprocess

    compiler = next(filter(None, map(shutil.which, COMPILERS)), None)
    if compiler is None:
        raise ParameterError(
            f"law {label}: {path.name} needs a C compiler ({', '.join(COMPILERS)}): install one, or name a library "
            f"compiled elsewhere"
        )
    result = temporary_folder() / f"{path.stem}.so"  # a library of one name is loaded once
    # in the folder of the file, so that messages have its name alone
    done = subprocess.run(
        [compiler, *FLAGS, path.name, "-o", str(result), "-lm"],
        cwd=path.parent,
        env={**os.environ, "LC_ALL": "C"},
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        errors="replace",
        check=False,
    )
    if done.returncode:
        lines = [line.strip() for line in done.stderr.splitlines() if line.strip()]
        first = next((line for line in lines if "error" in line), (lines or ["no message"])[0])
        raise ParameterError(f"law {label}: {path.name} does not compile: {first}")
    return result


def _probe(source: _Source, library: str, rows: Sequence[Sequence[float]]) -> None:
    """Run a law in a process of its own.

    Raises:
        ParameterError: If it has a fault there.
        MaglevError: If there can be no such process.
    """
    import subprocess

    if getattr(sys, "frozen", False):  # it would start itself
        raise MaglevError(f"{source.place}: a frozen program cannot check a law in C")
    words = library, source.symbol, str(source.memory), str(_PROBE_TIME)
    try:
        done = subprocess.run(
            [sys.executable, "-I", str(Path(probe.__file__)), *words],
            input=json.dumps(rows),
            capture_output=True,
            text=True,
            errors="replace",
            timeout=_PROBE_TIMEOUT,
            check=False,
        )
    except subprocess.TimeoutExpired:
        raise ParameterError(f"{source.place} does not return within {_PROBE_TIMEOUT:g} s") from None
    if probe.ANSWER in done.stdout:
        reason = done.stdout.partition(probe.ANSWER)[2].partition("\n")[0].strip()
    elif done.returncode < 0:
        ended = signal.Signals(-done.returncode).name
        slow = f"does not return within {_PROBE_TIME:g} s of processor time"
        reason = slow if ended.endswith("PROF") else f"crashes: {ended}"
    else:
        reason = f"ends its process, exit code {done.returncode:#x}"
    if reason:
        raise ParameterError(f"{source.place} {reason}")
