"""Studies whose workers die: finished results are kept, running trials are computed again."""

import contextlib
import multiprocessing
import os
import signal
import subprocess
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any
from unittest.mock import Mock

import pytest

from cell.errors import UsageError
from cell.scene.file import load_scene
from cell.study.placement_trial import COVERAGE_ONLY, evaluate_placement
from cell.study.prepared_part import scene_settings
from cell.study.trials import OnOutcome, Outcome, Processes, Trial, compute, open_workers, run_trials
from tests.support.fixture_types import StartCommand

pytestmark = pytest.mark.real_time


@pytest.fixture(scope="module")
def trials(part_file: Path) -> list[Trial]:
    """Return four quick trials with different results."""
    scene = load_scene(
        None, {"part": {"path": str(part_file), "units": "mm"}, "plan": {"faces": 40, "samples_per_face": 2}}
    )
    place = {"position_mm": [1100, 400, 100], "abc_deg": [0, 0, 0], "what": COVERAGE_ONLY, "solver": "greedy"}
    return [
        Trial.of(evaluate_placement, {**scene_settings(scene), **place, "candidates": candidates})
        for candidates in (4, 8, 12, 16)
    ]


def run(
    trials: list[Trial],
    *,
    processes: int,
    folder: Path,
    cluster: str | None = None,
    on_outcome: OnOutcome | None = None,
) -> list[Outcome]:
    """Run trials on new workers."""
    with open_workers(processes, cluster) as workers:
        return run_trials(trials, workers, folder=folder, on_outcome=on_outcome)


@pytest.fixture(scope="module")
def local(trials: list[Trial]) -> list[Outcome]:
    """Return the outcomes of the trials in this process."""
    outcomes = [compute(trial, trial.digest) for trial in trials]
    assert not [outcome.failure for outcome in outcomes if outcome.failure]
    assert len({outcome.values["coverable"] for outcome in outcomes}) == len(trials)
    return outcomes


def _values(outcomes: list[Outcome]) -> list[Any]:
    return [(outcome.trial, outcome.values, outcome.failure) for outcome in outcomes]


def test_a_process_that_dies_costs_no_trial(trials: list[Trial], local: list[Outcome], tmp_path: Path) -> None:
    """A worker is killed at the first result, and the outcomes equal those of an undisturbed run."""
    killed: list[int] = []

    def kill_one(n_done: int, total: int, outcome: Outcome) -> None:
        if not killed:
            victim = multiprocessing.active_children()[0]
            killed.append(victim.pid or 0)
            os.kill(killed[0], signal.SIGKILL)

    outcomes = run(trials, processes=2, folder=tmp_path, on_outcome=kill_one)
    assert killed
    assert _values(outcomes) == _values(local)


