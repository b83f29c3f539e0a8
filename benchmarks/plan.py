"""The main job in separate processes: seconds, memory and the error of the predicted coverage, on every part.

The parts of benchmarks/parts.py. The first row is the cold process: no cache of parts or matrices. SCAN_CELL_PLACE sets
another place of the part.
"""

import tempfile
from pathlib import Path
from typing import Any

from benchmarks.cell_process import run_cell
from benchmarks.checks import independent_visible
from benchmarks.parts import parts, place
from cell.errors import CellError


def run() -> list[dict[str, Any]]:
    """Return one row for each part."""
    rows = []
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        rows.append(_row("mseke (cold)", ("mseke",), folder / "cold", folder / "cold_cache"))
        for name, arguments in parts(folder):
            rows.append(_row(name, arguments, folder / name, folder / "cache"))
    return rows


def _row(name: str, arguments: tuple[str, ...], out: Path, cache: Path) -> dict[str, Any]:
    row: dict[str, Any] = {"part": name}
    try:
        summary, took = run_cell(out.parent, "plan", *arguments, "--place", place(), "--out", str(out), cache=cache)
    except CellError as error:
        return row | {"error": str(error)[:100]}
    predicted, coverable = summary["coverage"]["visible"], summary["coverage"]["coverable"]
    truth = independent_visible(out, seed=12345)
    return row | {
        "s": round(took["s"], 2),
        "cpu s": round(took["cpu s"], 2),
        "peak MB": took["peak MB"],
        "reachable": summary["verdicts"]["reachable"],
        "views": summary["n_views"],
        "bound": summary["lower_bound"],
        "visible %": round(100 * predicted, 2),
        "of coverable %": round(100 * predicted / coverable, 2),
        "error points": round(100 * (predicted - truth), 3),
        "motion s": round(summary["motion"]["duration_s"], 1),
        "nearest mm": summary["motion"]["minimum_clearance_mm"],
    }
