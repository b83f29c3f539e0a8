"""Measurability matrices of the parts of benchmarks/parts.py, with and without the robot, as files.

A file `PART.npz` (the part alone) or `PART.robot.npz` (in the cell, at the place of the README) has

    indptr, indices    int64, the matrix by rows: columns (views) that measure each row (sample), ascending
    shape              (rows, columns)
    area               float64, area of each row [m^2]
    reachable          bool, usable columns; all of them without the robot

Without the robot only the part itself occludes; with it the pedestal and the other solids of the cell do, too.
"""

import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.candidates import Bench, parts
from planner.viewpoints.viewpoints import Viewpoints


def write(folder: Path) -> Iterator[Path]:
    """Write the missing files of each part and yield their paths."""
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
