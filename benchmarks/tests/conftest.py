"""Fixtures of the product's tests for the tests of the benchmarks."""

import contextlib
import io
import os
import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest

from benchmarks.__main__ import run_study
from tests.conftest import (  # noqa: F401 -- pytest finds fixtures by their names in this module
    blob,
    cache,
    data_of,
    drawing,
    drawing_is_here,
    drawn_pictures,
    emulate,
    emulate_for_all,
    executed,
    full_effort,
    kernels_compiled_once,
    low_effort,
    made_once,
    made_setups,
    nothing_waits_for_the_disk,
    part_file,
    planned,
    pytest_collection_finish,
    resealed,
    run_cell,
    shared,
    small_plan,
    start_cell,
    swept,
    turned,
)

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="session")
def environment(cache: Path) -> dict[str, str]:  # noqa: F811 -- the fixture above
    """Return the environment of a benchmark in a separate process."""
    return {**os.environ, "XDG_CACHE_HOME": str(cache), "COLUMNS": "120", "NO_COLOR": "1", "PYTHONPATH": str(ROOT)}


@pytest.fixture(scope="session")
def run_benchmarks(environment: dict[str, str]) -> Callable[..., subprocess.CompletedProcess[str]]:
    """Run `python -m benchmarks NAME ...` in this process in a directory `cwd`; return the result of a process."""

    def run(name: str, *words: object, cwd: Path) -> subprocess.CompletedProcess[str]:
        out, errors = io.StringIO(), io.StringIO()
        with (
            pytest.MonkeyPatch.context() as patch,
            contextlib.redirect_stdout(out),
            contextlib.redirect_stderr(errors),
        ):
            for variable, value in environment.items():
                patch.setenv(variable, value)
            patch.chdir(cwd)
            code = run_study(name, [str(word) for word in words])
        return subprocess.CompletedProcess([name, *map(str, words)], code, out.getvalue(), errors.getvalue())

    return run
