"""Causes and changes with known closed forms: a wall on a plate, a grazing plane, fields of view."""

import numpy as np
import pytest

from cell.scanners.laser_area import LaserArea
from cell.world.embree import EmbreeRayCaster
from planner.errors import PlannerError
from planner.viewpoints.lines_of_sight import RayTargets
from planner.viewpoints.viewpoints import Viewpoints, aim_viewpoints
from planner.why import what_if, why
from planner.why.what_if import ChangeKind, PlanChange, select_changes
from planner.why.why import Reason

_FAR = EmbreeRayCaster(np.array([[9.0, 9, 9], [9.1, 9, 9], [9, 9.1, 9]]), np.array([[0, 1, 2]]))
"""An object that occludes nothing."""


def _rectangle(corner, first, second):
    corner, first, second = (np.array(value, dtype=float) for value in (corner, first, second))
    vertices = np.array([corner, corner + first, corner + first + second, corner + second])
    return vertices, np.array([[0, 1, 2], [0, 2, 3]])


def _caster(*pieces):
    starts = np.cumsum([0, *(len(vertices) for vertices, _ in pieces)])
    faces = np.concatenate([face + start for (_, face), start in zip(pieces, starts[:-1], strict=True)])
    return EmbreeRayCaster(np.concatenate([vertices for vertices, _ in pieces]), faces)


_PLATE = _rectangle([-0.05, -0.05, 0], [0.1, 0, 0], [0, 0.1, 0])
_WALL = _rectangle([0, -0.05, 0], [0, 0.1, 0], [0, 0, 0.02])  # 20 mm high, in the plane x = 0


def _down(x: float, height: float, roll: float = 0.0) -> Viewpoints:
    """Return a scanner above the plate at (x, 0, height), aimed straight down; at roll 0 the sensor is towards +x."""
    return aim_viewpoints(np.array([[x, 0.0, 0.0]]), np.array([[0.0, 0.0, 1.0]]), np.array([0]), [height], [roll])


def _on_plate(x: np.ndarray) -> RayTargets:
    points = np.stack([x, np.full(len(x), 0.003), np.zeros(len(x))], axis=1)
    return RayTargets.of(points, np.tile([0.0, 0.0, 1.0], (len(x), 1)))


def _reasons(targets: RayTargets, views: Viewpoints, scanner: LaserArea, part, other=_FAR, fails=Reason.NOT_SELECTED):
    rows = np.arange(len(targets))
    return why.diagnose(targets, rows, views, scanner, (part, other), np.full(len(views), fails, np.uint8))


def test_the_laser_shadow_of_a_wall_follows_from_similar_triangles() -> None:
    """A wall of 20 mm, seen from 40 mm before it and 200 mm above, has a shadow of 40 * 20 / 180 mm."""
    x = np.linspace(0.0005, 0.03, 400)
    scanner = LaserArea(range_mm=(50, 900), baseline_mm=0, grazing_max_deg=90)
    found = _reasons(_on_plate(x), _down(-0.04, 0.2), scanner, _caster(_PLATE, _WALL))
    shaded = x < 0.04 * 0.02 / 0.18
    assert shaded.any()
    assert not shaded.all()
    np.testing.assert_array_equal(found.reason == Reason.SOURCE_SHADED_BY_PART, shaded)
    np.testing.assert_array_equal(found.reason == Reason.NOT_SELECTED, ~shaded)


def test_another_standoff_gains_the_difference_of_the_shadows() -> None:
    """At twice the height the shadow is 40 * 20 / 380 mm long. The change gains the points between both ends."""
    x = np.linspace(0.0005, 0.03, 400)
    targets, part = _on_plate(x), _caster(_PLATE, _WALL)
    scanner = LaserArea(range_mm=(50, 900), baseline_mm=0, grazing_max_deg=90)
    higher = what_if.with_standoff(_down(-0.04, 0.2), 0.4)
    change = PlanChange(ChangeKind.STANDOFF, 1.0, "", "", higher.T_object_scanner, scanner, (part, _FAR))
    rows = np.flatnonzero(x < 0.04 * 0.02 / 0.18)
    gained = change.measures(targets, rows)
    np.testing.assert_array_equal(gained, x[rows] > 0.04 * 0.02 / 0.38)
    assert gained.any()
    assert not gained.all()


