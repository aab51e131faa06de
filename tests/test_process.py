"""Processes at the other end of a pipe."""

from contextlib import closing
from multiprocessing.connection import Connection

import pytest

from maglev_mj.process import SideProcess

pytestmark = pytest.mark.machine


def say(line: Connection) -> None:
    """Send a last message and end."""
    line.send("closed")
    line.close()


def test_the_last_message_of_a_process_is_received_after_a_message_that_it_could_not_take() -> None:
    with closing(SideProcess(say)) as process:
        process._process.join()
        process.send("too much")
        assert list(process.received()) == ["closed"] and process.ended
