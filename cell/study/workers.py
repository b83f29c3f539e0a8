"""Who computes trials: processes of this machine, or the workers of a Dask cluster. Open once, ask many times.

Outcomes come in the order in which they are finished. A worker that dies loses nothing but time.
"""

import multiprocessing
import os
import signal
import threading
from collections import deque
from collections.abc import Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from types import TracebackType
from typing import Any, Protocol, Self

from cell.errors import UsageError
from cell.study.trial import Outcome, Trial, compute

_DIED = "the process that computed it died, twice (out of memory, or a crash in a library)"
_PATIENCE_S = 10.0
_RETRIES = 2
"""How often a cluster tries a trial again whose worker was lost."""


class Workers(Protocol):
    """Computes trials; a context manager."""

    def compute(self, trials: Sequence[Trial]) -> Iterator[Outcome]:
        """Each trial's outcome, as they are finished. Distinct trials only."""
        ...

    def __enter__(self) -> Self: ...

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None: ...


def open_workers(processes: int, cluster: str | None = None) -> Workers:
    """Workers by the options of a command.

    Args:
        processes: local worker processes, at least 1.
        cluster: address of a Dask scheduler, in place of local processes.

    Raises:
        UsageError: if the number is not positive, the cluster does not answer, or Dask is not installed.
    """
    if processes < 1:
        raise UsageError(f"--processes {processes} must be at least 1")
    return Processes(processes) if cluster is None else Cluster(cluster)


class Processes:
    """Processes of this machine, begun when they are first needed."""

    def __init__(self, count: int) -> None:
        self._count = count
        self._pool: ProcessPoolExecutor | None = None

    def compute(self, trials: Sequence[Trial]) -> Iterator[Outcome]:
        """Each trial's outcome. A dying process takes all that are at work with it; each is tried once more, alone."""
        waiting, suspects = deque(trials), deque[Trial]()
        while waiting or suspects:
            queue, at_once = (waiting, self._count) if waiting else (deque([suspects.popleft()]), 1)
            at_work: dict[Future[Outcome], Trial] = {}
            try:
                while queue or at_work:
                    while queue and len(at_work) < at_once:
                        at_work[self._open().submit(compute, queue[0], queue[0].digest)] = queue[0]
                        queue.popleft()
                    done, _ = wait(at_work, return_when=FIRST_COMPLETED)
                    for future in sorted(done, key=lambda future: at_work[future].settings):
                        outcome = future.result()
                        del at_work[future]
                        yield outcome
            except BrokenProcessPool:
                self._close()
                if queue is waiting:
                    suspects.extend(at_work.values())
                else:
                    yield from (Outcome(trial, {}, _DIED, {}) for trial in at_work.values())

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._close()

    def _open(self) -> ProcessPoolExecutor:
        if self._pool is None:
            # spawn: a forked child would inherit the ray engine's and the solver's threads in an unknown state.
            context = multiprocessing.get_context("spawn")
            self._pool = ProcessPoolExecutor(self._count, mp_context=context, initializer=_live_with_parent)
        return self._pool

    def _close(self) -> None:
        if self._pool is not None:
            self._pool.shutdown(wait=False, cancel_futures=True)
            self._pool = None


def _live_with_parent() -> None:
    """A worker leaves Ctrl-C to its parent, and ends when that does, however it does: nobody would read its result."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    parent = multiprocessing.parent_process()

    def follow() -> None:
        if parent is not None:
            parent.join()
        os._exit(1)

    threading.Thread(target=follow, daemon=True).start()


class Cluster:
    """The workers of a Dask scheduler. Dask gives the trials of a worker that dies to another."""

    def __init__(self, address: str) -> None:
        try:
            from distributed import Client
        except ImportError as error:
            raise UsageError("--cluster needs Dask; install it with pip install 'scan-cell[cluster]'") from error
        try:
            self._client: Any = Client(address, timeout=_PATIENCE_S, set_as_default=False)
        except (OSError, ValueError, TimeoutError) as error:
            raise UsageError(
                f"no Dask scheduler answers at {address}; start one with dask scheduler ({error})"
            ) from error

    def compute(self, trials: Sequence[Trial]) -> Iterator[Outcome]:
        """Each trial's outcome."""
        from distributed import as_completed

        with self._client.as_current():
            keys = [trial.key for trial in trials]
            digests = [trial.digest for trial in trials]
            futures = self._client.map(compute, trials, digests, key=keys, pure=True, retries=_RETRIES)
            asked = dict(zip(keys, trials, strict=True))
            for future in as_completed(futures):
                lost = future.exception()
                if lost is None:
                    yield future.result()
                else:
                    yield Outcome(asked[future.key], {}, f"no worker kept it: {lost}", {})

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._client.close()
