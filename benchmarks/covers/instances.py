"""Tasks of the benchmark: an instance from a file or a generator, a question, and the evaluation of an answer."""

import json
from dataclasses import asdict, dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from benchmarks.covers.files import read
from benchmarks.covers.generators import generate


@dataclass(frozen=True)
class Instance:
    """A matrix with the costs of its columns and the areas of its rows.

    Attributes:
        M: (m, n) csr_array of bool.
        costs: (n,) whole numbers above zero.
        area: (m,) [m^2], or 1 each.
        usable: (n,) whether a column may be selected.
    """

    M: Any
    costs: NDArray[np.int64]
    area: NDArray[np.float64]
    usable: NDArray[np.bool_]

    @property
    def units(self) -> NDArray[np.int64]:
        """(m,) areas as integers: 1 each if all are equal, else millionths of their mean."""
        equal = np.ptp(self.area) <= 1e-9 * self.area.mean()
        return np.ones(len(self.area), np.int64) if equal else np.round(1e6 * self.area / self.area.mean()).astype(int)

    @property
    def coverable(self) -> NDArray[np.bool_]:
        """(m,) whether a usable column covers a row."""
        return np.asarray(self.M @ self.usable.astype(np.int32) > 0)


@dataclass(frozen=True)
class Task:
    """One run.

    Attributes:
        instance: a file (a set-cover file, or a part's matrix as `benchmarks.covers.visibility` writes it), or
            the name of a generated instance.
        solver: a name in `benchmarks.covers.one_run.SOLVERS`.
        seconds: processor seconds; for our solver counted effort of this many seconds, None: its default.
        seed: seed of the solver.
        weighted: whether columns have the costs of the file, or 1.
        coverage: share of the coverable area that must be covered.
        max_views: in place of `coverage`, the largest number of columns, whose area is maximised.
    """

    instance: str
    solver: str
    seconds: float | None = None
    seed: int = 1
    weighted: bool = False
    coverage: float = 1.0
    max_views: int | None = None

    @property
    def name(self) -> str:
        """Name of the instance in tables."""
        return Path(self.instance).name.removesuffix(".gz").removesuffix(".txt").removesuffix(".npz")

    @property
    def question(self) -> str:
        """All fields except solver, seconds and seed, as one string."""
        settings = asdict(self) | {"instance": self.name}
        return json.dumps({k: v for k, v in settings.items() if k not in ("solver", "seconds", "seed")}, sort_keys=True)


@lru_cache(2)
def load(name: str, weighted: bool) -> Instance:
    """Return the instance of a file or of a generator."""
    if name.endswith(".npz"):
        with np.load(name, allow_pickle=False) as file:
            ones = np.ones(len(file["indices"]), dtype=bool)
            indices, indptr = (file[name].astype(np.int32) for name in ("indices", "indptr"))  # as in the planner
            M = sp.csr_array((ones, indices, indptr), shape=tuple(file["shape"]))
            return Instance(M, np.ones(M.shape[1], np.int64), file["area"], file["reachable"])
    problem = generate(name)
    if problem is None:
        file = read(Path(name))
        problem = file.matrix, file.costs
    M, costs = problem
    M.sort_indices()
    m, n = M.shape
    return Instance(M, costs if weighted else np.ones(n, np.int64), np.ones(m), np.ones(n, dtype=bool))


def best_known(name: str) -> int | None:
    """Return the fewest known columns from the `best_known.json` of the folder of a file; None without such a list."""
    path = Path(name)
    beside = path.parent / "best_known.json"
    stem = path.name.removesuffix(".gz").removesuffix(".txt")
    return json.loads(beside.read_text())["best_known_unicost"].get(stem) if beside.is_file() else None


def evaluate_answer(task: Task, columns: list[int]) -> dict[str, int | bool]:
    """Evaluate an answer without its solver: number, cost, covered units, and whether it is feasible."""
    instance = load(task.instance, task.weighted)
    selected = np.zeros(len(instance.costs), dtype=np.int32)
    selected[columns] = 1
    units, coverable = instance.units, instance.coverable
    covered = int(units[instance.M @ selected > 0].sum())
    if task.max_views is not None:
        is_feasible = len(columns) <= task.max_views
    else:
        is_feasible = covered >= required_units(task.coverage, int(units[coverable].sum()))
    return {
        "views": len(columns),
        "cost": int(instance.costs[columns].sum()),
        "covered": covered,
        "coverable": int(units[coverable].sum()),
        "good": bool(is_feasible and instance.usable[columns].all()),
    }


def required_units(coverage: float, units: int) -> int:
    """Return the integer units of a coverage."""
    return int(np.ceil(coverage * units - 1e-9 * units))
