"""Run a command of the program in a separate process and measure its output, duration and memory."""

import json
import os
import subprocess
import sys
from pathlib import Path
from time import perf_counter
from typing import Any

import cell
from cell.errors import CellError

CODE = Path(cell.__file__).parents[1]
"""Checkout of this version."""

_GOOD = (0, 3)  # exit codes that leave a plan; 3: below the coverage that the scene requires


def run_cell(
    folder: Path, *arguments: str, cache: Path | None = None, code: Path | None = None
) -> tuple[dict[str, Any], dict[str, Any]]:
    """Run a command and return its JSON and its use: "s" on the wall clock, "cpu s" of all cores, "peak MB".

    Args:
        folder: receives the output of the command.
        arguments: arguments of the command line; `--json` is added.
        cache: cache folder in place of the user's.
        code: checkout of the version to run; None: that of this process.

    Raises:
        CellError: if the command fails; it has the sentence of the command.
    """
    environment = {**os.environ, "PYTHONPATH": str(code or CODE)}
    if cache is not None:
        environment["XDG_CACHE_HOME"] = str(cache)
    out, err = folder / "stdout", folder / "stderr"
    with out.open("wb") as stdout, err.open("wb") as stderr:
        start = perf_counter()
        process = subprocess.Popen(
            [sys.executable, "-P", "-m", "cell", *arguments, "--json"], env=environment, stdout=stdout, stderr=stderr
        )
        # Usage of this child only: the sum over all children has the largest peak of all of them.
        _, status, usage = os.wait4(process.pid, 0)
        process.returncode = os.waitstatus_to_exitcode(status)
    seconds = perf_counter() - start
    if process.returncode not in _GOOD:
        messages = err.read_text().strip().splitlines()
        raise CellError(messages[-1] if messages else f"cell {arguments[0]} ended with code {process.returncode}")
    took = {"s": seconds, "cpu s": usage.ru_utime + usage.ru_stime, "peak MB": usage.ru_maxrss // 1024}
    return json.loads(out.read_text()), took
