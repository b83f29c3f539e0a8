"""Answer a cover problem (inside still the modules that this one replaces)."""

import time
from collections.abc import Callable
from dataclasses import fields

import numpy as np

from planner.cover import most_coverage, overlap, selection
from planner.cover.answer import Cover, CoverStatus
from planner.cover.budget import DEFAULT_WORK
from planner.cover.problem import Problem


def solve(
    problem: Problem,
    *,
    rng: np.random.Generator,
    solver: str = "auto",
    budget: int = DEFAULT_WORK,
    time_limit_s: float | None = None,
    clock: Callable[[], float] = time.perf_counter,
) -> Cover:
    """Choose the fewest or cheapest columns for a coverage, or the most area with a number of them.

    A first cover and a lower bound are always computed, whatever the budget. Ctrl-C ends the search: the best so far is
    returned, and its status says so.

    Args:
        problem: what is asked for.
        rng: random choices of the search.
        solver: a name in `SOLVERS`.
        budget: units of work for everything together (500 million are about a second of one core).
        time_limit_s: wall-clock guard [s]; reported in the status when it fires.
        clock: seconds, for the guard.

    Raises:
        PlannerError: for a problem that contradicts itself, or an unknown solver.
    """
    p = problem
    shared = {"rng": rng, "pinned": p.pinned, "banned": p.banned, "budget": budget, "time_limit_s": time_limit_s,
              "clock": clock}  # fmt: skip
    upper = max_views = unconnected = None
    if p.max_views is not None:
        most = most_coverage.most_coverage(p.matrix, p.areas, p.allowed, max_views=p.max_views, **shared)
        old, upper, max_views = most.cover, most.upper_area, p.max_views
    elif p.overlap is not None:
        joined = overlap.overlap_cover(
            p.matrix, p.areas, p.allowed, overlap=overlap.Overlap(p.overlap.area, p.overlap.share),
            coverage=p.coverage, **shared
        )  # fmt: skip
        old, unconnected = joined.cover, joined.unconnected_views
    else:
        old = selection.solve(p.matrix, p.areas, p.allowed, coverage=p.coverage, solver=solver, costs=p.costs,
                              multiplicity=p.demand, **shared)  # fmt: skip
    values = {f.name: getattr(old, f.name) for f in fields(old) if f.name not in ("status", "multiplicity")}
    return Cover(
        **values, status=CoverStatus[old.status.name], demand=p.demand,
        upper_area=old.coverable_area if upper is None else upper,
        max_views=max_views, unconnected_views=unconnected,
    )  # fmt: skip
