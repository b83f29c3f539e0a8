"""Trials of studies: their keys, cached results, and the processes or the Dask cluster that compute them.

A trial is a module-level function and a table of settings that JSON can hold. The function maps the settings to values
that JSON can hold, and depends on nothing else; under "seconds" it can return times of steps, which are kept apart. So
a trial can run in another process or on another machine, and its result is cached under a key of all its inputs:
function, settings, the sources of the program, and those of the package of the function.

Each result is written before the next is waited for. Ctrl-C, a kill or a lost machine costs only the running trials.
"""

import hashlib
import importlib
import json
import multiprocessing
import os
import signal
import sys
import threading
import tomllib
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from time import perf_counter
from typing import Any, Self

from cell.errors import CellError, UsageError
from cell.files import atomic_write, cache_folder, file_errors
from planner.errors import PlannerError

JsonTable = Mapping[str, Any]
"""Settings or values of a trial by name, as JSON can hold them."""

TrialFunction = Callable[[JsonTable], JsonTable]

SCHEMA = "scan-cell/trial/2"

_SOURCES, _SUFFIXES = ("planner", "cell", "drivers"), (".py", ".toml", ".xml", ".npz", ".csv")
_DIED = "its process died twice (out of memory, or a crash in a library)"
_CLUSTER_TIMEOUT_S = 10.0
_RETRIES = 2
"""Repetitions of a trial on a cluster after its worker was lost."""


@dataclass(frozen=True, slots=True)
class Trial:
    """A trial.

    Attributes:
        function: "module:name" of the function.
        settings: canonical JSON of the settings.
    """

    function: str
    settings: str

    @classmethod
    def of(cls, function: TrialFunction, settings: Mapping[str, object]) -> "Trial":
        """Return a trial of a module-level function, which a worker can import.

        Raises:
            ValueError: if a setting is NaN or infinite.
        """
        name = f"{function.__module__}:{function.__name__}"
        return cls(name, json.dumps(dict(settings), sort_keys=True, allow_nan=False))

    @property
    def digest(self) -> str:
        """sha256 (hex) over the sources of this program that compute the trial."""
        return sources_digest(self.function.partition(".")[0])

    @property
    def key(self) -> str:
        """sha256 (hex) over all inputs of the result."""
        return hashlib.sha256(f"{self.function}\n{self.settings}\n{self.digest}".encode()).hexdigest()


@dataclass(frozen=True, slots=True)
class Outcome:
    """Result of a trial.

    Attributes:
        trial: the trial.
        values: its values; empty after a failure.
        failure: cause of a failure in one sentence; "" after success.
        seconds: time of each step on the machine that computed it, now or earlier; "total" is the sum.
        cached: whether the result was computed earlier.
    """

    trial: Trial
    values: JsonTable
    failure: str
    seconds: Mapping[str, float]
    cached: bool = False


OnOutcome = Callable[[int, int, Outcome], None]
"""Called with (finished trials, all trials, latest outcome)."""


@cache
def sources_digest(package: str) -> str:
    """Return the sha256 (hex) over sources, models and tables of the program and of a package next to it.

    Args:
        package: a package of the program, or one in the same folder.
    """
    root = Path(__file__).parents[2]
    digest = hashlib.sha256()
    folders = [root / name for name in dict.fromkeys((*_SOURCES, "models", "cell/models", package))]
    for folder in folders:
        for path in sorted(path for path in folder.rglob("*") if path.suffix in _SUFFIXES):
            digest.update(str(path.relative_to(folder)).encode())
            digest.update(path.read_bytes())
    return digest.hexdigest()


def compute(trial: Trial, digest: str) -> Outcome:
    """Compute a trial; an error is a failed outcome.

    Args:
        trial: the trial.
        digest: `Trial.digest` of the requesting program; a different one here is a failure.
    """
    if digest != trial.digest:
        return Outcome(trial, {}, "this worker runs another version of scan-cell; install the same one there", {})
    module, _, function = trial.function.partition(":")
    start = perf_counter()
    try:
        run: TrialFunction = getattr(importlib.import_module(module), function)
        # Through JSON, so that a result is equal whether it was computed here, elsewhere, or read from disk.
        values = json.loads(json.dumps(dict(run(json.loads(trial.settings))), allow_nan=False))
    except Exception as error:  # of any placement, part or scanner; the study continues
        is_ours = isinstance(error, CellError | PlannerError)
        sentence = str(error) if is_ours else f"{type(error).__name__}: {error}"
        return Outcome(trial, {}, sentence, {"total": perf_counter() - start})
    return Outcome(trial, values, "", {**values.pop("seconds", {}), "total": perf_counter() - start})


