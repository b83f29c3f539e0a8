"""Who is told what goes on: stages with their progress, notes, and questions that only a person can answer.

The command line's narrator is `cell.commands.terminal`; whoever calls from Python is told through a callable, or not.
"""

import logging
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from typing import Protocol, runtime_checkable

from planner.ports import Progress

log = logging.getLogger(__name__)
log.addHandler(logging.NullHandler())  # without a run.log, Python would print each warning on stderr


@runtime_checkable
class Narrator(Protocol):
    """What the work tells while it goes on."""

    def stage(self, name: str, *, time_left: bool = False) -> AbstractContextManager[Progress]:
        """Name a stage while it runs.

        Args:
            name: of the stage.
            time_left: whether the time left is worth telling.

        Yields:
            a callback `(done, total)` for stages that can tell how far they are.
        """
        ...

    def note(self, sentence: str) -> None:
        """Say something that the user should know although the work goes on."""
        ...


class Quiet:
    """A narrator for callers from Python: notes go to the log, progress to a callable where one is given."""

    def __init__(self, progress: Callable[[str, int, int], None] | None = None) -> None:
        """Tell `progress(stage, done, total)`; a stage begins with (0, 0), its total being unknown until it tells."""
        self._progress = progress

    @contextmanager
    def stage(self, name: str, *, time_left: bool = False) -> Iterator[Progress]:
        """Name a stage while it runs; see `Narrator`."""
        log.info("stage: %s", name)
        if self._progress is None:
            yield lambda done, total: None
            return
        tell = self._progress
        tell(name, 0, 0)
        yield lambda done, total: tell(name, done, total)

    def note(self, sentence: str) -> None:
        """Say something that the user should know although the work goes on."""
        log.warning("%s", sentence)
