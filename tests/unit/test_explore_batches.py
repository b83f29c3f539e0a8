"""Planning the stages of an exploration: selection of samples, order of the surfaces, expected and realised gain."""

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import trimesh

from cell.explore import explore, stage
from cell.explore.options import ExploreOptions
from cell.explore.policy import Batch, BatchRequest, expected_samples, realised_gain_ratio, select_samples
from cell.explore.state import ExplorationFolder
from cell.runs.schema import BELIEVED, MEASURED, SurfaceName
from cell.scanners.laser_area import LaserArea
from cell.world.embree import EmbreeRayCaster
from planner.explore.gain import GainRecord, gain_ratio
from planner.explore.space import VoxelSpace
from planner.geometry.mesh import TriangleMesh
from planner.geometry.sampling import SurfaceSamples, draw_samples
from planner.values import Bools, Floats
from planner.viewpoints.viewpoints import aim_viewpoints

UNKNOWN = VoxelSpace.from_cylinder(0.06, 0.06, 0.003, 0.002)
LAW = LaserArea(range_mm=(50, 900), baseline_mm=60.0, grazing_max_deg=75.0, sensor_grazing_max_deg=75.0)


@pytest.fixture(scope="module")
def balls() -> TriangleMesh:
    """Return two balls side by side that occlude each other in part."""
    whole = trimesh.util.concatenate([
        trimesh.creation.icosphere(3, 0.02).apply_translation((x, 0.0, 0.0)) for x in (-0.025, 0.025)
    ])  # fmt: skip
    return TriangleMesh(np.asarray(whole.vertices, dtype=np.float64), np.asarray(whole.faces, dtype=np.int32))


def _poses() -> Floats:
    """Return (3, 4, 4) poses: from one side, from above and from a corner."""
    out = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.6, 0.48, 0.64]])
    return np.asarray(aim_viewpoints(np.zeros((3, 3)), out, np.full(3, -1), [0.3], [0.0]).T_object_scanner[:, 0])


def _measured(samples: SurfaceSamples, poses: Floats, mesh: TriangleMesh, grazing_deg: float) -> Bools:
    """Return (N,) samples visible to source and sensor within the grazing limit, by ray casts of trimesh.

    Rays start 0.01 mm above the surface.
    """
    found = np.zeros(len(samples), dtype=bool)
    triangles = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)
    for T in poses:
        sees = np.ones(len(samples), dtype=bool)
        for stand in (T[:3, 3], T[:3, 3] + 0.06 * T[:3, 0]):
            leg = stand - samples.points
            length = np.linalg.norm(leg, axis=1, keepdims=True)
            sees &= np.einsum("ij,ij->i", leg / length, samples.normals) >= np.cos(np.radians(grazing_deg))
            sees &= ~triangles.ray.intersects_any(samples.points + 1e-5 * samples.normals, leg / length)
        found |= sees
    return found


def _request(poses: Floats | None, include_covered: bool = False, space: VoxelSpace = UNKNOWN) -> BatchRequest:
    return BatchRequest(space, GainRecord.empty(), Batch(1, include_covered=include_covered), 0.001, poses=poses)


def test_unmeasured_samples_of_the_measured_surface_are_selected(balls: TriangleMesh) -> None:
    """On measured surface, exactly the samples that no pose measures are selected, by comparison with brute force."""
    samples = draw_samples(balls, balls, 3000, np.random.default_rng(0))
    caster = EmbreeRayCaster(balls.vertices, balls.faces)
    selection = select_samples(samples, _request(_poses()), 3000, LAW, caster)
    missed = ~_measured(samples, _poses(), balls, LAW.grazing_max_deg)
    assert 0.2 < missed.mean() < 0.8
    for name in ("points", "normals", "areas", "face", "planning_face"):
        assert np.array_equal(getattr(selection, name), getattr(samples, name)[missed]), name
    assert len(select_samples(samples, _request(np.repeat(_poses()[:1], 2, axis=0)), 3000, LAW, caster)) > len(
        selection
    )


@pytest.mark.parametrize("views", [(1, 1), (2,), (1,)])
def test_the_realised_gain_counts_newly_measured_samples(views: tuple[int, ...], balls: TriangleMesh) -> None:
    """The realised gain counts samples near a point that the latest views measured first, as brute force does."""
    samples = draw_samples(balls, balls, 3000, np.random.default_rng(0))
    caster = EmbreeRayCaster(balls.vertices, balls.faces)
    space = replace(UNKNOWN, points=samples.points[samples.points[:, 1] > 0])
    near = np.linalg.norm(samples.points[:, None] - space.points[None], axis=2).min(axis=1) <= UNKNOWN.edge
    assert 0.4 < near.mean() < 0.8
    each = np.stack([_measured(samples, T[None], balls, LAW.grazing_max_deg) for T in _poses()])
    left, firsts = near.copy(), list[float]()
    for seen in each:
        firsts.append(float(samples.areas[left & seen].sum()))
        left &= ~seen
    latest = [(count, 0.001 * (number + 1)) for number, count in enumerate(views)]
    requests = replace(_request(_poses(), space=space), latest=latest)
    areas = np.split(np.array(firsts[-sum(views) :]), np.cumsum(views)[:-1])
    batches = [(expected, float(area.sum())) for (_, expected), area in zip(latest, areas, strict=True)]
    assert realised_gain_ratio(samples, requests, LAW, caster) == pytest.approx(gain_ratio(batches))
    assert realised_gain_ratio(samples, replace(requests, poses=None, gain_ratio=1.5), LAW, caster) == 1.5
    assert realised_gain_ratio(samples, replace(requests, latest=[(2, 0.0)]), LAW, caster) == 1.0


