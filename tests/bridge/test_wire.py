"""Frames: bytes and tables of docs/reference/protocol.md, damage, round trips, tags.

`test_wire_fuzz.py` damages whole sessions.
"""

from __future__ import annotations

import hashlib
import json
import math
import re
import runpy
import struct
import zlib
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from maglev_mj.bridge import wire
from maglev_mj.bridge.commissioning.calibration import Calibration
from maglev_mj.bridge.links import cobs_encode
from maglev_mj.bridge.safety import Limits, Profile
from maglev_mj.bridge.wire import (
    FORMATS,
    MAGIC,
    VERSION,
    Codec,
    CommandFrame,
    ControlAck,
    ControlRequest,
    Estop,
    EstopAck,
    Fault,
    Flag,
    Frame,
    Hello,
    HelloAck,
    HelloStatus,
    Operation,
    Outcome,
    State,
    StateReport,
    WallMessage,
    newer,
)
from maglev_mj.device import COILS, Device
from maglev_mj.errors import ParameterError
from maglev_mj.plants import sensor

ROOT = Path(__file__).resolve().parents[2]
PAGE = (ROOT / "docs" / "reference" / "protocol.md").read_text(encoding="utf-8")
TEXT = " ".join(PAGE.split())
KEY = bytes(range(32))
NOW, LATER = bytes([VERSION]), bytes([VERSION + 1])
BODIES: dict[str, Any] = {
    "HELLO": Hello,
    "HELLO_ACK": HelloAck,
    "CTRL": ControlRequest,
    "CTRL_ACK": ControlAck,
    "STATE": StateReport,
    "CMD": CommandFrame,
    "ESTOP": Estop,
    "ESTOP_ACK": EstopAck,
}


def golden_bytes() -> dict[str, bytes]:
    """Return the frames of the page by name.

    Those with the key end in " keyed".
    """
    (block,) = re.findall(r"```golden\n(.*?)```", PAGE, re.DOTALL)
    frames: dict[str, str] = {}
    name = ""
    for line in block.splitlines():
        if line.startswith(" "):
            frames[name] += line.replace(" ", "")
        else:
            name = line
            frames[name] = ""
    return {name: bytes.fromhex(digits) for name, digits in frames.items()}


def golden_values() -> dict[str, dict[str, Any]]:
    """Return the frames' values, field by field."""
    (block,) = re.findall(r"```json\n(.*?)```", PAGE, re.DOTALL)
    return {
        name: {field: _value(field, value) for field, value in fields.items()}
        for name, fields in json.loads(block).items()
    }


def golden_frames() -> dict[str, Frame]:
    """Return them as frames."""
    frames = {}
    for name, fields in golden_values().items():
        session, sequence, time = (fields.pop(field) for field in ("session", "sequence", "time"))
        frames[name] = Frame(session, sequence, time, BODIES[name.removesuffix("_WALLS")](**fields))
    return frames


def tables(heading: str) -> list[list[str]]:
    """Return the rows of a table of the page.

    The first table with that beginning, its head included.
    """
    lines = PAGE[PAGE.index(heading) :].splitlines()
    rows = []
    for line in lines[lines.index(next(one for one in lines if one.startswith("|"))) :]:
        if not line.startswith("|"):
            break
        if not line.startswith("|---"):
            rows.append([cell.strip() for cell in line.strip("|").split("|")])
    return rows


def _floats(cell: str) -> list[float]:
    return [float(part) for part in cell.split()]


def _value(field: str, value: Any) -> Any:
    if field == "calibration":
        return bytes.fromhex(value)
    if isinstance(value, str):
        return int(value, 16)
    if field == "walls":
        return tuple(WallMessage(*each) for each in value)
    return tuple(value) if isinstance(value, list) else value


def sealed(data: bytes) -> bytes:
    """Return data with a CRC that is right."""
    return data[:-4] + struct.pack("<I", zlib.crc32(data[:-4]))


@pytest.mark.parametrize("name", golden_bytes())
def test_golden_bytes(name: str) -> None:
    data = golden_bytes()[name]
    plain, _, keyed = name.partition(" ")
    frame = golden_frames()[plain]
    codec = Codec(KEY if keyed else None)
    assert codec.encode(*frame) == data
    assert codec.decode(data) == frame
    assert not codec.dropped
    sizes = {row[0]: int(row[3 if keyed else 2]) for row in tables("| frame | from |")[1:]}
    assert len(data) == sizes[plain.removesuffix("_WALLS")] + 36 * 2 * (plain == "CMD_WALLS")


