"""Study engine: kept results, no repeats, workers whose death costs their own cells only."""

import json
import os
import shutil
import signal
import subprocess
import sys
import threading
import time
from concurrent.futures import Future, ThreadPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from maglev_mj.cli import main
from maglev_mj.errors import ParameterError
from maglev_mj.scenes.drop import Drop
from maglev_mj.studies import record as recording
from maglev_mj.studies.cells import StudyInterrupted, Workers, dask_workers, local_workers, run_cells
from maglev_mj.studies.record import Cell, Record, pack
from maglev_mj.studies.sweep import Grid, run_scene_cells


def squares(cells: list[Cell]) -> list[Any]:
    return [{"square": cell["x"] ** 2} for cell in cells]


def drop_cells(count: int) -> list[Cell]:
    return list(
        Grid(Drop(height=0.003, pulse=0.0), {"phase": [number / count for number in range(count)]}, plant="exact")
    )


def deadly(cells: list[Cell]) -> list[Any]:
    """Kill the worker on a cell marked always, or once and not yet seen."""
    for cell in cells:
        if cell.get("kill") == "always":
            os.kill(os.getpid(), signal.SIGKILL)
        if cell.get("kill") == "once" and not (seen := Path(cell["note"])).exists():
            seen.touch()
            os.kill(os.getpid(), signal.SIGKILL)
    return squares(cells)


def kept(path: Path, cells: list[Cell]) -> Record:
    """Return a record as a study would find it."""
    record = Record(path)
    record.begin(cells)
    return record


def shards(path: Path) -> list[Path]:
    return sorted(path.glob("cells-*"))


