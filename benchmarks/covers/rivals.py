"""HiGHS and CP-SAT on the integer programme of a task, and the textbook search, limited by processor time.

    cover the rows     min c x    s.t. M x >= 1
    a share of area    min c x    s.t. M x >= y, a y >= share of the coverable area
    at most k views    max a y    s.t. M x >= y, 1 x <= k

Rows with the same columns are merged first. Both get one core (HiGHS one thread, CP-SAT eight searches whose processor
times are summed), and their clock starts once the model exists.
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
from benchmarks.covers.instances import Instance, Task, required_units

_MANY = 2**40  # no upper limit
_CHECK_S = 0.02  # between checks of the clock
_WORKERS = 8  # searches of CP-SAT: with one it has no neighbourhood search, and finds worse covers


@dataclass
class Answer:
    """Answer of a solver.

    Attributes:
        columns: selected columns.
        bound: lower bound on the cost; with `max_views` upper bound on the covered units.
        trace: processor seconds since the start and cost (or units) of each better answer.
    """

    columns: list[int]
    bound: float
    trace: list[tuple[float, float]]


@dataclass(frozen=True)
class Programme:
    """Minimise objective z subject to lower <= A z <= upper; z are the usable columns (0 or 1), then y (0 to 1)."""

    A: Any
    lower: Any
    upper: Any
    objective: Any
    columns: Any


def programme(instance: Instance, task: Task) -> Programme:
    """Return the integer programme of a task."""
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
        low, high = required_units(task.coverage, int(units.sum())), int(units.sum())
        objective = np.concatenate((costs, np.zeros(m, np.int64)))
    else:
        last, low, high = np.repeat((1, 0), (n, m)), 0, task.max_views
        objective = np.concatenate((np.zeros(n, np.int64), -units))
    A = sp.vstack((A, sp.csr_array(last[None, :])), format="csr")
    return Programme(A, np.append(np.zeros(m, np.int64), low), np.append(many, high), objective, columns)


def _merged(M: Any) -> tuple[Any, Any]:
    """Return the first row of each group with the same columns, and the group of each row."""
    M.sort_indices()
    numbers: dict[bytes, int] = {}
    same = np.array([
        numbers.setdefault(M.indices[a:b].tobytes(), len(numbers)) for a, b in pairwise(M.indptr.tolist())
    ])  # fmt: skip
    return np.unique(same, return_index=True)[1], same


def highs(instance: Instance, task: Task) -> Answer:
    """Solve by branch and cut of HiGHS."""
    import highspy

    model_data = programme(instance, task)
    n, sign = len(model_data.columns), -1 if task.max_views is not None else 1
    solver = highspy.Highs()
    settings = {"threads": 1, "random_seed": task.seed, "mip_rel_gap": 0.0, "mip_abs_gap": 0.999, "output_flag": False}
    for key, value in settings.items():
        solver.setOptionValue(key, value)
    model = highspy.HighsLp()
    model.num_col_, model.num_row_ = len(model_data.objective), len(model_data.lower)
    model.col_cost_, model.col_lower_ = model_data.objective.astype(float), np.zeros(model.num_col_)
    model.col_upper_ = np.ones(model.num_col_)
    model.row_lower_ = model_data.lower.astype(float)
    model.row_upper_ = np.where(model_data.upper < _MANY, model_data.upper, highspy.kHighsInf)
    matrix = model_data.A
    model.a_matrix_.format_ = highspy.MatrixFormat.kRowwise
    model.a_matrix_.start_, model.a_matrix_.index_ = matrix.indptr, matrix.indices
    model.a_matrix_.value_ = matrix.data.astype(float)
    kinds = highspy.HighsVarType.kInteger, highspy.HighsVarType.kContinuous
    model.integrality_ = [kinds[k >= n] for k in range(model.num_col_)]
    solver.passModel(model)
    begin, trace = time.process_time(), list[tuple[float, float]]()

    def better(event: Any) -> None:
        trace.append((time.process_time() - begin, sign * event.data_out.objective_function_value))

    def check(event: Any) -> None:
        if time.process_time() - begin >= (task.seconds or 0.0):
            event.interrupt()

    solver.cbMipImprovingSolution += better
    for moment in (solver.cbMipInterrupt, solver.cbSimplexInterrupt, solver.cbIpmInterrupt):
        moment += check
    solver.run()
    info = solver.getInfo()
    bound = sign * float(info.mip_dual_bound)
    if not info.primal_solution_status:  # none found
        return Answer([], bound if np.isfinite(bound) else 0.0, trace)
    values = np.asarray(solver.getSolution().col_value)[:n]
    return Answer(model_data.columns[values > 0.5].tolist(), bound, trace)


def cp_sat(instance: Instance, task: Task) -> Answer:
    """Solve by CP-SAT of OR-Tools."""
    from ortools.sat.python import cp_model

    model_data = programme(instance, task)
    sign = -1 if task.max_views is not None else 1
    model = cp_model.CpModel()
    z = np.array([model.new_bool_var("") for _ in model_data.objective], dtype=object)
    full, A = task.coverage == 1 and task.max_views is None, model_data.A
    for row in range(len(model_data.lower)):
        inside = slice(A.indptr[row], A.indptr[row + 1])
        variables, factors = z[A.indices[inside]], A.data[inside]
        if full:
            model.add_bool_or(variables)
        elif row < len(model_data.lower) - 1:  # y implies one of the columns that cover the row
            model.add_bool_or(*variables[factors > 0], ~variables[factors < 0][0])
        else:
            total = cp_model.LinearExpr.weighted_sum(variables, factors)
            model.add_linear_constraint(total, int(model_data.lower[row]), int(model_data.upper[row]))
    model.minimize(cp_model.LinearExpr.weighted_sum(z, model_data.objective))
    solver = cp_model.CpSolver()
    solver.parameters.num_workers, solver.parameters.random_seed = _WORKERS, task.seed
    begin, trace = time.process_time(), list[tuple[float, float]]()

    class Better(cp_model.CpSolverSolutionCallback):
        def on_solution_callback(self) -> None:
            trace.append((time.process_time() - begin, sign * self.objective_value))

    with _TimeLimit(task.seconds or 0.0, begin, solver.stop_search):
        status = solver.solve(model, Better())
    found = status in (cp_model.OPTIMAL, cp_model.FEASIBLE)
    columns = [int(c) for c, v in zip(model_data.columns, z, strict=False) if solver.boolean_value(v)] if found else []
    return Answer(columns, sign * solver.best_objective_bound if found else 0.0, trace)


def textbook(instance: Instance, task: Task) -> Answer:
    """Solve by the row-weighting search after selecting columns without an alternative; covers only, no bound."""
    answer, seconds = Answer([], 0.0, []), task.seconds or 0.0
    usable = np.flatnonzero(instance.usable)
    M = instance.M[:, usable]
    forced = np.unique(M.indices[M.indptr[:-1][np.diff(M.indptr) == 1]])
    selected = np.isin(np.arange(len(usable)), forced).astype(np.int32)
    residual = M[(np.diff(M.indptr) > 0) & (M @ selected == 0)]
    residual.sort_indices()
    forced_cost, costs = int(instance.costs[usable[forced]].sum()), instance.costs[usable]
    for at, cost, columns in row_weighting.row_weighting_search(residual, costs, task.seed, seconds, time.process_time):
        answer.columns = usable[np.union1d(forced, columns)].tolist()
        answer.trace.append((at, forced_cost + cost))
    return answer


class _TimeLimit:
    """Call `stop` once the processor time is spent, from another thread: CP-SAT has no processor clock."""

    def __init__(self, seconds: float, begin: float, stop: Callable[[], None]) -> None:
        self._done = threading.Event()
        self._thread = threading.Thread(target=self._watch, args=(begin + seconds, stop))

    def _watch(self, end: float, stop: Callable[[], None]) -> None:
        while not self._done.wait(_CHECK_S):
            if time.process_time() >= end:
                stop()  # repeatedly: before the search has started it is ignored

    def __enter__(self) -> None:
        self._thread.start()

    def __exit__(self, *_: object) -> None:
        self._done.set()
        self._thread.join()
