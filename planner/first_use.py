"""Compilation of the kernels of selection and ordering, by a small problem of each.

The first command after an installation compiles all kernels. A plan needs these last, so that a second process can
compile them meanwhile (`share_compilation`); each kernel is cached when it is compiled.
"""

import atexit
import multiprocessing
import os
import subprocess
from contextlib import suppress

import numpy as np
from scipy.sparse import csr_array

from planner import compiled, cover
from planner.ports import JointLimits
from planner.processes import python_command
from planner.tour.orderings import order_views
from planner.tour.visits import TourProblem

N_ROWS, N_COLUMNS, N_VIEWS = 300, 120, 16
"""Size of the small problems: large enough that neither reductions nor an exact method solve them alone."""


def share_compilation() -> None:
    """Start the second process when this one compiles its first kernel; workers of a study start none."""
    if multiprocessing.parent_process() is None and (os.cpu_count() or 1) > 1:
        compiled.call_at_first_compilation(_start)


def _start() -> None:
    """Start the second process, which ends with this one at the latest; without it kernels are compiled later."""
    quiet = subprocess.DEVNULL
    command = python_command("from planner.first_use import compile_late_kernels as run; run()")
    with suppress(OSError, TypeError):  # TypeError: an embedded Python without sys.executable
        atexit.register(subprocess.Popen(command, stdin=quiet, stdout=quiet, stderr=quiet).kill)


def compile_late_kernels() -> None:
    """Solve a small cover and order a few views."""
    rng = np.random.default_rng(0)
    matrix = csr_array(rng.random((N_ROWS, N_COLUMNS)) < 0.06)
    cover.solve(cover.CoverProblem(matrix, np.ones(N_ROWS), coverage=0.99), rng=rng, effort_budget=10_000_000)
    limits = JointLimits(*(np.full(6, value) for value in (-3.0, 3.0, 2.0, 5.0)))
    q = rng.uniform(-1.0, 1.0, (N_VIEWS, 2, 6))
    order_views(TourProblem.straight(list(q), np.zeros(6), limits), np.tile(np.eye(4), (N_VIEWS, 1, 1)), rng)
