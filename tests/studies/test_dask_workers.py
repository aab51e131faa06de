"""Dask cluster of real processes: other code, lost scheduler."""

import json
import os
import random
import re
import shutil
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from maglev_mj.cli import main
from maglev_mj.scenes.drop import Drop
from maglev_mj.studies.cells import WorkersError, dask_workers, run_cells
from maglev_mj.studies.record import Record, _read_table
from maglev_mj.studies.sweep import Grid, run_scene_cells, sweep
from maglev_mj.versions import versions

pytestmark = [pytest.mark.machine, pytest.mark.filterwarnings("ignore")]

ROOT = Path(__file__).resolve().parents[2]
_PATIENCE = 60.0


def wait_until(condition: Callable[[], object], why: str) -> None:
    deadline = time.monotonic() + _PATIENCE
    while not condition():
        assert time.monotonic() < deadline, why
        time.sleep(0.05)


@contextmanager
def dask(program: str, *arguments: str, code: Path | None = None) -> Iterator[subprocess.Popen[bytes]]:
    """Run a Dask program, with the package of a folder."""
    # -P: modules must not come from the folder that the test runs in
    command = [sys.executable, "-P", "-m", f"distributed.cli.dask_{program}", "--no-dashboard", *arguments]
    env = {**os.environ, **({} if code is None else {"PYTHONPATH": str(code)})}
    process = subprocess.Popen(command, env=env, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    try:
        yield process
    finally:
        process.kill()
        process.wait()


class Cluster:
    """A scheduler of its own process."""

    def __init__(self, address: str, process: subprocess.Popen[bytes]) -> None:
        self.address, self.process = address, process

    def workers(self) -> list[str]:
        from distributed import Client

        with Client(self.address, set_as_default=False) as client:
            return sorted(client.nthreads())

    def transitions(self) -> int:
        """Return how many changes its tasks have made."""
        from distributed import Client

        with Client(self.address, set_as_default=False) as client:
            count: int = client.run_on_scheduler(lambda dask_scheduler: dask_scheduler.transition_counter)
        return count

    @contextmanager
    def worker(self, code: Path | None = None, wait: bool = True) -> Iterator[str]:
        """Start a worker; return its address."""
        before = set(self.workers())
        options = ["--host", "127.0.0.1", "--nthreads", "1", "--no-nanny"]
        with dask("worker", self.address, *options, code=code):
            if not wait:
                yield ""
                return
            wait_until(lambda: set(self.workers()) - before, "no worker came")
            (address,) = set(self.workers()) - before
            yield address


@pytest.fixture(scope="module")
def lasting(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Cluster]:
    with made_cluster(tmp_path_factory.mktemp("dask") / "scheduler.json") as cluster:
        yield cluster


@pytest.fixture
def cluster(lasting: Cluster) -> Cluster:
    """Return the scheduler of this file, without workers of the test before."""
    wait_until(lambda: not lasting.workers(), "the workers of the test before stay")
    return lasting


@pytest.fixture
def mortal(tmp_path: Path) -> Iterator[Cluster]:
    """Yield a scheduler that a test kills."""
    with made_cluster(tmp_path / "scheduler.json") as cluster:
        yield cluster


@contextmanager
def made_cluster(told: Path) -> Iterator[Cluster]:
    with dask("scheduler", "--host", "127.0.0.1", "--port", "0", "--scheduler-file", str(told)) as process:
        wait_until(told.exists, "no scheduler came")
        wait_until(lambda: told.read_text().endswith("}"), "no scheduler came")
        yield Cluster(json.loads(told.read_text())["address"], process)


def copy_of_package(folder: Path, file: str, line: str) -> Path:
    """Return a copy of the package with one added line."""
    for name in ("maglev_mj", "model"):
        shutil.copytree(ROOT / name, folder / name)
    with (folder / "maglev_mj" / file).open("a") as end:
        end.write(f"\n{line}\n")
    return folder


def gravity(folder: Path) -> Path:
    """Return a package of this version with less gravity."""
    return copy_of_package(folder, "spec.py", "GRAVITY = 9.0")


def test_workers_of_other_code_are_refused_by_name_before_any_cell(
    cluster: Cluster, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    record, out = tmp_path / "cells", tmp_path / "out.json"
    command = ["sweep", "drop", "--vary", "phase=0:0.9:4", "--set", "plant=exact", "--scheduler", cluster.address]
    command += ["--record", str(record), "--json", str(out)]
    with cluster.worker() as good:
        for what, code in (
            ("sources", gravity(tmp_path / "a")),
            ("code not available", copy_of_package(tmp_path / "b", "versions.py", "del versions")),
        ):
            with cluster.worker(code) as bad:
                assert main(command) == 1
                said = capsys.readouterr()
                assert said.out == "" and len(said.err.splitlines()) == 1
                assert f"workers must run the code of this process: {bad}: {what}" in said.err
                assert good not in said.err and not record.exists()
        wait_until(lambda: cluster.workers() == [good], "the other workers stay")
        assert main(command) == 0
    results = json.loads(out.read_text())["results"]
    assert results == run_scene_cells(Grid(Drop(), {"phase": [0.0, 0.3, 0.6, 0.9]}, plant="exact"))
    assert json.loads((record / "plan.json").read_text())["versions"] == versions()


def test_a_worker_of_other_code_that_joins_late_takes_no_cell(cluster: Cluster, tmp_path: Path) -> None:
    cells = list(Grid(Drop(duration=2.0), {"phase": [k / 2000 for k in range(2000)]}, plant="mujoco"))
    path, late = tmp_path / "record", cluster.worker(gravity(tmp_path / "a"), wait=False)
    joined: list[str] = []

    def progress(done: int, total: int) -> None:
        if not joined:
            joined.append(late.__enter__())

    try:
        with cluster.worker() as good:
            workers = dask_workers(cluster.address)
            with pytest.raises(WorkersError, match=r"sources [0-9a-f]{16} \(here") as ended:
                run_cells(run_scene_cells, cells, record=Record(path), workers=workers, progress=progress)
            assert joined and good not in str(ended.value)
    finally:
        late.__exit__(None, None, None)
    kept = Record(path)
    kept.begin(cells)
    landed = np.flatnonzero(kept.done)
    assert 0 < len(landed) < len(cells)
    assert (ended.value.record.done == kept.done).all()
    some = landed[:: max(len(landed) // 10, 1)].tolist()
    assert [kept[index] for index in some] == run_scene_cells([cells[index] for index in some])


def test_a_scheduler_without_workers_is_said_at_once_and_its_first_worker_does_the_study(
    cluster: Cluster, tmp_path: Path
) -> None:
    command = [sys.executable, "-m", "maglev_mj", "sweep", "drop", "--vary", "phase=0:0.9:4", "--set", "plant=exact"]
    process = subprocess.Popen(
        [*command, "--scheduler", cluster.address],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        cwd=tmp_path,
    )
    assert process.stderr
    said = process.stderr.readline()
    assert (
        f"maglev-mj sweep: the Dask scheduler at {cluster.address} has no workers yet: jobs wait for the first" in said
    )
    with cluster.worker():
        out, more = process.communicate(timeout=_PATIENCE)
    assert (process.returncode, more) == (0, "") and "4 cells" in out


@pytest.mark.parametrize("command", ["sweep", pytest.param("map", marks=pytest.mark.study)])
def test_a_scheduler_that_dies_is_one_line_and_the_record_stays_good(
    mortal: Cluster, command: str, tmp_path: Path
) -> None:
    # The map is asked for no record; its cells are kept where those of one that is stopped are.
    studies = {
        "sweep": ["sweep", "drop", "--vary", "phase=0:0.999:600", "--set", "plant=mujoco", "--set", "duration=2"],
        "map": ["map", "--grid", "40", "--of", "mujoco"],
    }
    pattern = {"sweep": "drop-sweep-*", "map": "stability-cells-*"}[command]
    arguments = [sys.executable, "-m", "maglev_mj", *studies[command], "--scheduler", mortal.address]
    with mortal.worker():
        before = mortal.transitions()
        process = subprocess.Popen(
            arguments, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, cwd=tmp_path, start_new_session=True
        )
        if command == "sweep":
            wait_until(lambda: [*tmp_path.glob(f"{pattern}/cells-*")], "nothing landed")
        else:
            wait_until(lambda: mortal.transitions() > before + 10, "nothing was handed out")
        mortal.process.send_signal(signal.SIGKILL)
        out, said = process.communicate(timeout=_PATIENCE)
    assert process.returncode == 1 and out == ""
    last = [line for line in said.splitlines() if not re.match(rf"{command}( drop)?: \d+ of \d+", line)]
    assert len(last) == 1, said
    found = re.search(
        rf"the Dask scheduler at {mortal.address} is no longer reachable; (\d+) cells saved in (\S+); to resume",
        last[0],
    )
    (record,) = tmp_path.glob(pattern)
    assert found and found[2] == record.name
    assert sum(indices.size for indices in indices_of(record)) == int(found[1])
    if command == "sweep":
        phases = np.linspace(0.0, 0.999, 600).tolist()
        cells = Grid(Drop(), {"plant": ["mujoco"], "duration": [2.0], "phase": phases})
        kept = Record(record)
        kept.begin(cells)
        done = np.flatnonzero(kept.done).tolist()
        assert 0 < len(done) == int(found[1]) < 600
        assert run_scene_cells([cells[index] for index in done[:3]]) == [kept[index] for index in done[:3]]


def indices_of(record: Path) -> list[np.ndarray[Any, Any]]:
    """Return the cells of each shard."""
    return [_read_table(path)["#"] for path in sorted(record.glob("cells-*"))]


@pytest.mark.study
def test_workers_and_schedulers_killed_at_random_lose_nothing_and_leave_nothing_twice(tmp_path: Path) -> None:
    draw, record, ended, kept = random.Random(3), tmp_path / "record", list[str](), 0
    grid = {"phase": np.linspace(0.0, 0.999, 2400).tolist()}
    while "all" not in ended:
        with made_cluster(tmp_path / f"scheduler-{len(ended)}") as cluster, ExitStack() as beside:
            command = "worker", cluster.address, "--host", "127.0.0.1", "--nthreads", "1", "--no-nanny"
            workers = [beside.enter_context(dask(*command)) for _ in range(2)]
            wait_until(lambda: len(cluster.workers()) == 2, "no workers came")
            killed = [worker for worker in workers if draw.random() < 0.4]
            timers = [threading.Timer(draw.uniform(0.0, 1.0), process.kill) for process in [*killed, cluster.process]]

            def first(done: int, total: int, timers: list[threading.Timer] = timers) -> None:
                while timers and len(ended) < 12:  # at last it may end
                    timers.pop().start()

            try:
                found = sweep(
                    "drop", grid, plant="mujoco", workers=dask_workers(cluster.address), record=record, progress=first
                )
                ended.append("all")
            except WorkersError as error:
                ended.append(str(error))
        indices = np.concatenate([*indices_of(record), []])
        assert np.unique(indices).size == indices.size > kept
        kept = indices.size
    assert len(ended) > 3 and found.resumed < kept == 2400
    assert found.results == sweep("drop", grid, plant="mujoco").results
