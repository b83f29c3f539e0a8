"""`cell diff` of two clouds: distances of the points of one from the surface of the other. Metres."""

from pathlib import Path

import numpy as np
from pydantic import Field
from scipy.spatial import cKDTree

from cell.errors import FileError
from cell.metrology import point_files
from cell.part.workpiece import UNITS
from cell.runs.schema import JsonTable
from planner.values import Bools, Floats

_NEIGHBOURS = 12  # points of the plane that stands for the surface
_FAR, _NEAR = 4.0, 0.002  # spacings, or m: a point that is farther from all others has no counterpart


class CloudDifference(JsonTable):
    """Difference of two clouds in the same frame."""

    points_a: int
    points_b: int
    spacing_mm: float = Field(description="median distance of neighbouring points of A")
    rms_mm: float = Field(description="of the distances of B from planes through neighbouring points of A")
    quantile_95_mm: float
    largest_mm: float
    only_a: float = Field(description="share of A without points of B nearby")
    only_b: float = Field(description="share of B without points of A nearby")


def compare_clouds(a: Path, b: Path, units: str) -> CloudDifference:
    """Compare two files of points in the same frame and unit.

    Raises:
        FileError: if a file cannot be read, or the clouds have nothing in common.
    """
    first, second = (UNITS[units] * point_files.read(path) for path in (a, b))
    if min(len(first), len(second)) < _NEIGHBOURS:
        raise FileError(f"{a} and {b} have {len(first)} and {len(second)} points; give at least {_NEIGHBOURS} each")
    tree = cKDTree(first)
    spacing = float(np.median(np.asarray(tree.query(first, 2)[0])[:, 1]))
    near, rows = map(np.asarray, tree.query(second, _NEIGHBOURS))
    reach = max(_FAR * spacing, _NEAR)
    both: Bools = near[:, 0] <= reach
    if not both.any():
        raise FileError(f"no point of {b} is within {1000 * reach:.3g} mm of {a}; give both in one frame and unit")
    patches = first[rows[both]]
    middle = patches.mean(axis=1)
    normals: Floats = np.linalg.svd(patches - middle[:, None], full_matrices=False)[2][:, 2]
    off = 1000 * np.abs(np.einsum("nj,nj->n", second[both] - middle, normals))
    back = np.asarray(cKDTree(second).query(first)[0])
    return CloudDifference(
        points_a=len(first), points_b=len(second), spacing_mm=1000 * spacing,
        rms_mm=float(np.sqrt(np.mean(off**2))), quantile_95_mm=float(np.quantile(off, 0.95)),
        largest_mm=float(off.max()), only_a=float(np.mean(back > reach)), only_b=float(1 - both.mean()),
    )  # fmt: skip
