"""One trial of a study: what is computed, under which settings, and the key that its result is kept under.

A trial is a name of `TRIALS` and a table of settings that JSON can hold; its function is a pure map from those settings
to values that JSON can hold (and `seconds`, which are kept apart). So it can be sent to another process or machine, its
result can be kept on disk, and the key says everything that the result depends on: name, settings and the program's
own sources.
"""

import hashlib
import importlib
import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from time import perf_counter
from typing import Any

from cell.errors import CellError
from planner.errors import PlannerError

TRIALS = {
    "table-row": "cell.study.table_row:row",
    "placement": "cell.study.placed:placement",
    "views": "cell.study.views:views",
    "knob": "cell.study.knobs:turn",
    "whole": "cell.study.whole:whole",
    "measurable": "cell.study.whole:measurable",
    "stability": "cell.study.stability:at",
}
"""Name of a trial and where its function is; only these can be run, whoever asks."""

TrialFunction = Callable[[Mapping[str, Any]], Mapping[str, Any]]

_SOURCES = ("planner", "cell", "drivers")


@dataclass(frozen=True, slots=True)
class Trial:
    """What is computed.

    Attributes:
        name: a key of `TRIALS`.
        settings: canonical JSON of the settings.
    """

    name: str
    settings: str

    @classmethod
    def of(cls, name: str, settings: Mapping[str, Any]) -> "Trial":
        """A trial from a table of settings.

        Raises:
            KeyError: if no trial has this name.
            ValueError: if a setting is NaN or infinite.
        """
        _ = TRIALS[name]
        return cls(name, json.dumps(dict(settings), sort_keys=True, allow_nan=False))

    @property
    def key(self) -> str:
        """sha256 (hex) over all that the result depends on."""
        return hashlib.sha256(f"{self.name}\n{self.settings}\n{sources_digest()}".encode()).hexdigest()


@dataclass(frozen=True, slots=True)
class Outcome:
    """How a trial ended.

    Attributes:
        trial: what was asked.
        values: what came out; empty where it failed.
        failure: why it failed, in one sentence; "" where it did not.
        seconds: what each step took on the machine that computed it, now or earlier; "total" is all of it.
        cached: whether it was computed earlier.
    """

    trial: Trial
    values: Mapping[str, Any]
    failure: str
    seconds: Mapping[str, float]
    cached: bool = False


def compute(trial: Trial, digest: str) -> Outcome:
    """Compute a trial. A failure is a result: the study goes on. Ctrl-C is not.

    Args:
        trial: what to compute.
        digest: `sources_digest()` of the program that asks; another program here is a failure.
    """
    if digest != sources_digest():
        return Outcome(trial, {}, "this worker runs another version of scan-cell; install the same one there", {})
    module, _, function = TRIALS[trial.name].partition(":")
    run: TrialFunction = getattr(importlib.import_module(module), function)
    start = perf_counter()
    try:
        # Through JSON, so that a result is the same whether it was computed here, elsewhere, or read from disk.
        values = json.loads(json.dumps(dict(run(json.loads(trial.settings))), allow_nan=False))
    except Exception as error:  # whatever a placement, a part or a scanner may do: the sentence is kept with the trial
        return Outcome(trial, {}, _sentence(error), {"total": perf_counter() - start})
    return Outcome(trial, values, "", {**values.pop("seconds", {}), "total": perf_counter() - start})


def _sentence(error: Exception) -> str:
    """Ours speak for themselves; of others the kind is told too."""
    return str(error) if isinstance(error, CellError | PlannerError) else f"{type(error).__name__}: {error}"


@cache
def sources_digest() -> str:
    """sha256 (hex) over the program's own sources and models: another program, other results."""
    root = Path(__file__).parents[2]
    digest = hashlib.sha256()
    folders = [root / name for name in _SOURCES] + [root / "models", root / "cell" / "models"]
    for folder in folders:
        for path in sorted(path for path in folder.rglob("*") if path.suffix in {".py", ".toml", ".xml"}):
            digest.update(str(path.relative_to(folder)).encode())
            digest.update(path.read_bytes())
    return digest.hexdigest()
