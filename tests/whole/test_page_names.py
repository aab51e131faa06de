"""Names on pages: every path, extra, target, option, key, control, count and identifier that a page names exists."""

from __future__ import annotations

import re
import shlex
import tomllib
from collections.abc import Iterable, Mapping
from contextlib import chdir, suppress
from functools import cache
from importlib import import_module
from inspect import ismodule
from pathlib import Path
from unittest.mock import patch

from maglev_mj.cli import main
from maglev_mj.cli.program import COMMANDS, add_options, command_parser
from maglev_mj.device import _SECTIONS
from maglev_mj.recording import FORMATS
from maglev_mj.scenes import find_scene
from maglev_mj.scenes.interactive import Joystick
from maglev_mj.scenes.names import BUILT_IN
from maglev_mj.scenes.stick_slip import LAWS as FRICTION_LAWS
from maglev_mj.session import EMERGENCY_STOP, REWIND_ACTIONS
from maglev_mj.session.tour import STEPS
from maglev_mj.studies.wall_laws import LAWS as WALL_LAWS
from maglev_mj.views.page import panel
from maglev_mj.views.readings import grouped
from tests.whole.test_docs import COMMANDS as COMMANDS_OF
from tests.whole.test_docs import LESSONS, PAGES, ROOT, text_of, write_files

FOLDERS = "maglev_mj", "scripts", "tests", "docs", "model", "changelog.d"
SOURCES = (
    "maglev_mj/**/*.*",
    "scripts/**/*.*",
    "tests/**/*.py",
    "model/**/*.*",
    "docs/conf.py",
    "Makefile",
    "pyproject.toml",
)
"""What declares a name that a page may use."""

CURRENT = [page for page in PAGES if page != "CHANGELOG.md"]
"""Pages of this version."""


@cache
def modules() -> Mapping[str, str]:
    """Return the source of each module of the package: its docstrings, help and messages are texts, too."""
    return {str(path.relative_to(ROOT)): path.read_text(encoding="utf-8") for path in ROOT.glob("maglev_mj/**/*.py")}


TEXTS: Mapping[str, str] = {page: text_of(page) for page in [*CURRENT, *LESSONS]}
"""What a reader reads: pages, and the text of the lessons."""


def spans(text: str) -> list[str]:
    """Return the inline code of a text, also of spans that a line break divides."""
    text = re.sub(r"^```.*?^```$", "", text, flags=re.DOTALL | re.MULTILINE)
    return [" ".join(found.split()) for found in re.findall(r"(?<!`)`([^`]+)`(?!`)", text)]


def code(text: str) -> str:
    """Return all code of a text: blocks, indented lines and spans."""
    fenced = re.findall(r"^```\w*\n(.*?)^```$", text, re.DOTALL | re.MULTILINE)
    indented = re.findall(r"^ {4,}(.*)$", text, re.MULTILINE)
    return "\n".join([*fenced, *indented, *spans(text)])


@cache
def repository() -> frozenset[str]:
    """Return all files and folders of the project, each also by its last parts."""
    tops = [path for path in ROOT.iterdir() if path.is_file() or path.name in FOLDERS]
    below = (path for top in tops if top.is_dir() for path in top.rglob("*") if "__pycache__" not in path.parts)
    hidden = (path for pattern in (".ci/*", ".github/**/*") for path in ROOT.glob(pattern))
    parts = [path.relative_to(ROOT).parts for path in [*tops, *below, *hidden]]
    return frozenset("/".join(path[first:]) for path in parts for first in range(len(path)))


def undefined(names: Iterable[tuple[str, str]], defined: Iterable[str]) -> list[str]:
    """Return the names, each with its page, that are not defined."""
    known = {*defined}
    return sorted({f"{page}: {name}" for page, name in names if name not in known})


def in_texts(pattern: str, texts: Mapping[str, str] = TEXTS) -> list[tuple[str, str]]:
    """Return what a pattern finds in each text."""
    return [(page, found) for page, text in texts.items() for found in re.findall(pattern, text)]


# extras and targets

EXTRA = re.compile(r"extras? ((?:`[\w-]+`(?:, | and |, and | or )?)+|[a-z]+(?=\)))")


def extras(text: str) -> list[str]:
    """Return the extras that a text names in words, and in what it installs."""
    words = " ".join(text.split())
    spoken = [name for part in EXTRA.findall(words) for name in re.findall(r"[\w-]+", re.sub(r" and | or ", " ", part))]
    installed = re.findall(r"(?:\.|maglev-mj|maglev_mj-[\w.-]+\.whl)\[([a-z,]+)\]", words)
    return spoken + [name for part in installed for name in part.split(",")]


