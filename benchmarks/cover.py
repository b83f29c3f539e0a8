"""Compare the view-selection solvers: time, views, lower bound and gap in one row; and a chart for each family.

python -m benchmarks.cover                              # real visibility of built-in parts, and a displaced sphere
python -m benchmarks.cover --budgets 10 FILE...         # set-cover files as in `cell cover`, at cost 1 for each column
python -m benchmarks.cover --seconds 10 FILE...         # the same, ended by processor time in place of counted work
python -m benchmarks.cover --charts docs/images FILE... # draw time against gap, a panel for each family of instances
python -m benchmarks.cover --memory                     # 10,000 x 10,000 at 5 %, peak memory in a process of its own
"""

import argparse
import json
import platform
import resource
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path
from typing import Any

import numpy as np
import scipy
import scipy.sparse as sp

from cell.cover.cover_files import read
from planner import cover
from planner.cover.budget import UNLIMITED_WORK, WORK_PER_SECOND

BUDGETS = (0.1, 0.3, 1.0, 3.0)
"""Seconds' worth of work of the runs that a chart connects."""

COMPARED = ("greedy", "meta-raps", "local-search", "auto")

_COLOURS = {
    "greedy": "#888888",
    "meta-raps": "#c0392b",
    "local-search": "#2471a3",
    "auto": "#1e8449",
    "exact": "#7d3c98",
}


@dataclass(frozen=True)
class Instance:
    """A matrix, its family (a panel of the chart), and the fewest columns known, where a list lies beside it."""

    name: str
    family: str
    M: Any
    known: int | None = None


def part_visibility(part: str, fov_deg: float, count: int = 1500) -> Any:
    """Measurability of a built-in part: so many samples of its surface, from one view over each of so many faces.

    Args:
        part: name of the part.
        fov_deg: full opening angle of the scanner; the narrower, the sparser the matrix.
        count: rows, and columns.

    Returns:
        (count, count) sparse matrix of bool; each entry is two rays past the part's own triangles.
    """
    from cell.part import workpiece
    from cell.plan import candidates
    from cell.rays.embree import EmbreeRayCaster
    from cell.rays.matrix import surface_features
    from cell.scanners.laser_area import LaserArea
    from cell.scene.resolve import resolve
    from cell.scene.scene import load_scene
    from planner.measurability.matrix import fill
    from planner.surface.decimate import decimate

    tables = {
        "part": {"name": part},
        "placement": {"position_mm": [1200.0, 500.0, 0.0]},
        "scanner": {"fov_deg": [fov_deg, fov_deg]},
        "plan": {"faces": count, "rolls_deg": [0.0], "samples_per_face": 1},
    }
    scene = load_scene(None, tables)
    piece = workpiece.load(scene.part.source, scene.part.units)
    settings = resolve(scene, piece)
    planning = decimate(piece.reference, count)
    features = surface_features(scene, piece.reference, planning, np.random.default_rng([0, 0]))
    views = candidates.first(scene, settings, piece, planning)
    caster = EmbreeRayCaster(piece.reference.vertices, piece.reference.faces)
    return fill(views, features, LaserArea(**settings.scanner), caster).matrix()


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


def sphere_caps(count: int, density: float, rng: np.random.Generator) -> Any:
    """A large matrix made quickly: random points on a sphere, seen from above others within a cap of the given share.

    Returns:
        (count, count) csr_array of bool.
    """
    points, eyes = (
        directions / np.linalg.norm(directions, axis=1, keepdims=True) for directions in rng.normal(size=(2, count, 3))
    )
    blocks = [sp.csr_array(points[at : at + 500] @ eyes.T > 1.0 - 2.0 * density) for at in range(0, count, 500)]
    return sp.vstack(blocks, format="csr")