@pytest.mark.parametrize("name", BODIES)
def test_the_tables_of_the_page_decode_its_bytes(name: str) -> None:
    data, values = golden_bytes()[name], golden_values()[name]
    rows = tables("| offset | type | header |")[1:] + tables(f"### {name},")[1:]
    end, found = 0, {}
    for offset, kind, field, *_ in rows:
        count, _, unit = kind.rpartition(" ")
        layout = f"<{count}{FORMATS[unit]}"
        assert int(offset) == end, f"{field} of {name}"
        end += struct.calcsize(layout)
        parts = struct.unpack_from(layout, data, int(offset))
        if parts:
            found[field] = parts if len(parts) > 1 else parts[0]
    assert end == len(data) - 4
    # the page calls two fields of a HELLO_ACK version, the header's and the body's
    assert found.pop("magic") == MAGIC and found.pop("type") == list(BODIES).index(name) + 1
    if "version" not in values:
        assert found.pop("version") == VERSION
    assert found == values


def test_the_table_of_walls_decodes_them() -> None:
    data, values = golden_bytes()["CMD_WALLS"], golden_values()["CMD_WALLS"]["walls"]
    start = len(golden_bytes()["CMD"]) - 4
    rows = [(int(row[0]), *row[1].rpartition(" ")[::2], row[2]) for row in tables("| offset | type | wall |")[1:]]
    for index, wall in enumerate(values):
        parts = [
            struct.unpack_from(f"<{count}{FORMATS[unit]}", data, start + 36 * index + offset)
            for offset, count, unit, _ in rows
        ]
        assert tuple(part[0] for part in parts if part) == wall
    assert [row[3] for row in rows if row[3]] == list(WallMessage._fields) and start + 36 * len(values) + 4 == len(data)


def test_a_limit_has_one_name_and_one_unit_in_the_table_of_limits_the_frame_and_the_page() -> None:
    rows = {row[2]: (row[1], row[3]) for row in tables("### HELLO_ACK,")[1:]}
    profile = Profile(period=5_000_000, delay=0, calibration=bytes(16))
    assert profile.answer(**dict.fromkeys(("nonce", "status", "state", "fault_time", "faults", "first"), 0))
    for limit in Limits.parameters():
        stated = profile.stated[limit.name]
        kind, unit = ("f64", limit.unit) if isinstance(stated, float) else ("u64", "ns") if limit.unit else ("u32", "")
        assert rows[limit.name][0] == kind, limit.name
        assert f"[{unit}]" in rows[limit.name][1] if unit else "[" not in rows[limit.name][1], limit.name


def test_the_page_has_the_words_of_both_ends() -> None:
    assert {row[1]: int(row[0]) for row in tables("| bit | fault |")[1:]} == {one.name: one.value for one in Fault}
    for words in (State, Operation, HelloStatus):
        assert ", ".join(f"{one.value} {one.name}" for one in words) in PAGE
    assert ", ".join(f"{one.value} {one.name}" for one in Outcome) in PAGE
    (flags,) = [row[3] for row in tables("### STATE,") if row[2] == "flags"]
    assert re.findall(r"(\d) ([A-Z]+)", flags) == [(str(one.value), one.name) for one in Flag]


def test_the_page_says_where_coils_and_diodes_are_and_which_way_they_point() -> None:
    known = Calibration.nominal()
    coils, beams = known.coils, sensor.beams()
    rows = [[_floats(cell) for cell in row[2:]] for row in tables("| coil | name |")[1:]]
    assert [row[1] for row in tables("| coil | name |")[1:]] == list(COILS)
    for found, expected in ((0, 1e3 * coils.points), (1, coils.directions), (2, coils.force_constants[:, None])):
        assert np.allclose([row[found] for row in rows], expected, atol=6e-4)
    rows = [[_floats(cell) for cell in row[1:]] for row in tables("| diode | LED")[1:]]
    places = (1e3 * beams.leds, 1e3 * beams.diodes, beams.across[:, 0], beams.across[:, 1])
    for place, expected in enumerate(places):
        assert np.allclose([row[place] for row in rows], expected, atol=6e-4)
    moved = [[float(cell) for cell in row[1:]] for row in tables("| spot | +x |")[1:]]
    small = np.diag([1e-6] * 3 + [1e-6] * 3)  # m and rad, of which the page has a thousand and ten thousand
    slopes = (beams.spots(small) - beams.spots(-small)).T / 2e-6 * ([1.0] * 3 + [10.0] * 3)
    assert np.allclose(moved, slopes, atol=6e-4)
    assert np.round(known.hover, 4).tolist() == [1.1445] * 3 + [0.0] * 3 and "1.1445 A carry 0.7 kg" in TEXT
    inertia, (_, _, gravity) = known.inertia, known.gravity
    moments = "moments of inertia of {:g}, {:g} and {:g} kg m²".format(*inertia)
    assert f"a mass of {known.mass:g} kg and {moments}" in TEXT and f"gravity is {-gravity:g} m/s² along -z" in TEXT
    assert not known.gravity[:2].any()
    assert round(float(coils.wrench(np.array([0, 0, 0, 1, 1, 1.0]))[5]), 3) == 0.252 and "0.252 N m about +z" in TEXT


