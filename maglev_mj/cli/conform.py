"""`maglev-mj conform`: a host that tests a device."""

from __future__ import annotations

import argparse
import json
import signal
import sys
from contextlib import ExitStack, closing
from pathlib import Path

from maglev_mj.bridge.bench.calibration import Calibration
from maglev_mj.bridge.conformance import CheckResult, checks, conform
from maglev_mj.bridge.links import open_link, parse_url
from maglev_mj.bridge.realtime import realtime
from maglev_mj.cli.arguments import Parser
from maglev_mj.cli.options import add_calibration, add_key, chosen_key
from maglev_mj.cli.progress import Progress
from maglev_mj.terminal import say, wrapped
from maglev_mj.versions import versions

_WORDS = {True: "pass", False: "FAIL", None: "skip"}
_FORMAT = "maglev_mj conformance 1"


def add_options(parser: Parser) -> None:
    """Add the options of the command."""
    parser.description = (
        "Test a device against docs/reference/protocol.md: first with at most half the currents that carry its flotor, "
        "then in flight, where the flotor is dropped onto its stops. Keep hands off. Ctrl-C lands and cuts. Exit "
        "status 0 if every check passes, 1 if one fails."
    )
    parser.add_argument("address", metavar="ADDRESS", help="udp://HOST:PORT, or serial:///PATH?baud=RATE")
    add_calibration(parser)
    add_key(parser)
    parser.group("run").add_argument("--no-flight", action="store_true", help="leave out the checks that fly")
    parser.group("output").add_argument("--json", metavar="FILE", type=Path, help="write the report here as well")
    parser.set_defaults(run=_conform)


def _conform(options: argparse.Namespace) -> int:
    key = chosen_key(options.key)
    calibration = Calibration.nominal() if options.calibration is None else Calibration.load(options.calibration)
    for name in ("SIGTERM", "SIGHUP"):  # as Ctrl-C: a flight is landed
        if hasattr(signal, name):
            signal.signal(getattr(signal, name), signal.default_int_handler)
    with ExitStack() as last:
        peers = 2 if parse_url(options.address).scheme == "udp" else 1
        links = [last.enter_context(closing(open_link(options.address, key))) for _ in range(peers)]
        for complaint in last.enter_context(realtime("ignore")):
            say(f"  not in real time: {complaint}", sys.stderr)
        progress = last.enter_context(Progress("conform"))
        every, results = len(checks()), list[CheckResult]()

        def tell(result: CheckResult) -> None:
            results.append(result)
            with progress.aside():
                _tell(result)
            progress(len(results), every)

        conform(links, calibration, key, flight=not options.no_flight, tell=tell)
    counts = {word: sum(one.passed is value for one in results) for value, word in _WORDS.items()}
    say("  " + ", ".join(f"{count} {word}" for word, count in counts.items()))
    if options.json is not None:
        checked = [one._asdict() for one in results]
        report = {"format": _FORMAT, "address": options.address, "versions": versions()}
        options.json.write_text(
            json.dumps({**report, "counts": counts, "checks": checked}, indent=1) + "\n",
            "utf-8",
        )
    return 1 if counts["FAIL"] else 0


def _tell(result: CheckResult) -> None:
    for line in wrapped(f"{_WORDS[result.passed]}  {result.name}: {result.expected}; {result.seen}", further=" " * 8):
        say(line)
