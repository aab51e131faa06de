"""Reference pages of the commands.

The parser gives usage, options and example.
"""

from __future__ import annotations

import argparse
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from inspect import getdoc
from itertools import compress
from pathlib import Path

from sphinx.application import Sphinx
from sphinx.util.osutil import FileAvoidWrite

from maglev_mj.cli.declare import Parser, help_of
from maglev_mj.cli.options import add_parameters
from maglev_mj.cli.program import GROUPS, add_options, command_parser
from maglev_mj.scenes.find import find_scene
from maglev_mj.scenes.names import scene_names

_FOLDER = "reference/commands"
_ANY_SCENE = "drop"
_COLUMNS = {"Option": 25, "Meaning": 45, "Default": 12, "Allowed": 18}
"""Columns of a table of options, and their widths."""


def setup(app: Sphinx) -> dict[str, bool]:
    """Register the generator."""
    app.connect("config-inited", write_pages)
    return {"parallel_read_safe": True, "parallel_write_safe": True}


def write_pages(app: Sphinx, _: object) -> None:
    """Write the pages of commands and scenes, and their index."""
    folder = Path(app.srcdir, _FOLDER)
    folder.mkdir(exist_ok=True)
    pages = {name: _command_page(name) for group in GROUPS.values() for name in group}
    for name, page in {**pages, "scenes": _scenes_page(), "index": _index_page()}.items():
        write(folder / f"{name}.rst", page)


def _index_page() -> Iterator[str]:
    yield from title("Commands", "=")
    yield "Every command, by what it is for. ``maglev-mj COMMAND --help`` prints the same. Exit status: 0; 1 for a run"
    yield "that failed, 2 for bad input, 130 for Ctrl-C, 141 for a closed output."
    for purpose, group in GROUPS.items():
        yield from title(_capital(purpose), "-")
        rows = [(f":doc:`{name}`", as_rst(one.summary)) for name, one in group.items()]
        yield from table(("Command", "Summary"), rows, (20, 80))
    yield from ("", ".. toctree::", "   :hidden:", "", *(f"   {name}" for group in GROUPS.values() for name in group))
    yield "   scenes"


def _prepared(name: str, arguments: Sequence[str]) -> Parser:
    """Return the parser of a command with its options."""
    made = command_parser(name, arguments)
    add_options(made, name)
    return made


def _command_page(name: str) -> Iterator[str]:
    command = _prepared(name, [])
    description, notes = str(command.description), command.epilog
    if any(one.dest == "scene" and one.required for one in command._actions):
        command = _prepared(name, [_ANY_SCENE])  # for what each scene has
        if command.description == description:  # `run` has that of the scene, and its notes
            notes = command.epilog
    of_scene = f"parameters of {getattr(command.get_default('scene_class'), 'name', '')}"
    yield from title(name, "=")
    yield as_rst(description)
    yield from _block(command.format_usage().removeprefix("usage: "))
    yield from ("Example:", *_block(command.example))
    for group in command._action_groups:
        options = [one for one in group._group_actions if one.help != argparse.SUPPRESS and one.dest != "help"]
        named = "arguments" if group is command._positionals else str(group.title)
        if named == of_scene:  # its parameters are on the page of the scenes
            named, options = "scene", [one for one in options if not hasattr(one, "parameter")]
        if options:
            yield from title(_capital(named), "-")
            yield from _options(options)
    if notes:
        yield from title("Notes", "-")
        for paragraph in re.split(r"\n(?!\s)", notes):
            yield from _block(paragraph) if "\n " in paragraph else (as_rst(paragraph), "")
    if "SCENE" in command.format_help():
        yield "Each scene has parameters of its own, which are further options: see :doc:`scenes`."


def _scenes_page() -> Iterator[str]:
    yield from title("Parameters of the scenes", "=")
    yield "Each scene of the package, and the options that its parameters make in any command that takes a ``SCENE``."
    yield "The name of a scene is short for :doc:`run` and that name."
    for name in scene_names():
        scene = find_scene(name)
        made = Parser()
        add_parameters(made, scene)
        yield from title(name, "-")
        yield from (as_rst(str(getdoc(scene))), "", f"Plants: {', '.join(scene.plants)}.")
        yield from _options([one for one in made._actions if one.dest != "help"])


def _options(options: Sequence[argparse.Action]) -> Iterator[str]:
    rows = [_row(one) for one in options]
    used = [any(cells) for cells in zip(*rows)]
    heads = list(compress(_COLUMNS, used))
    yield from table(heads, [list(compress(row, used)) for row in rows], [_COLUMNS[head] for head in heads])


def _row(option: argparse.Action) -> tuple[str, str, str, str]:
    """Return an option, its meaning, default and allowed values."""
    value = _value(option)
    words = [f"``{one} {value}``" if value else f"``{one}``" for one in option.option_strings] or [f"``{value}``"]
    told, _, default = help_of(option).partition(" (default")
    default, _, rest = default.strip(": ").rpartition(")")
    declared = getattr(option, "parameter", None)
    allowed = ", ".join(option.choices or getattr(option, "offered", None) or ())
    if declared is not None and declared.bounds:
        allowed = _range(declared.bounds)
    return ", ".join(words), as_rst(told + rest), as_rst(default), as_rst(allowed)


def _range(bounds: Mapping[str, float]) -> str:
    if bounds.keys() == {"at_least", "at_most"}:
        return f"{bounds['at_least']:g} to {bounds['at_most']:g}"
    return ", ".join(f"{name.replace('_', ' ')} {bound:g}" for name, bound in bounds.items())


def _value(option: argparse.Action) -> str:
    if option.nargs == 0:
        return ""
    name = str(option.metavar or (option.dest if not option.option_strings else "NAME"))
    return f"[{name}]" if option.nargs == "?" else name


def write(path: Path, lines: Iterable[str]) -> None:
    """Write a page, unless it is there already."""
    text = "\n".join(lines) + "\n"
    with FileAvoidWrite(path) as file:
        file.write(text)


def table(heads: Sequence[str], rows: Iterable[Sequence[str]], widths: Sequence[int]) -> Iterator[str]:
    """Yield the lines of a table."""
    yield from ("", ".. list-table::", "   :header-rows: 1", f"   :widths: {' '.join(map(str, widths))}", "")
    for row in [heads, *rows]:
        for first, cell in enumerate(row):
            yield f"   {'  -' if first else '* -'} {cell}"
    yield ""


def title(text: str, line: str) -> tuple[str, ...]:
    """Return the lines of a title, underlined."""
    return "", text, line * len(text), ""


def _capital(text: str) -> str:
    return text[:1].upper() + text[1:]


def _block(text: str) -> Iterator[str]:
    yield from ("", ".. code-block:: text", "", *(f"   {line}" for line in text.splitlines()), "")


def as_rst(text: str) -> str:
    """Return plain text as reStructuredText: code in backticks, and options."""
    parts = re.split(r"`([^`]*)`|(?<!\S)(--[\w-]+)", text)
    plain, quoted, options = parts[::3], parts[1::3], parts[2::3]
    escaped = [re.sub(r"([\\*|_])", r"\\\1", part) for part in plain]
    code = [f"``{one or other}``" for one, other in zip(quoted, options)]
    return "".join(part for pair in zip(escaped, [*code, ""]) for part in pair)
