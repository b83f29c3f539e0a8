"""Measurability matrices of the parts of benchmarks/parts.py, with the robot and without, kept as files.

A file `PART.npz` (the part alone) or `PART.robot.npz` (in the cell, at the place of the README) has

    indptr, indices    int64, the matrix by rows: which columns (views) measure the row (sample); ascending in a row
    shape              (rows, columns)
    area               float64, area that a row stands for [m^2]
    reachable          bool, columns that may be used; all of them without the robot

Without the robot a row may be covered by nothing but the part's own occlusion counts; with it the pedestal and the
other solids of the cell occlude as well.
"""

import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.candidates import Bench, parts
from planner.viewpoints.viewpoints import Viewpoints


def write(folder: Path) -> Iterator[Path]:
    """Make the two files of each part that are not there yet."""
    folder.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as scratch:
        for name, options in parts(Path(scratch)):
            stem = name.removesuffix(" (file)")
            alone, cell = folder / f"{stem}.npz", folder / f"{stem}.robot.npz"
            if alone.exists() and cell.exists():
                continue
            bench = Bench(options)
            views = bench.views("optimal-scanning-zone")
            for path, arrays in ((alone, _alone(bench, views)), (cell, _in_the_cell(bench, views))):
                np.savez_compressed(path, allow_pickle=False, **arrays)
                yield path


def _alone(bench: Bench, views: Viewpoints) -> dict[str, Any]:
    return _arrays(bench.measure_alone(views), np.ones(len(views), dtype=bool))


def _in_the_cell(bench: Bench, views: Viewpoints) -> dict[str, Any]:
    return _arrays(bench.measure(views), bench.reach_of(views).reachable)


def _arrays(M: Any, reachable: Any) -> dict[str, Any]:
    matrix = M.matrix().tocsr()
    matrix.sort_indices()
    return {
        "indptr": matrix.indptr.astype(np.int64),
        "indices": matrix.indices.astype(np.int64),
        "shape": np.array(matrix.shape),
        "area": M.samples.areas,
        "reachable": reachable,
    }
