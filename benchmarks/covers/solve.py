"""Solve a set-cover file with the product's view selection, so that others can check it."""

import time
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
from pydantic import Field

from benchmarks.covers.files import CoverFile, read
from cell.errors import FileError, UsageError
from cell.scene.fields import NotNegative, Table
from cell.scene.options import Option
from planner import cover
from planner.cover.budget import DEFAULT_EFFORT, EFFORT_PER_SECOND
from planner.errors import PlannerError

_SEARCH = "Search"
_MAX_EFFORT = 10**15


class CoverOptions(Table):
    """Options of reader and solver, which check their ranges."""

    form: Annotated[str | None, Option("rows, rail or steiner. Default: the one that fits.", name="format")] = None
    solver: Annotated[str, Option("auto, greedy, meta-raps, local-search or exact.", _SEARCH)] = "auto"
    budget_s: Annotated[
        NotNegative | None,
        Option(
            "Effort to spend, counted and not timed: about this many seconds of one core, with the same answer on "
            "every machine. Default: 2.",
            _SEARCH, name="budget", metavar="SECONDS",
        ),
    ] = None  # fmt: skip
    coverage: Annotated[float, Option("Share of the coverable rows that must be covered.")] = 1.0
    multiplicity: Annotated[int, Option("Number of columns that must cover each row.", metavar="K")] = 1
    seed: Annotated[int, Field(ge=0), Option("Seed of the solver's random choices.", _SEARCH)] = 0


@dataclass(frozen=True, slots=True, eq=False)
class SolvedFile:
    """A solved file.

    Attributes:
        path: the file.
        problem: its content.
        result: the cover.
        seconds: time of the solution [s].
    """

    path: Path
    problem: CoverFile
    result: cover.Cover
    seconds: float

    def as_json(self) -> dict[str, object]:
        """Return the object that `--json` prints; columns are numbered from 1, as in the file."""
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
        """The proof status in the terms of a set-cover file."""
        return (
            self.result.sentence.replace("candidate poses", "columns")
            .replace("views", "columns")
            .replace("view", "column")
        )

    def rows(self) -> list[tuple[str, str]]:
        """Return the table for a terminal: problem, cover, bound and columns."""
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


def solve_file(path: Path, options: CoverOptions, *, unicost: bool) -> SolvedFile:
    """Solve a set-cover file.

    Args:
        path: the file, see `benchmarks.covers.files`.
        options: options of reader and solver.
        unicost: whether every column costs 1 in place of the cost in the file.

    Raises:
        FileError: if the file is not a set-cover file.
        UsageError: if an option is out of its range.
    """
    limit = _MAX_EFFORT // EFFORT_PER_SECOND
    if options.budget_s is not None and options.budget_s > limit:
        raise UsageError(f"--budget is {options.budget_s:g}; it must be from 0 to {limit} seconds of effort")
    problem = read(path, options.form)
    if not min(problem.matrix.shape):
        raise FileError(
            f"{path} has {problem.matrix.shape[0]} rows and {problem.matrix.shape[1]} columns; both must be 1 or more"
        )
    budget = DEFAULT_EFFORT if options.budget_s is None else round(options.budget_s * EFFORT_PER_SECOND)
    areas, costs = np.ones(problem.matrix.shape[0]), None if unicost else problem.costs
    start = time.perf_counter()
    try:
        request = cover.CoverProblem(
            problem.matrix, areas, coverage=options.coverage, demand=options.multiplicity, costs=costs
        )
        rng = np.random.default_rng(options.seed)
        result = cover.solve(request, rng=rng, solver=options.solver, effort_budget=budget)
    except PlannerError as error:
        raise UsageError(str(error)) from error
    return SolvedFile(path, problem, result, time.perf_counter() - start)
