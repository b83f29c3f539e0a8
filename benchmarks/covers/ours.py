"""Our solver, as one of the solvers of the benchmark."""

import numpy as np

from benchmarks.covers.instances import Instance, Task
from benchmarks.covers.rivals import Answer
from planner import cover


def ours(instance: Instance, task: Task) -> Answer:
    """Solve a task with the planner; `task.seconds` of counted effort, None: its default."""
    problem = cover.CoverProblem(
        instance.M, instance.area, instance.usable, coverage=task.coverage, max_views=task.max_views,
        costs=instance.costs if task.weighted else None,
    )  # fmt: skip
    effort = None if task.seconds is None else round(task.seconds * cover.EFFORT_PER_SECOND)
    found = cover.solve(problem, rng=np.random.default_rng(task.seed), effort_budget=effort)
    unit = found.total_area / instance.units.sum()
    bound = found.cost_bound if task.max_views is None else found.upper_area / unit
    return Answer(found.views.tolist(), bound, [])
