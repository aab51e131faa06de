"""Numbers on pages are those that the commands of the page print.

A block of text is compared with what the commands, or the Python, above it print; so is a comment behind a statement of
Python. Numbers in words or in a table are held by a comment right below them, which a reader does not see:

    <!-- numbers of: maglev-mj card; maglev-mj card --rate 1000 --delay 0.0005 except 3 0.4 -->

Each number of that paragraph, list item or table must then be printed by one of the commands, or be an argument of
one, but for inline code and the numbers after `except`. `numbers of (study)` is run by `make studies` alone, `each row`
stands for the command in each row of a table. Other commands are `python -c "..."`, and `python` for the Python of the
page.
"""

from __future__ import annotations

import io
import math
import re
import shlex
import tempfile
import textwrap
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, chdir, redirect_stderr, redirect_stdout
from functools import cache
from pathlib import Path
from typing import NamedTuple

import pytest

from maglev_mj.bridge import TwinParameters
from maglev_mj.cli import main
from tests.processes import lockstep_twin
from tests.whole.test_docs import FULL, LESSONS, PAGES, RUNNING, blocks, run_page, shared, text_of, write_files

PRESS = "press --plant exact --hits 1 --quantize 5e-6 --record run.maglev", "analyse run.maglev"
"""A press over a sensor of 5 µm, as two pages say in words."""

OTHER_FLOTOR = """python -c "
from pathlib import Path
import pictures
from maglev_mj.cli import main
main('run drop --mass 0.75 --quantize 5e-6 --record run.maglev'.split())
pictures.assume_mass(Path('run.maglev'), 0.7)
main(['analyse', 'run.maglev'])"
"""
"""A recording whose metadata state another mass: that of the picture beside it."""

WRONG_LAWS = """python -c "
import math
from maglev_mj import AxisLaw, ParameterError, check_law
class A(AxisLaw):
    def force(self, x, v, gains, state):
        return -math.sin(x)
class B(AxisLaw):
    def force(self, x, v, gains, state):
        if x < 0.0:
            return -x
        return 0.0
class C(AxisLaw):
    def force(self, x, v, gains, state):
        return -100.0 * x**3
for law in (A, B, C):
    try:
        check_law(law(axes='x'))
    except ParameterError as error:
        print(error)"
"""
"""Laws with the mistakes of the table above the quote."""

BEFORE: dict[tuple[str, int], Sequence[str]] = {
    ("docs/howto/record.md", 0): PRESS,
    ("docs/howto/law.md", 0): (WRONG_LAWS,),
    ("docs/explanation/analysis.md", 0): (OTHER_FLOTOR,),
    ("docs/explanation/analysis.md", 1): PRESS,
    ("docs/howto/drive_an_inverse3.md", 0): (),  # its Python alone
}
"""What is typed before a quote, where it is not the lines above it."""

NOT_TYPED = {
    ("docs/explanation/bridge.md", 1): "checks of three devices, one of them with a fault",
    ("docs/explanation/bridge.md", 0): "times of a flight on a busy machine",
}
"""Quotes that no command prints as they stand."""

SHOWN = re.compile(r"view|tour|twin|.*--(?:web|help)")
_NUMBER = re.compile(r"[-+]?\d+(?:\.\d+)?(?:e[-+]?\d+)?")


def quotes(page: str) -> Iterator[tuple[int, list[str], str]]:
    """Yield place, commands since the one before, and text of each quote."""
    lines: list[str] = []
    for place, (before, quoted) in enumerate(blocks(page, "text")):
        between = text_of(page).splitlines()[len(lines) : before]
        lines += [*between, *quoted.splitlines()]
        typed_in = [match[1] for line in between if (match := re.match(r"    maglev-mj (.*?)(?: *#.*)?$", line))]
        yield place, [line for line in typed_in if not SHOWN.match(line)], quoted


