"""Write what follows from declarations: C code, tables, sizes and golden bytes.

The messages are declared in maglev_mj/bridge/wire.py, the values of a device cycle in maglev_mj/recording/journal.py.

Run: python scripts/firmware/make_protocol.py [--check]     (make protocol); `--check` lists what is stale
"""

from __future__ import annotations

import json
import re
import struct
import sys
import textwrap
from collections.abc import Iterator
from enum import IntFlag
from pathlib import Path
from typing import Any

from maglev_mj.bridge import wire
from maglev_mj.bridge.links import BAUD, cobs_encode
from maglev_mj.bridge.safety import Limits
from maglev_mj.recording import journal

ROOT = Path(__file__).resolve().parents[2]
FIRMWARE, PAGE = ROOT / "scripts" / "firmware", ROOT / "docs" / "reference" / "protocol.md"
RECORDING, RECORDER = PAGE.with_name("recording.md"), ROOT / "docs" / "explanation" / "recorder.md"
KEY = bytes(range(32))
HEADER = 20
WIDTH = 120
NAMES = "HELLO", "HELLO_ACK", "CTRL", "CTRL_ACK", "STATE", "CMD", "ESTOP", "ESTOP_ACK"
BODIES = dict(zip(NAMES, wire.BODIES))
C_NAMES = {"MAGLEV_ESTOP": "MAGLEV_ESTOPPED"}
"""Faults whose name in C is that of a message."""
C_TYPES = {"u8": "uint8_t", "i8": "int8_t", "u16": "uint16_t", "u32": "uint32_t", "u64": "uint64_t"}
C_TYPES |= {"f32": "float", "f64": "double", "bytes": "uint8_t"}


def put(text: str, pattern: str, new: object) -> str:
    """Return a text in which the group of each match is replaced.

    Raises:
        ValueError: If the pattern does not match.
    """
    matches = list(re.finditer(pattern, text, re.DOTALL))
    if not matches:
        raise ValueError(f"no match for {pattern}")
    for match in reversed(matches):
        text = f"{text[: match.start(1)]}{new}{text[match.end(1) :]}"
    return text


def region(text: str, name: str, lines: list[str], indent: int) -> str:
    """Return a C file with the lines between two comments replaced."""
    inside = "".join(f"{' ' * indent}{line}\n" for line in lines)
    return put(text, rf"/\* {name}, by make protocol \*/\n(.*?) */\* end \*/", inside)


def member(name: str, on: wire.On) -> str:
    """Return the declaration of a value in a C structure."""
    return f"{C_TYPES[on.type]} {name}{f'[{on.count}]' if on.count > 1 else ''};"


def commented(name: str, on: wire.On) -> Iterator[str]:
    """Yield the lines of a member of `struct maglev_profile`, with the text of the page."""
    text = re.sub(r"\[([^]]*)\]\([^)]*\)", r"\1", on.text)  # links
    start, *others = textwrap.wrap(f"/* {text} */", WIDTH - 33)
    yield f"{member(name, on):29}{start}"
    for line in others:
        yield f"{'':32}{line}"


def bits(kind: type[IntFlag], *others: str) -> list[str]:
    """Return the lines of an enumeration in C."""
    names = ((f"MAGLEV_{one.name}", one.value) for one in kind)
    return [*(f"{C_NAMES.get(name, name)} = {value}," for name, value in names), *others]


def walked(place: str, name: str, on: wire.On) -> str:
    """Return the C code that encodes or decodes a value."""
    place, gap = f"{place}{name}", f"gap(c, {on.gap}), " * bool(on.gap)
    if on.type == "i8":
        return f"{gap}u8(c, (uint8_t *)&{place});"
    if on.type == "bytes":
        return f"{gap}hash(c, {place});"
    if on.type[0] == "f":
        return f"{gap}{on.type}(c, {'&' * (on.count == 1)}{place}, {on.count});"
    loop = f"for (int i = 0; i < {on.count}; i++) " if on.count > 1 else ""
    return f"{gap}{loop}{on.type}(c, &{place}{'[i]' if loop else ''});"


def table(body: type[wire.Body | wire.WallMessage], offset: int = HEADER) -> str:
    """Return the rows of a table on the page."""
    rows = ""
    for name, on in wire.layout(body).items():
        if on.gap:
            rows += f"| {offset} | {on.gap} zeros | | |\n"
        offset += on.gap
        rows += f"| {offset} | {on.kind} | {name} | {on.text + ' ' if on.text else ''}|\n"
        offset += struct.calcsize(f"<{on.count}{wire.FORMATS[on.type]}")
    return rows


