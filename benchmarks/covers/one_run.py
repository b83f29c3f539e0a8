"""One run in a separate process: a task as JSON on standard input, its result as JSON on standard output.

Each run has its own process, because highspy and OR-Tools cannot be loaded together, and because peak memory belongs to
a process. The clock starts after imports, reading, and a small instance of the same kind that loads compiled loops.
"""

import hashlib
import json
import resource
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import asdict, replace
from functools import cache
from importlib.metadata import version
from pathlib import Path
from typing import Any

from benchmarks.covers import rivals, row_weighting
from benchmarks.covers.instances import Instance, Task, evaluate_answer, load
from benchmarks.covers.ours import ours

SOLVERS: dict[str, Callable[[Instance, Task], rivals.Answer]] = {
    "ours": ours,
    "textbook": rivals.textbook,
    "HiGHS": rivals.highs,
    "CP-SAT": rivals.cp_sat,
}

_TIMEOUT = 3  # times the seconds of a task
_WARM = "uniform:60x120:0.05:1"


@cache
def version_of(solver: str) -> str:
    """Return the version of a solver's library, or the digest of our own sources."""
    if solver in ("HiGHS", "CP-SAT"):
        return version({"HiGHS": "highspy", "CP-SAT": "ortools"}[solver])
    own = Path(str(row_weighting.__file__))
    files = [own] if solver == "textbook" else sorted(own.parents[2].glob("planner/cover/**/*.py"))
    return hashlib.sha256(b"".join(path.read_bytes() for path in files)).hexdigest()[:12]


def run(task: Task) -> dict[str, Any]:
    """Return the row of a task: its fields, the evaluation, bound, trace, processor seconds and peak memory.

    A solver that does not end is killed after `_TIMEOUT` times its seconds; it then has no columns.

    Raises:
        RuntimeError: if the process fails, or if its answer is infeasible.
    """
    child = subprocess.run(
        [sys.executable, "-m", "benchmarks.covers.one_run"],
        input=json.dumps(asdict(task)), capture_output=True, text=True, check=False,
    )  # fmt: skip
    if child.returncode in (-signal.SIGXCPU, -signal.SIGKILL):
        child.stdout = json.dumps({"columns": [], "bound": None, "cpu_s": None, "trace": [], "killed": True})
    elif child.returncode:
        raise RuntimeError(f"{task}: {child.stderr.strip().splitlines()[-1:]}")
    result = json.loads(child.stdout)
    columns = result.pop("columns")
    evaluation = evaluate_answer(task, columns)
    if columns and not evaluation["good"]:
        raise RuntimeError(f"{task}: the answer is infeasible: {evaluation}")
    return asdict(task) | {"name": task.name, "version": version_of(task.solver)} | evaluation | result


def _child(task: Task) -> dict[str, Any]:
    solve = SOLVERS[task.solver]
    small = replace(task, instance=_WARM, seconds=0.05, max_views=None if task.max_views is None else 2)
    solve(load(_WARM, False), small)
    instance = load(task.instance, task.weighted)
    used = time.process_time()
    if task.seconds is not None:
        resource.setrlimit(resource.RLIMIT_CPU, (round(used + _TIMEOUT * task.seconds + 5), resource.RLIM_INFINITY))
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss // 1024
    begun = time.process_time()
    answer = solve(instance, task)
    return {
        "columns": answer.columns,
        "bound": round(answer.bound, 6),
        "cpu_s": round(time.process_time() - begun, 3),
        "trace": [(round(at, 3), value) for at, value in answer.trace],
        "peak_mb": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss // 1024,
        "peak_mb_before": before,
    }


if __name__ == "__main__":
    json.dump(_child(Task(**json.load(sys.stdin))), sys.stdout)
