"""A rotary table compared with the fixed plan of every part: views, coverage, and the ceiling of coverage.

The parts of benchmarks/parts.py, each by `cell plan` with and without `--table`. A table measures more; its target is
99 % of that. *at fixed* is the number of views, selected from the candidates and samples of the table, that measure the
same share of the surface as the fixed plan, with its bound; if all of them measure less, the difference is given.
*Attainable* is the share that any pose that the arm reaches at the table can measure, *ceiling* the share that any
scanner pose can measure past part, post and table (report.json). With SCAN_CELL_RUNS=FOLDER plans are stored there and
used again.
"""

import os
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.cell_process import run_cell
from benchmarks.parts import parts, place
from cell.errors import CellError
from cell.runs.run import Run, open_run
from planner import cover


def run() -> list[dict[str, Any]]:
    """Return one row for each part."""
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(os.environ.get("SCAN_CELL_RUNS", scratch))
        return [_row(name, arguments, folder) for name, arguments in parts(Path(scratch))]


def _row(name: str, arguments: tuple[str, ...], folder: Path) -> dict[str, Any]:
    runs = []
    for kind, options in (("fixed", ()), ("table", ("--table",))):
        out = folder / f"{name.split()[0]}_{kind}"
        try:
            if not out.is_dir():
                run_cell(folder, "plan", *arguments, *options, "--place", place(), "--out", str(out))
            runs.append(open_run(out))
        except CellError as error:
            return {"part": name, "error": str(error)[:100]}
    fixed, turned = (each.report for each in runs)
    can = turned.attainable
    return {
        "part": name,
        "views": fixed.n_views,
        "with table": turned.n_views,
        "at fixed": _at(runs[1], fixed.coverage.visible),
        "coverable %": round(100 * fixed.coverage.coverable, 2),
        "with table %": round(100 * turned.coverage.coverable, 2),
        "attainable %": None if can is None else round(100 * can.share, 2),
        "ceiling %": None if can is None else round(100 * (1 - can.out_of_sight), 2),
        "visible %": round(100 * fixed.coverage.visible, 2),
        "visible with table %": round(100 * turned.coverage.visible, 2),
        "motion s": round(fixed.motion.duration_s, 1),
        "motion with table s": round(turned.motion.duration_s, 1),
    }


def _at(record: Run, share: float) -> str:
    """Return the fewest views found among a run's candidates that measure a share of the surface, and their bound."""
    M, areas = record.measurability, record.measurability.samples.areas
    coverable = float(areas[np.diff(M.indptr) > 0].sum())
    less = share - coverable / float(areas.sum())
    target = min(1.0, share * float(areas.sum()) / coverable)
    problem = cover.CoverProblem(M.matrix(), areas, record.reach.reachable, coverage=target)
    found = cover.solve(problem, rng=np.random.default_rng(0))
    note = f", which are all: {100 * less:.2f} points less" if less > 0 else ""
    return f"{len(found.views)} ({found.lower_bound}){note}"