def load(trial: Trial, folder: Path) -> Outcome | None:
    """Load a cached result; None if it is missing, damaged, of another version, or a failure."""
    try:
        content = json.loads(_path(trial, folder).read_text(encoding="utf-8"))
        if content["schema"] == SCHEMA and content["settings"] == trial.settings and not content["failure"]:
            return Outcome(trial, dict(content["values"]), "", dict(content["seconds"]), cached=True)
    except (OSError, ValueError, KeyError, TypeError):
        return None
    return None


def save(outcome: Outcome, folder: Path) -> None:
    """Write a result to the cache.

    Raises:
        FileError: if it cannot be written.
    """
    content = {
        "schema": SCHEMA,
        "function": outcome.trial.function,
        "settings": outcome.trial.settings,
        "values": dict(outcome.values),
        "failure": outcome.failure,
        "seconds": dict(outcome.seconds),
    }
    failure, cure = f"the result of a trial cannot be written to {folder}", "free disk space, or set XDG_CACHE_HOME to"
    with file_errors(failure, f"{cure} a writable folder"), atomic_write(_path(outcome.trial, folder)) as temporary:
        temporary.write_text(json.dumps(content, allow_nan=False), encoding="utf-8")


def _path(trial: Trial, folder: Path) -> Path:
    key = trial.key
    return folder / key[:2] / f"{key}.json"


class Workers(ABC):
    """Computes trials; a context manager."""

    @abstractmethod
    def compute(self, trials: Sequence[Trial]) -> Iterator[Outcome]:
        """Yield the outcome of each of the distinct trials as it is finished."""

    def start(self, trials: Sequence[Trial]) -> None:  # noqa: B027 # a hint, which other workers ignore
        """Begin trials, if there are workers for other trials meanwhile; they are saved when `compute` yields them."""

    @abstractmethod
    def close(self) -> None:
        """End the workers."""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()


def run_trials(
    trials: Sequence[Trial], workers: Workers, *, folder: Path | None = None, on_outcome: OnOutcome | None = None
) -> list[Outcome]:
    """Return the outcome of each trial, in their order; cached results are not computed again.

    Args:
        trials: the trials; equal ones are computed once.
        workers: for the other ones.
        folder: of the cached results; None: the user's cache.
        on_outcome: is called for each outcome as it comes.

    Raises:
        FileError: if a result cannot be written.
    """
    folder = cache_folder("studies") if folder is None else folder
    outcomes: dict[Trial, Outcome] = {}
    distinct = list(dict.fromkeys(trials))

    def add(outcome: Outcome) -> None:
        outcomes[outcome.trial] = outcome
        if on_outcome is not None:
            on_outcome(len(outcomes), len(distinct), outcome)

    for trial in distinct:
        if (cached_outcome := load(trial, folder)) is not None:
            add(cached_outcome)
    missing = [trial for trial in distinct if trial not in outcomes]
    for outcome in workers.compute(missing) if missing else ():
        save(outcome, folder)
        add(outcome)
    return [outcomes[trial] for trial in trials]


def start_trials(trials: Sequence[Trial], workers: Workers) -> None:
    """Begin trials that `run_trials` computes later; other trials may be computed meanwhile."""
    workers.start([trial for trial in trials if load(trial, cache_folder("studies")) is None])


def open_workers(processes: int, cluster: str | None = None, security: Path | None = None) -> Workers:
    """Return local worker processes, or those of a Dask cluster.

    Args:
        processes: number of local processes, at least 1.
        cluster: address of a Dask scheduler, in place of local processes.
        security: TOML file with `ca_file`, `cert_file` and `key_file` of a tls:// scheduler, relative to it.

    Raises:
        UsageError: if the number is not positive, the cluster does not answer, or Dask is not installed.
    """
    if processes < 1:
        raise UsageError(f"--processes {processes} must be at least 1")
    if cluster is None and security is not None:
        raise UsageError("--cluster-security is for --cluster tls://HOST:PORT; give both, or omit it")
    return Processes(processes) if cluster is None else Cluster(cluster, security)


