"""Firmware in C behind the Python firmware's interface.

The same tests check both.
"""

from __future__ import annotations

import ctypes
import re
import shutil
import subprocess
import tempfile
from collections import Counter
from collections.abc import Callable, Sequence
from ctypes import c_bool, c_char_p, c_double, c_size_t, c_uint8, c_uint32, c_uint64, c_void_p
from functools import cache
from itertools import chain
from pathlib import Path
from typing import Any

import pytest

from maglev_mj.bridge.safety import Profile
from maglev_mj.bridge.twin.firmware import Amplifiers, Firmware, Reading
from maglev_mj.bridge.wire import Codec, Fault, State
from tests.conftest import COMPILER

FOLDER = Path(__file__).resolve().parents[2] / "scripts" / "firmware"
STRICT = ["-std=c99", "-Wall", "-Wextra", "-Wpedantic", "-Werror"]
SANITIZED = ["-g", "-O1", "-fsanitize=address,undefined", "-fno-sanitize-recover=all"]
TRAPPED = ["-O1", "-fsanitize=undefined", "-fsanitize-undefined-trap-on-error"]

LARGEST, _REASONS, _NO_FRAME = 600, 12, 7
_Six = c_double * 6


def _declared(struct: str) -> list[tuple[str, Any]]:
    """Return the fields of a structure, as the header declares them."""
    header = (FOLDER / "maglev_firmware.h").read_text(encoding="utf-8")
    whole = {f"{sign}int{bits}_t": f"c_{sign}int{bits}" for sign in ("", "u") for bits in (8, 16, 32, 64)}
    names = {**whole, "bool": "c_bool", "float": "c_float", "double": "c_double"}
    kinds: dict[str, Any] = {name: getattr(ctypes, of) for name, of in names.items()}
    sizes = {"MAGLEV_KEY": 32, "MAGLEV_SPOTS": 6, "MAGLEV_COILS": 6}
    (text,) = re.findall(rf"struct {struct} \{{\n(.*?)\}};", header, re.DOTALL)
    declared = re.findall(r"^    (\w+) (\w+)(?:\[(\w+)\])?;", text, re.MULTILINE)
    return [
        (name, kinds[kind] * (sizes.get(count) or int(count)) if count else kinds[kind])
        for kind, name, count in declared
    ]


class _Profile(ctypes.Structure):
    _fields_ = _declared("maglev_profile")


class _Reading(ctypes.Structure):
    _fields_ = _declared("maglev_reading")

    @classmethod
    def of(cls, now: int, number: int, reading: Reading) -> _Reading:
        """Return a reading as the core takes it."""
        known = reading._asdict() | {"time": now, "number": number, "conversions": reading.conversions & 0xFFFFFFFF}
        values = {name: known[name] for name, _ in cls._fields_}
        return cls(**{name: _Six(*value) if isinstance(value, Sequence) else value for name, value in values.items()})


class _Hardware(ctypes.Structure):
    _read = ctypes.CFUNCTYPE(None, c_void_p, ctypes.POINTER(_Reading))
    _drive = ctypes.CFUNCTYPE(None, c_void_p, c_uint64, ctypes.POINTER(_Six), ctypes.POINTER(_Six), c_double)
    _add = ctypes.CFUNCTYPE(None, c_void_p, c_uint64, ctypes.POINTER(_Six))
    _cut = ctypes.CFUNCTYPE(None, c_void_p)
    _toggle = ctypes.CFUNCTYPE(None, c_void_p, c_uint64)
    _now = ctypes.CFUNCTYPE(c_uint64, c_void_p)
    _random = ctypes.CFUNCTYPE(c_uint32, c_void_p)
    _fields_ = [
        ("context", c_void_p),
        *zip(
            ("read", "drive", "add", "cut", "toggle", "now", "random"),
            (_read, _drive, _add, _cut, _toggle, _now, _random),
        ),
    ]


class _Device(ctypes.Structure):
    """The half of the structure that anyone may read."""

    _fields_ = [
        *[(name, c_void_p) for name in ("profile", "hardware")],
        *[(name, c_uint64) for name in ("peer", "fault_time")],
        *[(name, c_uint32) for name in ("session", "faults", "first", "answered")],
        ("counts", c_uint32 * _REASONS),
        ("state", c_uint8),
        *[(name, c_bool) for name in ("is_answered", "holding", "stopping", "walled")],
        ("rises", _Six),
    ]


@cache
def library() -> ctypes.CDLL:
    """Return the compiled firmware.

    It stops at undefined behaviour.
    """
    folder = Path(tempfile.mkdtemp())
    size = folder / "size.c"
    size.write_text('#include "maglev_firmware.h"\nconst size_t maglev_size = sizeof(struct maglev_device);\n')
    sources, target = [FOLDER / f"maglev_{name}.c" for name in ("firmware", "queue")], folder / "maglev_firmware.so"
    command = [str(COMPILER), *STRICT, *TRAPPED, f"-I{FOLDER}", *map(str, sources), str(size)]
    command += ["-shared", "-fPIC", "-o", str(target)]
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=120)
    if done.returncode:
        pytest.fail(f"{' '.join(command)}:\n{done.stderr}")
    core = ctypes.CDLL(str(target))
    shutil.rmtree(folder)
    core.maglev_start.restype = core.maglev_rests.restype = c_bool
    for function in (core.maglev_receive, core.maglev_sample, core.maglev_stuff, core.maglev_unstuff):
        function.restype = c_size_t
    core.maglev_receive.argtypes = [c_void_p, c_char_p, c_size_t, c_uint64, c_void_p]
    core.maglev_heat.argtypes = [c_void_p, c_double, c_void_p]
    core.maglev_wall.argtypes = [c_void_p]
    for function in (core.maglev_wall, core.maglev_heat, core.maglev_trip, core.maglev_lose_host, core.maglev_serve):
        function.restype = None
    return core