def instances(paths: Sequence[Path]) -> Iterator[Instance]:
    """The files, or, where none is given, visibility matrices from sparse to dense."""
    for path in paths:
        name = path.name.removesuffix(".gz").removesuffix(".txt")
        beside = path.parent / "best_known.json"
        known = json.loads(beside.read_text())["best_known_unicost"].get(name) if beside.exists() else None
        yield Instance(name, _family(name), read(path).matrix, known)
    if not paths:
        yield Instance("mseke, 6 deg", "part, 1 %", part_visibility("mseke", 6.0))
        yield Instance("mseke, 18 deg", "part, 9 %", part_visibility("mseke", 18.0))
        rng = np.random.default_rng(7)
        yield Instance("displaced sphere", "dense sphere", displaced_sphere(3720, 1860, 0.45, rng))


def _family(name: str) -> str:
    """scp41 is of the family scp4, scpclr10 of scpclr, rail507 of rail, data.45 of Steiner."""
    letters = name.removeprefix("scp").rstrip("0123456789")
    return {"": f"scp{name[3:4]}", "rail": "rail", "data.": "Steiner"}.get(letters, f"scp{letters}")


def solve(instance: Instance, solver: str, budget_s: float | None, seconds: float | None) -> dict[str, Any]:
    """One row: a solver on an instance.

    Args:
        instance: the problem; every column costs 1.
        solver: a name in `planner.cover.SOLVERS`.
        budget_s: seconds' worth of work; None: no end.
        seconds: processor time that ends the search; None: no guard.
    """
    M = instance.M
    wall, started = time.perf_counter(), time.process_time()
    result = cover.solve(
        cover.Problem(M, np.ones(M.shape[0])),
        rng=np.random.default_rng(1),
        solver=solver,
        budget=UNLIMITED_WORK if budget_s is None else round(budget_s * WORK_PER_SECOND),
        time_limit_s=seconds,
        clock=time.process_time,
    )
    row = {
        "instance": instance.name,
        "family": instance.family,
        "rows": M.shape[0],
        "columns": M.shape[1],
        "density_percent": round(100 * M.nnz / (M.shape[0] * M.shape[1]), 2),
        "solver": solver,
        "budget_s": budget_s,
        "cpu_s": round(time.process_time() - started, 2),
        "wall_s": round(time.perf_counter() - wall, 2),
        "views": len(result.views),
        "lower_bound": result.lower_bound,
        "gap_percent": round(100 * result.gap, 1),
    }
    if instance.known is not None:
        row |= {"known": instance.known, "over_known_percent": round(100 * (len(result.views) / instance.known - 1), 2)}
    return row | {"work": result.work, "status": result.sentence}


def run(
    paths: Sequence[Path] = (),
    solvers: Sequence[str] = COMPARED,
    budgets: Sequence[float] = BUDGETS,
    seconds: float | None = None,
) -> list[dict[str, Any]]:
    """One row per instance, solver and budget; greedy has no use for more than one.

    Args:
        paths: set-cover files; none: visibility matrices made here.
        solvers: names in `planner.cover.SOLVERS`.
        budgets: seconds' worth of work of each run.
        seconds: processor seconds for each run in place of the budgets.
    """
    solve(Instance("warm", "", sp.eye_array(3, dtype=bool, format="csr")), "greedy", 0.1, None)  # imports
    rows = []
    for instance in instances(paths):
        for solver in solvers:
            for budget_s in [None] if seconds is not None else [0.0] if solver == "greedy" else budgets:
                rows.append(solve(instance, solver, budget_s, seconds))
    return rows


