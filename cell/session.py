"""Session of a command: folder of its results, progress, confirmation, plots, random streams, effort and origin.

A command makes one `Session` and passes it to every function that writes, reports, draws or chooses at random. The
reporter of the command line is `cell.cli.terminal.Terminal`.
"""

import logging
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass, field
from enum import IntEnum
from pathlib import Path
from typing import Generic, Protocol, TypeVar, runtime_checkable

import numpy as np
from numpy.typing import ArrayLike

from planner.cover.budget import DEFAULT_EFFORT
from planner.cover.curve import CURVE_EFFORT
from planner.measurability.coverage import N_SAMPLES
from planner.ports import Progress, no_progress
from planner.viewpoints.attainable import N_PROBED_SAMPLES

log = logging.getLogger(__name__)
log.addHandler(logging.NullHandler())  # without a run.log, Python would print each warning on stderr

Confirm = Callable[[str], str]
"""Put a question to a person and return the answer."""


class Stream(IntEnum):
    """Numbers of the random streams of the product; a stream is seeded by (seed of the run, number).

    The streams of a plan have fixed numbers, so that no step changes the draws of another. Streams below them
    with an equal number (aliases) belong to commands that never meet in one run; those of a scan are seeded by
    (seed, number, view or set-up).
    """

    # plan
    MATRIX_SAMPLES = 0
    HELD_OUT_SAMPLES = 1
    SELECTION = 2
    MOTION = 3
    POSE_ERRORS = 4
    SIMULATED_EXECUTIONS = 5
    COVERAGE_CURVE = 6
    SCOUTS = 7
    ATTAINABLE_SAMPLES = 8
    FRESH_SAMPLES = 9
    POSE_SEARCH = 15
    POSE_COMPARISON = 16
    # plan of an exploration, in place of the samples of the matrix and the scouts
    BELIEF_SAMPLES = 10
    BELIEF_SCOUTS = 11
    # evaluation of an exploration
    FEWEST_VIEWS = 12
    # scan
    POSE_DISTURBANCE = 10
    RANGE_NOISE = 11
    DEVIATION_SAMPLES = 12
    PART_DISTURBANCE = 13
    REGISTRATION_STARTS = 14
    # commands without a plan of their own
    ADVICE_SAMPLES = 10
    LOCALISATION_STARTS = 11
    CANDIDATE_SUBSET = 5


def random_stream(seed: int, stream: Stream, *part: int) -> np.random.Generator:
    """Return the generator of a stream, or of one part of it."""
    return np.random.default_rng([seed, int(stream), *part])


@dataclass(frozen=True, slots=True)
class Effort:
    """Limits of the computing effort: counts and shares, never seconds.

    Attributes:
        held_out_samples: samples on which coverage is predicted and measured; the definition of coverage has 100,000.
        deviation_samples: samples on which the deviation of a surface is measured.
        searched_samples: unmeasured samples for each of which a measuring pose is searched.
        pose_search_share: share of the requested effort of a pose search.
        motion_share: share of the effort of the search for detours.
        clearance_share: tolerance of a proven clearance, as a share of the clearance.
        cover_work: search for the fewest or the cheapest views, with its proof.
        probe_work: search for views that only shows where samples are missing.
        selection_work: search that continues from a probe.
        repeat_work: each later search, where views fall slightly short of the target.
        constrained_work: search for the most coverage by k views, and for views with connected scans.
        curve_work: search and bound of the coverage over the number of views.
    """

    held_out_samples: int = N_SAMPLES
    deviation_samples: int = 100_000
    searched_samples: int = N_PROBED_SAMPLES
    pose_search_share: float = 1.0
    motion_share: float = 1.0
    clearance_share: float = 0.05
    cover_work: int = DEFAULT_EFFORT
    probe_work: int = DEFAULT_EFFORT // 25
    selection_work: int = 2 * DEFAULT_EFFORT // 5
    repeat_work: int = DEFAULT_EFFORT // 5
    constrained_work: int = 3 * DEFAULT_EFFORT
    curve_work: int = CURVE_EFFORT


_effort = Effort()


def default_effort() -> Effort:
    """Return the effort of sessions, and of functions without one, that name no other."""
    return _effort


@contextmanager
def effort_of(effort: Effort) -> Iterator[None]:
    """Replace the default effort of this process inside a block."""
    global _effort
    before, _effort = _effort, effort
    try:
        yield
    finally:
        _effort = before


