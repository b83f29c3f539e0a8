"""Run the trials of a study: kept results first, the others by the workers.

Every result is on disk before the next is waited for, so Ctrl-C, a kill or a dead machine loses only what was being
computed. Results come back in the order of the trials, whoever computed them, and are the same to the bit: a trial is
a pure function of its settings, and its result passes through JSON in every case.
"""

from collections.abc import Callable, Sequence
from pathlib import Path

from cell.study import store
from cell.study.trial import Outcome, Trial
from cell.study.workers import Workers

Told = Callable[[int, int, Outcome], None]
"""Called with (trials done, trials in all, the outcome that came last)."""


def run(
    trials: Sequence[Trial], workers: Workers, *, folder: Path | None = None, told: Told | None = None
) -> list[Outcome]:
    """The outcome of each trial, in their order; equal trials are computed once.

    Args:
        trials: what is asked.
        workers: who computes what is not kept from before.
        folder: where results are kept; None: `store.cache_folder()`.
        told: is told of each outcome as it comes.

    Raises:
        FileError: if a result cannot be kept.
    """
    kept = store.cache_folder() if folder is None else folder
    outcomes: dict[Trial, Outcome] = {}
    distinct = list(dict.fromkeys(trials))

    def note(outcome: Outcome) -> None:
        outcomes[outcome.trial] = outcome
        if told is not None:
            told(len(outcomes), len(distinct), outcome)

    for trial in distinct:
        found = store.load(trial, kept)
        if found is not None:
            note(found)
    missing = [trial for trial in distinct if trial not in outcomes]
    for outcome in workers.compute(missing) if missing else ():
        store.save(outcome, kept)
        note(outcome)
    return [outcomes[trial] for trial in trials]