def test_a_shorter_baseline_shortens_the_sensor_shadow_of_a_wall() -> None:
    """With the sensor behind the wall, the source side is in its shadow; half the baseline halves the shadow."""
    x = -np.linspace(0.0005, 0.03, 400)
    targets, part = _on_plate(x), _caster(_PLATE, _WALL)
    limits = {"range_mm": (50, 900), "grazing_max_deg": 90}
    views = _down(-0.03, 0.2)
    wide, narrow = LaserArea(**limits, baseline_mm=100), LaserArea(**limits, baseline_mm=65)
    found = _reasons(targets, views, wide, part)
    shaded = -x < 0.07 * 0.02 / 0.18  # the sensor is 70 mm beyond the wall
    np.testing.assert_array_equal(found.reason == Reason.SENSOR_SHADED_BY_PART, shaded)
    gained = PlanChange(ChangeKind.BASELINE, 0.35, "", "", views.T_object_scanner, narrow, (part, _FAR)).measures(
        targets, np.flatnonzero(shaded)
    )
    np.testing.assert_array_equal(gained, -x[shaded] > 0.035 * 0.02 / 0.18)
    assert gained.any()
    assert not gained.all()


def test_the_occluder_is_named() -> None:
    """A plate above the part is reported as the occluder, and without it the points are measured."""
    x = np.linspace(-0.02, 0.02, 81)
    targets, part = _on_plate(x), _caster(_PLATE)
    clamp = _caster(_rectangle([-0.01, -0.02, 0.05], [0.02, 0, 0], [0, 0.04, 0]))
    scanner, views = LaserArea(range_mm=(50, 900), baseline_mm=0), _down(0.0, 0.2)
    found = _reasons(targets, views, scanner, part, clamp)
    shaded = np.abs(x) < 0.01 * 0.2 / 0.15
    np.testing.assert_array_equal(found.reason == Reason.SOURCE_SHADED, shaded)
    casters = {"mast": _FAR, "clamp": clamp}
    names = why.occluders_of(targets, np.arange(len(x)), found, views, scanner, casters)
    assert {name for name, dark in zip(names, shaded, strict=True) if dark} == {"clamp"}
    assert {name for name, dark in zip(names, shaded, strict=True) if not dark} == {""}
    without = PlanChange(ChangeKind.FIXTURE, 0.0, "", "", views.T_object_scanner, scanner, (part, _FAR))
    assert without.measures(targets, np.flatnonzero(shaded)).all()


@pytest.mark.parametrize("angle_deg", [76.0, 80.0, 88.0])
def test_the_grazing_angle_is_exact_and_the_smallest_sufficient_limit_is_that_angle(angle_deg: float) -> None:
    """One candidate at a known angle has the grazing reason, its angle, and the first integer degree that suffices."""
    targets = _on_plate(np.array([0.0, 0.01]))  # lines of sight need an extent to end slightly above the plate
    outward = np.array([[np.sin(np.radians(angle_deg)), 0, np.cos(np.radians(angle_deg))]])
    views = aim_viewpoints(np.array([[0.0, 0.003, 0.0]]), outward, np.array([0]), [0.2], [0.0])
    rows, part = np.array([0]), _caster(_PLATE)
    found = why.diagnose(
        targets, rows, views, LaserArea(baseline_mm=0), (part, _FAR), np.array([Reason.NOT_SELECTED], np.uint8)
    )
    assert found.reason[0] == Reason.GRAZING_SOURCE
    np.testing.assert_allclose(np.degrees(found.grazing_source[0]), angle_deg, atol=1e-9)
    limits = np.arange(76, 90)
    gains = [
        PlanChange(
            ChangeKind.GRAZING, limit - 75, "", "", views.T_object_scanner,
            LaserArea(baseline_mm=0, grazing_max_deg=float(limit)), (part, _FAR),
        ).measures(targets, rows)[0]
        for limit in limits
    ]  # fmt: skip
    assert limits[int(np.argmax(gains))] == angle_deg
    selection = select_changes(np.array(gains, float), [ChangeKind.GRAZING] * len(limits), (limits - 75).tolist())
    assert [int(limits[i]) for i in selection] == [angle_deg]


def test_uncovered_points_without_any_candidate_are_refused() -> None:
    """Without a candidate no cause exists; without points nothing is asked."""
    none, part = _down(0.0, 0.2).pick(np.empty(0, dtype=np.int64)), _caster(_PLATE)
    targets, fails = _on_plate(np.array([0.0, 0.01])), np.empty(0, dtype=np.uint8)
    with pytest.raises(PlannerError, match="no candidate, so none of 2 uncovered points"):
        why.diagnose(targets, np.arange(2), none, LaserArea(), (part, _FAR), fails)
    found = why.diagnose(targets, np.empty(0, dtype=np.int64), none, LaserArea(), (part, _FAR), fails)
    assert len(found.reason) == len(found.distance) == 0


def test_the_verdict_of_the_robot_counts_only_if_the_scanner_would_measure() -> None:
    """A point that the scanner cannot measure has a reason of the scanner, not of the robot."""
    x = np.array([0.0, 0.04])
    scanner = LaserArea(range_mm=(50, 900), fov_deg=(10, 10), baseline_mm=0)
    for fails in (Reason.OUT_OF_REACH, Reason.JOINT_LIMIT, Reason.COLLISION, Reason.NO_PATH):
        found = _reasons(_on_plate(x), _down(0.0, 0.2), scanner, _caster(_PLATE), fails=fails)
        assert found.reason.tolist() == [fails, Reason.OUT_OF_FOV]


