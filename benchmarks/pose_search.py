"""Views over the effort of the pose search: views, coverage and motion of each part beside processor seconds.

The parts of benchmarks/parts.py, each with `cell plan` at its defaults and the efforts 0 (the cover over the
candidates), low, normal and 200,000 poses; SCAN_CELL_EFFORTS replaces them, SCAN_CELL_SEEDS the single seed 0, and
SCAN_CELL_COVERAGES the requested coverage of 0.99. Coverage is measured on 100,000 samples that neither selection nor
search used, all parts with the same samples for all efforts. SCAN_CELL_PART runs parts of one name only.
"""

import os
import sys
import tempfile
from itertools import product
from pathlib import Path
from time import process_time
from typing import Any

import numpy as np

from benchmarks.parts import parts, place
from cell import api
from cell.runs.cell import read_cell
from planner.geometry.sampling import draw_samples
from planner.measurability.visibility import find_measured
from planner.viewpoints.pose_search import EFFORTS

_N_SAMPLES = 100_000
_NO_SEARCH = 4_000  # place of effort 0 on the logarithmic axis


def run(efforts: str = "0,low,normal,200000", coverages: str = "0.99") -> list[dict[str, Any]]:
    """Return one row for each part, effort, seed and requested coverage."""
    seeds = range(int(os.environ.get("SCAN_CELL_SEEDS", "1")))
    shares = [float(share) for share in os.environ.get("SCAN_CELL_COVERAGES", coverages).split(",")]
    only = os.environ.get("SCAN_CELL_PART", "")
    rows = []
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        for name, words in parts(folder):
            if only in name:
                for plan in product(os.environ.get("SCAN_CELL_EFFORTS", efforts).split(","), seeds, shares):
                    rows.append(_row(name, words, *plan, folder))
                    print(rows[-1], file=sys.stderr, flush=True)  # noqa: T201 -- keeps rows of an interrupted run
    return rows


def _row(name: str, words: tuple[str, ...], effort: str, seed: int, coverage: float, folder: Path) -> dict[str, Any]:
    options: dict[str, Any] = {"place": place()} | ({"units": words[2]} if len(words) > 1 else {})
    start = process_time()
    plan = api.plan(
        words[0], effort=effort, seed=seed, coverage=coverage,
        out=folder / f"{Path(words[0]).stem}_{effort}_{seed}_{coverage}", **options,
    )  # fmt: skip
    seconds = process_time() - start
    cell = read_cell(plan)
    samples = draw_samples(plan.reference, plan.planning_mesh, _N_SAMPLES, np.random.default_rng(9))
    views = plan.candidates.T_object_scanner[plan.candidate]
    measured = find_measured(views, samples, cell.scanner, (cell.part_caster, cell.occluder_caster))
    return {
        "part": name,
        "effort": effort,
        "seed": seed,
        "requested %": 100 * coverage,
        "views": len(plan.candidate),
        "coverage %": 100 * float(measured.mean()),
        "predicted %": 100 * plan.report.coverage.visible,
        "motion s": plan.report.motion.duration_s,
        "processor s": seconds,
    }


def chart(rows: list[dict[str, Any]], folder: Path) -> None:
    """Draw views over the effort, a line for each part."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(figsize=(7.5, 5.6))
    colours = plt.get_cmap("tab20").colors
    for number, part in enumerate(dict.fromkeys(row["part"] for row in rows)):
        own = [row for row in rows if row["part"] == part]
        efforts = dict.fromkeys(row["effort"] for row in own)
        views = [np.median([row["views"] for row in own if row["effort"] == effort]) for effort in efforts]
        poses = [max(EFFORTS[effort] if effort in EFFORTS else int(effort), _NO_SEARCH) for effort in efforts]
        axes.plot(poses, views, "o-", ms=4, lw=1.2, color=colours[number % 20], label=part.removesuffix(" (file)"))
    axes.set(xscale="log", yscale="log", xlabel="evaluated poses (effort; leftmost: candidates only)", ylabel="views")
    axes.yaxis.set_major_formatter("{x:g}")
    axes.yaxis.set_minor_formatter("{x:g}")
    axes.set_xticks([_NO_SEARCH, 12_000, 48_000, 200_000, 800_000], ["0", "12,000", "48,000", "200,000", "800,000"])
    axes.set_xticks([], minor=True)
    axes.grid(alpha=0.2)
    axes.set_ylim(4.5, 150)
    axes.legend(fontsize=7, ncols=5, loc="upper center")
    figure.tight_layout()
    figure.savefig(folder / "pose_search.png", dpi=120)
    plt.close(figure)
