"""HiGHS and CP-SAT on the plain integer programme of a task, and the textbook search, each ended by processor time.

    cover the rows     min c x    s.t. M x >= 1
    a share of area    min c x    s.t. M x >= y, a y >= share of the coverable area
    at most k views    max a y    s.t. M x >= y, 1 x <= k

Rows of the same columns are merged first. Both get one core (HiGHS one thread, CP-SAT eight searches whose processor
time counts together), and their clock starts when the model stands.
"""

import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
import scipy.sparse as sp

from benchmarks.covers import row_weighting
from benchmarks.covers.instances import Instance, Task, target

_MANY = 2**40  # no upper limit
_LOOK_S = 0.02  # between looks at the clock
_WORKERS = 8  # of CP-SAT: with one it has no neighbourhood search, and finds worse covers


@dataclass
class Answer:
    """What a solver says.

    Attributes:
        columns: chosen.
        bound: on the cost from below; with at most k views on the covered units from above.
        trace: processor seconds since the beginning, and cost (or units), of each better answer.
    """

    columns: list[int]
    bound: float
    trace: list[tuple[float, float]]


@dataclass(frozen=True)
class Programme:
    """min objective z subject to lower <= A z <= upper, z the usable columns (0 or 1) and then y (0 to 1)."""

    A: Any
    lower: Any
    upper: Any
    objective: Any
    columns: Any


def programme(instance: Instance, task: Task) -> Programme:
    """The integer programme of a task."""
    columns, rows = np.flatnonzero(instance.usable), np.flatnonzero(instance.coverable)
    M = instance.M[rows][:, columns].astype(np.int64)
    first, same = _merged(M)
    M = M[first]
    m, n = M.shape
    costs, units = instance.costs[columns], np.bincount(same, instance.units[rows]).astype(np.int64)
    many = np.full(m, _MANY)
    if task.coverage == 1 and task.max_views is None:
        return Programme(M, np.ones(m, np.int64), many, costs, columns)
    A = sp.hstack((M, -sp.eye_array(m, dtype=np.int64)), format="csr")
    if task.max_views is None:
        last = np.concatenate((np.zeros(n, np.int64), units))
        low, high = target(task.coverage, int(units.sum())), int(units.sum())
        objective = np.concatenate((costs, np.zeros(m, np.int64)))
    else:
        last, low, high = np.repeat((1, 0), (n, m)), 0, task.max_views
        objective = np.concatenate((np.zeros(n, np.int64), -units))
    A = sp.vstack((A, sp.csr_array(last[None, :])), format="csr")
    return Programme(A, np.append(np.zeros(m, np.int64), low), np.append(many, high), objective, columns)


def _merged(M: Any) -> tuple[Any, Any]:
    """Rows of the same columns are one: the first of each, and which of these each row is."""
    M.sort_indices()
    numbers: dict[bytes, int] = {}
    same = np.array([
        numbers.setdefault(M.indices[a:b].tobytes(), len(numbers)) for a, b in pairwise(M.indptr.tolist())
    ])  # fmt: skip
    return np.unique(same, return_index=True)[1], same


def highs(instance: Instance, task: Task) -> Answer:
    """HiGHS's branch and cut."""
    import highspy

    asked = programme(instance, task)
    n, sign = len(asked.columns), -1 if task.max_views is not None else 1
    solver = highspy.Highs()
    settings = {"threads": 1, "random_seed": task.seed, "mip_rel_gap": 0.0, "mip_abs_gap": 0.999, "output_flag": False}
    for key, value in settings.items():
        solver.setOptionValue(key, value)
    model = highspy.HighsLp()
    model.num_col_, model.num_row_ = len(asked.objective), len(asked.lower)
    model.col_cost_, model.col_lower_ = asked.objective.astype(float), np.zeros(model.num_col_)
    model.col_upper_ = np.ones(model.num_col_)
    model.row_lower_ = asked.lower.astype(float)
    model.row_upper_ = np.where(asked.upper < _MANY, asked.upper, highspy.kHighsInf)
    matrix = asked.A
    model.a_matrix_.format_ = highspy.MatrixFormat.kRowwise
    model.a_matrix_.start_, model.a_matrix_.index_ = matrix.indptr, matrix.indices
    model.a_matrix_.value_ = matrix.data.astype(float)
    kinds = highspy.HighsVarType.kInteger, highspy.HighsVarType.kContinuous
    model.integrality_ = [kinds[k >= n] for k in range(model.num_col_)]
    solver.passModel(model)
    begin, trace = time.process_time(), list[tuple[float, float]]()

    def better(event: Any) -> None:
        trace.append((time.process_time() - begin, sign * event.data_out.objective_function_value))

    def look(event: Any) -> None:
        if time.process_time() - begin >= (task.seconds or 0.0):
            event.interrupt()

    solver.cbMipImprovingSolution += better
    for moment in (solver.cbMipInterrupt, solver.cbSimplexInterrupt, solver.cbIpmInterrupt):
        moment += look
    solver.run()
    info = solver.getInfo()
    bound = sign * float(info.mip_dual_bound)
    if not info.primal_solution_status:  # none found
        return Answer([], bound if np.isfinite(bound) else 0.0, trace)
    values = np.asarray(solver.getSolution().col_value)[:n]
    return Answer(asked.columns[values > 0.5].tolist(), bound, trace)


