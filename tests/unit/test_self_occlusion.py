"""Self-occlusion: compared with brute force; other joint configurations first, then lost samples."""

import numpy as np
import pytest
import trimesh

from cell.robot.arm import kinematics_of
from cell.scanners.laser_area import LaserArea
from cell.scene.model import Scene
from cell.world import self_occlusion
from cell.world.embree import EmbreeRayCaster
from cell.world.model import World, compile_world
from cell.world.occluders import Occluder, arm_occluders, box_triangles
from cell.world.self_occlusion import MAX_OCCLUDED_SHARE, OcclusionUpdate, SelfOcclusion, coverage_with_arm
from planner.geometry.mesh import TriangleMesh
from planner.geometry.sampling import draw_samples
from planner.kinematics.reach import Reach, Verdict
from planner.measurability.matrix import Measurability
from planner.measurability.visibility import fill_matrix
from planner.viewpoints.viewpoints import Viewpoints, optimal_scanning_zone

BALL = trimesh.creation.icosphere(2, 0.05)
PART = TriangleMesh(BALL.vertices, BALL.faces)
SCANNER = LaserArea(baseline_mm=40, range_mm=(200, 700))
ENDS = np.stack([SCANNER.source, SCANNER.sensor])
SIDEWAYS = {"position_mm": [250.0, 0.0, 50.0], "abc_deg": [0.0, -98.5, 0.0]}  # aimed over the wrist at the part


def _world(**tables: object) -> World:
    tables = {"placement": {"position_mm": [900, 300, 500]}, "scanner": {"baseline_mm": 40}, **tables}
    return compile_world(Scene.model_validate(tables), PART.vertices, baseline_mm=40)


def _cell(world: World) -> tuple[Measurability, Reach, Viewpoints]:
    """Return candidates all around the ball with all joint configurations, and their measurability."""
    views = optimal_scanning_zone(TriangleMesh(PART.vertices, PART.faces[::20]), (0.48,), (0.0, np.pi / 2))
    kinematics = kinematics_of(world.model)
    flange = world.T_base_object @ views.T_object_scanner[:, 0] @ np.linalg.inv(world.T_flange_scanner)
    branches = [q[np.isfinite(q).all(axis=1)] for q in kinematics.inverse(flange)]
    reachable = [k for k, q in enumerate(branches) if len(q)]
    views = Viewpoints(*(getattr(views, name)[reachable] for name in ("T_object_scanner", "face", "standoff", "roll")))
    solutions = [branches[k] for k in reachable]
    offsets = np.concatenate([[0], np.cumsum([len(q) for q in solutions])])
    verdict = np.full(len(views), Verdict.REACHABLE, dtype=np.uint8)
    reached = Reach(verdict, np.concatenate(solutions), offsets, ("",) * len(views))
    features = draw_samples(PART, PART, 800, np.random.default_rng(0))
    return fill_matrix(views, features, SCANNER, EmbreeRayCaster(PART.vertices, PART.faces)), reached, views


def _column(M: Measurability, view: int) -> np.ndarray:
    return np.flatnonzero(M.matrix()[:, [view]].toarray().ravel())


