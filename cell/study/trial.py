"""One trial of a study: what is computed, under which settings, and the key that its result is kept under.

A trial is a function of a module and a table of settings that JSON can hold; the function is a pure map from those
settings to values that JSON can hold (and `seconds`, which are kept apart). So it can be sent to another process or
machine, its result can be kept on disk, and the key says everything that the result depends on: function, settings, the
program's own sources, and those of the package beside it that the function is in.
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

JsonTable = Mapping[str, Any]
"""What JSON holds of a trial, by name: its settings, or the values that it comes to."""

TrialFunction = Callable[[JsonTable], JsonTable]

_SOURCES = ("planner", "cell", "drivers")


@dataclass(frozen=True, slots=True)
class Trial:
    """What is computed.

    Attributes:
        function: module and name of the function, as "module:name".
        settings: canonical JSON of the settings.
    """

    function: str
    settings: str

    @classmethod
    def of(cls, function: TrialFunction, settings: Mapping[str, object]) -> "Trial":
        """A trial from a function of a module, which a worker can import, and a table of settings.

        Raises:
            ValueError: if a setting is NaN or infinite.
        """
        name = f"{function.__module__}:{function.__name__}"
        return cls(name, json.dumps(dict(settings), sort_keys=True, allow_nan=False))

    @property
    def digest(self) -> str:
        """sha256 (hex) over the sources that compute it here."""
        return sources_digest(self.function.partition(".")[0])

    @property
    def key(self) -> str:
        """sha256 (hex) over all that the result depends on."""
        return hashlib.sha256(f"{self.function}\n{self.settings}\n{self.digest}".encode()).hexdigest()


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
    values: JsonTable
    failure: str
    seconds: Mapping[str, float]
    cached: bool = False


def compute(trial: Trial, digest: str) -> Outcome:
    """Compute a trial. A failure is a result: the study goes on. Ctrl-C is not.

    Args:
        trial: what to compute.
        digest: `Trial.digest` of the program that asks; another program here is a failure.
    """
    if digest != trial.digest:
        return Outcome(trial, {}, "this worker runs another version of scan-cell; install the same one there", {})
    module, _, function = trial.function.partition(":")
    start = perf_counter()
    try:
        run: TrialFunction = getattr(importlib.import_module(module), function)
        # Through JSON, so that a result is the same whether it was computed here, elsewhere, or read from disk.
        values = json.loads(json.dumps(dict(run(json.loads(trial.settings))), allow_nan=False))
    except Exception as error:  # whatever a placement, a part or a scanner may do: the sentence is kept with the trial
        return Outcome(trial, {}, _sentence(error), {"total": perf_counter() - start})
    return Outcome(trial, values, "", {**values.pop("seconds", {}), "total": perf_counter() - start})


def _sentence(error: Exception) -> str:
    """Ours speak for themselves; of others the kind is told too."""
    return str(error) if isinstance(error, CellError | PlannerError) else f"{type(error).__name__}: {error}"


@cache
def sources_digest(package: str) -> str:
    """sha256 (hex) over the program's sources and models, and over those of a package beside it: others, other results.

    Args:
        package: one of the program's, or one that stands in the same folder as these.
    """
    root = Path(__file__).parents[2]
    digest = hashlib.sha256()
    folders = [root / name for name in dict.fromkeys((*_SOURCES, "models", "cell/models", package))]
    for folder in folders:
        for path in sorted(path for path in folder.rglob("*") if path.suffix in {".py", ".toml", ".xml", ".npz"}):
            digest.update(str(path.relative_to(folder)).encode())
            digest.update(path.read_bytes())
    return digest.hexdigest()
