"""Settings of the tests of commands."""

from functools import cache

import pytest

from maglev_mj.scenes import names

installed = cache(names.installed_scenes)


@pytest.fixture(autouse=True)
def scenes_are_looked_up_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """Look up the scenes of other packages once; each parser does, which takes ten times as long as the parser."""
    monkeypatch.setattr(names, "installed_scenes", installed)