LONG = {
    ("docs/howto/c_law.md", 1),
    ("docs/howto/compare.md", 0),
    ("docs/howto/compare.md", 1),
    ("docs/howto/fly.md", 0),
    ("docs/tutorials/own_law.md", 4),
    ("docs/tutorials/own_law.md", 5),
}
"""Quotes of commands that take seconds: studies."""

QUOTED = [
    pytest.param(
        page,
        [*BEFORE.get((page, place), commands)],
        quoted,
        id=f"{page} {place}",
        marks=[pytest.mark.study] if (page, place) in LONG else shared("press" if (page, place) in BEFORE else page),
    )
    for page in PAGES
    if page != "docs/gallery.md"  # scripts, see test_examples
    for place, commands, quoted in quotes(page)
    if (page, place) not in NOT_TYPED
]


@cache
def said_by(*commands: str, page: str = "") -> str:
    """Return all that commands print beside the files of a page, once per process.

    A device is one in lockstep, with the delay of a line.
    """
    out = io.StringIO()
    with ExitStack() as flight, redirect_stdout(out), redirect_stderr(out):
        flight.enter_context(chdir(flight.enter_context(tempfile.TemporaryDirectory())))
        if page:
            write_files(page, Path())
        for command in commands:
            if command.startswith("bridge"):
                address = flight.enter_context(lockstep_twin(TwinParameters(delay=0.0025)))
                command = re.sub(r"udp://\S+", address, command)
            main(re.sub(r"(?<=--workers )\d+", "0", re.sub(r" --out (?!\S+\.maglev)\S+", "", command)).split())
    return out.getvalue()


def last_digit(number: str) -> float:
    """Return one unit in the last printed digit of a number."""
    mantissa, _, exponent = number.partition("e")
    return 10.0 ** (int(exponent or 0) - len(mantissa.partition(".")[2]))


def alike(quoted: str, said: str, numbers: bool) -> bool:
    """Tell whether two words are the same, numbers to the last printed digit; rounding errors are below 1e-12."""
    if _NUMBER.sub("0", quoted) != _NUMBER.sub("0", said):
        return quoted == "..."
    pairs = zip(_NUMBER.findall(quoted), _NUMBER.findall(said), strict=True)
    return not numbers or all(
        math.isclose(float(one), float(other), rel_tol=1e-9, abs_tol=max(last_digit(one), 1e-12))
        for one, other in pairs
    )


@pytest.mark.parametrize(("page", "commands", "quoted"), QUOTED)
def test_what_a_page_quotes_is_what_its_commands_print(page: str, commands: list[str], quoted: str) -> None:
    own = "" if commands == [*PRESS] else page  # which two pages have
    if commands and not commands[0].startswith("python"):
        words = said_by(*commands, page=own).split()
    else:
        words = printed(page, commands[0] if commands else "python").split()
    is_flight, start = "latency [ms]" in quoted, 0
    for line in quoted.splitlines():
        wanted = line.split()
        if line.startswith("  sample age"):  # has none in lockstep
            continue
        numbers = not is_flight and "of the answers exceed" not in line  # times of a link vary
        places = range(start, len(words) - len(wanted) + 1)
        found = [place for place in places if all(map(alike, wanted, words[place:], [numbers] * len(wanted)))]
        assert found, f"{page}: {line!r} is not in {' '.join(words)}"
        start = found[0] + len(wanted)


TIE = re.compile(r"<!-- numbers of( \(study\))?: (.*?)(?: except ([\d.\s]+))? -->", re.DOTALL)
_WRITTEN = re.compile(r"(?<![\w.])(\d{1,3}(?: \d{3})+(?!\d)|\d+)(\.\d+)?(e-?\d+)?(?![\w])")
"""A number in words, without its sign: 10 173, 0.5, 1e-14."""


def written_numbers(text: str) -> list[str]:
    """Return the numbers in words, without signs and blanks."""
    return ["".join(match.groups("")).replace(" ", "") for match in _WRITTEN.finditer(text)]


def numbers_of(output: str) -> list[float]:
    """Return the numbers in what a command prints."""
    return [float(number) for number in [*written_numbers(output), *_NUMBER.findall(output)]]


