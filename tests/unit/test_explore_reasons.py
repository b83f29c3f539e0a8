"""Reasons for uncovered surface: sentences by area, and samples that are a remainder of measured surface."""

import numpy as np
import pytest

from cell.explore.belief import MISSED, NOT_SELECTED, REMAINDER, UncoveredReport, assign_causes, describe_cause
from cell.scanners.laser_area import LaserArea
from cell.world.embree import EmbreeRayCaster
from planner.explore.gain import OpenSamples
from planner.geometry.sampling import SurfaceSamples
from planner.kinematics.reach import Reach, Verdict
from planner.viewpoints.viewpoints import aim_viewpoints
from planner.why.why import Reason

_FAR = EmbreeRayCaster(np.array([[9.0, 0, 0], [9, 1, 0], [9, 0, 1]]), np.array([[0, 1, 2]], dtype=np.int32))


def _samples(count: int) -> SurfaceSamples:
    none = np.zeros(count, dtype=np.int32)
    points = np.column_stack([np.linspace(-0.002, 0.002, count), np.zeros(count), np.zeros(count)])
    return SurfaceSamples(points, np.tile([0.0, 0, 1], (count, 1)), 1e-6 * np.arange(1.0, count + 1), none, none)


_WALL = EmbreeRayCaster(
    np.array([[-9.0, -9, 0.05], [9, -9, 0.05], [0, 9, 0.05]]), np.array([[0, 1, 2]], dtype=np.int32)
)
_OF = OpenSamples(np.array([0, 0, 1, 1]), np.array([1.0, 9.0, 1.0, 9.0]), np.zeros(4, dtype=bool))


@pytest.mark.parametrize("verdict", [Verdict.REACHABLE, Verdict.OUT_OF_REACH])
def test_tried_samples_beside_measured_surface_are_remainders(verdict: Verdict) -> None:
    """A tried sample near measured surface is a remainder."""
    views = aim_viewpoints(np.zeros((1, 3)), np.array([[0.0, 0, 1]]), np.array([-1]), [0.1], [0.0])
    q = np.zeros((1 if verdict == Verdict.REACHABLE else 0, 6))
    reached = Reach(np.array([verdict], dtype=np.uint8), q, np.array([0, len(q)]), ("",))
    found = assign_causes(_samples(4), _OF, views, reached, LaserArea(range_mm=(50, 900), baseline_mm=0), (_FAR, _FAR))
    reached_codes = [NOT_SELECTED, NOT_SELECTED, REMAINDER, MISSED]
    others = [Reason.OUT_OF_REACH, Reason.OUT_OF_REACH, REMAINDER, Reason.OUT_OF_REACH]
    assert found.reason.tolist() == (reached_codes if verdict == Verdict.REACHABLE else others)


@pytest.mark.parametrize(
    ("casters", "near"), [((_FAR, _WALL), REMAINDER), ((_WALL, _FAR), Reason.SOURCE_SHADED_BY_PART)]
)
def test_tried_samples_shaded_by_the_support_are_remainders(
    casters: tuple[EmbreeRayCaster, EmbreeRayCaster], near: int
) -> None:
    """A tried sample near measured surface is a remainder even if the stand shades it."""
    views = aim_viewpoints(np.zeros((1, 3)), np.array([[0.0, 0, 1]]), np.array([-1]), [0.1], [0.0])
    reached = Reach(np.array([Verdict.REACHABLE], dtype=np.uint8), np.zeros((1, 6)), np.array([0, 1]), ("",))
    found = assign_causes(_samples(4), _OF, views, reached, LaserArea(range_mm=(50, 900), baseline_mm=0), casters)
    message = [describe_cause(code) for code in found.reason.tolist()]
    assert message == ["laser or sensor occluded"] * 2 + [describe_cause(near), "laser or sensor occluded"]


def test_grazing_samples_are_no_remainder() -> None:
    """A view from the side is reported as too grazing for tried and untried samples."""
    views = aim_viewpoints(
        np.zeros((1, 3)), np.array([[0.995, 0, np.sqrt(1 - 0.995**2)]]), np.array([-1]), [0.1], [0.0]
    )
    reached = Reach(np.array([Verdict.REACHABLE], dtype=np.uint8), np.zeros((1, 6)), np.array([0, 1]), ("",))
    scanner = LaserArea(range_mm=(50, 900), baseline_mm=0, fov_deg=(60, 60))
    found = assign_causes(_samples(4), _OF, views, reached, scanner, (_FAR, _FAR))
    assert found.reason.tolist() == [Reason.GRAZING_SOURCE] * 4


def test_equal_sentences_are_reported_once() -> None:
    """Areas [mm2] of reasons with the same sentence are added. The largest area comes first."""
    codes = np.array([Reason.SOURCE_SHADED_BY_PART, NOT_SELECTED, Reason.SENSOR_SHADED, MISSED])
    views = aim_viewpoints(np.zeros((1, 3)), np.array([[0.0, 0, 1]]), np.array([-1]), [0.1], [0.0])
    message = UncoveredReport(_samples(4), codes, views).by_area()
    assert [(each.cause, each.area_mm2) for each in message] == [
        (describe_cause(Reason.SENSOR_SHADED), 4.0), (describe_cause(MISSED), 4.0), (describe_cause(NOT_SELECTED), 2.0)
    ]  # fmt: skip
