"""Compare the view-selection solvers: time, views, lower bound and gap in one row.

python -m benchmarks.cover                      # visibility of a displaced sphere, made here
python -m benchmarks.cover --seconds 10 FILE... # OR-Library row files (unicost), plain or .gz
"""

import argparse
import gzip
import platform
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import scipy
import scipy.sparse as sp

from planner import cover
from planner.cover.budget import DEFAULT_WORK

UNLIMITED = 10**15


def displaced_sphere(n_samples: int, n_views: int, half_angle: float, rng: np.random.Generator) -> Any:
    """Measurability of a bumpy sphere seen from around it, by marching each line of sight over the surface.

    The surface is r(d) = 1 + a smooth random displacement of unit direction d. A view looks at the surface from a
    standoff of 3 along the local normal; a sample counts when it lies in the view's cone, faces it within 75 degrees,
    and the surface does not rise above the line of sight.

    Args:
        n_samples: rows.
        n_views: columns.
        half_angle: half opening angle of the view's cone [rad].
        rng: bumps, samples and views.

    Returns:
        (S, V) csr_array of bool.
    """
    waves = rng.normal(size=(24, 3)) * 3.0
    phases = rng.uniform(0, 2 * np.pi, 24)
    heights = rng.normal(size=24) * 0.04

    def radius(d: Any) -> Any:
        return 1.0 + np.cos(d @ waves.T + phases) @ heights

    def surface(count: int) -> tuple[Any, Any]:
        d = rng.normal(size=(count, 3))
        d /= np.linalg.norm(d, axis=1, keepdims=True)
        # normal of F(x) = |x| - r(x / |x|): radial minus the tangential gradient of r over r
        gradient = -(np.sin(d @ waves.T + phases) * heights) @ waves
        gradient -= (gradient * d).sum(1, keepdims=True) * d
        r = radius(d)[:, None]
        normal = d - gradient / r
        return d * r, normal / np.linalg.norm(normal, axis=1, keepdims=True)

    points, normals = surface(n_samples)
    spots, directions = surface(n_views)
    eyes = spots + 3.0 * directions
    columns = []
    steps = np.linspace(0.02, 0.6, 16)[:, None, None] ** 1.5
    for eye, direction in zip(eyes, directions, strict=True):
        sight = eye - points
        length = np.linalg.norm(sight, axis=1, keepdims=True)
        sight /= length
        seen = np.flatnonzero(
            ((normals * sight).sum(1) > np.cos(np.radians(75))) & (sight @ direction > np.cos(half_angle))
        )
        if len(seen):
            along = points[seen] + steps * sight[seen] * 2.0
            size = np.linalg.norm(along, axis=2)
            seen = seen[(size > radius(along / size[..., None])).all(axis=0)]
        columns.append(seen)
    start = np.concatenate(([0], np.cumsum([len(c) for c in columns])))
    rows = np.concatenate(columns)
    return sp.csc_array((np.ones(len(rows), bool), rows, start), shape=(n_samples, n_views)).tocsr()


def read_or_library(path: Path) -> Any:
    """An OR-Library set-cover file in row format; its costs are ignored (unicost).

    Args:
        path: text, or gzip where the name ends in .gz.

    Returns:
        (rows, columns) csr_array of bool.
    """
    with gzip.open(path, "rt") if path.suffix == ".gz" else path.open() as file:
        numbers = np.array(file.read().split(), dtype=np.int64)
    n_rows, n_columns = int(numbers[0]), int(numbers[1])
    at = 2 + n_columns
    start, columns = [0], []
    for _ in range(n_rows):
        count = int(numbers[at])
        columns.append(numbers[at + 1 : at + 1 + count] - 1)
        start.append(start[-1] + count)
        at += 1 + count
    members = np.concatenate(columns)
    return sp.csr_array((np.ones(len(members), bool), members, np.array(start)), shape=(n_rows, n_columns))


def instances(paths: Sequence[Path]) -> list[tuple[str, Any]]:
    """Named matrices: the files, or, where none is given, displaced spheres from sparse to dense."""
    if paths:
        return [(path.name.split(".")[0], read_or_library(path)) for path in paths]
    shapes = {
        "sphere narrow": (1500, 1500, 0.10),
        "sphere wide": (1500, 1500, 0.25),
        "sphere default plan": (3720, 1860, 0.45),
    }
    return [(name, displaced_sphere(*shape, np.random.default_rng(7))) for name, shape in shapes.items()]


def run(
    paths: Sequence[Path] = (),
    solvers: Sequence[str] = ("greedy", "meta-raps", "local-search", "auto"),
    seconds: float | None = None,
    coverage: float = 1.0,
) -> list[dict[str, Any]]:
    """One row per instance and solver.

    Args:
        paths: OR-Library files; none: instances made here.
        solvers: names in `planner.cover.SOLVERS`.
        seconds: processor seconds for each run; None: the default budget of work.
        coverage: share of the coverable area.
    """
    rows: list[dict[str, Any]] = []
    for name, M in instances(paths):
        for solver in solvers:
            started = time.process_time()
            result = cover.solve(
                M,
                np.ones(M.shape[0]),
                rng=np.random.default_rng(1),
                solver=solver,
                coverage=coverage,
                budget=DEFAULT_WORK if seconds is None else UNLIMITED,
                time_limit_s=seconds,
                clock=time.process_time,
            )
            elapsed = time.process_time() - started
            rows.append(
                {
                    "instance": name,
                    "rows": M.shape[0],
                    "columns": M.shape[1],
                    "density_percent": round(100 * M.nnz / (M.shape[0] * M.shape[1]), 2),
                    "solver": solver,
                    "cpu_s": round(elapsed, 2),
                    "views": len(result.views),
                    "lower_bound": result.lower_bound,
                    "gap_percent": round(100 * result.gap, 1),
                    "work": result.work,
                    "status": result.sentence,
                }
            )
    return rows


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("files", nargs="*", type=Path, help="OR-Library set-cover files (row format)")
    parser.add_argument(
        "--seconds", type=float, help="processor time for each run; default: the default budget of work"
    )
    parser.add_argument("--coverage", type=float, default=1.0, help="share of the coverable area")
    parser.add_argument("--solvers", nargs="+", default=["greedy", "meta-raps", "local-search", "auto"])
    arguments = parser.parse_args()
    out = sys.stdout
    versions = f"numpy {np.__version__}, scipy {scipy.__version__}, python {platform.python_version()}"
    out.write(f"{versions}, {platform.machine()} {platform.system()}\n")
    table = run(arguments.files, arguments.solvers, arguments.seconds, arguments.coverage)
    names = list(table[0])
    out.write(" | ".join(names) + "\n")
    for row in table:
        out.write(" | ".join(str(row[name]) for name in names) + "\n")


if __name__ == "__main__":
    main()