@pytest.fixture(params=[".parquet", ".npz"])
def suffix(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> str:
    """Return the suffix of shards, with pyarrow or without."""
    monkeypatch.setattr(recording, "find_spec", lambda name: request.param == ".parquet")
    return str(request.param)


CELLS: list[Cell] = [{"x": x} for x in range(10)]


def missing_after(cells: list[Cell]) -> list[Any]:
    if cells[0]["x"] == 6:
        raise KeyboardInterrupt
    return squares(cells)


def test_a_rerun_computes_only_what_is_missing(suffix: str, tmp_path: Path) -> None:
    path, calls = tmp_path / "record", []

    def counted(cells: list[Cell]) -> list[Any]:
        calls.append([cell["x"] for cell in cells])
        return squares(cells)

    with pytest.raises(StudyInterrupted) as stopped:
        run_cells(missing_after, CELLS, record=Record(path), together=3)
    assert stopped.value.record.done.tolist() == [True] * 6 + [False] * 4
    assert run_cells(counted, CELLS, record=Record(path), together=3) == squares(CELLS)
    assert calls == [[6, 7, 8], [9]] and {one.suffix for one in shards(path)} == {suffix}
    assert run_cells(counted, CELLS, record=Record(path), together=3) == squares(CELLS) and len(calls) == 2


RESULTS: list[Any] = [
    {"a": 1.5, "b": True, "c": 3, "d": [1.0, None], "e": "text", "f": None},
    {"a": None, "b": None, "c": -(2**70), "f": 0.0},
    {"error": 'diverged: "é"'},
    {"b": 0.25, "a": 7, "error": None},
    {},
    {"#": 1, "=": 2},
    {"~": 3},
    [1, {"z": 1, "y": 2}],
    None,
    -0.5,
]


@pytest.mark.parametrize("together", [1, 2, 10])
def test_every_result_of_json_is_kept_as_it_is(suffix: str, together: int, tmp_path: Path) -> None:
    cells: list[Cell] = [{"index": index} for index in range(len(RESULTS))]

    def function(cells: list[Cell]) -> list[Any]:
        return [RESULTS[cell["index"]] for cell in cells]

    made = run_cells(function, cells, record=Record(tmp_path / "a"), together=together)
    again = list(kept(tmp_path / "a", cells))
    assert [json.dumps(one) for one in made] == [json.dumps(one) for one in again]
    assert [json.dumps(one, sort_keys=True) for one in made] == [json.dumps(one, sort_keys=True) for one in RESULTS]
    assert [type(one) for one in made] == [type(one) for one in RESULTS]
    assert kept(tmp_path / "a", cells).failed == [2, 3]


def test_results_that_are_no_json_are_refused() -> None:
    with pytest.raises(ParameterError, match=r"a result must hold values of JSON [(]got <object"):
        run_cells(lambda cells: [{"a": object()}], CELLS[:1])


@pytest.mark.parametrize("share", [0.0, 0.5, 0.98])
def test_a_torn_shard_is_computed_again(share: float, suffix: str, tmp_path: Path) -> None:
    path = tmp_path / "record"
    path.mkdir()
    (path / "0a1b2c3d.partial").write_text('{"cells": ')  # of a program that died before its plan was written
    run_cells(squares, CELLS, record=Record(path))
    (shard,) = shards(path)
    whole = shard.read_bytes()
    shard.write_bytes(whole[: int(share * len(whole))])
    assert not kept(path, CELLS).done.any()
    assert run_cells(squares, CELLS, record=Record(path)) == squares(CELLS)
    assert kept(path, CELLS).done.all()


@pytest.mark.parametrize("step", [7, pytest.param(1, marks=pytest.mark.study)])
def test_a_changed_bit_in_a_shard_is_no_result_and_no_error(suffix: str, step: int, tmp_path: Path) -> None:
    # One bit of every n-th byte, also of the directory, which has the columns' names and no checksum of the format.
    run_cells(squares, CELLS, record=Record(tmp_path / "a"))
    (shard,) = shards(tmp_path / "a")
    whole = shard.read_bytes()
    bits = 1 << np.random.default_rng(0).integers(8, size=len(whole))
    lost, changed = 0, list(enumerate(bits.tolist()))[::step]
    for place, bit in changed:
        shard.write_bytes(whole[:place] + bytes([whole[place] ^ bit]) + whole[place + 1 :])
        found = kept(tmp_path / "a", CELLS)
        lost += not found.done.any()
        assert not found.done.any() or (found.done.all() and list(found) == squares(CELLS))
    assert 0.3 * len(changed) < lost < len(changed)


@pytest.mark.parametrize("change", ["other cells", "no plan", "torn plan", "a file of an old version"])
def test_what_is_no_record_of_the_study_is_refused_and_left_alone(change: str, tmp_path: Path) -> None:
    path, words = (
        tmp_path / "record",
        "record must be a new or empty folder, or one with plan.json [(]got '.*record'[)]$",
    )
    run_cells(squares, CELLS[: 9 if change == "other cells" else 10], record=Record(path))
    if change == "other cells":
        words = "record must be of this study [(]got '.*record', which differs in cells"
    elif change == "no plan":
        (path / "plan.json").unlink()
    elif change == "torn plan":
        (path / "plan.json").write_text('{"cells": ')
    else:
        shutil.rmtree(path)
        path.write_text('{"cell": {"x": 1}, "result": 1}\n')
        words = "got '.*record'; maglev_mj 0.2.0 reads a file of JSON lines[)]$"
    files = sorted(path.iterdir()) if path.is_dir() else [path]
    before = [one.read_bytes() for one in files]
    with pytest.raises(ParameterError, match=words):
        run_cells(squares, CELLS, record=Record(path))
    assert before == [one.read_bytes() for one in files]


@pytest.mark.parametrize("count", [1, pytest.param(2, marks=pytest.mark.machine)])
def test_local_processes_equal_this_one(count: int) -> None:
    # To the last bit where no pulse splits the others' periods: then it does not matter who is in a batch.
    cells = drop_cells(16)
    assert run_cells(run_scene_cells, cells, workers=local_workers(count), together=8) == run_scene_cells(cells)


class _Fragile(ThreadPoolExecutor):
    """Pool that breaks at its third job."""

    jobs = 0

    def submit(self, function: Any, /, *args: Any, **keywords: Any) -> Future[Any]:
        self.jobs += 1
        if self.jobs >= 3:
            raise BrokenProcessPool
        return super().submit(function, *args, **keywords)


@pytest.mark.parametrize("window", [1, 2, 4])
def test_a_worker_that_dies_between_two_jobs_costs_no_cell(window: int) -> None:
    pools: list[_Fragile] = []

    def make() -> _Fragile:
        pools.append(_Fragile(1))
        return pools[-1]

    workers = Workers(make, window, (BrokenProcessPool,))
    assert run_cells(squares, CELLS[:8], workers=workers) == squares(CELLS[:8]) and len(pools) == 4


def test_the_window_bounds_what_is_in_hand() -> None:
    started: list[Future[Any]] = []

    def slowly(function: Any, *args: Any, **keywords: Any) -> Any:
        time.sleep(0.01)
        return function(*args, **keywords)

    class Watching(ThreadPoolExecutor):
        def submit(self, function: Any, /, *args: Any, **keywords: Any) -> Future[Any]:
            assert sum(not one.done() for one in started) < 3
            started.append(super().submit(slowly, function, *args, **keywords))
            return started[-1]

    cells: list[Cell] = [{"x": x} for x in range(20)]
    assert run_cells(squares, cells, workers=Workers(lambda: Watching(4), 3)) == squares(cells) and len(started) > 3


@pytest.mark.machine
def test_a_worker_that_dies_costs_its_own_cells_and_a_cell_that_always_kills_is_named(tmp_path: Path) -> None:
    path = tmp_path / "record"
    cells: list[Cell] = [{"x": x} for x in range(12)]
    cells[3] |= {"kill": "always"}
    cells[0] |= {"kill": "once", "note": str(tmp_path / "seen")}  # first: a job that waits is lost by another's death
    results = run_cells(deadly, cells, record=Record(path), workers=local_workers(1), together=2)
    assert results[3] == {"error": "worker died twice"}
    assert [results[place] for place in range(12) if place != 3] == [{"square": x**2} for x in range(12) if x != 3]
    assert np.flatnonzero(~kept(path, cells).done).tolist() == [3]  # so that a rerun tries it again


def test_what_is_in_hand_lands_where_another_job_fails(tmp_path: Path) -> None:
    path, failed = tmp_path / "record", threading.Event()
    cells: list[Cell] = [{"x": x} for x in range(4)]

    def fails_at_two(cells: list[Cell]) -> list[Any]:
        if cells[0]["x"] == 2:
            failed.set()
            raise RuntimeError("a bug")
        assert cells[0]["x"] != 1 or failed.wait(60.0)  # in hand as the other fails
        return squares(cells)

    with pytest.raises(RuntimeError, match="a bug"):
        run_cells(fails_at_two, cells, record=Record(path), workers=Workers(lambda: ThreadPoolExecutor(2), 2))
    assert kept(path, cells).done[:2].all()


def test_two_programs_with_one_record_lose_nothing(tmp_path: Path) -> None:
    path = tmp_path / "record"
    one, other = kept(path, CELLS), kept(path, CELLS)
    for number in range(5):
        one.add(range(number, number + 1), pack([float(number)]))
        other.add(range(9 - number, 10 - number), pack([float(9 - number)]))
    one.flush()
    other.flush()
    assert list(kept(path, CELLS)) == [float(number) for number in range(10)]


def test_a_result_is_written_while_a_long_job_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(recording, "_PAUSE", 0.0)
    path, deadline = tmp_path / "record", time.monotonic() + 60.0

    def is_written() -> bool:
        return (path / "plan.json").exists() and bool(kept(path, CELLS).done[:9].all())

    def long_last(cells: list[Cell]) -> list[Any]:
        while cells[0]["x"] == 9 and not is_written() and time.monotonic() < deadline:
            time.sleep(0.05)
        return [time.monotonic() < deadline]

    assert all(run_cells(long_last, CELLS, record=Record(path), workers=Workers(lambda: ThreadPoolExecutor(2), 10)))


@pytest.mark.machine
@pytest.mark.parametrize(("workers", "count"), [("0", 64), ("2", 32)])
def test_ctrl_c_on_the_command_line_ends_cleanly_and_goes_on(
    tmp_path: Path, workers: str, count: int, capsys: pytest.CaptureFixture[str]
) -> None:
    # One line on stderr, no traceback from any process, status 130; the rerun computes the rest.
    record = tmp_path / "cells"
    command = ["sweep", "wall", "--vary", "delay=0:0.005:8", "--vary", f"damping=60:100:{count}"]
    command += ["--set", "plant=exact", "--record", str(record), "--workers"]
    process = subprocess.Popen(
        [sys.executable, "-m", "maglev_mj", *command, workers],
        stderr=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    deadline = time.monotonic() + 60.0
    while not (record.exists() and shards(record)) and time.monotonic() < deadline:
        time.sleep(0.01)
    os.killpg(process.pid, signal.SIGINT)  # as a terminal does: to every process of the group
    _, said = process.communicate(timeout=60)
    assert process.returncode == 130, said
    assert "Traceback" not in said
    assert "maglev-mj sweep: stopped; " in said.splitlines()[-1]
    done = sum(recording._read_table(path)["#"].size for path in shards(record))
    assert main([*command, "0"]) == 0
    said = capsys.readouterr().out
    assert f"{8 * count} cells\n" in said and f" {done} resumed" in " ".join(said.split())


def first_soon(cells: list[Cell]) -> list[Any]:
    """Square the first cell at once, and others in minutes."""
    time.sleep(300.0 * bool(cells[0]["x"]))
    return squares(cells)


@pytest.mark.machine
def test_ctrl_c_does_not_wait_for_long_jobs(tmp_path: Path) -> None:
    # neither does the end of the program: it would wait for the workers' thread
    program = (
        "import sys; from pathlib import Path; from maglev_mj.studies.cells import *\n"
        "from maglev_mj.studies.record import Record\n"
        "from tests.studies.test_study import first_soon\n"
        "def progress(done, total): print(done, flush=True)\n"
        "if __name__ == '__main__':\n"
        "    cells = [{'x': x, 'long': 30000 * 'z'} for x in range(9)]\n"  # more than a pipe holds
        "    try: run_cells(first_soon, cells, record=Record(Path(sys.argv[1])), workers=2, progress=progress)\n"
        "    except StudyInterrupted as error: print(error.record.done.nonzero()[0].tolist())\n"
    )
    (script := tmp_path / "long.py").write_text(program)
    process = subprocess.Popen(
        [sys.executable, str(script), str(tmp_path / "cells")],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
        env={**os.environ, "PYTHONPATH": os.pathsep.join([".", *sys.path])},
    )
    assert process.stdout is not None and process.stdout.readline() == "1\n"
    os.killpg(process.pid, signal.SIGINT)
    said = process.communicate(timeout=60)
    assert (*said, process.returncode) == ("[0]\n", "", 0)


def test_workers_never_hear_ctrl_c() -> None:
    # Held from the first instruction of the process: while it imports, a handler would come too late.
    with local_workers(1).make() as workers:
        blocked = workers.submit(signal.pthread_sigmask, signal.SIG_BLOCK, []).result(timeout=60)
    assert signal.SIGINT in blocked
    assert signal.SIGINT not in signal.pthread_sigmask(signal.SIG_BLOCK, [])


@pytest.fixture(scope="module")
def cluster() -> Any:
    import distributed

    with distributed.LocalCluster(n_workers=2, threads_per_worker=1, processes=True, dashboard_address=None) as made:
        yield made


@pytest.mark.machine
@pytest.mark.filterwarnings("ignore")
def test_dask_equals_local_also_with_a_worker_killed_half_way(cluster: Any) -> None:
    cells = drop_cells(36)
    local = run_cells(run_scene_cells, cells, together=3)  # as processes of this machine, see above
    assert run_cells(run_scene_cells, cells, workers=dask_workers(cluster.scheduler_address), together=3) == local

    killed: list[int] = []

    def progress(done: int, total: int) -> None:
        if done >= total // 2 and not killed:
            nanny = next(iter(cluster.workers.values()))
            killed.append(nanny.pid)
            os.kill(nanny.pid, signal.SIGKILL)

    workers = dask_workers(cluster.scheduler_address)
    again = run_cells(slowly, cells, workers=workers, together=3, progress=progress)
    assert killed and again == local


def slowly(cells: list[Cell]) -> list[Any]:
    """Run a drop slowly enough for two busy workers."""
    time.sleep(0.1)
    return run_scene_cells(cells)


UNGUARDED = """
from maglev_mj import run_cells
from tests.studies.test_study import squares
print("read", flush=True)
run_cells(squares, [{"x": x} for x in range(200)], workers=2)
"""


@pytest.mark.machine
def test_a_script_that_its_workers_run_again_ends_at_once_and_says_what_is_missing(tmp_path: Path) -> None:
    script = tmp_path / "script.py"
    script.write_text(UNGUARDED)
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(Path(__file__).parents[2]), *sys.path])}
    done = subprocess.run([sys.executable, script], env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 1 and done.stdout.count("read") <= 5  # itself, two workers, and one that is tried alone
    assert 'below if __name__ == "__main__":, because' in done.stderr.splitlines()[-1]


@pytest.mark.machine
def test_cells_that_all_kill_their_workers_do_not_make_the_workers_broken() -> None:
    cells: list[Cell] = [{"x": x, "kill": "always"} for x in range(2)]
    assert run_cells(deadly, cells, workers=1) == [{"error": "worker died twice"}] * 2