def test_every_extra_of_a_page_or_message_exists() -> None:
    defined = tomllib.loads(text_of("pyproject.toml"))["project"]["optional-dependencies"]
    named = [(page, name) for page, text in {**TEXTS, **modules()}.items() for name in extras(text)]
    assert undefined(named, defined) == [] and len({page for page, _ in named}) > 15


def test_every_target_of_make_exists() -> None:
    defined = re.findall(r"^([\w-]+):(?!=)", text_of("Makefile"), re.MULTILINE)
    named = in_texts(r"(?:`|^ {4}|&& )make ([a-z][\w-]*)")
    named += [
        (page, name) for page, text in TEXTS.items() for name in re.findall(r"^ {4}make ([\w-]+)", text, re.MULTILINE)
    ]
    assert undefined(named, defined) == [] and len({name for _, name in named}) > 10


# paths

SUFFIXES = (
    "py pyi md toml xml ipynb html js json png gif mp4 wav csv gz yml c h elf bin cff lock maglev txt log".split()
)
PATH = re.compile(
    rf"[\w.*-]+(?:/[\w.*-]+)*(?:/|\.(?:{'|'.join(SUFFIXES)}))|\w[\w.*-]*(?:/[\w.*-]+)+|(?:\.\./)+[\w./-]+"
)
PRODUCTS = {
    "0/position": "key of an export to NumPy",
    "attachment/0": "key of an export to NumPy",
    "device.toml": "attachment of a recording",
    "fault-DATE.maglev": "last cycles of a flight that ended in a fault",
    "figures/flight_safety": "record of scripts/studies/flights.py",
    "friction_laws.json": "figures of scripts/studies/friction_laws.py",
    "lab.toml": "a device file of the reader's own",
    "maglev_mj/Joystick-v0": "name of an environment of gymnasium",
    "plan.json": "plan of a sweep",
    "run.csv.json": "units beside an export to CSV",
    "source/HASH/FILE.py": "attachment of a recording",
    "source/HASH/FILE.c": "attachment of a recording",
    "uv.lock": "lock file of another installer",
}
"""Names that look like a path and that no command of their page spells out, each with what it is."""


def written(text: str) -> set[str]:
    """Return the words of a text's command lines and programs, and the exports of its recordings."""
    lines = re.findall(r"^ {4,}(.*)$|`((?:maglev-mj|python|rerun) [^`]*)`", text, re.MULTILINE)
    fenced = re.findall(r"^```\w*\n(.*?)^```$", text, re.DOTALL | re.MULTILINE)
    words = {word.rstrip("/") for word in re.findall(r"[\w./*-]+", "\n".join([*map("".join, lines), *fenced]))}
    stems = {word.removesuffix(".maglev") for word in words if word.endswith(".maglev")}
    return words | {f"{stem}.{kind}" for stem in stems for kind in FORMATS}


def charts_of(page: str, folder: Path) -> set[str]:
    """Return the names of the charts that the commands of a page write, without their pixels."""
    commands = [command for command in COMMANDS_OF[page] if "--out figures" in command]
    with chdir(folder), patch("matplotlib.figure.Figure.savefig", lambda _, path, **__: Path(path).touch()):
        write_files(page, folder)
        for command in commands:
            main(command.split())
    return {name for path in folder.rglob("*.png") for name in (path.name, str(path.relative_to(folder)))}


def test_every_path_of_a_page_exists_or_is_written_by_its_commands(tmp_path: Path) -> None:
    missing, count, products = [], 0, {*PRODUCTS}
    for page, text in TEXTS.items():
        named = {span.rstrip("/") for span in spans(text) if PATH.fullmatch(span) and not span.startswith("/")}
        count += len(named)
        products -= named
        named -= repository() | written(text) | PRODUCTS.keys()
        named = {name for name in named if not any((ROOT / page).parent.glob(name)) and not any(ROOT.glob(name))}
        if drawn := {name for name in named if name.endswith(".png")}:
            named -= drawn & charts_of(page, tmp_path)
        missing += [f"{page}: {name}" for name in sorted(named)]
    assert missing == [] and count > 150 and not products


# commands, options and parameters

FOREIGN_OPTIONS = {
    ".ci/run": "--install",
    "dask": "--host --nthreads --nworkers --port",
    "mujoco.viewer": "--mjcf",
    "mypy": "--platform",
    "pip": "--constraint --editable --find-links --no-index --wheel-dir",
    "pytest": "--dist",
    "register-python-argcomplete": "--shell",
    "uv": "--all-extras --group --no-annotate --no-emit-find-links --no-emit-index-url --no-header --no-project "
    "--python-version --universal",
    "a wrong one, quoted with its answer": "--stifness",
}
"""Options of other programs."""