def chart(rows: Sequence[dict[str, Any]], folder: Path) -> None:
    """Time against the mean excess over the fewest known views, a panel for each family."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    fewest = {row["instance"]: row.get("known") for row in rows}
    for row in rows:
        found = fewest[row["instance"]]
        fewest[row["instance"]] = row["views"] if found is None else min(found, row["views"])
    families = list(dict.fromkeys(row["family"] for row in rows))
    across = min(4, len(families))
    down = -(-len(families) // across)
    figure = Figure(figsize=(3.1 * across, 2.5 * down + 0.7), dpi=110, layout="constrained")
    panels = figure.subplots(down, across, squeeze=False).flat
    for axis, family in zip(panels, families, strict=False):
        for solver in dict.fromkeys(row["solver"] for row in rows):
            mine = [row for row in rows if row["family"] == family and row["solver"] == solver]
            mine.sort(key=lambda row: row["budget_s"])
            groups = [list(group) for _, group in groupby(mine, key=lambda row: row["budget_s"])]
            time_s = [float(np.mean([row["cpu_s"] for row in group])) for group in groups]
            excess = [
                float(np.mean([100 * (row["views"] / fewest[row["instance"]] - 1) for row in group]))
                for group in groups
            ]
            axis.plot(
                np.maximum(time_s, 0.01),
                excess,
                "o-",
                color=_COLOURS[solver],
                markersize=3.5,
                linewidth=1.4,
                label=solver,
            )
        axis.set_xscale("log")
        axis.set_xlim(0.008, 12)
        axis.set_ylim(bottom=-0.5)
        count = len({row["instance"] for row in rows if row["family"] == family})
        axis.set_title(family + (f" ({count} files)" if count > 1 else ""), fontsize=9.5, loc="left")
        axis.grid(color="0.92", linewidth=0.6)
        axis.set_axisbelow(True)
        axis.tick_params(labelsize=8)
        for side in ("top", "right"):
            axis.spines[side].set_visible(False)
    for axis in list(figure.axes)[len(families) :]:
        axis.set_visible(False)
    handles, labels = figure.axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper center", ncols=len(labels), frameon=False, fontsize=9.5)
    figure.supxlabel("processor time [s]", fontsize=9.5)
    figure.supylabel("more views than the fewest known [%]", fontsize=9.5)
    FigureCanvasAgg(figure)
    name = "cover_files.png" if any("known" in row for row in rows) else "cover_visibility.png"
    figure.savefig(folder / name, format="png", metadata={"Software": "scan-cell"})


def memory() -> dict[str, Any]:
    """The largest matrix that is promised, in a process of its own: peak memory beside time and result."""
    child = subprocess.run(
        [sys.executable, "-m", "benchmarks.cover", "--memory-child"], capture_output=True, text=True, check=True
    )
    row: dict[str, Any] = json.loads(child.stdout)
    return row


def _memory_child() -> None:
    M = sphere_caps(10_000, 0.05, np.random.default_rng(7))
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    row = solve(Instance("sphere caps", "large", M), "auto", 10.0, None)
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    json.dump(row | {"peak_mb": round(peak), "peak_mb_with_the_matrix_alone": round(before)}, sys.stdout)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("files", nargs="*", type=Path, help="set-cover files, as in cell cover")
    parser.add_argument("--budgets", nargs="+", type=float, default=BUDGETS, help="seconds' worth of work of each run")
    parser.add_argument("--seconds", type=float, help="processor time of each run, in place of the budgets")
    parser.add_argument("--solvers", nargs="+", default=COMPARED)
    parser.add_argument("--charts", type=Path, help="draw into this folder")
    parser.add_argument("--memory", action="store_true", help="only the memory of the largest matrix")
    parser.add_argument("--memory-child", action="store_true", help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.memory_child:
        _memory_child()
        return
    out = sys.stdout
    versions = f"numpy {np.__version__}, scipy {scipy.__version__}, python {platform.python_version()}"
    out.write(f"{versions}, {platform.machine()} {platform.system()}\n")
    if arguments.memory:
        table = [memory()]
    else:
        table = run(arguments.files, arguments.solvers, arguments.budgets, arguments.seconds)
    names = list(dict.fromkeys(name for row in table for name in row))
    out.write(" | ".join(names) + "\n")
    for row in table:
        out.write(" | ".join(str(row.get(name, "")) for name in names) + "\n")
    for solver in dict.fromkeys(row["solver"] for row in table):
        over = [row["over_known_percent"] for row in table if row["solver"] == solver and "known" in row]
        if over:
            out.write(f"{solver}: mean {np.mean(over):.2f} % over the fewest known, {len(over)} runs\n")
    if arguments.charts is not None and table:
        chart(table, arguments.charts)


if __name__ == "__main__":
    main()