class Processes(Workers):
    """Processes of this machine, started when they are first needed."""

    def __init__(self, count: int) -> None:
        self._count = count
        self._pool: ProcessPoolExecutor | None = None
        self._started: dict[Trial, Future[Outcome]] = {}

    def start(self, trials: Sequence[Trial]) -> None:
        """Begin trials, unless there is one process only."""
        if self._count > 1:
            self._started.update({trial: self._submit(trial) for trial in trials})

    def compute(self, trials: Sequence[Trial]) -> Iterator[Outcome]:
        """Yield each outcome. A dying process ends all running trials; each of them is repeated once, alone."""
        waiting, suspects = deque(trials), deque[Trial]()
        while waiting or suspects:
            queue, limit = (waiting, self._count) if waiting else (deque([suspects.popleft()]), 1)
            running: dict[Future[Outcome], Trial] = {}
            try:
                while queue or running:
                    while queue and len(running) < limit:
                        started = self._started.pop(queue[0], None)
                        running[started or self._submit(queue[0])] = queue[0]
                        queue.popleft()
                    completed, _ = wait(running, return_when=FIRST_COMPLETED)
                    for future in sorted(completed, key=lambda future: running[future].settings):
                        outcome = future.result()
                        del running[future]
                        yield outcome
            except BrokenProcessPool:
                self.close()
                if queue is waiting:
                    suspects.extend(running.values())
                else:
                    yield from (Outcome(trial, {}, _DIED, {}) for trial in running.values())

    def _submit(self, trial: Trial) -> Future[Outcome]:
        if self._pool is None:
            # spawn: a forked child would inherit the threads of ray engine and solver in an unknown state.
            context = multiprocessing.get_context("spawn")
            self._pool = ProcessPoolExecutor(self._count, mp_context=context, initializer=_end_with_parent)
        return self._pool.submit(_compute_in_worker, trial, trial.digest)

    def close(self) -> None:
        """End the processes, also those that compute: the exit of Python would wait for them."""
        self._started.clear()
        if self._pool is not None:
            running = list((self._pool._processes or {}).values())  # Python 3.14 has terminate_workers
            self._pool.shutdown(wait=False, cancel_futures=True)
            for process in running:
                process.terminate()
            self._pool = None


def _compute_in_worker(trial: Trial, digest: str) -> Outcome:
    """Compute a trial; a worker that is terminated meanwhile ends, and takes no other trial."""
    try:
        return compute(trial, digest)
    except SystemExit:
        os._exit(1)


def _end_with_parent() -> None:
    """Leave Ctrl-C to the parent process, and end this worker when it is terminated or the parent ends."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(1))  # removes temporary folders
    parent = multiprocessing.parent_process()

    def follow() -> None:
        if parent is not None:
            parent.join()
        os._exit(1)

    threading.Thread(target=follow, daemon=True).start()


def _certificates(path: Path) -> dict[str, str]:
    """Return the certificate files that a security file names, by their names in Dask.

    Raises:
        UsageError: if it is not readable, or a key or a file is missing.
    """
    names = {"ca_file": "tls_ca_file", "cert_file": "tls_client_cert", "key_file": "tls_client_key"}
    try:
        paths = tomllib.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise UsageError(f"--cluster-security {path} cannot be read as TOML; it has {', '.join(names)}") from error
    if set(paths) != set(names) or not all(isinstance(each, str) for each in paths.values()):
        raise UsageError(f"--cluster-security {path} has {', '.join(paths) or 'no keys'}; it has {', '.join(names)}")
    files = {name: path.parent / paths[key] for key, name in names.items()}
    if missing := [str(file) for file in files.values() if not file.is_file()]:
        raise UsageError(f"--cluster-security {path} names {missing[0]}, which does not exist")
    return {name: str(file) for name, file in files.items()}


class Cluster(Workers):
    """Workers of a Dask scheduler, which gives the trials of a lost worker to another."""

    def __init__(self, address: str, security: Path | None = None) -> None:
        if address.startswith("tls://") is not (security is not None):
            raise UsageError(
                f"--cluster {address} and --cluster-security {security or 'is not given'} do not agree; a tls:// "
                "scheduler needs the file of its certificates, and no other scheduler uses it"
            )
        try:
            from distributed import Client, Security
        except ImportError as error:
            raise UsageError("--cluster needs Dask; install it with pip install 'scan-cell[cluster]'") from error
        try:
            files = {} if security is None else _certificates(security)
            options = {"security": Security(require_encryption=True, **files)} if files else {}
            self._client: Any = Client(address, timeout=_CLUSTER_TIMEOUT_S, set_as_default=False, **options)
        except (OSError, ValueError, TimeoutError) as error:
            raise UsageError(
                f"no Dask scheduler answers at {address}; start one with dask scheduler --host 127.0.0.1, and check "
                "address, port and certificates"
            ) from error

    def compute(self, trials: Sequence[Trial]) -> Iterator[Outcome]:
        """Yield each outcome."""
        from distributed import as_completed

        with self._client.as_current():
            by_key = {trial.key: trial for trial in trials}
            digests = [trial.digest for trial in trials]
            futures = self._client.map(compute, trials, digests, key=list(by_key), pure=True, retries=_RETRIES)
            for future in as_completed(futures):
                error = future.exception()
                if error is None:
                    yield future.result()
                else:
                    yield Outcome(by_key[future.key], {}, f"its workers were lost: {error}", {})

    def close(self) -> None:
        """Disconnect from the scheduler."""
        self._client.close()