def test_the_page_says_what_the_digest_is() -> None:
    values = Device.load("ubc").as_json()  # by what the page says of it and nothing else
    for section, key, neutral in re.findall(
        r"`(\w+)\.(\w+)`, ([\d.]+)", TEXT.split("its neutral value")[1].split(". The")[0]
    ):
        assert values[section].pop(key) == float(neutral)
    text = json.dumps(values, sort_keys=True, separators=(",", ":"))
    assert hashlib.blake2s(text.encode("ascii"), digest_size=16).hexdigest() in PAGE


def test_check_values_of_the_page() -> None:
    assert "`11 22 00 33` is sent as `03 11 22 02 33 00`" in TEXT
    assert cobs_encode(bytes.fromhex("11220033")).hex(" ") == "03 11 22 02 33"
    for name, size, slow, fast, once in tables("| frame | bytes on the link |")[1:]:
        frame, keyed = name.split()[0], " keyed" * name.endswith("key")
        assert len(cobs_encode(golden_bytes()[frame + keyed])) + 2 == int(size)
        figures = (f"{int(size) * 2} kbaud", f"{int(size) * 1e-2:.2f} Mbaud", f"{int(size) * 1e4 / 921_600:.2f} ms")
        assert (slow, fast, once) == figures
    assert f"`{zlib.crc32(b'123456789'):08x}`" in TEXT
    assert f"`{hashlib.blake2s(b'123456789', digest_size=16, key=KEY).hexdigest()}`" in TEXT


def test_nan_keeps_its_payload() -> None:
    codec = Codec()
    (strange,) = struct.unpack("<d", bytes.fromhex("efbeadde0000f8ff"))
    six = (strange, math.nan, -math.nan, 0.0, math.inf, -math.inf)
    for body in (
        CommandFrame(1, 0, six, six, strange),
        StateReport(six, six, six, 1, 7, 0, 0, 1, 2, 3),
        ControlRequest(1, 1, 0, six),
    ):
        data = codec.encode(1, 2, 3, body)
        frame = codec.decode(data)
        assert frame is not None and codec.encode(*frame) == data
    assert struct.pack("<d", strange) in data