def with_values(block: str) -> str:
    """Return the page's values of the golden frames, with those of new fields and of the version."""
    for message, body in BODIES.items():
        known = json.loads(block)[message]
        for index, (name, on) in enumerate(wire.layout(body).items(), 1):
            if name not in known:
                number = float(index) if on.type[0] == "f" else index
                value: Any = bytes([index] * on.count).hex() if on.type == "bytes" else [number] * on.count
                example = json.dumps(number if on.count == 1 else value)
                block = put(block, rf'"{message}": {{[^}}]*()}}', f',\n    "{name}": {example}')
    return put(block, r'"version": (\d+)', wire.VERSION)


def golden(block: str) -> dict[str, bytes]:
    """Return the golden frames by name, without and with the key, from their values."""
    frames = {}
    for suffix, key in (("", None), (" keyed", KEY)):
        for name, fields in json.loads(block).items():
            values = {field: _value(field, value) for field, value in fields.items()}
            session, sequence, time = (values.pop(field) for field in ("session", "sequence", "time"))
            body: Any = BODIES[name.removesuffix("_WALLS")](**values)
            frames[name + suffix] = wire.Codec(key).encode(session, sequence, time, body)
    return frames


def _value(field: str, value: Any) -> Any:
    if isinstance(value, str):
        return bytes.fromhex(value) if field == "calibration" else int(value, 16)
    if field == "walls":
        return tuple(wire.WallMessage(*wall) for wall in value)
    return tuple(value) if isinstance(value, list) else value


def page(text: str, frames: dict[str, bytes]) -> str:
    """Return the page of the protocol."""
    text = put(text, r"# The protocol, version (\d+)", wire.VERSION)
    text = put(text, r"\| 2 \| u8 \| version \| (\d+) \|", wire.VERSION)
    text = put(text, r"\| offset \| type \| wall \| \|\n\|---[^\n]*\n((?:\|[^\n]*\n)*)", table(wire.WallMessage, 0))
    for name, body in BODIES.items():
        text = put(text, rf"### {name}, type \d+\n\n\|[^\n]*\n\|---[^\n]*\n((?:\|[^\n]*\n)*)", table(body))
    lines = ""
    for name, data in frames.items():
        words = " ".join(re.findall("..?.?.?.?.?.?.?", data.hex()))
        lines += f"{name}\n{textwrap.indent(textwrap.fill(words, 71), '  ')}\n"
    text = put(text, r"```golden\n(.*?)```", lines)
    for name in NAMES:
        sizes = f"{len(frames[name])} | {len(frames[name + ' keyed'])}"
        text = put(text, rf"\n\| {name} \| \w+ \| (\d+ \| \d+) \|", sizes)
    for title in ("STATE", "CMD", "STATE with a key", "CMD with a key"):
        size = on_link(frames[title.replace("with a key", "keyed")])
        row = f"{size} | {size * 2} kbaud | {size * 1e-2:.2f} Mbaud | {size * 1e4 / BAUD:.2f} ms"
        text = put(text, rf"\n\| {title} \| (\d+ \| \d+ kbaud \|[^\n]*) \|\n", row)
    state, both = len(frames["STATE"]), together(frames)
    text = put(text, r"bytes and a STATE (\d+):", state - 24)  # six numbers of four bytes less
    text = put(text, r" ms less, of ([\d.]+) ms", both)
    text = put(text, r"for STATE and CMD: ([\d.]+) ms", both)
    text = put(text, r"28 bytes longer: ([\d.]+) Mbit/s", f"{(state + 28) * 8e-3:.1f}")
    return put(text, r"The answer has (\d+) bytes", len(frames["HELLO_ACK"]))


def on_link(frame: bytes) -> int:
    """Return the length of a frame on a serial link."""
    return len(cobs_encode(frame)) + 2


def together(frames: dict[str, bytes]) -> str:
    """Return the time of a STATE and a CMD on a serial link [ms], as text."""
    return f"{(on_link(frames['STATE']) + on_link(frames['CMD'])) * 1e4 / BAUD:.1f}"