@cache
def options() -> frozenset[str]:
    """Return all options of the package's commands, of its scenes and of its scripts."""
    found = {"--version"}
    for name, *words in [*([name] for name in COMMANDS), ["fidelity", "drop"], *(["run", scene] for scene in BUILT_IN)]:
        parser = command_parser(name, words)
        add_options(parser, name)
        found |= {*parser._option_string_actions}
    sources = (path for path in ROOT.glob("scripts/**/*.*") if path.suffix in (".py", ".c"))  # not compiled ones
    scripts = "".join(path.read_text(encoding="utf-8") for path in sources)
    sections = re.findall(r"def measure\((.*?)\) ->", scripts, re.DOTALL)  # of scripts/benchmarks/system
    found |= {f"--{name}" for name in re.findall(r"(\w+):", "".join(sections))}
    return frozenset(found | {*re.findall(r'"(--[a-z][\w-]*)"', scripts)})


def test_every_option_of_a_page_exists() -> None:
    """Options of `maglev-mj` commands are parsed in `test_docs`; here all others too, wherever a page names them."""
    named = [(page, name) for page, text in TEXTS.items() for name in re.findall(r"(?<![\w-])--[a-z][\w-]*", text)]
    foreign = {name for words in FOREIGN_OPTIONS.values() for name in words.split()}
    own = {  # parameters of scenes that a page defines
        f"--{name.replace('_', '-')}"
        for text in TEXTS.values()
        for name in re.findall(r"^ {4}(\w+): .*= param\(", text, re.MULTILINE)
    }
    assert undefined(named, options() | foreign | own) == [] and len(named) > 500
    assert foreign <= {name for _, name in named}


def test_every_parameter_that_a_page_varies_or_sets_is_one_of_its_scene(tmp_path: Path) -> None:
    count, wrong = 0, []
    for page in TEXTS.keys() & COMMANDS_OF.keys():
        for command in COMMANDS_OF[page]:
            words = shlex.split(command)
            names = re.findall(r"--(?:vary|set) ([\w-]+(?:=\S*)?(?: [\w-]+=\S*)*)", command)
            names = [word.partition("=")[0] for group in names for word in re.split(r"[ ,](?=\w+=|pulse$)", group)]
            if names and "SCENE" not in words[1]:
                write_files(page, tmp_path)
                with chdir(tmp_path):
                    declared = {item.name for item in find_scene(words[1]).parameters()}
                count += len(names)
                wrong += [f"{page}: {name}" for name in names if name not in declared | {"rate", "plant", "phase"}]
    assert wrong == [] and count > 10


def test_every_key_of_a_device_file_on_a_page_exists() -> None:
    keys = {f"{section}.{item.name}" for section, kind in _SECTIONS.items() for item in kind.parameters()}
    named = [
        (page, span)
        for page, text in TEXTS.items()
        for span in spans(text)
        if re.fullmatch(rf"({'|'.join(_SECTIONS)})\.\w+", span)
    ]
    assert undefined(named, keys) == [] and len(named) > 40


# controls of the browser's page


LABEL = r"[`*][\w ]+[`*]"
CONTROLS = {
    "folder": rf"folder {LABEL} (?!to |\()|folder {LABEL}[:;,.]|Folders\*\*, [^.]*",
    "button": rf"(?:[Bb]uttons?|[Pp]ress) {LABEL}(?:(?: and|,) {LABEL})*",
    "slider": rf"[Ss]liders? {LABEL}",
}
"""Where a page names a control of the panel, by kind."""


def test_every_folder_button_and_slider_of_a_page_is_on_the_panel() -> None:
    parameters = Joystick.parameters()
    folders = {*grouped(parameters), *re.findall(r'add_folder\("(\w+)"', modules()["maglev_mj/views/page/panel.py"])}
    there = {
        "folder": folders,
        "button": {name for row in panel._ROWS.values() for name in row} | {EMERGENCY_STOP, *REWIND_ACTIONS},
        "slider": {item.name.replace("_", " ") for item in parameters if item.live} | {"hand", REWIND_ACTIONS[0]},
    }
    for kind, pattern in CONTROLS.items():
        named = [(page, name) for page, found in in_texts(pattern) for name in re.findall(r"[`*]([\w ]+)[`*]", found)]
        assert undefined(named, there[kind]) == [] and len(named) > 1


