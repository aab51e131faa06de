"""The command `view`, with each snapshot as a line of JSON in a file.

    python tests/views/watched_view.py FILE SCENE [options of view]

A line has tick, state, scene, pose, whether the hand holds the knob, its wrench, and all parameters.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Sequence
from typing import Any
from unittest.mock import patch

from maglev_mj.cli import main
from maglev_mj.session import Publisher, Publishers, Snapshot


class Lines:
    """Publisher that appends to a file.

    Args:
        path: Path of the file; emptied.
    """

    def __init__(self, path: str) -> None:
        self._file = open(path, "w", buffering=1, encoding="utf-8")

    def take(self) -> None:
        """Request nothing."""

    def show(self, snapshot: Snapshot) -> None:
        """Write a line."""
        seen = {"tick": snapshot.tick, "pose": snapshot.pose.tolist(), "hand": snapshot.hand.tolist()}
        named = {"scene": snapshot.scene.name, "state": snapshot.state, "held": snapshot.target is not None}
        self._file.write(json.dumps({**snapshot.scene.as_json(), **named, **seen}) + "\n")

    def close(self) -> None:
        """Close the file."""
        self._file.close()


if __name__ == "__main__":
    begin, file = Publishers.__init__, Lines(sys.argv[1])

    def watched(self: Publishers, publishers: Sequence[Publisher] = (), **options: Any) -> None:
        """Begin with the file as a further publisher."""
        begin(self, [*publishers, file], **options)

    with patch.object(Publishers, "__init__", watched):
        sys.exit(main(["view", *sys.argv[2:]]))
