"""Ctrl-C at any moment: while modules load, where an exception is lost, and while processes start."""

import os
import signal
import sys
import threading
import time
from contextlib import suppress
from multiprocessing.connection import Connection
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from maglev_mj.cli.program import _interruptible
from maglev_mj.errors import MaglevError
from maglev_mj.process import SideProcess, be_nice, interrupts_held, process_start
from maglev_mj.studies.cells import local_workers
from maglev_mj.views.window import backend
from tests.processes import run

# Ctrl-C as the n-th module whose name begins so is looked for
PROGRAM = """
import os, runpy, signal, sys
at, number = sys.argv[1], int(sys.argv[2])
class Pressed:
    left = number
    @classmethod
    def find_spec(cls, name, path=None, target=None):
        if name.startswith(at):
            cls.left -= 1
            if cls.left == 0:
                os.kill(os.getpid(), signal.SIGINT)
sys.meta_path.insert(0, Pressed)
sys.argv[:3] = ["maglev-mj"]
runpy.run_module("maglev_mj", run_name="__main__", alter_sys=True)
"""
COMMANDS = {
    "card": "card --table1",
    "drop": "drop --phases 400 --out pictures",
    "scene": "stability drop",
    "sweep": "sweep drop --vary height=1e-3:4e-3:3 --workers 1",
    "render": "render drop --out a.png --size 160x160",
    "page": "view --web --port 0 --no-open --seconds 3",
    "twin": "twin --listen udp://127.0.0.1:0",
}


EARLY = [("maglev_mj.cli.", 1), ("numpy", 60), ("", 250)]
"""Moments that are the same for every command, or nearly."""


@pytest.mark.machine
@pytest.mark.parametrize(
    ("command", "module", "number"),
    [*((name, "maglev_mj.", 30) for name in COMMANDS), *(("drop", *moment) for moment in EARLY), ("page", "numpy", 1)],
)
def test_no_traceback_while_a_command_loads(command: str, module: str, number: int, tmp_path: Path) -> None:
    done = run(sys.executable, "-c", PROGRAM, module, str(number), *COMMANDS[command].split(), cwd=tmp_path)
    # a twin that has begun to serve before the signal reaches it is ended by it, as by any Ctrl-C
    served = command == "twin" and "no faults" in done.output
    assert done.status == (0 if served else 130), done
    assert "Traceback" not in done.errors and "ignored" not in done.errors


def test_a_thread_leaves_signals_alone() -> None:
    failed = list[BaseException]()

    def work() -> None:
        try:
            with _interruptible(), interrupts_held():
                pass
        except BaseException as error:
            failed.append(error)

    thread = threading.Thread(target=work)
    thread.start()
    thread.join()
    assert not failed


def test_it_waits_while_a_process_starts_though_another_thread_takes_the_signal() -> None:
    # threads of libraries do not block it: then it reaches this one's handler all the same
    done = False
    threading.Thread(target=time.sleep, args=(1.0,), daemon=True).start()
    with pytest.raises(KeyboardInterrupt):
        with interrupts_held():
            os.kill(os.getpid(), signal.SIGINT)
            time.sleep(0.01)
            done = True
    assert done


def test_a_process_whose_start_is_interrupted_ends_with_it(monkeypatch: pytest.MonkeyPatch) -> None:
    closed = list[float]()
    close = SideProcess.close

    def closing(process: SideProcess, patience: float = 10.0) -> None:
        close(process, patience)
        closed.append(patience)
        assert not process._process.is_alive()

    monkeypatch.setattr(SideProcess, "close", closing)
    # not the module itself, with which libraries register while they load
    at_exit = SimpleNamespace(register=lambda _: os.kill(os.getpid(), signal.SIGINT), unregister=lambda _: None)
    monkeypatch.setattr("maglev_mj.process.atexit", at_exit)
    with pytest.raises(KeyboardInterrupt):
        SideProcess(time.sleep, 30.0)
    assert closed == [0.0]


def echo(line: Connection) -> None:
    with suppress(EOFError):
        while True:
            line.send(line.recv())


def test_processes_start_and_answer_without_what_windows_lacks(monkeypatch: pytest.MonkeyPatch) -> None:
    # There `select` takes sockets alone, which a Pipe is not, and the tracker of shared resources cannot start.
    def missing(*_: object, **__: object) -> None:
        raise ModuleNotFoundError("No module named '_posixsubprocess'")

    for name in ("fork", "nice"):
        monkeypatch.delattr(os, name)
    monkeypatch.setattr("multiprocessing.connection.Pipe", missing)
    monkeypatch.setattr("multiprocessing.resource_tracker.ensure_running", missing)
    process = SideProcess(echo)
    try:
        assert process.ready
        process.send({"a": 1})
        assert process.line.poll(60.0) and list(process.received()) == [{"a": 1}]
    finally:
        process.close()
    with process_start():
        pass
    be_nice()


def test_a_frozen_program_in_place_of_its_worker_starts_no_other(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "frozen", True, raising=False)
    for word in ("--multiprocessing-fork", "from multiprocessing.resource_tracker import main;main(3)"):
        monkeypatch.setattr(sys, "argv", ["app", word])
        for start in (lambda: SideProcess(repr), lambda: local_workers(1).make()):
            with pytest.raises(MaglevError, match="freeze_support"):
                start()
    with pytest.raises(backend.DisplayError, match="MUJOCO_GL"):
        backend._first_working.__wrapped__()


def test_what_is_sent_to_a_process_that_has_ended_is_lost_but_not_what_it_sent_last() -> None:
    process = SideProcess(Connection.send, "closed")
    process._process.join()
    process.send("too much")
    assert list(process.received()) == ["closed"] and process.ended and not process.ready
    process.send("more")
    assert list(process.received()) == []
    process.close()
    process.close()


@pytest.mark.parametrize("before", [signal.SIG_IGN, signal.SIG_DFL, lambda *_: None])
def test_the_handler_before_a_command_is_back_after_it_and_an_ignored_signal_stays_ignored(before: Any) -> None:
    earlier, raised = signal.signal(signal.SIGINT, before), False
    try:
        try:
            with _interruptible():
                signal.raise_signal(signal.SIGINT)
        except KeyboardInterrupt:
            raised = True
        assert raised == (before is not signal.SIG_IGN)
        assert signal.getsignal(signal.SIGINT) is before
    finally:
        signal.signal(signal.SIGINT, earlier)
