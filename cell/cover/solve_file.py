"""`cell cover`: read a set-cover file, solve it with the planner's own selection, and say what is proven."""

import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from cell.cover.cover_files import CoverFile, read
from cell.cover.options import CoverOptions
from cell.errors import FileError, UsageError
from planner import cover
from planner.cover.budget import DEFAULT_EFFORT, EFFORT_PER_SECOND, UNLIMITED_EFFORT
from planner.errors import PlannerError

DEFAULT_S = DEFAULT_EFFORT / EFFORT_PER_SECOND
"""Work where none is asked for [seconds of a usual core]."""


@dataclass(frozen=True, slots=True, eq=False)
class CoverOutcome:
    """A solved file.

    Attributes:
        path: the file.
        problem: what it holds.
        result: the cover.
        seconds: time that the solution took [s].
    """

    path: Path
    problem: CoverFile
    result: cover.Cover
    seconds: float

    def as_json(self) -> dict[str, object]:
        """The object that `--json` prints; columns are numbered from 1, as in the file."""
        rows, columns = self.problem.matrix.shape
        return {
            "file": str(self.path),
            "format": self.problem.format,
            "rows": rows,
            "columns": columns,
            "entries": int(self.problem.matrix.nnz),
            "solver": self.result.solver,
            "views": sorted(int(view) + 1 for view in self.result.views),
            "n_views": len(self.result.views),
            "cost": self.result.cost,
            "lower_bound": self.result.cost_bound,
            "gap": self.result.gap,
            "status": self.result.status.name.lower(),
            "sentence": self.sentence,
            "uncoverable_rows": [int(row) + 1 for row in self.result.uncoverable_rows],
            "work": self.result.effort,
            "seconds": round(self.seconds, 3),
        }

    @property
    def sentence(self) -> str:
        """What is proven, in the words of a set-cover file."""
        told = self.result.sentence.replace(" for these candidates and samples", "")
        return told.replace("views", "columns").replace("view", "column")

    def rows(self) -> list[tuple[str, str]]:
        """What a terminal shows: the problem, the cover, what is proven about it, and the columns."""
        rows, columns = self.problem.matrix.shape
        result = self.result
        return [
            ("problem", f"{rows} rows, {columns} columns, {self.problem.matrix.nnz} ones ({self.problem.format})"),
            ("columns", str(len(result.views))),
            *([] if result.cost_and_bound is None else [("cost", f"{result.cost:.10g}")]),
            ("lower bound", f"{result.cost_bound:.10g}"),
            ("gap", f"{100 * result.gap:.1f} %"),
            *([("rows without a column", str(len(result.uncoverable_rows)))] if len(result.uncoverable_rows) else []),
            ("solver", f"{result.solver}, {self.seconds:.2f} s"),
            ("chosen", " ".join(str(view + 1) for view in sorted(result.views.tolist()))),
        ]


def solve_file(path: Path, wanted: CoverOptions, *, unicost: bool) -> CoverOutcome:
    """Solve a set-cover file.

    Args:
        path: the file, see `cell.cover.cover_files`.
        wanted: its format, solver, work and time; without a budget the default one, or, with a time limit, no end but
            that.
        unicost: whether every column costs 1, whatever the file says.

    Raises:
        FileError: if the file is not a set-cover file.
        UsageError: for an option out of its range.
    """
    most = UNLIMITED_EFFORT // EFFORT_PER_SECOND
    if wanted.budget_s is not None and wanted.budget_s > most:
        raise UsageError(f"--budget is {wanted.budget_s:g}; it must be from 0 to {most} seconds' worth of work")
    problem = read(path, wanted.form)
    if not min(problem.matrix.shape):
        raise FileError(
            f"{path} has {problem.matrix.shape[0]} rows and {problem.matrix.shape[1]} columns; both must be 1 or more"
        )
    if wanted.budget_s is not None:
        budget = round(wanted.budget_s * EFFORT_PER_SECOND)
    else:
        budget = DEFAULT_EFFORT if wanted.time_limit_s is None else UNLIMITED_EFFORT
    rows, costs = np.ones(problem.matrix.shape[0]), None if unicost else problem.costs
    start = time.perf_counter()
    try:
        asked = cover.CoverProblem(
            problem.matrix, rows, coverage=wanted.coverage, demand=wanted.multiplicity, costs=costs
        )
        rng = np.random.default_rng(wanted.seed)
        result = cover.solve(
            asked, rng=rng, solver=wanted.solver, effort_budget=budget, time_limit_s=wanted.time_limit_s
        )
    except PlannerError as error:
        raise UsageError(str(error)) from error
    return CoverOutcome(path, problem, result, time.perf_counter() - start)