class CoreFirmware:
    """`Firmware`, in C.

    What it tells the amplifiers reaches them when the call into C returns, so that what they raise is seen.

    Attributes:
        heats: Whether the pieces of current between samples are told, as by a board that pulses.

    Raises:
        ValueError: If the profile is not one of a device.
    """

    def __init__(self, profile: Profile, amplifiers: Amplifiers, codec: Codec, draw: Callable[[], int]) -> None:
        self.profile, self._amplifiers, self._codec, self._core = profile, amplifiers, codec, library()
        known = _Profile(**profile.stated | {"calibration": tuple(profile.calibration)})
        if (maps := profile.wall_maps) is not None:
            known.spots[:], known.pose[:], known.current[:] = maps.spots, [*chain(*maps[1])], [*chain(*maps[2])]
        if (key := codec._key) is not None:
            known.key_length, known.key[:] = len(key), key[:32].ljust(32, b"\0")
        self._now, self._reading = 0, _Reading()
        self._told: list[Callable[[], None]] = []
        self.heats = True
        self._peers: list[Any] = [None]
        hardware = _Hardware(
            None,
            _Hardware._read(self._read),
            _Hardware._drive(self._drive),
            _Hardware._add(self._add),
            _Hardware._cut(lambda _: self._told.append(amplifiers.cut)),
            _Hardware._toggle(lambda _, now: self._told.append(lambda: amplifiers.toggle(now))),
            _Hardware._now(lambda _: self._now),
            _Hardware._random(lambda _: draw()),
        )
        self._kept = known, hardware  # by reference
        self._memory = ctypes.create_string_buffer(c_size_t.in_dll(self._core, "maglev_size").value)
        self._device = _Device.from_buffer(self._memory)
        if not self._core.maglev_start(self._memory, ctypes.byref(known), ctypes.byref(hardware)):
            raise ValueError(f"no device is like this: {profile}")
        assert len(self._told) == 1  # a board begins with its currents cut
        self._told.clear()

    @property
    def state(self) -> State:
        return State(self._device.state)

    @state.setter
    def state(self, state: State) -> None:
        self._device.state = state

    @property
    def faults(self) -> Fault:
        return Fault(self._device.faults)

    @faults.setter
    def faults(self, faults: Fault) -> None:
        self._device.faults = faults

    @property
    def stopping(self) -> bool:
        return bool(self._device.stopping)

    @property
    def walled(self) -> bool:
        return bool(self._device.walled)

    def wall(self, now: int, reading: Reading) -> None:
        self._now = now
        self._reading = _Reading.of(now, 0, reading)
        self._core.maglev_wall(self._memory)
        self._passed_on(b"")

    @property
    def counts(self) -> Counter[str]:
        return Counter({name: count for name, count in self._counted()[_NO_FRAME:] if count})

    @property
    def answered(self) -> int | None:
        return self._device.answered if self._device.is_answered else None

    @property
    def session(self) -> int:
        return int(self._device.session)

    @property
    def peer(self) -> Any:
        return self._peers[self._device.peer]

    def receive(self, data: bytes, now: int, peer: Any) -> bytes | None:
        self._now = now
        if peer not in self._peers:
            self._peers.append(peer)
        answer = ctypes.create_string_buffer(LARGEST)
        length = self._core.maglev_receive(self._memory, data, len(data), self._peers.index(peer), answer)
        for name, count in self._counted()[:_NO_FRAME]:
            if count:
                self._codec.dropped[name] = count
        return self._passed_on(answer.raw[:length])

    def sample(self, tick: int, now: int, reading: Reading) -> bytes | None:
        self._now = now
        self._reading = _Reading.of(now, tick & 0xFFFFFFFF, reading)
        for seconds, currents in (reading.intervals or ((0.0, reading.measured),)) if self.heats else ():
            self._core.maglev_heat(self._memory, seconds, _Six(*currents))
        frame = ctypes.create_string_buffer(LARGEST)
        length = self._core.maglev_sample(self._memory, frame)
        return self._passed_on(frame.raw[:length])

    def trip(self, faults: Fault, now: int) -> None:
        self._now = now
        self._core.maglev_trip(self._memory, int(faults))
        self._passed_on(b"")

    def lose_host(self, now: int) -> None:
        self._now = now
        self._core.maglev_lose_host(self._memory)
        self._passed_on(b"")

    def _counted(self) -> list[tuple[str, int]]:
        names = (c_char_p * _REASONS).in_dll(self._core, "maglev_reasons")
        return [((name or b"").decode(), count) for name, count in zip(names, self._device.counts)]

    def _passed_on(self, data: bytes) -> bytes | None:
        told, self._told[:] = [*self._told], []
        for tell in told:
            tell()
        return data or None

    def _read(self, _: Any, place: Any) -> None:
        place[0] = self._reading

    def _add(self, _: Any, now: int, currents: Any) -> None:
        told = tuple(currents[0])
        self._told.append(lambda: self._amplifiers.add(now, told))

    def _drive(self, _: Any, now: int, held: Any, pulsed: Any, width: float) -> None:
        currents, pulse = tuple(held[0]), tuple(pulsed[0]) if width else None
        self._told.append(lambda: self._amplifiers.drive(now, currents, pulse, width))


FIRMWARES = ["python", pytest.param("c", marks=pytest.mark.needs("compiler"))]
FIRMWARE: dict[str, Callable[..., Any]] = {"python": Firmware, "c": CoreFirmware}
