"""Virtual screen with a mouse and keys by xdotool."""

from __future__ import annotations

import ctypes
import ctypes.util
import os
import subprocess
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from tests.conftest import COMPILER

__all__ = ["VirtualScreen"]


class VirtualScreen:
    """X server for the duration of a context."""

    def __init__(self, width: int, height: int) -> None:
        self._size = f"{width}x{height}x24"

    def __enter__(self) -> Self:
        read, write = os.pipe()
        self._server = subprocess.Popen(
            # without a reset when xdotool, for a moment the only client, goes: a window that comes then is turned away
            ["Xvfb", "-displayfd", str(write), "-screen", "0", self._size, "-nolisten", "tcp", "-noreset"],
            pass_fds=[write],
            stderr=subprocess.DEVNULL,
        )
        os.close(write)
        with os.fdopen(read) as pipe:
            self.display = f":{pipe.readline().strip()}"
        # drawn by one thread, a few times a second: a window that waits for no screen would keep every core from all
        software = {"LIBGL_ALWAYS_SOFTWARE": "1", "LP_NUM_THREADS": "0"}
        self.environment = {**os.environ, "DISPLAY": self.display, **software}
        for name in ("WAYLAND_DISPLAY", "MUJOCO_GL"):
            self.environment.pop(name, None)
        self._folder = tempfile.TemporaryDirectory()
        if COMPILER is not None:
            library = Path(self._folder.name) / "slow_screen.so"
            source = Path(__file__).with_name("slow_screen.c")
            subprocess.run([COMPILER, "-shared", "-fPIC", source, "-o", library, "-ldl"], check=True)
            self.environment["LD_PRELOAD"] = str(library)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._folder.cleanup()
        self._server.terminate()
        self._server.wait(60.0)

    def xdotool(self, *arguments: object) -> str:
        """Move the mouse or press keys; return xdotool's output."""
        done = subprocess.run(
            ["xdotool", *map(str, arguments)], env=self.environment, capture_output=True, text=True, timeout=60
        )
        assert not done.stderr, f"xdotool {arguments}: {done.stderr}"
        return done.stdout.strip()

    def window(self, name: str, patience: float = 60.0) -> int:
        """Return the number of a window by name, once present."""
        found = waited(lambda: self.xdotool("search", "--onlyvisible", "--name", name), patience)
        return int(str(found).split()[-1])

    def close(self, window: int) -> None:
        """Ask a window to close, as its close button does.

        Without a window manager that is a message to it.
        """
        x11 = ctypes.CDLL(ctypes.util.find_library("X11") or "libX11.so.6")
        x11.XOpenDisplay.restype = ctypes.c_void_p
        x11.XInternAtom.restype = ctypes.c_ulong
        server = ctypes.c_void_p(x11.XOpenDisplay(self.display.encode()))
        atom = [x11.XInternAtom(server, name, 0) for name in (b"WM_PROTOCOLS", b"WM_DELETE_WINDOW")]

        class Message(ctypes.Structure):
            _fields_ = (
                ("type", ctypes.c_int),
                ("serial", ctypes.c_ulong),
                ("send_event", ctypes.c_int),
                ("display", ctypes.c_void_p),
                ("window", ctypes.c_ulong),
                ("message_type", ctypes.c_ulong),
                ("format", ctypes.c_int),
                ("data", ctypes.c_long * 5),
                ("room", ctypes.c_char * 192),  # an event is a union of this size at most
            )

        message = Message(type=33, window=window, message_type=atom[0], format=32)
        message.data[0] = atom[1]
        x11.XSendEvent(server, ctypes.c_ulong(window), 0, ctypes.c_long(0), ctypes.byref(message))
        x11.XFlush(server)
        x11.XCloseDisplay(server)


def waited(ask: Callable[[], Any], patience: float) -> Any:
    """Return the first answer that is not empty."""
    end = time.monotonic() + patience
    while not (answer := ask()):
        assert time.monotonic() < end, "waited in vain"
        time.sleep(0.1)
    return answer