@runtime_checkable
class ProgressReporter(Protocol):
    """Receiver of progress and notes of a command."""

    def stage(self, name: str, *, time_left: bool = False) -> AbstractContextManager[Progress]:
        """Report a stage while it runs.

        Args:
            name: of the stage.
            time_left: whether the remaining time is worth reporting.

        Yields:
            a callback `(done, total)`.
        """

    def note(self, sentence: str) -> None:
        """Report a finding that the user should know although the command continues."""


class LoggedProgress:
    """Reporter for calls from Python: notes go to the log, progress to a callable if one is given."""

    def __init__(self, progress: Callable[[str, int, int], None] | None = None) -> None:
        """Call `progress(stage, done, total)`; a stage begins with (0, 0) because its total is unknown."""
        self._progress = progress or no_progress

    @contextmanager
    def stage(self, name: str, *, time_left: bool = False) -> Iterator[Progress]:
        """Report a stage while it runs; see `ProgressReporter`."""
        log.info("stage: %s", name)
        self._progress(name, 0, 0)
        yield lambda n_done, total: self._progress(name, n_done, total)

    def note(self, sentence: str) -> None:
        """Log a note as a warning."""
        log.warning("%s", sentence)


class PlotQueue:
    """Queue of the plots of a run; this one draws nothing. `cell.report.plots` has one that draws."""

    def part_ready(self, folder: Path) -> None:
        """Prepare the part for drawing: the meshes are in the run folder."""

    def cell_ready(self, folder: Path) -> None:
        """Prepare the cell for drawing: its files are in the run folder."""

    def send(self, plot: str, path: Path, **arrays: ArrayLike) -> None:
        """Queue a plot.

        Args:
            plot: function of `cell.report.figures`.
            path: PNG to write.
            arrays: its arguments; numbers and words arrive as arrays without dimension.
        """

    def finish(self) -> list[Path]:
        """Wait until all plots are drawn and return their files.

        Raises:
            RuntimeError: if drawing failed.
        """
        return []


@dataclass(frozen=True, slots=True)
class Origin:
    """Origin of a command, for manifests: command line and scene file (None: the built-in scene)."""

    argv: tuple[str, ...] = ()
    scene_path: Path | None = None


class ResultFolder(Protocol):
    """Folder that records the stages of a command."""

    def stage(self, name: str) -> AbstractContextManager[None]:
        """Record a stage and its seconds."""


FolderT = TypeVar("FolderT", bound=ResultFolder | None, covariant=True)
OpenedT = TypeVar("OpenedT", bound=ResultFolder)


@dataclass(frozen=True, slots=True, eq=False)
class Session(Generic[FolderT]):
    """Surroundings of a command. `Session[None]` has no folder yet; `opened` adds it.

    Attributes:
        folder: open folder of the results.
        reporter: receiver of progress and notes.
        out: path of the folder to make; None chooses one below sim_runs/.
        confirm: asks the user; None without a user.
        plots: queue of plots.
        seed: of every random stream.
        effort: amount of computing.
        use_cache: whether matrices are read from and written to the user's cache.
        origin: command line and scene file.
    """

    folder: FolderT
    reporter: ProgressReporter = field(default_factory=LoggedProgress)
    out: Path | None = None
    confirm: Confirm | None = None
    plots: PlotQueue = field(default_factory=PlotQueue)
    seed: int = 0
    effort: Effort = field(default_factory=default_effort)
    use_cache: bool = True
    origin: Origin = Origin()

    def opened(self, folder: OpenedT, seed: int, plots: PlotQueue | None = None) -> "Session[OpenedT]":
        """Return this session with the open folder of its results."""
        return Session(
            folder, self.reporter, self.out, self.confirm, self.plots if plots is None else plots, seed, self.effort,
            self.use_cache, self.origin,
        )  # fmt: skip

    @contextmanager
    def stage(self, name: str) -> Iterator[Progress]:
        """Report a stage to the user, and record it in the folder if there is one."""
        with self.reporter.stage(name) as progress:
            if self.folder is None:
                yield progress
                return
            with self.folder.stage(name):
                yield progress

    def note(self, sentence: str) -> None:
        """Report a finding that the user should know although the command continues."""
        self.reporter.note(sentence)

    def rng(self, stream: Stream) -> np.random.Generator:
        """Return a new generator of a random stream."""
        return random_stream(self.seed, stream)