def test_the_range_is_missed_by_the_logarithm_of_the_distance() -> None:
    """The miss is the logarithm of distance over standoff: 500 of 450 mm is closer than 900."""
    T = np.concatenate([_down(0.0, height).T_object_scanner for height in (0.9, 0.5)])
    views = Viewpoints(T, np.zeros(2, np.int32), np.full(2, 0.3), np.zeros(2))
    found = _reasons(_on_plate(np.array([0.0, 0.01])), views, LaserArea(baseline_mm=0), _caster(_PLATE))
    assert found.reason.tolist() == [Reason.OUT_OF_RANGE] * 2
    assert found.pose.tolist() == [1, 1]
    np.testing.assert_allclose(found.distance[0], np.hypot(0.5, 0.003), atol=1e-12)


def test_new_views_are_aimed_at_the_point_at_the_tilt_and_the_standoff() -> None:
    """The axis of each view passes through its point; tilt, standoff and number of sides are as requested."""
    rng = np.random.default_rng(5)
    points, normals = rng.normal(size=(7, 3)), rng.normal(size=(7, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    tilt, standoff = np.radians(35.0), 0.25
    viewpoints = what_if.tilted_viewpoints(points, normals, tilt, 8, standoff, [0.0, np.pi / 2])
    assert len(viewpoints) == 7 * 8 * 2
    T = viewpoints.T_object_scanner[:, 0]
    point, normal = np.repeat(points, 16, axis=0), np.repeat(normals, 16, axis=0)
    np.testing.assert_allclose(T[:, :3, 3] + standoff * T[:, :3, 2], point, atol=1e-12)
    np.testing.assert_allclose(np.einsum("nj,nj->n", -T[:, :3, 2], normal), np.cos(tilt), atol=1e-12)
    assert len(np.unique(T[:16, :3, 2].round(9), axis=0)) == 8


def test_the_smaller_of_two_equally_good_changes_is_selected_first() -> None:
    """Among changes above 90 % of the largest gain, kind and then size decide. A gain below 1 % is not selected."""
    kinds = [ChangeKind.GRAZING, ChangeKind.STANDOFF, ChangeKind.STANDOFF, ChangeKind.FOV]
    assert select_changes(np.array([1.0, 0.92, 0.95, 0.005]), kinds, [3, 0.1, 0.2, 10]) == [1, 0]
    assert select_changes(np.array([1.0, 0.5, 0.6, 0.3]), kinds, [3, 0.1, 0.2, 10]) == [0, 2, 3]
    assert select_changes(np.array([0.009, 0.0, 0.0, 0.0]), kinds, [3, 0.1, 0.2, 10]) == []


def test_few_views_are_selected_greedily_until_nearly_all_rows_are_measured() -> None:
    """Views 2 and 0 measure all ten rows, so both are selected and no third."""
    pairs = np.array([[row, 2] for row in range(6)] + [[row, 0] for row in range(5, 10)] + [[0, 1], [9, 1]])
    assert what_if.select_views(pairs, 10) == [2, 0]
    assert what_if.select_views(np.empty((0, 2), np.int64), 4) == []


def test_a_candidate_needs_a_reason_beyond_the_scanner() -> None:
    """A reason of the scanner for a candidate is refused."""
    with pytest.raises(PlannerError, match="each value must be OUT_OF_REACH"):
        _reasons(_on_plate(np.array([0.0])), _down(0.0, 0.2), LaserArea(), _caster(_PLATE), fails=Reason.OUT_OF_FOV)


def test_the_middle_of_a_sweep_stays_with_another_standoff_and_roll() -> None:
    """A sweep of eight poses, rotating or straight, moves as one: the result is the sweep of the moved view."""
    from planner.viewpoints.viewpoints import straight_sweep_poses, sweep_viewpoints, turned_sweep_poses

    start = np.concatenate([_down(0.01, 0.2).T_object_scanner, _down(-0.02, 0.2, 0.3).T_object_scanner])
    views = Viewpoints(start, np.zeros(2, np.int32), np.full(2, 0.2), np.array([0.0, 0.3]))
    for poses in (straight_sweep_poses(0.1, 8), turned_sweep_poses(0.5, 8)):
        columns = sweep_viewpoints(views, poses)
        np.testing.assert_allclose(what_if.middle_poses(columns.T_object_scanner), start[:, 0], atol=1e-12)
        for change in (lambda v: what_if.with_standoff(v, 0.26), lambda v: what_if.with_roll(v, 1.1)):
            np.testing.assert_allclose(
                change(columns).T_object_scanner, sweep_viewpoints(change(views), poses).T_object_scanner, atol=1e-12
            )
