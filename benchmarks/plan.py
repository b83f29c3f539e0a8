"""The main job as whole processes: seconds, memory and the error of the predicted coverage, on every part.

The parts of benchmarks/parts.py. The first row is the cold process: no cache of parts or matrices. Set SCAN_CELL_PLACE
to plan somewhere else.
"""

import json
import os
import resource
import subprocess
import sys
import tempfile
from pathlib import Path
from time import perf_counter
from typing import Any

from benchmarks.checks import independent_visible
from benchmarks.parts import parts, place


def run() -> list[dict[str, Any]]:
    """One row per part."""
    rows = []
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        rows.append(_row("mseke (cold)", ("mseke",), folder / "cold", folder / "cold_cache"))
        for name, arguments in parts(folder):
            rows.append(_row(name, arguments, folder / name, folder / "cache"))
    return rows


def _row(name: str, arguments: tuple[str, ...], out: Path, cache: Path) -> dict[str, Any]:
    environment = {**os.environ, "XDG_CACHE_HOME": str(cache)}
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    start = perf_counter()
    done = subprocess.run(
        [sys.executable, "-m", "cell", "plan", *arguments, "--place", place(), "--out", str(out), "--json"],
        env=environment, capture_output=True, text=True, check=False,
    )  # fmt: skip
    seconds = perf_counter() - start
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    row: dict[str, Any] = {"part": name, "exit": done.returncode, "s": round(seconds, 2)}
    row["cpu s"] = round(after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime, 2)
    if done.returncode != 0:
        return row | {"said": done.stderr.strip().splitlines()[-1][:100]}
    summary = json.loads(done.stdout)
    predicted, coverable = summary["coverage"]["visible"], summary["coverage"]["coverable"]
    truth = independent_visible(out, seed=12345)
    row |= {
        "peak MB (so far)": after.ru_maxrss // 1024,
        "reachable": summary["verdicts"]["reachable"],
        "views": summary["n_views"],
        "bound": summary["lower_bound"],
        "visible %": round(100 * predicted, 2),
        "of coverable %": round(100 * predicted / coverable, 2),
        "error points": round(100 * (predicted - truth), 3),
        "motion s": round(summary["motion"]["duration_s"], 1),
        "nearest mm": summary["motion"]["minimum_clearance_mm"],
    }
    return row
