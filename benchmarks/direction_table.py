"""Error of the direction table over its size: share of the surface that poses measure, compared with exact rays.

Parts mseke, robinet and mug at the place of the README, with 12,000 samples and all reachable candidates. For each
number of nodes along an axis of the grid, and each number of samples: the error of the approximate sum that compares
proposals, that of the decision for poses that are moved to, processor time to build the table, its size, and processor
time to evaluate a pose with all samples. Shares refer to the same samples; the last column is the standard error of a
share of the surface from that many samples. Each row is a process of its own, since the kernels contain the number of
nodes. SCAN_CELL_NODES and SCAN_CELL_SAMPLES replace the numbers (default "9,17,33,65" and "3000,12000").
"""

import json
import os
import subprocess
import sys
import tempfile
from itertools import product
from pathlib import Path
from time import process_time
from typing import Any

import numpy as np

from benchmarks.parts import place

_PARTS = ("mseke", "robinet", "mug")
_POSES = 400  # candidates that are evaluated


def run() -> list[dict[str, Any]]:
    """Return one row for each part, number of nodes and number of samples."""
    nodes = os.environ.get("SCAN_CELL_NODES", "9,17,33,65").split(",")
    counts = os.environ.get("SCAN_CELL_SAMPLES", "3000,12000").split(",")
    rows = []
    with tempfile.TemporaryDirectory() as scratch:
        for part, n_nodes, count in product(_PARTS, nodes, counts):
            environment = {**os.environ, "NUMBA_CACHE_DIR": str(Path(scratch) / n_nodes)}
            code = f"from benchmarks.direction_table import print_row; print_row({part!r}, {n_nodes}, {count})"
            process = subprocess.run(
                [sys.executable, "-c", code], env=environment, check=True, stdout=subprocess.PIPE, text=True
            )
            rows.append(json.loads(process.stdout.splitlines()[-1]))
    return rows


def print_row(part: str, n_nodes: int, count: int) -> None:
    """Print the row of a part as JSON."""
    from planner.measurability import direction_table

    direction_table.N_NODES = n_nodes  # before the first call, which compiles the kernels
    from cell import api
    from cell.plan.pose_search import distances_of
    from cell.runs.cell import read_cell
    from planner.geometry.sampling import draw_samples
    from planner.measurability.visibility import find_measured
    from planner.viewpoints.lines_of_sight import RayTargets

    with tempfile.TemporaryDirectory() as scratch:
        plan = api.plan(part, place=place(), effort="0", out=Path(scratch) / "run")
        cell = read_cell(plan)
        samples = draw_samples(plan.reference, plan.planning_mesh, count, np.random.default_rng(9))
        T = plan.candidates.T_object_scanner[plan.reach.reachable][:_POSES]
    casters = cell.part_caster, cell.occluder_caster
    targets = RayTargets.of(samples.points, samples.normals, samples.region)

    def build() -> direction_table.DirectionTable:
        return direction_table.DirectionTable.build(
            targets, cell.scanner, casters[0], casters[1:], distances_of(cell.scanner)
        )

    table = build()
    weights, rows, starts = np.full(count, 1 / count), np.arange(count), np.array([0, count])

    def sums() -> np.ndarray:
        return table.weights_measured(T[:, 0][None], rows, starts, weights, np.array([-np.inf]))[0]

    exact = find_measured(T, samples, cell.scanner, casters, each=True).mean(axis=0)
    errors = {"sum": sums() - exact, "decision": table.measured(T[:, 0]).mean(axis=1) - exact}
    start = process_time()
    build()
    built, start = process_time() - start, process_time()
    sums()
    evaluated = process_time() - start
    row = {"part": part, "nodes": n_nodes, "samples": count, "poses": len(T)}
    for name, error in errors.items():
        row |= {
            f"{name} rms points": round(100 * float(np.sqrt((error**2).mean())), 4),
            f"{name} worst points": round(100 * float(np.abs(error).max()), 4),
        }
    row |= {
        "build s": round(built, 3),
        "MB": round((table.nodes.nbytes + table.near_nodes.nbytes) / 1e6, 2),
        "us per pose": round(1e6 * evaluated / len(T), 1),
        "sampling points": round(100 * float(np.sqrt((exact * (1 - exact)).mean() / count)), 3),
    }
    print(json.dumps(row))  # noqa: T201


def chart(rows: list[dict[str, Any]], folder: Path) -> None:
    """Draw the error over the time to build the table."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, panels = plt.subplots(1, 2, figsize=(10, 4.2), sharey=True)
    most = max(row["samples"] for row in rows)
    for part in dict.fromkeys(row["part"] for row in rows):
        own = [row for row in rows if row["part"] == part and row["samples"] == most]
        for axes, key in zip(panels, ("build s", "MB"), strict=True):
            (line,) = axes.plot(
                [row[key] for row in own], [row["sum rms points"] for row in own], "o-", label=f"{part}, sums"
            )
            axes.plot(
                [row[key] for row in own], [max(row["decision rms points"], 1e-3) for row in own], "s--",
                color=line.get_color(), label=f"{part}, decisions",
            )  # fmt: skip
            for row in own:
                axes.annotate(str(row["nodes"]), (row[key], row["sum rms points"]), fontsize=7, xytext=(3, 3),
                              textcoords="offset points")  # fmt: skip
    for axes, label in zip(panels, ("processor time to build the table [s]", "size of the table [MB]"), strict=True):
        axes.set(xscale="log", yscale="log", xlabel=label)
        axes.xaxis.set_major_formatter("{x:g}")
        axes.xaxis.set_minor_formatter("")
        axes.grid(alpha=0.3, which="both")
    panels[0].set_ylabel("rms error of the measured share [points]\n(numbers: nodes along an axis)")
    panels[0].legend(fontsize=7)
    figure.tight_layout()
    figure.savefig(folder / "direction_table.png", dpi=120)
    plt.close(figure)
