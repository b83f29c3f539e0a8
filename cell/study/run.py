"""Run the trials of a study: kept results first, the others on local processes or on a Dask cluster.

Every result is on disk before the next is waited for, so Ctrl-C, a kill or a dead machine loses only what was being
computed. Results come back in the order of the trials, whoever computed them, and are the same to the bit: a trial is
a pure function of its settings, and its result passes through JSON in every case.
"""

import multiprocessing
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from pathlib import Path
from typing import Any

from cell.errors import UsageError
from cell.study import store
from cell.study.trial import Outcome, Trial, compute, sources_digest

Told = Callable[[int, int, Outcome], None]
"""Called with (trials done, trials in all, the outcome that came last)."""

_DIED = "the process that computed it died, twice (out of memory, or a crash in a library)"

_PATIENCE_S = 10.0

_RETRIES = 2
"""How often a cluster tries a trial again whose worker was lost."""


def run(
    trials: Sequence[Trial],
    *,
    processes: int,
    cluster: str | None = None,
    folder: Path | None = None,
    told: Told | None = None,
) -> list[Outcome]:
    """The outcome of each trial, in their order; equal trials are computed once.

    Args:
        trials: what is asked.
        processes: local worker processes, at least 1.
        cluster: address of a Dask scheduler, in place of local processes.
        folder: where results are kept; None: `store.cache_folder()`.
        told: is told of each outcome as it comes.

    Raises:
        UsageError: if the cluster cannot be reached, or Dask is not installed.
        FileError: if a result cannot be kept.
    """
    kept = store.cache_folder() if folder is None else folder
    outcomes: dict[Trial, Outcome] = {}

    def note(outcome: Outcome) -> None:
        outcomes[outcome.trial] = outcome
        if told is not None:
            told(len(outcomes), len(distinct), outcome)

    distinct = list(dict.fromkeys(trials))
    for trial in distinct:
        found = store.load(trial, kept)
        if found is not None:
            note(found)
    missing = [trial for trial in distinct if trial not in outcomes]
    if missing:
        computed = _on_cluster(missing, cluster) if cluster is not None else _on_processes(missing, processes)
        for outcome in computed:
            store.save(outcome, kept)
            note(outcome)
    return [outcomes[trial] for trial in trials]


def _on_processes(trials: Sequence[Trial], processes: int) -> Iterator[Outcome]:
    """Outcomes as they come. A process that dies (memory, a crash in a library) costs its trial, not the study."""
    if processes < 1:
        raise UsageError(f"--processes {processes} must be at least 1")
    waiting, suspects = deque(trials), deque[Trial]()
    while waiting or suspects:
        # A dying process takes all that are at work with it; each of them is tried once more, alone.
        queue, workers = (waiting, min(processes, len(waiting))) if waiting else (deque([suspects.popleft()]), 1)
        at_work: dict[Future[Outcome], Trial] = {}
        # spawn: a forked child would inherit the ray engine's and the solver's threads in an unknown state.
        with ProcessPoolExecutor(workers, mp_context=multiprocessing.get_context("spawn")) as pool:
            try:
                while queue or at_work:
                    while queue and len(at_work) < workers:
                        at_work[pool.submit(compute, queue[0], sources_digest())] = queue[0]
                        queue.popleft()
                    done, _ = wait(at_work, return_when=FIRST_COMPLETED)
                    for future in sorted(done, key=lambda future: at_work[future].settings):
                        outcome = future.result()
                        del at_work[future]
                        yield outcome
            except BrokenProcessPool:
                if queue is waiting:
                    suspects.extend(at_work.values())
                else:
                    yield from (Outcome(trial, {}, _DIED, {}) for trial in at_work.values())
            except BaseException:
                pool.shutdown(wait=False, cancel_futures=True)
                raise


def _on_cluster(trials: Sequence[Trial], address: str) -> Iterator[Outcome]:
    """Outcomes as a Dask cluster gives them. Dask sends the trials of a worker that dies to another."""
    try:
        from distributed import Client, as_completed
    except ImportError as error:
        raise UsageError("--cluster needs Dask; install it with pip install 'scan-cell[cluster]'") from error
    try:
        client: Any = Client(address, timeout=_PATIENCE_S, set_as_default=False)
    except (OSError, ValueError, TimeoutError) as error:
        raise UsageError(f"no Dask scheduler answers at {address}; start one with dask scheduler ({error})") from error
    with client, client.as_current():
        digest = sources_digest()
        keys = [trial.key for trial in trials]
        futures = client.map(compute, trials, [digest] * len(trials), key=keys, pure=True, retries=_RETRIES)
        asked = dict(zip(keys, trials, strict=True))
        for future in as_completed(futures):
            lost = future.exception()
            yield future.result() if lost is None else Outcome(asked[future.key], {}, f"no worker kept it: {lost}", {})
