"""Speed against accuracy of the default job: views over processor seconds for each number that decides.

`cell plan PART --place 1200,500,0` with other values of the effort of the pose search, the samples on which it
evaluates poses, and the nodes of the direction table; one is changed at a time. Mean over the parts mseke and mug and
the seeds 0, 1 and 2. Each plan is a process of its own, without cache; processor seconds include the process of the
pictures. Kernels are compiled before.
"""

import json
import os
import resource
import subprocess
import sys
import tempfile
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.parts import place

_PARTS, _SEEDS = ("mseke", "mug"), (0, 1, 2)
_DEFAULTS = {"effort": "normal", "evaluated samples": 12_000, "nodes": 33}
_VALUES: dict[str, tuple[Any, ...]] = {
    "effort": ("0", "low", "normal", "200000"),
    "evaluated samples": (3_000, 6_000, 12_000, 24_000),
    "nodes": (9, 17, 33, 65),
}
_CODE = """
import sys
import cell.plan.pose_search as search
import planner.measurability.direction_table as table
search.N_EVALUATED, search.EVALUATED_PER_VIEW, table.N_NODES = {evaluated}, 0, {nodes}
from cell.cli import main
sys.argv = {words}
main()
"""


def run() -> list[dict[str, Any]]:
    """Return one row for each value."""
    rows = []
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        of_default = _mean(_DEFAULTS, folder)
        for name, values in _VALUES.items():
            for value in values:
                numbers = of_default if value == _DEFAULTS[name] else _mean(_DEFAULTS | {name: value}, folder)
                rows.append({"number": name, "value": value} | numbers)
                print(rows[-1], file=sys.stderr, flush=True)  # noqa: T201 -- keeps rows of an interrupted run
    return rows


def _mean(values: dict[str, Any], folder: Path) -> dict[str, Any]:
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(folder / f"kernels_{values['nodes']}")}
    if not Path(environment["NUMBA_CACHE_DIR"]).is_dir():
        _plan("mug", 0, values, folder, environment)  # compiles
    each = [_plan(part, seed, values, folder, environment) for part, seed in product(_PARTS, _SEEDS)]
    return {key: round(float(np.mean([plan[key] for plan in each])), 3) for key in each[0]}


def _plan(part: str, seed: int, values: dict[str, Any], folder: Path, environment: dict[str, str]) -> dict[str, float]:
    with tempfile.TemporaryDirectory(dir=folder) as out:
        words = [
            "cell", "plan", part, "--place", place(), "--seed", str(seed), "--effort", values["effort"], "--no-cache",
            "--json", "--out", f"{out}/run",
        ]  # fmt: skip
        code = _CODE.format(evaluated=values["evaluated samples"], nodes=values["nodes"], words=words)
        before = resource.getrusage(resource.RUSAGE_CHILDREN)
        process = subprocess.run(
            [sys.executable, "-c", code], env=environment, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, check=True
        )
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
    report = json.loads(process.stdout)
    return {
        "processor s": after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime,
        "views": report["n_views"],
        "visible of coverable %": 100 * report["coverage"]["visible_of_coverable"],
        "motion s": report["motion"]["duration_s"],
    }


def chart(rows: list[dict[str, Any]], folder: Path) -> None:
    """Draw views over processor seconds, a line for each number."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(figsize=(6.4, 4.2))
    for name in dict.fromkeys(row["number"] for row in rows):
        own = [row for row in rows if row["number"] == name]
        axes.plot([row["processor s"] for row in own], [row["views"] for row in own], "o-", ms=4, label=name)
        for row in own:
            axes.annotate(
                str(row["value"]), (row["processor s"], row["views"]), fontsize=7, xytext=(3, 3),
                textcoords="offset points",
            )  # fmt: skip
    axes.set(xlabel="processor time [s]", ylabel="views (mean)")
    axes.grid(alpha=0.3)
    axes.legend(fontsize=8)
    figure.tight_layout()
    figure.savefig(folder / "default_job.png", dpi=120)
    plt.close(figure)
