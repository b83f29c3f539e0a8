"""Requests beyond the fewest views on built-in parts: processor seconds and the remaining gap.

Rows: the curve of coverage over the number of views; connected scans at several overlaps; coverage promises under pose
errors, with 200 simulated executions. Candidates are one view over each planning face. The arm is not considered.
"""

import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

PARTS = ("mseke", "robinet")
SHARES = (0.2, 0.5, 0.8)
ERRORS = ((0.5, 0.1), (2.0, 0.5))


def run() -> list[dict[str, Any]]:
    """Return the rows of all requests."""
    return [row for part in PARTS for row in _of_part(part)]


def chart(rows: list[dict[str, Any]], folder: Path) -> None:
    """Draw coverage over views with its bound, the price of overlaps, and the price of promises."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(13.5, 4.3), dpi=110, layout="constrained")
    FigureCanvasAgg(figure)
    curve, overlap, promise = figure.subplots(1, 3)
    for part, colour in zip(PARTS, ("#2471a3", "#ca6f1e"), strict=True):
        mine = [row for row in rows if row["part"] == part]
        points = next(row["points"] for row in mine if row["request"] == "curve")
        n, covered, upper = np.array(points).T
        curve.fill_between(n, covered, upper, color=colour, alpha=0.3, lw=0)
        curve.plot(n, covered, "-", color=colour, label=f"{part}: found, and above it what the bound leaves open")
        for axes, request in ((overlap, "overlap"), (promise, "promise")):
            values = [row for row in mine if row["request"] == request]
            x = [row["requested"] for row in values]
            axes.plot(x, [row["views"] for row in values], "o-", color=colour, label=f"{part}: views")
            axes.plot(x, [row["at_least"] for row in values], ":", color=colour, label=f"{part}: at least")
    curve.set(xlabel="number of views", ylabel="covered [% of coverable]", ylim=(0, 102), xlim=(0, None))
    overlap.set(
        xlabel="requested overlap [share of the smaller view]", ylabel="views, all scans connected", ylim=(0, None)
    )
    promise.set(xlabel="standard deviation of poses", ylabel="views for 98 % with probability 95 %", ylim=(0, None))
    for axes in (curve, overlap, promise):
        axes.grid(alpha=0.3)
        axes.legend(fontsize=8)
    figure.savefig(folder / "coverage_requests.png", metadata={"Software": "scan-cell"})


def _of_part(part: str) -> Iterator[dict[str, Any]]:
    from planner.cover import CoverProblem, Overlap, solve
    from planner.cover.curve import coverage_curve
    from planner.cover.robust import robust_cover
    from planner.measurability.pose_ensemble import PoseError, probability_layer, simulate_executions

    M, views, scanner, caster, samples = _matrix(part)
    areas, size = M.samples.areas, f"{M.shape[0]} x {M.shape[1]}"
    matrix = M.matrix()
    plain, seconds = _timed(lambda: solve(CoverProblem(matrix, areas), rng=np.random.default_rng(0)))
    yield _row(part, "fewest", size, "", plain, plain.sentence, seconds)
    curve, seconds = _timed(
        lambda: coverage_curve(
            CoverProblem(matrix, areas),
            rng=np.random.default_rng(0),
            known_selections=[plain.views],
            min_views_full_coverage=plain.lower_bound,
        )
    )
    share = 100 / curve.coverable_area
    gaps = share * (curve.upper_area - curve.covered_area)
    yield {
        "part": part, "request": "curve", "size": size, "requested": f"0 to {curve.n_views[-1]} views",
        "views": int(curve.n_views[-1]), "at_least": plain.lower_bound, "seconds": round(seconds, 2),
        "found": f"gap {gaps.mean():.2f} points on average, {gaps.max():.2f} at most",
        "points": [
            (int(n), share * a, share * u)
            for n, a, u in zip(curve.n_views, curve.covered_area, curve.upper_area, strict=True)
        ],
    }  # fmt: skip
    for least in SHARES:
        found, seconds = _timed(
            lambda least=least: solve(
                CoverProblem(matrix, areas, overlap=Overlap(share=least), coverage=0.98), rng=np.random.default_rng(0)
            )
        )
        yield _row(
            part,
            "overlap",
            size,
            least,
            found,
            f"{len(found.views) - found.n_views_without_overlap} more; {found.sentence}",
            seconds,
        )
    for position, orientation in ERRORS:
        error = PoseError(position / 1000, float(np.deg2rad(orientation)))
        errors = error.draw(32, np.random.default_rng(1))
        layer, filled = _timed(lambda errors=errors: probability_layer(M, views, scanner, (caster,), errors))
        robust, seconds = _timed(
            lambda layer=layer: robust_cover(
                CoverProblem(matrix, areas, coverage=0.98), layer, rng=np.random.default_rng(0)
            )
        )
        poses = views.T_object_scanner[robust.cover.views]
        pose_errors = error.draw(200 * len(poses), np.random.default_rng(2)).reshape(200, len(poses), 4, 4)
        times, _ = simulate_executions(poses, samples, scanner, (caster,), pose_errors)
        success_share = (times >= 190).mean()
        expected = (
            f"layer {filled:.1f} s; promised {100 * robust.robust_area / robust.cover.total_area:.2f} %, of other "
            f"samples {100 * success_share:.2f} % in 190 of 200 executions"
        )
        yield _row(part, "promise", size, f"{position:g} mm, {orientation:g} deg", robust.cover, expected, seconds)


def _row(part: str, request: str, size: str, requested: Any, cover: Any, found: str, seconds: float) -> dict[str, Any]:
    return {
        "part": part, "request": request, "size": size, "requested": requested, "views": len(cover.views),
        "at_least": cover.lower_bound, "seconds": round(seconds, 2), "found": found,
    }  # fmt: skip


def _timed(call: Callable[[], Any]) -> tuple[Any, float]:
    start = time.process_time()
    result = call()
    return result, time.process_time() - start


def _matrix(part: str) -> tuple[Any, Any, Any, Any, Any]:
    """Return matrix, candidates, scanner, caster and 5,000 independent samples of a built-in part at its defaults."""
    from cell.part import workpiece
    from cell.plan import candidates
    from cell.scanners.laser_area import LaserArea
    from cell.scene.file import load_scene
    from cell.scene.settle import settle
    from cell.world.embree import EmbreeRayCaster
    from cell.world.measurability import surface_samples
    from planner.geometry.decimation import decimate
    from planner.geometry.sampling import draw_samples
    from planner.measurability.visibility import fill_matrix

    tables = {"part": {"name": part}, "placement": {"position_mm": [1200.0, 500.0, 0.0]}, "plan": {"rolls_deg": [0.0]}}
    scene = load_scene(None, tables)
    loaded = workpiece.load(scene.part.source, scene.part.units)
    settings = settle(scene, loaded).settings
    planning = decimate(loaded.reference, settings.faces)
    views = candidates.generate_viewpoints(scene, settings, loaded, planning)
    features = surface_samples(scene, loaded.reference, planning, np.random.default_rng(0))
    scanner = LaserArea(**settings.scanner)
    caster = EmbreeRayCaster(loaded.reference.vertices, loaded.reference.faces)
    samples = draw_samples(loaded.reference, planning, 5_000, np.random.default_rng(1))
    return fill_matrix(views, features, scanner, caster), views, scanner, caster, samples
