"""Evaluation of explorations: coverage of the true part, and bounds on views and coverage against brute force."""

from itertools import combinations
from pathlib import Path

import numpy as np
import pytest

from benchmarks.exploring.evaluation import CurvePoint, bounds, evaluate, fewest_views, plan_known_model
from benchmarks.triangle_cell import TriangleCell
from cell.explore.explore import explore
from cell.explore.options import ExploreOptions
from cell.explore.prepare import prepare_exploration
from cell.runs.cell import world_of
from cell.runs.run import open_finished
from cell.scan.options import ScanOptions
from cell.scene.file import scene_from_options
from cell.scene.options import parse_options
from cell.session import Session
from planner.values import Bools, Floats


def _columns(planned: Path) -> tuple[Bools, Floats, float]:
    """Return the matrix (S, V) of reachable candidates that no other dominates, and the samples' shares and total."""
    run = open_finished(planned)
    M = run.measurability
    sees = M.matrix().toarray()[:, run.reach.reachable]
    total = float(M.samples.areas.sum())
    more = np.array([
        [(~one | other).all() and ((one != other).any() or i > j) for j, other in enumerate(sees.T)]
        for i, one in enumerate(sees.T)
    ])  # fmt: skip
    return sees[:, ~more.any(axis=1)], M.samples.areas / total, total


def _most(sees: Bools, areas: Floats, count: int) -> float:
    """Return the largest share that `count` columns measure, by enumeration."""
    return max(
        float(areas[sees[:, list(columns)].any(axis=1)].sum()) for columns in combinations(range(sees.shape[1]), count)
    )


@pytest.mark.parametrize("count", [1, 2])
def test_the_fewest_views_for_a_coverage_are_those_of_brute_force(count: int, planned: Path) -> None:
    """The largest coverage of n views needs n views, and a slightly larger coverage needs more than n."""
    run = open_finished(planned)
    M, (sees, areas, _) = run.measurability, _columns(planned)
    most = _most(sees, areas, count)
    assert fewest_views(run, M, most - 1e-9) == (count, count)
    least, found = fewest_views(run, M, most + 1e-6)
    assert count < least <= found
    assert fewest_views(run, M, _most(sees, areas, count - 1) + 1e-6 if count > 1 else 1e-6) == (count, count)


def test_a_coverage_above_the_coverable_one_needs_as_many_views_as_all_coverable_surface(planned: Path) -> None:
    """Executed views may measure surface that no candidate measures."""
    run = open_finished(planned)
    M, (sees, areas, _) = run.measurability, _columns(planned)
    all_of_it = float(areas[sees.any(axis=1)].sum())
    assert all_of_it < 1
    assert fewest_views(run, M, 1.0) == fewest_views(run, M, all_of_it)
    assert fewest_views(run, M, all_of_it)[0] >= run.plan.lower_bound


def test_the_curve_is_tightened_by_the_fewest_views_for_a_coverage() -> None:
    """The bound is never raised and never below the best selection; `found` views reach the coverage."""
    curve = [(0, 0.0, 0.0), (1, 0.3, 0.35), (2, 0.6, 0.7), (3, 0.7, 0.85), (4, 0.8, 0.9), (5, 0.82, 0.9)]
    points = [CurvePoint(n_views=n, coverage=found, upper_bound=most) for n, found, most in curve]
    reached, fewest = 0.75, 4
    bound = bounds(points, reached, fewest, 4)
    assert [(at.views, at.found) for at in bound] == [(n, found) for n, found, _ in curve]
    assert [at.found for at in bounds(points, reached, 3, 3)] == [0.0, 0.3, 0.6, 0.75, 0.8, 0.82]
    assert [at.at_most for at in bound] == [0.0, 0.35, 0.7, 0.75, 0.9, 0.9]
    assert [at.at_most for at in bounds(points, 0.7 - 1e-12, fewest, 4)] == [0.0, 0.35, 0.7 - 1e-12, 0.7, 0.9, 0.9]
    assert [at.at_most for at in bounds(points, 1.0, 6, 6)] == [most for _, _, most in curve]


def test_an_exploration_is_evaluated_on_the_true_part(part_file: Path, tmp_path: Path) -> None:
    """Coverage grows with the views and stays below the bound. The arm keeps clear of the true part."""
    scene_options = {"place": (1100, 400, 100), "units": "mm", "faces": 120, "samples": 2, "standoff": 250, "seed": 3}
    scene = scene_from_options(
        None, {**scene_options, "candidates": "optimal-scanning-zone", "max_views": 5}, part_file
    )
    options, scanning = parse_options(ExploreOptions, {"ring": 3, "batch": 2}), ScanOptions(resolution_deg=0.5)
    session, known_model = Session(None, out=tmp_path / "explored"), tmp_path / "known"
    file = explore(session, scene, options, scanning)
    work = prepare_exploration(session, scene, options, scanning)
    plan_known_model(work, known_model)
    found = evaluate(work, file, known_model)
    assert len(found.by_views) == file.views == 5
    assert (np.diff(found.by_views) >= 0).all()
    assert found.visible == pytest.approx(found.by_views[-1])
    at_most = {point.views: point.at_most for point in found.bound}
    assert all(share <= at_most[n] + 0.02 for n, share in enumerate(found.by_views, start=1) if n in at_most)
    assert 1 <= found.fewest <= found.fewest_found <= 5
    assert found.visible > 0.6
    assert found.nearest_mm > 0


@pytest.mark.slow
@pytest.mark.parametrize("name", ["mug", "petanque"])
@pytest.mark.parametrize("policy", ["stepwise", "two-stage"])
def test_explorations_of_built_in_parts_measure_most_and_touch_nothing(name: str, policy: str, tmp_path: Path) -> None:
    """The views measure at least 85 % of the coverable surface.

    The motions have no contacts of triangles in python-fcl.
    """
    scene = scene_from_options(None, {"place": (1200, 500, 0), "max_views": 16}, name)
    options, out, known_model = (
        parse_options(ExploreOptions, {"policy": policy}),
        tmp_path / "explored",
        tmp_path / "known",
    )
    file = explore(Session(None, out=out), scene, options, ScanOptions())
    work = prepare_exploration(Session(None, out=out), scene, options, ScanOptions())
    plan_known_model(work, known_model)
    found = evaluate(work, file, known_model)
    assert found.nearest_mm > 0
    assert found.visible > 0.85 * found.coverable
    run = open_finished(known_model)
    part = run.mesh("reference.ply")
    judge = TriangleCell(world_of(run, part), part)
    assert not any(judge.contacts(open_finished(out / stage.folder).motion.q) for stage in file.batches)