class Tie(NamedTuple):
    """Numbers of a paragraph, list item or table, and the commands that print them."""

    page: str
    text: str
    commands: tuple[str, ...]
    exceptions: str
    is_study: bool

    @property
    def numbers(self) -> list[str]:
        """Numbers of the text that a command must print."""
        text = re.sub(r"`[^`]*`|\]\([^)]*\)|<!--.*?-->", "", self.text, flags=re.DOTALL)
        return [number for number in written_numbers(text) if number not in self.exceptions.split()]


def ties(page: str) -> Iterator[Tie]:
    """Yield the ties of a page, in order."""
    text = text_of(page)
    for match in TIE.finditer(text):
        block: list[str] = []
        for line in reversed(text[: match.start()].rstrip().splitlines()):
            if (
                not line.strip()
                or line.startswith(("#", "```"))
                or (block and line.startswith("|") != block[0].startswith("|"))
            ):
                break
            block.insert(0, line)
            if re.match(r" *(?:- |\d+\. )", line):
                break
        rows = [(row, tuple(re.findall(r"`(maglev-mj [^`]*)`", row))) for row in block]
        if match[2] != "each row":
            commands = re.split(r";\s+(?=maglev-mj |python)", match[2])
            rows = [("\n".join(block), tuple(commands))]
        yield from (Tie(page, row, commands, match[3] or "", bool(match[1])) for row, commands in rows if commands)


def printed(page: str, command: str) -> str:
    """Return what a command of a tie prints: commands of one folder are joined by `&&`."""
    if command == "python":
        return "\n".join(run_page(page).lines)
    if command.startswith("python -c "):
        out = io.StringIO()
        with tempfile.TemporaryDirectory() as folder, chdir(folder), redirect_stdout(out):
            exec(compile(textwrap.dedent(shlex.split(command)[2]), page, "exec", dont_inherit=True), {"__name__": page})
        return out.getvalue()
    return said_by(*(part.strip().removeprefix("maglev-mj ") for part in command.split("&&")), page=page)


def is_printed(number: str, printed: Sequence[float]) -> bool:
    """Tell whether one of the printed values rounds to a number; of three digits and more, also with another prefix."""
    tolerance, digits = (
        max(0.5000001 * last_digit(number), 1e-12 * float(number)),
        len(re.sub(r"e.*|\D", "", number).lstrip("0")),
    )
    scales = (1.0, 1e3, 1e-3, 1e6, 1e-6) if digits >= 3 else (1.0,)
    return any(abs(abs(value) * scale - float(number)) <= tolerance for value in printed for scale in scales)


TIES = [tie for page in [*PAGES, *LESSONS] for tie in ties(page)]


NOT_RESULTS = "(2, 2), NaN", "or the device's service", "or a list of phases", "8 devices as a batch", "multiples of"
"""Beginnings of comments whose numbers are no results."""


@pytest.mark.parametrize("page", [pytest.param(page, marks=shared(page)) for page in RUNNING if page not in FULL])
def test_a_result_in_a_comment_is_that_of_its_statement(page: str) -> None:
    for comment, result in run_page(page).comments:
        if not comment.startswith(NOT_RESULTS):
            values = numbers_of(result)
            assert [number for number in written_numbers(comment) if not is_printed(number, values)] == [], result


@pytest.mark.parametrize(
    "tie",
    [
        pytest.param(
            tie,
            id=f"{tie.page} {' '.join(tie.text.split())[:30]}",
            marks=[pytest.mark.study] if tie.is_study else shared(tie.page),
        )
        for tie in TIES
    ],
)
def test_the_numbers_of_a_paragraph_are_those_that_its_commands_print(tie: Tie) -> None:
    stated = [command for command in tie.commands if not command.startswith("python")]
    output = "\n".join([*stated, *(printed(tie.page, command) for command in tie.commands)])
    values = numbers_of(output)
    assert tie.numbers and [number for number in tie.numbers if not is_printed(number, values)] == [], output
