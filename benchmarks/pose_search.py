"""Views over the effort of the pose search: views, coverage and motion of each part beside processor seconds.

The parts of benchmarks/parts.py, each with `cell plan` at its defaults and the efforts 0 (the cover over the
candidates), low, normal and 200,000 poses; SCAN_CELL_EFFORTS replaces them, SCAN_CELL_SEEDS the single seed 0. Coverage
is measured on 100,000 samples that neither selection nor search used, all parts with the same samples for all efforts.
SCAN_CELL_PART runs parts of one name only.
"""

import os
import tempfile
from pathlib import Path
from time import process_time
from typing import Any

import numpy as np

from benchmarks.parts import parts, place
from cell import api
from cell.runs.cell import read_cell
from planner.geometry.sampling import draw_samples
from planner.measurability.visibility import find_measured

_N_SAMPLES = 100_000


def run() -> list[dict[str, Any]]:
    """Return one row for each part, effort and seed."""
    efforts = os.environ.get("SCAN_CELL_EFFORTS", "0,low,normal,200000").split(",")
    seeds = range(int(os.environ.get("SCAN_CELL_SEEDS", "1")))
    only = os.environ.get("SCAN_CELL_PART", "")
    rows = []
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        for name, words in parts(folder):
            if only in name:
                plans = ((effort, seed) for effort in efforts for seed in seeds)
                rows += [_row(name, words, effort, seed, folder) for effort, seed in plans]
    return rows


def _row(name: str, words: tuple[str, ...], effort: str, seed: int, folder: Path) -> dict[str, Any]:
    options: dict[str, Any] = {"place": place()} | ({"units": words[2]} if len(words) > 1 else {})
    start = process_time()
    plan = api.plan(
        words[0], effort=effort, seed=seed, out=folder / f"{Path(words[0]).stem}_{effort}_{seed}", **options
    )
    seconds = process_time() - start
    cell = read_cell(plan)
    samples = draw_samples(plan.reference, plan.planning_mesh, _N_SAMPLES, np.random.default_rng(9))
    views = plan.candidates.T_object_scanner[plan.candidate]
    measured = find_measured(views, samples, cell.scanner, (cell.part_caster, cell.occluder_caster))
    return {
        "part": name,
        "effort": effort,
        "seed": seed,
        "views": len(plan.candidate),
        "coverage %": 100 * float(measured.mean()),
        "predicted %": 100 * plan.report.coverage.visible,
        "motion s": plan.report.motion.duration_s,
        "processor s": seconds,
    }


def chart(rows: list[dict[str, Any]], folder: Path) -> None:
    """Draw views over processor seconds, a line for each part."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(figsize=(7.5, 4.8))
    for part in dict.fromkeys(row["part"] for row in rows):
        own = [row for row in rows if row["part"] == part]
        efforts = dict.fromkeys(row["effort"] for row in own)
        each = [[row for row in own if row["effort"] == effort] for effort in efforts]
        seconds = [np.median([row["processor s"] for row in some]) for some in each]
        axes.plot(seconds, [np.median([row["views"] for row in some]) for some in each], "o-", label=part)
    axes.set(xscale="log", yscale="log", xlabel="processor time of the plan [s]", ylabel="views")
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_major_formatter("{x:g}")
        axis.set_minor_formatter("{x:g}")
    axes.legend(fontsize=8, ncols=2)
    figure.tight_layout()
    figure.savefig(folder / "pose_search.png", dpi=120)
    plt.close(figure)