def cp_sat(instance: Instance, task: Task) -> Answer:
    """CP-SAT of OR-Tools."""
    from ortools.sat.python import cp_model

    asked = programme(instance, task)
    sign = -1 if task.max_views is not None else 1
    model = cp_model.CpModel()
    z = np.array([model.new_bool_var("") for _ in asked.objective], dtype=object)
    full, A = task.coverage == 1 and task.max_views is None, asked.A
    for row in range(len(asked.lower)):
        inside = slice(A.indptr[row], A.indptr[row + 1])
        chosen, factors = z[A.indices[inside]], A.data[inside]
        if full:
            model.add_bool_or(chosen)
        elif row < len(asked.lower) - 1:  # y implies one of the columns that cover the row
            model.add_bool_or(*chosen[factors > 0], ~chosen[factors < 0][0])
        else:
            total = cp_model.LinearExpr.weighted_sum(chosen, factors)
            model.add_linear_constraint(total, int(asked.lower[row]), int(asked.upper[row]))
    model.minimize(cp_model.LinearExpr.weighted_sum(z, asked.objective))
    solver = cp_model.CpSolver()
    solver.parameters.num_workers, solver.parameters.random_seed = _WORKERS, task.seed
    begin, trace = time.process_time(), list[tuple[float, float]]()

    class Better(cp_model.CpSolverSolutionCallback):
        def on_solution_callback(self) -> None:
            trace.append((time.process_time() - begin, sign * self.objective_value))

    with _ended_after(task.seconds or 0.0, begin, solver.stop_search):
        status = solver.solve(model, Better())
    found = status in (cp_model.OPTIMAL, cp_model.FEASIBLE)
    columns = [int(c) for c, v in zip(asked.columns, z, strict=False) if solver.boolean_value(v)] if found else []
    return Answer(columns, sign * solver.best_objective_bound if found else 0.0, trace)


def textbook(instance: Instance, task: Task) -> Answer:
    """The row-weighting search, after columns without an alternative; it knows covers only, and no bound."""
    answer, seconds = Answer([], 0.0, []), task.seconds or 0.0
    usable = np.flatnonzero(instance.usable)
    M = instance.M[:, usable]
    forced = np.unique(M.indices[M.indptr[:-1][np.diff(M.indptr) == 1]])
    taken = np.isin(np.arange(len(usable)), forced).astype(np.int32)
    rest = M[(np.diff(M.indptr) > 0) & (M @ taken == 0)]
    rest.sort_indices()
    paid, costs = int(instance.costs[usable[forced]].sum()), instance.costs[usable]
    for at, cost, columns in row_weighting.search(rest, costs, task.seed, seconds, time.process_time):
        answer.columns = usable[np.union1d(forced, columns)].tolist()
        answer.trace.append((at, paid + cost))
    return answer


class _ended_after:  # noqa: N801 - reads as a word of the `with` line
    """Call `stop` once the processor time is up, from a thread of its own: CP-SAT has no processor clock."""

    def __init__(self, seconds: float, begin: float, stop: Callable[[], None]) -> None:
        self._done = threading.Event()
        self._thread = threading.Thread(target=self._watch, args=(begin + seconds, stop))

    def _watch(self, end: float, stop: Callable[[], None]) -> None:
        while not self._done.wait(_LOOK_S):
            if time.process_time() >= end:
                stop()  # again and again: before the search has begun it is not heard

    def __enter__(self) -> None:
        self._thread.start()

    def __exit__(self, *_: object) -> None:
        self._done.set()
        self._thread.join()
