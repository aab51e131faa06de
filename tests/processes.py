"""Programs that run beside a test, and commands that run within it."""

from __future__ import annotations

import io
import os
import re
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, redirect_stderr, redirect_stdout
from dataclasses import replace
from inspect import unwrap
from pathlib import Path
from typing import Any, NamedTuple, cast
from unittest.mock import patch

from maglev_mj import cli
from maglev_mj.bridge import Twin, TwinParameters
from maglev_mj.bridge.links import UdpServer
from maglev_mj.bridge.remote import RemotePlant
from maglev_mj.bridge.twin.twin import TwinServer

COMMAND = [sys.executable, "-m", "maglev_mj"]
PATIENCE = 60.0
WEAK = "--stiffness", "2000", "--damping", "30"
"""Options of a flight whose walls are stable up to 8 ms, which a busy machine's line needs."""
ADDRESS = r"(?:udp|serial)://\S+?(?=,|\s)"


class Outcome(NamedTuple):
    """Exit status and output of a program that has ended."""

    status: int
    output: str
    errors: str


class Program:
    """Running program with its output so far.

    Args:
        arguments: Program and its arguments.
        env: Environment variables beside those of this process.
        cwd: Working folder.

    Attributes:
        child: The process, with an open standard input.
    """

    def __init__(self, *arguments: str, env: Mapping[str, str] | None = None, cwd: Path | None = None) -> None:
        pipe = subprocess.PIPE
        environment = {**os.environ, **(env or {})}
        self.child = subprocess.Popen(arguments, stdin=pipe, stdout=pipe, stderr=pipe, env=environment, cwd=cwd)
        self._output, self._errors, self._lines = bytearray(), bytearray(), 0
        self._readers = [
            threading.Thread(target=self._read, args=(self.child.stdout, self._output)),
            threading.Thread(target=self._read, args=(self.child.stderr, self._errors)),
        ]
        for reader in self._readers:
            reader.start()

    @staticmethod
    def _read(stream: io.BufferedReader, into: bytearray) -> None:
        while part := stream.read1():
            into += part

    @property
    def output(self) -> str:
        """Standard output so far."""
        return self._output.decode()

    @property
    def errors(self) -> str:
        """Standard error so far."""
        return self._errors.decode()

    def wait_for(self, pattern: str) -> str:
        """Wait for text in the output.

        Args:
            pattern: Regular expression.

        Returns:
            Its first group, or all of the match if it has none.
        """
        deadline = time.monotonic() + PATIENCE
        while time.monotonic() < deadline:
            ended = self.child.poll() is not None
            if ended:  # the last of its output may still be on the way
                self._join()
            if match := re.search(pattern, self.output, re.MULTILINE):
                return match[1] if match.re.groups else match[0]
            if ended:
                break
            time.sleep(0.01)
        raise AssertionError((pattern, self.output, self.errors))

    def line(self) -> str:
        """Wait for the next line of the output."""
        deadline = time.monotonic() + PATIENCE
        while self.output.count("\n") <= self._lines:
            assert time.monotonic() < deadline, (self.output, self.errors)
            time.sleep(0.001)
        self._lines += 1
        return self.output.splitlines()[self._lines - 1].strip()

    def end(self, number: int | None = signal.SIGINT) -> Outcome:
        """Send a signal and wait for the end.

        Args:
            number: The signal; None to send none.
        """
        if number is not None:
            self.child.send_signal(number)
        status = self.child.wait(PATIENCE)
        self._join()
        return Outcome(status, self.output, self.errors)

    def close(self) -> None:
        """Kill the program if it still runs."""
        self.child.kill()
        self.child.wait()
        self._join()
        for stream in (self.child.stdin, self.child.stdout, self.child.stderr):
            assert stream is not None
            stream.close()

    def _join(self) -> None:
        for reader in self._readers:
            reader.join()


@contextmanager
def running(*arguments: str, env: Mapping[str, str] | None = None, cwd: Path | None = None) -> Iterator[Program]:
    """Start a program, which is killed at the end in any case."""
    program = Program(*arguments, env=env, cwd=cwd)
    try:
        yield program
    finally:
        program.close()


@contextmanager
def started(*arguments: str, env: Mapping[str, str] | None = None, cwd: Path | None = None) -> Iterator[Program]:
    """Start a command of maglev-mj, which is killed at the end in any case."""
    with running(*COMMAND, *arguments, env=env, cwd=cwd) as program:
        yield program


@contextmanager
def twin(*options: str, listen: str = "udp://127.0.0.1:0") -> Iterator[tuple[Program, str]]:
    """Start a twin; yield it and its address."""
    with started("twin", "--listen", listen, *options) as program:
        yield program, program.wait_for(ADDRESS)


def ended(program: Program, number: int | None = signal.SIGINT) -> tuple[int, str]:
    """End a program as `Program.end` does; return its status and all output."""
    status, output, errors = program.end(number)
    return status, output + errors


def run(*arguments: str, env: Mapping[str, str] | None = None, cwd: Path | None = None) -> Outcome:
    """Run a program to its end."""
    environment = {**os.environ, **(env or {})}
    done = subprocess.run(arguments, env=environment, cwd=cwd, capture_output=True, text=True, timeout=2 * PATIENCE)
    return Outcome(done.returncode, done.stdout, done.stderr)


def run_here(*arguments: str) -> Outcome:
    """Run a command of maglev-mj in this process."""
    with redirect_stdout(io.StringIO()) as output, redirect_stderr(io.StringIO()) as errors:
        try:
            status = cli.main(arguments)
        except SystemExit as ending:
            status = int(ending.code or 0)
    return Outcome(status, output.getvalue(), errors.getvalue())


def said_by(*arguments: str) -> tuple[int, str]:
    """Run a command as `run_here` does; return its status and all output."""
    status, output, errors = run_here(*arguments)
    return status, output + errors


@contextmanager
def lockstep_twin(parameters: TwinParameters) -> Iterator[str]:
    """Yield the address of a twin in a thread; hosts here wait long for it.

    A busy machine may let it stand for more than the usual second.
    """
    server = UdpServer("127.0.0.1", 0)
    twin = TwinServer(Twin(replace(parameters, lockstep=True)), server)
    thread = threading.Thread(target=twin.run)
    thread.start()
    try:
        with patch.dict(cast(Any, unwrap(RemotePlant.__init__)).__kwdefaults__, patience=30.0):
            yield "udp://{}:{}".format(*server.address)
    finally:
        twin.stop()
        thread.join()
        server.close()