@pytest.mark.parametrize("name", golden_bytes())
def test_every_flipped_bit_and_every_other_length_is_noticed(name: str) -> None:
    data = golden_bytes()[name]
    codec = Codec(KEY if name.endswith("keyed") else None)
    for bit in range(8 * len(data)):
        changed = bytearray(data)
        changed[bit // 8] ^= 1 << bit % 8
        assert codec.decode(bytes(changed)) is None, bit
    assert codec.dropped == {"magic": 16, "crc": 8 * len(data) - 16}
    assert codec.version_met is None  # a CRC that is wrong vouches for no version
    wrong = [data[:end] for end in range(len(data))] + [data[start:] for start in range(1, len(data))]
    for more in range(1, 40):
        wrong += [data + bytes(more), data + b"\xff" * more, bytes(more) + data, data + data[:more]]
    for one in wrong:
        assert codec.decode(one) is None, one.hex()
        if len(one) > 8:  # and with a CRC that fits
            walls = name.startswith("CMD") and abs(len(one) - len(data)) % 36 == 0 and one[:20] == data[:20]
            assert codec.decode(sealed(one)) is None or walls, one.hex()
    assert not codec.dropped["version"] and not codec.dropped["type"]


def test_frames_without_the_right_key_are_dropped() -> None:
    with pytest.raises(ParameterError, match="got 15"):
        Codec(bytes(15))
    frames = golden_bytes()
    plain, keyed = frames["STATE"], frames["STATE keyed"]
    cases: list[tuple[bytes | None, bytes, str]] = [
        (None, keyed, "length"),
        (KEY, plain, "length"),
        (bytes(32), keyed, "tag"),
        (KEY[:-1], keyed, "tag"),
        (KEY, sealed(keyed[:-20] + bytes(20)), "tag"),
    ]
    for key, data, reason in cases:
        codec = Codec(key)
        assert codec.decode(data) is None
        assert codec.dropped == {reason: 1}


WALL = WallMessage(2, 1, 0.0, 0.0, 0.0, 0.0)
CMD, WALLED = (
    len(Codec().encode(0, 0, 0, CommandFrame(0, 0, (0.0,) * 6, (0.0,) * 6, 0.0, walls))) - 4 for walls in ((), (WALL,))
)
"""Bytes of a CMD behind its type, without walls and with one."""


@pytest.mark.parametrize(
    ("data", "reason"),
    [
        (b"", "short"),
        (b"MJ" + NOW + b"\x06", "crc"),
        (b"JM" + NOW + b"\x06" + bytes(CMD), "magic"),
        (sealed(b"MJ" + LATER + b"\x07" + bytes(28)), "version"),
        (sealed(b"MJ" + NOW + b"\x09" + bytes(CMD)), "type"),
        (sealed(b"MJ" + NOW + b"\x06" + bytes(4)), "length"),
        (sealed(b"MJ" + NOW + b"\x06" + bytes(CMD + 1)), "length"),
        (sealed(b"MJ" + NOW + b"\x06" + bytes(CMD + (wire.MOST_WALLS + 1) * (WALLED - CMD))), "length"),
        (b"MJ" + LATER + b"\x06" + bytes(CMD), "crc"),
    ],
)
def test_what_is_no_frame_is_counted_by_reason(data: bytes, reason: str) -> None:
    codec = Codec()
    assert codec.decode(data) is None
    assert codec.dropped == {reason: 1}
    assert codec.version_met == (data[2] if reason == "version" else None)


@pytest.mark.parametrize("start", [0, 1, 2**31 - 1, 2**31, 2**32 - 2, 2**32 - 1])
def test_newer_goes_round(start: int) -> None:
    for step in (1, 2, 1000, 2**31 - 1):
        after = (start + step) % 2**32
        assert newer(after, start) and not newer(start, after)
    assert not newer(start, start)
    opposite = (start + 2**31) % 2**32  # half way round neither is the newer
    assert not newer(opposite, start) and not newer(start, opposite)


def test_nothing_that_follows_from_the_messages_is_stale() -> None:
    made = runpy.run_path(str(ROOT / "scripts" / "firmware" / "make_protocol.py"))
    for path, text in made["files"]():
        assert path.read_text(encoding="utf-8") == text, f"{path.relative_to(ROOT)} is stale: make protocol"


LAYOUTS = {5: 0x81FF3F54}
"""CRC-32 of the names and types of all messages, by version of the protocol."""


def test_messages_change_with_the_version_alone() -> None:
    """A device in use speaks the messages of its version."""
    bodies = (*wire.BODIES, WallMessage)
    declared = [
        f"{body.__name__} {name} {on.gap} {on.kind}" for body in bodies for name, on in wire.layout(body).items()
    ]
    found = zlib.crc32(" ".join(declared).encode())
    advice = f"raise VERSION in bridge/wire.py, then LAYOUTS here: {{{VERSION}: 0x{found:08X}}} if it is unreleased"
    assert LAYOUTS.get(VERSION) == found, f"the messages are not those of version {VERSION}: {advice}"


UNITS = [unit for unit in FORMATS if unit not in ("bytes", "zeros")]


@st.composite
def messages(draw: st.DrawFn) -> tuple[Any, list[Any], bytes]:
    """Return a class of random declarations, values of its fields, and their bytes."""
    declared: list[tuple[str, Any]] = []
    values, data = [], b""
    for index in range(draw(st.integers(1, 12))):
        unit, count, gap = draw(st.sampled_from([*UNITS, "bytes"])), draw(st.integers(1, 6)), draw(st.integers(0, 3))
        kind = f"{count} {unit}" if count > 1 or unit == "bytes" else unit
        declared.append((f"v{index}", Annotated[Any, wire.On(kind, gap=gap)]))
        numbers = draw(st.lists(st.integers(0, 127), min_size=count, max_size=count))
        values.append(bytes(numbers) if unit == "bytes" else tuple(numbers) if count > 1 else numbers[0])
        packed = [struct.pack("<" + FORMATS[unit].replace("s", "B"), number) for number in numbers]
        data += bytes(gap) + b"".join(packed)
    return NamedTuple("Body", declared), values, data


@given(messages())
def test_a_message_is_packed_as_declared(message: tuple[Any, list[Any], bytes]) -> None:
    kind, values, data = message
    body, shape = kind(*values), struct.Struct(f"<{wire._format(kind)}")
    assert shape.pack(*wire._flat(kind)(body)) == data
    assert wire._nested(kind, 0)(shape.unpack(data)) == body
    assert shape.pack(*wire._flat(kind)(wire.blank(kind))) == bytes(len(data))


@pytest.mark.parametrize("body", wire.BODIES)
def test_a_declared_message_survives_the_wire(body: Any) -> None:
    values = [
        bytes(range(on.count)) if on.type == "bytes" else index if on.count == 1 else tuple(range(on.count))
        for index, on in enumerate(wire.layout(body).values())
    ]
    frame = Frame(1, 2, 3, body(*values))
    assert Codec().decode(Codec().encode(*frame)) == frame
