"""What is solved: an instance from a file or a generator, what is asked of it, and the judge of an answer."""

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
    """A matrix with what its columns cost and its rows stand for.

    Attributes:
        M: (m, n) csr_array of bool.
        costs: (n,) whole numbers above zero.
        area: (m,) [m^2], or 1 each.
        usable: (n,) columns that may be chosen.
    """

    M: Any
    costs: NDArray[np.int64]
    area: NDArray[np.float64]
    usable: NDArray[np.bool_]

    @property
    def units(self) -> NDArray[np.int64]:
        """(m,) area as whole numbers: 1 each where all are equal, else millionths of their mean."""
        equal = np.ptp(self.area) <= 1e-9 * self.area.mean()
        return np.ones(len(self.area), np.int64) if equal else np.round(1e6 * self.area / self.area.mean()).astype(int)

    @property
    def coverable(self) -> NDArray[np.bool_]:
        """(m,) rows that a usable column covers."""
        return np.asarray(self.M @ self.usable.astype(np.int32) > 0)


@dataclass(frozen=True)
class Task:
    """One run.

    Attributes:
        instance: a file (a set-cover file, or a part's matrix as `benchmarks.covers.visibility` writes it), or
            the name of a generated instance.
        solver: a name in `benchmarks.covers.one_run.SOLVERS`.
        seconds: processor seconds, or for ours seconds' worth of work; None: ours by default.
        seed: of the solver.
        weighted: whether columns cost what the file says, or 1.
        coverage: share of the coverable area that must be covered.
        max_views: in its place: the most area with at most so many columns.
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
        """The instance for people."""
        return Path(self.instance).name.removesuffix(".gz").removesuffix(".txt").removesuffix(".npz")

    @property
    def asked(self) -> str:
        """All but solver, seconds and seed, in one word."""
        settings = asdict(self) | {"instance": self.name}
        return json.dumps({k: v for k, v in settings.items() if k not in ("solver", "seconds", "seed")}, sort_keys=True)


@lru_cache(2)
def load(name: str, weighted: bool) -> Instance:
    """The instance of a file's path or of a generator's name."""
    if name.endswith(".npz"):
        with np.load(name, allow_pickle=False) as file:
            ones = np.ones(len(file["indices"]), dtype=bool)
            indices, indptr = (file[name].astype(np.int32) for name in ("indices", "indptr"))  # as the planner has them
            M = sp.csr_array((ones, indices, indptr), shape=tuple(file["shape"]))
            return Instance(M, np.ones(M.shape[1], np.int64), file["area"], file["reachable"])
    made = generate(name)
    if made is None:
        file = read(Path(name))
        made = file.matrix, file.costs
    M, costs = made
    M.sort_indices()
    m, n = M.shape
    return Instance(M, costs if weighted else np.ones(n, np.int64), np.ones(m), np.ones(n, dtype=bool))


def best_known(name: str) -> int | None:
    """The fewest columns known, from `best_known.json` beside a file; None where there is no such list."""
    path = Path(name)
    beside = path.parent / "best_known.json"
    stem = path.name.removesuffix(".gz").removesuffix(".txt")
    return json.loads(beside.read_text())["best_known_unicost"].get(stem) if beside.is_file() else None


def judged(task: Task, columns: list[int]) -> dict[str, int | bool]:
    """An answer looked at without its solver: cost, number, covered units, and whether it gives what was asked."""
    instance = load(task.instance, task.weighted)
    chosen = np.zeros(len(instance.costs), dtype=np.int32)
    chosen[columns] = 1
    units, coverable = instance.units, instance.coverable
    covered = int(units[instance.M @ chosen > 0].sum())
    if task.max_views is not None:
        good = len(columns) <= task.max_views
    else:
        good = covered >= target(task.coverage, int(units[coverable].sum()))
    return {
        "views": len(columns),
        "cost": int(instance.costs[columns].sum()),
        "covered": covered,
        "coverable": int(units[coverable].sum()),
        "good": bool(good and instance.usable[columns].all()),
    }


def target(coverage: float, units: int) -> int:
    """Whole units that are the share of so many."""
    return int(np.ceil(coverage * units - 1e-9 * units))
