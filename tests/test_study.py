"""Study engine: kept results, no repeats, workers whose death costs their own cells only."""

import json
import os
import signal
import subprocess
import sys
import threading
import time
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from pathlib import Path
from typing import Any

import pytest

from maglev_mj.cli import main
from maglev_mj.errors import MaglevError, ParameterError
from maglev_mj.scenes.drop import Drop
from maglev_mj.studies.cells import Cell, Record, StudyInterrupted, Workers, dask_workers, local_workers, run_cells
from maglev_mj.studies.sweep import run_scene_cells, swept_cells
from maglev_mj.versions import versions


def squares(cells: list[Cell]) -> list[Any]:
    return [{"square": cell["x"] ** 2} for cell in cells]


def drop_cells(count: int) -> list[Cell]:
    return swept_cells(
        Drop(height=0.003, pulse=0.0), {"phase": [number / count for number in range(count)]}, plant="exact"
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


def test_a_rerun_computes_only_what_is_missing(tmp_path: Path) -> None:
    path, calls = tmp_path / "record.jsonl", []

    def counted(cells: list[Cell]) -> list[Any]:
        calls.append(len(cells))
        return squares(cells)

    cells: list[Cell] = [{"x": x} for x in range(10)]
    first = run_cells(counted, cells[:6], record=Record(path), together=4)
    second = run_cells(counted, cells, record=Record(path), together=4)
    assert calls == [4, 2, 4]
    assert second[:6] == first and second == squares(cells)
    assert len(path.read_text().splitlines()) == 10


@pytest.mark.parametrize(("newest", "count"), [("ours", 0), ("theirs", 1)])
def test_the_newest_line_of_a_cell_names_its_code(tmp_path: Path, newest: str, count: int) -> None:
    path, made = tmp_path / "record.jsonl", {"ours": versions(), "theirs": {**versions(), "numpy": "1.0"}}
    kinds = sorted(made, key=lambda kind: kind == newest)
    lines = [{"cell": {"x": 1}, "result": {"of": kind}, "versions": made[kind]} for kind in kinds]
    path.write_text("".join(json.dumps(line) + "\n" for line in lines))
    kept = Record(path)
    assert kept[{"x": 1}] == {"of": newest}
    assert sum(other["cells"] for other in kept.others([{"x": 1}])) == count


@pytest.mark.parametrize("torn", ['{"cell": {"x": 1}, "resu', '{"cell": {"x": 1}, "result": {"square": 1}}'])
def test_a_line_torn_by_a_dying_process_is_no_obstacle(tmp_path: Path, torn: str) -> None:
    path = tmp_path / "record.jsonl"
    path.write_text(json.dumps({"cell": {"x": 0}, "result": {"square": 0}}) + "\n" + torn)
    cells: list[Cell] = [{"x": x} for x in range(3)]
    assert run_cells(squares, cells, record=Record(path)) == squares(cells)
    # read again, every cell is there
    again = Record(path)
    assert all(cell in again for cell in cells)


def test_a_file_that_is_no_record_is_refused_and_left_alone(tmp_path: Path) -> None:
    path = tmp_path / "notes.txt"
    for text, words in (
        ("dear diary\nnothing\n", "record must hold one cell a line, not 'dear diary'"),
        ("x", "one cell a line, not 'x'"),
    ):
        path.write_text(text)
        with pytest.raises(ParameterError, match=words):
            Record(path)
        assert path.read_text() == text


def test_local_processes_equal_this_one() -> None:
    # To the last bit where no pulse splits the others' periods: then it does not matter who is in a batch.
    cells = drop_cells(16)
    assert run_cells(run_scene_cells, cells, workers=local_workers(2), together=8) == run_scene_cells(cells)


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
    cells: list[Cell] = [{"x": x} for x in range(8)]
    pools: list[_Fragile] = []

    def make() -> _Fragile:
        pools.append(_Fragile(1))
        return pools[-1]

    workers = Workers(make, window, (BrokenProcessPool,))
    assert run_cells(squares, cells, workers=workers) == squares(cells) and len(pools) == 4


def test_a_worker_that_dies_costs_its_own_cells_and_a_cell_that_always_kills_is_named(tmp_path: Path) -> None:
    path = tmp_path / "record.jsonl"
    cells: list[Cell] = [{"x": x} for x in range(12)]
    cells[3] |= {"kill": "always"}
    cells[0] |= {"kill": "once", "note": str(tmp_path / "seen")}  # first: a job that waits is lost by another's death
    results = run_cells(deadly, cells, record=Record(path), workers=local_workers(1), together=2)
    assert results[3] == {"error": "its worker died 2 times"}
    assert [results[place] for place in range(12) if place != 3] == [{"square": x**2} for x in range(12) if x != 3]
    assert cells[3] not in Record(path)  # so that a rerun tries it again


def fails_at_two(cells: list[Cell]) -> list[Any]:
    if cells[0]["x"] == 2:
        raise RuntimeError("a bug")
    time.sleep(0.2)
    return squares(cells)


def test_what_is_in_hand_lands_where_another_job_fails(tmp_path: Path) -> None:
    path = tmp_path / "record.jsonl"
    cells: list[Cell] = [{"x": x} for x in range(4)]
    with pytest.raises(RuntimeError, match="a bug"):
        run_cells(fails_at_two, cells, record=Record(path), workers=local_workers(2))
    assert all(cell in Record(path) for cell in cells[:2])


def test_two_programs_with_one_record_lose_nothing(tmp_path: Path) -> None:
    path = tmp_path / "record.jsonl"
    path.write_text('{"cell": {"x": 0}, "result"')  # a third one died
    one, other = Record(path), Record(path)
    for number in range(1, 6):
        one.add([({"x": number}, {"square": number**2})])
        other.add([({"x": -number}, {"square": number**2})])
    kept = Record(path)
    assert all({"x": number} in kept for number in range(-5, 6) if number)


def test_an_interrupt_keeps_what_has_landed(tmp_path: Path) -> None:
    def interrupted(cells: list[Cell]) -> list[Any]:
        if cells[0]["x"] == 3:
            raise KeyboardInterrupt
        return squares(cells)

    path = tmp_path / "record.jsonl"
    with pytest.raises(StudyInterrupted) as stopped:
        run_cells(interrupted, [{"x": x} for x in range(6)], record=Record(path))
    assert [cell["x"] for cell, _ in stopped.value.landed] == [0, 1, 2]
    assert len(path.read_text().splitlines()) == 3


@pytest.mark.parametrize(("workers", "count"), [("0", 64), ("2", 32)])
def test_ctrl_c_on_the_command_line_ends_cleanly_and_goes_on(
    tmp_path: Path, workers: str, count: int, capsys: pytest.CaptureFixture[str]
) -> None:
    # One line on stderr, no traceback from any process, status 130; the rerun computes the rest.
    #
    # Of 256 cells all are in hand by then, and land.
    record = tmp_path / "cells.jsonl"
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
    while not (record.exists() and record.stat().st_size) and time.monotonic() < deadline:
        time.sleep(0.01)
    os.killpg(process.pid, signal.SIGINT)  # as a terminal does: to every process of the group
    _, said = process.communicate(timeout=60)
    assert process.returncode == 130, said
    assert "Traceback" not in said
    assert "maglev-mj sweep: stopped; " in said.splitlines()[-1]
    done = len(record.read_text().splitlines())
    assert 64 <= done < 512
    assert main([*command, "0"]) == 0
    said = capsys.readouterr().out
    assert f"{8 * count} cells\n" in said and f"\n  {done} of them already in" in said


def first_soon(cells: list[Cell]) -> list[Any]:
    """Square the first cell at once, and others in minutes."""
    time.sleep(300.0 * bool(cells[0]["x"]))
    return squares(cells)


def test_ctrl_c_does_not_wait_for_long_jobs(tmp_path: Path) -> None:
    # neither does the end of the program: it would wait for the workers' thread
    program = (
        "import sys; from pathlib import Path; from maglev_mj.studies.cells import *\n"
        "from tests.test_study import first_soon\n"
        "def progress(done, total): print(done, flush=True)\n"
        "if __name__ == '__main__':\n"
        "    cells = [{'x': x, 'long': 30000 * 'z'} for x in range(9)]\n"  # more than a pipe holds
        "    try: run_cells(first_soon, cells, record=Record(Path(sys.argv[1])), workers=2, progress=progress)\n"
        "    except StudyInterrupted as error: print([cell['x'] for cell, _ in error.landed])\n"
    )
    (script := tmp_path / "long.py").write_text(program)
    process = subprocess.Popen(
        [sys.executable, str(script), str(tmp_path / "cells.jsonl")],
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


def test_bad_workers_are_refused() -> None:
    with pytest.raises(ParameterError, match="workers must be at least 0, not -1"):
        local_workers(-1)
    assert local_workers(0).window == 1
    with pytest.raises(MaglevError, match="address of a Dask scheduler, not 'moon'"):
        dask_workers("moon")


@pytest.fixture(scope="module")
def cluster() -> Any:
    import distributed

    with distributed.LocalCluster(n_workers=2, threads_per_worker=1, processes=True, dashboard_address=None) as made:
        yield made


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


def test_the_window_bounds_what_is_in_hand() -> None:
    class Watching(Executor):
        most = 0

        def __init__(self) -> None:
            self.open, self.lock = 0, threading.Lock()

        def submit(self, function: Any, /, *args: Any, **keywords: Any) -> Any:
            from concurrent.futures import Future

            future: Future[Any] = Future()
            Watching.most += 1

            def work() -> None:
                time.sleep(0.01)
                Watching.most -= 1
                future.set_result(function(*args, **keywords))

            assert Watching.most <= 3
            threading.Thread(target=work).start()
            return future

    cells: list[Cell] = [{"x": x} for x in range(20)]
    assert run_cells(squares, cells, workers=Workers(Watching, 3)) == squares(cells)