# counts

WORDS = dict(zip("two three four five six seven eight nine ten eleven twelve".split(), range(2, 13)))
NOTEBOOKS = len(list(ROOT.glob("docs/lessons/*.ipynb")))
COUNTED = {
    r"friction laws|laws, an ideal": len(FRICTION_LAWS),
    r"wall laws|published wall laws|others, \w+ of them as published": len(WALL_LAWS),
    r"of them as published": sum(row.status == "as published" for row in WALL_LAWS.values()),
    r"notebooks|lessons": NOTEBOOKS,
    r"built-in scenes": len(BUILT_IN),
    r"steps on the joystick|steps in a browser|steps, in a window|steps \(": len(STEPS),
}
"""Phrases that count a list of the package, with its length."""


def test_a_count_in_words_is_that_of_its_list() -> None:
    texts = {**{page: " ".join(text.split()) for page, text in TEXTS.items()}, **modules()}
    count = 0
    for phrase, length in COUNTED.items():
        for page, found in in_texts(rf"(?i)\b({'|'.join(WORDS)}|\d+) (?:{phrase})", texts):
            assert (WORDS.get(found.lower()) or int(found)) == length, f"{page}: {found} {phrase}"
            count += 1
    assert count >= 3


# identifiers

FOREIGN_WORDS = {
    "shells": "Activate ExecutionPolicy RemoteSigned Scope Scripts activate bat exe fish ps1 sudo",
    "installers and build tools": "libgcc uvx wheels",
    "MuJoCo": "launch_passive solref",
    "Dask": "deserialization",
    "Haply": "force_gate",
    "a column of a reader's table": "time_ms",
    "a law that was removed, as its paragraph says": "PredictiveWall",
}
"""Words in the code of pages that others declare."""


@cache
def declared() -> frozenset[str]:
    """Return all words of the sources, of file names, and of the options of other programs."""
    text = "".join(path.read_bytes().decode("utf-8", "ignore") for pattern in SOURCES for path in ROOT.glob(pattern))
    names = " ".join([*repository(), *FOREIGN_WORDS.values(), *FOREIGN_OPTIONS.values()])
    return frozenset(re.findall(r"\w+", f"{text} {names}"))


def test_every_word_of_inline_code_is_declared_somewhere() -> None:
    """A name that was renamed or deleted is declared nowhere. Words in capitals stand for the reader's own."""
    named, own = [], {page: {*re.findall(r"\w+", " ".join(written(text)))} for page, text in TEXTS.items()}
    for page, text in TEXTS.items():
        code = " ".join(span for span in spans(text) if " -k " not in f" {span}")
        words = {*re.findall(r"[A-Za-z_]\w{2,}", code)} - own[page]
        named += [(page, word) for word in words if not re.search(r"^[A-Z_\d]+$|^my_|[0-9a-f]{8}", word)]
    assert undefined(named, declared()) == [] and len(named) > 1000


def test_every_test_that_a_page_selects_exists() -> None:
    tests = "".join(path.read_text(encoding="utf-8") for path in ROOT.glob("tests/**/test_*.py"))
    names = " ".join(re.findall(r"def (test_\w+)", tests))
    chosen = [(page, word) for page, words in in_texts(r"-k (\w+|\"[^\"]*\")") for word in re.findall(r"\w+", words)]
    assert [f"{page}: {word}" for page, word in chosen if word not in ("or", "and", "not") and word not in names] == []
    assert len(chosen) > 10


def resolves(name: str) -> bool:
    """Return True if a dotted name leads to a module, or to an attribute of one."""
    module, _, rest = name.partition(".")
    found = import_module(module)
    for part in rest.split("."):
        with suppress(ImportError):
            import_module(f"{found.__name__}.{part}") if ismodule(found) and not hasattr(found, part) else None
        if not hasattr(found, part):
            return False
        found = getattr(found, part)
    return True


def test_every_name_that_a_page_imports_or_spells_out_resolves() -> None:
    imports = re.findall(r"from (maglev_mj[\w.]*) import \(?([\w, ]+)", "\n".join(TEXTS.values()))
    dotted = re.findall(r"`(maglev_mj(?:\.\w+)+)", "\n".join(TEXTS.values()))
    names = {f"{module}.{name}" for module, words in imports for name in re.findall(r"\w+", words)} | {*dotted}
    assert [name for name in sorted(names) if not resolves(name)] == ["maglev_mj.setups"]  # key of an export to Parquet
    assert len(names) > 80