def test_of_more_samples_than_are_kept_the_area_is_the_same(balls: TriangleMesh) -> None:
    """At most the requested number of samples remains; their areas add up to that of all selected samples."""
    samples = draw_samples(balls, balls, 3000, np.random.default_rng(0))
    caster = EmbreeRayCaster(balls.vertices, balls.faces)
    every, few = (select_samples(samples, _request(_poses()), most, LAW, caster) for most in (3000, 100))
    assert 90 < len(few) <= 100 < len(every)
    assert few.areas.sum() == pytest.approx(every.areas.sum())
    assert {tuple(point) for point in few.points.tolist()} < {tuple(point) for point in every.points.tolist()}


@pytest.mark.parametrize("include_covered", [False, True])
def test_unseen_samples_of_the_believed_surface_are_selected(include_covered: bool, balls: TriangleMesh) -> None:
    """On believed surface a sample has its area times its probability of gain."""
    samples = draw_samples(balls, balls, 3000, np.random.default_rng(0))
    right = samples.points[:, 0] > 0
    space = replace(UNKNOWN, points=samples.points[right])
    requests = _request(None, include_covered, space)
    selection = select_samples(samples, requests, 3000, LAW, EmbreeRayCaster(balls.vertices, balls.faces))
    seen = space.is_measured(samples.points, samples.normals)
    assert seen[right].all()
    weights = np.where(
        seen, float(include_covered), GainRecord.empty().weights(space.open_samples_at(samples.points, samples.normals))
    )
    assert np.array_equal(selection.points, samples.points[weights > 0])
    assert selection.areas == pytest.approx((weights * samples.areas)[weights > 0])
    assert np.array_equal(expected_samples(samples, requests, 3000).areas, selection.areas)


@pytest.mark.parametrize(
    ("views", "seconds", "on", "batches", "ended"),
    [
        (5, 40.0, BELIEVED, (BELIEVED, MEASURED), "no batch of the policy"),
        (5, 40.0, MEASURED, (MEASURED, BELIEVED), "no batch of the policy"),
        (7, 40.0, BELIEVED, (), "the budget of 7 views is used"),
        (8, 90.0, BELIEVED, (), "the budget of 7 views is used"),
        (5, 60.0, BELIEVED, (), "the budget of 60 s of motion is used"),
    ],
)
def test_the_next_batches_are_the_policys_within_the_budget(
    views: int, seconds: float, on: SurfaceName, batches: tuple[SurfaceName, ...], ended: str
) -> None:
    """Stepwise batches have no more views than remain in the budget."""
    stages = [
        SimpleNamespace(seconds=seconds / 2, planning_surface=BELIEVED),
        SimpleNamespace(seconds=seconds / 2, planning_surface=on),
    ]
    plan = SimpleNamespace(max_views=7, max_sigma_mm=None)
    scene = SimpleNamespace(plan=plan, scanner=SimpleNamespace(max_spacing_mm=None))
    work: Any = SimpleNamespace(scene=scene, options=ExploreOptions(max_seconds=60.0, batch=3))
    found, message = explore._next_batches(work, SimpleNamespace(batches=stages, views=views))  # type: ignore[arg-type]
    assert [(batch.views, batch.per_second, batch.on) for batch in found] == [(2, True, each) for each in batches]
    assert message.startswith(ended)
    first, _ = explore._next_batches(work, SimpleNamespace(batches=[], views=0))  # type: ignore[arg-type]
    assert first == (Batch(1),)


@pytest.mark.parametrize(
    ("batch", "output"),
    [
        (Batch(1), "less than the 0.1 % minimum"),
        (Batch(1, min_gain_factor=1.5), "less than 1.5 x the 0.1 % minimum"),
        (Batch(1, min_gain_factor=0.5), ""),
        (Batch(1, include_covered=True), ""),
    ],
)
def test_a_batch_below_the_minimum_gain_names_the_minimum(batch: Batch, output: str) -> None:
    """Two views with an expected gain of 0.08 % each are compared with the minimum gain of the batch."""
    selection: Any = SimpleNamespace(cover=SimpleNamespace(covered_area=0.0001, views=(3, 7)))
    requests = BatchRequest(UNKNOWN, GainRecord.empty(), batch, 0.001, measured_area=0.1, gain_ratio=1.6)
    message = stage._insufficient_gain(selection, requests)
    assert message.endswith(output)
    assert ("to add 0.080 % of the measured surface" in message) == bool(output)


def test_a_plan_that_finished_is_taken_with_its_surface(tmp_path: Path) -> None:
    """A finished plan is used again without new planning, and its files remain."""
    paths = ExplorationFolder(tmp_path)
    paths.stage(2).mkdir(parents=True)
    for path in (paths.unseen(2), paths.measured(2)):
        path.touch()
    work: Any = SimpleNamespace(paths=paths)
    file: Any = SimpleNamespace(batches=[None])
    known: Any = None
    assert explore._plan_next(work, file, known, [Batch(1)], "") == paths.stage(2)
    assert paths.unseen(2).is_file()
    assert paths.measured(2).is_file()