def test_a_started_trial_is_submitted_once(
    trials: list[Trial], local: list[Outcome], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its outcome comes after those of other trials."""
    with Processes(2) as workers:
        submit = Mock(wraps=workers._submit)
        monkeypatch.setattr(workers, "_submit", submit)
        workers.start(trials[3:])
        others = run_trials(trials[:3], workers, folder=tmp_path)
        assert submit.call_count == 4
        assert _values(others + run_trials(trials[3:], workers, folder=tmp_path)) == _values(local)
        assert submit.call_count == 4


def test_a_started_trial_whose_process_died_is_computed_again(
    trials: list[Trial], local: list[Outcome], tmp_path: Path
) -> None:
    """All processes are killed after the start."""
    with Processes(2) as workers:
        workers.start(trials[3:])
        for process in multiprocessing.active_children():
            process.kill()
            process.join()
        assert _values(run_trials(trials, workers, folder=tmp_path)) == _values(local)


def sleep(settings: dict[str, Any]) -> dict[str, object]:
    """Sleep in a temporary folder."""
    with tempfile.TemporaryDirectory(dir=settings["folder"]) as folder:
        (Path(folder) / "started").touch()
        time.sleep(1000)
    return {}


def test_started_trials_end_with_their_workers(tmp_path: Path) -> None:
    """Of more trials than processes none goes on, and the temporary folders are removed."""
    others = multiprocessing.active_children()
    with Processes(2) as workers:
        workers.start([Trial.of(sleep, {"folder": str(tmp_path), "number": number}) for number in range(5)])
        running = [process for process in multiprocessing.active_children() if process not in others]
        deadline = time.monotonic() + 60
        while len(list(tmp_path.glob("*/started"))) < 2 and time.monotonic() < deadline:
            time.sleep(0.02)
    assert running
    deadline = time.monotonic() + 20
    while any(process.exitcode is None for process in running):  # another thread waits for them too, and knows first
        assert time.monotonic() < deadline
        time.sleep(0.02)
    assert list(tmp_path.iterdir()) == []


def test_a_stopped_study_resumes(trials: list[Trial], local: list[Outcome], tmp_path: Path) -> None:
    """After Ctrl-C at the first result, the next run computes only the remaining trials."""

    def stop(n_done: int, total: int, outcome: Outcome) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run(trials[:2], processes=1, folder=tmp_path, on_outcome=stop)
    outcomes = run(trials[:2], processes=1, folder=tmp_path)
    assert [outcome.cached for outcome in outcomes] == [True, False]
    assert _values(outcomes) == _values(local[:2])


def test_no_processes_is_refused(trials: list[Trial], tmp_path: Path) -> None:
    """The message names the option."""
    with pytest.raises(UsageError, match="--processes 0"):
        run(trials[:1], processes=0, folder=tmp_path)


@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="processes are looked up in /proc")
def test_no_worker_outlives_a_study_that_was_killed(tmp_path: Path, start_cell: StartCommand) -> None:
    """After SIGKILL of the command in its first trial, its processes end soon."""
    silent = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    study = start_cell("study", "standoff", "petanque", "--processes", "2", cwd=tmp_path, **silent)

    def until(condition: Callable[[], object]) -> None:
        deadline = time.monotonic() + 120
        while not condition():
            assert time.monotonic() < deadline
            time.sleep(0.05)

    def workers() -> list[int]:
        # Children by the id of their parent, which changes when they are orphans.
        found = []
        for path in Path("/proc").glob("[0-9]*/stat"):
            with contextlib.suppress(OSError):
                if int(path.read_text().rpartition(")")[2].split()[1]) == study.pid:
                    found.append(int(path.parent.name))
        return found

    until(lambda: len(workers()) >= 3)  # two of the pool and the tracker of shared resources
    children = workers()
    study.kill()
    study.wait()
    until(lambda: not [pid for pid in children if Path(f"/proc/{pid}").exists()])


@pytest.fixture(scope="module")
def cluster() -> Iterator[Any]:
    """Yield a scheduler and two worker processes on loopback."""
    from distributed import LocalCluster

    with LocalCluster(
        n_workers=2, threads_per_worker=1, processes=True, host="127.0.0.1", dashboard_address=None
    ) as local_cluster:
        yield local_cluster


@pytest.mark.filterwarnings("default")  # warnings of Dask about the killed worker
def test_a_cluster_gives_the_same_to_the_bit_and_loses_nothing_with_a_worker(
    trials: list[Trial], local: list[Outcome], cluster: Any, tmp_path: Path
) -> None:
    """A worker is killed at the first result, and the other worker computes its trials."""
    killed: list[int] = []

    def kill_one(n_done: int, total: int, outcome: Outcome) -> None:
        if not killed:
            nanny = next(iter(cluster.workers.values()))
            killed.append(nanny.pid)
            os.kill(killed[0], signal.SIGKILL)

    outcomes = run(trials, processes=1, cluster=cluster.scheduler_address, folder=tmp_path, on_outcome=kill_one)
    assert killed
    assert _values(outcomes) == _values(local)


def test_a_cluster_that_does_not_answer_is_one_sentence(
    trials: list[Trial], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The message has the address and the command that starts a cluster."""
    monkeypatch.setattr("cell.study.trials._CLUSTER_TIMEOUT_S", 0.5)
    with pytest.raises(UsageError, match="dask scheduler"):
        run(trials[:1], processes=1, cluster="tcp://127.0.0.1:9", folder=tmp_path)