def _hidden(world: World, T: np.ndarray, q: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Test both rays of each pair against the arm in float64, in the base frame."""
    to_base = world.T_base_object
    targets = points @ to_base[:3, :3].T + to_base[:3, 3]
    hidden = np.zeros(len(points), dtype=bool)
    for piece in arm_occluders(world, q, ENDS):
        a, b, c = (piece.vertices[piece.faces[:, k]] for k in range(3))
        for end in ENDS:
            origin = to_base[:3, :3] @ (T[:3, :3] @ end + T[:3, 3]) + to_base[:3, 3]
            way = (targets - origin)[:, None]
            normal = np.cross(b - a, c - a)
            with np.errstate(divide="ignore", invalid="ignore"):
                t = ((a - origin) * normal).sum(-1) / (way * normal).sum(-1)
            at = origin + np.where(np.isfinite(t), t, -1)[..., None] * way
            inside = np.ones(t.shape, dtype=bool)
            for p, r in ((a, b), (b, c), (c, a)):
                inside &= (np.cross(r - p, at - p) * normal).sum(-1) >= 0
            hidden |= (inside & (t > 0) & (t < 1)).any(axis=1)
    return hidden


def test_the_default_mount_is_never_occluded():
    """The check finds no occlusion and returns the same matrix object."""
    world = _world()
    M, reached, views = _cell(world)
    arm = SelfOcclusion(M, reached, views, world, SCANNER)
    selection = np.arange(len(views))
    assert len(selection) > 10
    assert (
        arm.update(selection, np.stack([reached.configurations_of(v)[0] for v in selection])) is OcclusionUpdate.CLEAR
    )
    assert arm.M is M
    assert not arm.reasons


def test_exactly_the_hidden_samples_are_removed():
    """With a mount aimed over the wrist, exactly the samples hidden by brute force are removed from a view."""
    world = _world(mount=SIDEWAYS, housing={"bracket_diameter_mm": 0.0, "size_mm": [100.0, 60.0, 40.0]})
    M, reached, views = _cell(world)
    arm = SelfOcclusion(M, reached, views, world, SCANNER)
    selection = np.arange(0, len(views), 6)
    looks = []
    for _ in range(20):
        looks.append(arm.update(selection, np.stack([arm.configurations(v)[0] for v in selection])))
        if looks[-1] is OcclusionUpdate.CLEAR:
            break
    assert looks[0] is OcclusionUpdate.LESS_MEASURED
    assert looks[-1] is OcclusionUpdate.CLEAR
    assert arm.reasons
    points = M.samples.points
    for view in selection:
        before, after = _column(M, view), _column(arm.M, view)
        assert set(after) <= set(before)
        q = arm.configurations(view)[0]
        hidden = _hidden(world, views.T_object_scanner[view, 0], q, points[before])
        is_lost = np.isin(before, after, invert=True)
        if view in arm.reasons:
            assert "link_" in arm.reasons[view]
            np.testing.assert_array_equal(is_lost, hidden)
        else:
            assert not is_lost.any()
    untouched = np.setdiff1d(np.arange(len(views)), list(arm.reasons))
    assert (arm.M.matrix()[:, untouched] != M.matrix()[:, untouched]).nnz == 0


def test_other_configurations_are_used_before_samples_are_removed(monkeypatch: pytest.MonkeyPatch):
    """Only configurations with an occluding A4 are removed. The matrix is unchanged, and the next check is clear."""
    world = _world()
    M, reached, views = _cell(world)
    block, faces = box_triangles(np.array([0.2, 0.2, 0.01]))
    view = int(np.argmax([len(_column(M, v)) for v in range(len(views))]))
    T = world.T_base_object @ views.T_object_scanner[view, 0]
    wall = (block + np.array([0, 0, 0.2])) @ T[:3, :3].T + T[:3, 3]

    def fake(_world: World, q: np.ndarray, _ends: object = None) -> list[Occluder]:
        return [Occluder("link_4", wall if q[3] > 0 else wall + 50.0, faces)]

    monkeypatch.setattr(self_occlusion, "arm_occluders", fake)
    solutions = reached.configurations_of(view)
    good = solutions[:, 3] <= 0
    assert 0 < good.sum() < len(solutions)
    arm = SelfOcclusion(M, reached, views, world, SCANNER)
    assert arm.update(np.array([view]), solutions[~good][:1]) is OcclusionUpdate.OTHER_CONFIGURATIONS
    np.testing.assert_array_equal(arm.configurations(view), solutions[good])
    assert arm.M is M
    assert arm.update(np.array([view]), solutions[good][:1]) is OcclusionUpdate.CLEAR


def test_occlusion_of_samples_of_another_view_is_no_loss(monkeypatch: pytest.MonkeyPatch):
    """An arm in front of one of two equal views loses no sample; in front of both it does."""
    world = _world()
    M, reached, views = _cell(world)
    twice = Viewpoints(*(
        np.repeat(getattr(views, name)[:1], 2, axis=0) for name in ("T_object_scanner", "face", "standoff", "roll")
    ))  # fmt: skip
    M = fill_matrix(twice, M.samples, SCANNER, EmbreeRayCaster(PART.vertices, PART.faces))
    q = np.stack([reached.configurations_of(0)[0], reached.configurations_of(0)[-1]])
    both = Reach(np.zeros(2, dtype=np.uint8), q, np.array([0, 1, 2]), ("", ""))
    T = world.T_base_object @ twice.T_object_scanner[0, 0]
    block, faces = box_triangles(np.array([0.2, 0.2, 0.01]))
    wall = (block + np.array([0, 0, 0.2])) @ T[:3, :3].T + T[:3, 3]
    shaded = {q[0].tobytes()}
    monkeypatch.setattr(
        self_occlusion, "arm_occluders",
        lambda _w, at, _e=None: [Occluder("link_5", wall + (0.0 if at.tobytes() in shaded else 50.0), faces)],
    )  # fmt: skip
    arm = SelfOcclusion(M, both, twice, world, SCANNER)
    # The second view keeps all samples, so the plan loses none of the first view.
    assert arm.update(np.array([0, 1]), q) is OcclusionUpdate.CLEAR
    shaded.add(q[1].tobytes())
    assert arm.update(np.array([0, 1]), q) is OcclusionUpdate.LESS_MEASURED
    assert set(arm.reasons) == {0, 1}
    assert len(arm.M.indices) == 0
    assert f"{100 * MAX_OCCLUDED_SHARE:g} %" in arm.reasons[0]


def test_coverage_with_the_arm_is_never_larger(monkeypatch: pytest.MonkeyPatch):
    """The coverage with the arm is at most that without, and equal if the arm is far away."""
    from cell.world.prediction import Prediction

    world = _world(mount=SIDEWAYS, housing={"bracket_diameter_mm": 0.0, "size_mm": [100.0, 60.0, 40.0]})
    M, reached, views = _cell(world)
    caster = EmbreeRayCaster(PART.vertices, PART.faces)
    prediction = Prediction.of(M.samples, SCANNER, [caster], views.T_object_scanner[:6])
    arms = [
        self_occlusion.arm_caster(world, reached.configurations_of(v)[0], views.T_object_scanner[v, 0], SCANNER)
        for v in range(6)
    ]
    assert any(arm is not None for arm in arms)
    visible = prediction.coverable.covered
    with_arm = coverage_with_arm(prediction, views.T_object_scanner[:6], arms, visible)
    assert with_arm == coverage_with_arm(prediction, views.T_object_scanner[:6], arms, np.ones_like(visible))
    assert with_arm < prediction.coverable.fraction
    far = EmbreeRayCaster(BALL.vertices + 50.0, BALL.faces)
    assert (
        coverage_with_arm(prediction, views.T_object_scanner[:6], [far] * 6, visible) == prediction.coverable.fraction
    )


def test_the_housing_occludes_only_away_from_source_and_sensor():
    """A front face in the plane of the source has a window; a shifted housing occludes like other shapes."""
    q = np.deg2rad([10, -80, 90, 5, 20, 30])
    names = {piece.name for piece in arm_occluders(_world(), q, ENDS)}
    assert "housing" not in names
    assert {"bracket", "link_4", "link_5"} <= names
    aside = _world(housing={"position_mm": [200.0, 0.0, 10.0]})
    assert "housing" in {piece.name for piece in arm_occluders(aside, q, ENDS)}
    assert "housing" not in {piece.name for piece in arm_occluders(aside, q)}