def recording(text: str) -> str:
    """Return the page of the format of recordings."""
    size, types = journal.RECORD.itemsize, {"<u4": "uint32", "<f8": "float64", "6<f8": "6 float64"}
    text = put(text, r"end of the file, (\d+) bytes each", size)
    text = put(
        text, r"grows by (\d+ kB/s at 1 kHz, [\d.]+ GB) per hour", f"{size} kB/s at 1 kHz, {size * 3.6e-3:.2f} GB"
    )
    rows = ""
    for name, kind, unit, meaning in journal.CYCLE_PARTS:
        rows += f"| `{name}`{f' [{unit}]' if unit else ''} | {types[kind]} | {meaning} |\n"
    return put(text, r"\| field \| type \| meaning \|\n\|---[^\n]*\n((?:\|[^\n]*\n)*)", rows)


def files() -> Iterator[tuple[Path, str]]:
    """Yield each file with the text that it should have."""
    text = PAGE.read_text("utf-8")
    (block,) = re.findall(r"```json\n(.*?)```", text, re.DOTALL)
    values = with_values(block)
    frames = golden(values)
    yield PAGE, page(text.replace(block, values), frames)
    yield RECORDING, recording(RECORDING.read_text("utf-8"))
    yield RECORDER, put(RECORDER.read_text("utf-8"), r"its sample into (\d+) bytes", journal.RECORD.itemsize)

    path = FIRMWARE / "maglev_firmware.h"
    text = put(path.read_text("utf-8"), r"MAGLEV_VERSION = (\d+)", wire.VERSION)
    text = put(text, r"protocol\.md, version (\d+)", wire.VERSION)
    lines = [line for item in wire.PROPERTIES.items() for line in commented(*item)]
    text = region(text, "properties", lines, 4)
    text = region(text, "flags", bits(wire.Flag), 4)
    text = region(text, "faults", bits(wire.Fault, f"MAGLEV_ALL_FAULTS = {sum(wire.Fault)}"), 4)
    text = region(text, "walls", [member(*item) for item in wire.layout(wire.WallMessage).items()], 4)
    for name, body in BODIES.items():
        text = region(text, name, [member(*item) for item in wire.layout(body).items()], 12)
    yield path, text

    path = FIRMWARE / "maglev_firmware.c"
    sizes = ", ".join(str(len(frames[name]) - 4) for name in NAMES)
    text = put(path.read_text("utf-8"), r"SIZES\[\w*\] = \{0, ([^}]*)\}", sizes)
    text = region(text, "walls", [walked("w->", *item) for item in wire.layout(wire.WallMessage).items()], 12)
    for name, body in BODIES.items():
        place = f"f->of.{name.lower()}."
        text = region(text, name, [walked(place, *item) for item in wire.layout(body).items()], 8)
    numbers = [name for name, on in wire.PROPERTIES.items() if on.count == 1]
    yield path, region(text, "properties", [f".{name} = p->{name}," for name in numbers], 8)

    names = [limit.name for limit in Limits.parameters() if wire.PROPERTIES[limit.name].type != "u64"]
    names = [name for name in names if name not in ("hover_limit", "frozen")]
    limits = [f".{name} = {getattr(Limits(), name)}," for name in names]
    places = [f'{{"{name}", &profile.{name}}},' for name in names if wire.PROPERTIES[name].type == "f64"]
    path = FIRMWARE / "fuzz_firmware.c"
    yield path, region(path.read_text("utf-8"), "limits", limits, 4)
    path = FIRMWARE / "simulated_device.c"
    yield path, region(region(path.read_text("utf-8"), "limits", limits, 4), "places of limits", places, 4)
    path = FIRMWARE / "README.md"
    yield path, put(path.read_text("utf-8"), r"protocol\.md\), version (\d+)", wire.VERSION)
    path = FIRMWARE / "boards" / "stm32f405" / "README.md"
    yield path, put(path.read_text("utf-8"), r"STATE and CMD take ([\d.]+) ms together", together(frames))


def main() -> int:
    """Write what is stale, or list it."""
    check, stale = "--check" in sys.argv, 0
    for path, text in files():
        if path.read_text("utf-8") != text:
            print(f"{path.relative_to(ROOT)} {'is stale: make protocol' if check else 'written'}")
            stale += 1
            if not check:
                path.write_text(text, "utf-8")
    return int(check and stale > 0)


if __name__ == "__main__":
    sys.exit(main())
