"""Clearances of a motion: refusal of a motion in contact, and the tightest moment."""

import numpy as np
import pytest

from cell.plan.evaluation import require_no_contact
from cell.report.plan_report import tightest_moment
from cell.runs import schema
from cell.world.clearance import MotionClearance, TightestMoment, time_of_tightest
from planner.errors import PlannerError


def _measured(*proven: float) -> MotionClearance:
    names = tuple("housing with part" for _ in proven)
    return MotionClearance(np.array(proven) + 0.001, np.array(proven), names, None, 1)


def test_a_motion_that_is_not_proven_is_not_written() -> None:
    """A proven distance of zero is refused as contact. The message has the segment, counted from 1, and the pair."""
    require_no_contact(_measured(0.01, 1e-6))
    with pytest.raises(PlannerError, match=r"segment 2 of the motion is not proven .*housing with part, 1\.000 mm"):
        require_no_contact(_measured(0.01, 0.0))


def test_the_moment_is_found_between_the_samples_of_its_segment() -> None:
    """The time of the tightest moment is searched in its own segment, although other segments pass the same pose."""
    t = np.arange(7.0)
    q = np.zeros((7, 6))
    q[:, 0] = [0.0, 1.0, 0.0, 1.0, 2.0, 1.0, 0.0]
    segment = np.array([0, 0, 1, 1, 1, 2, 2])
    at = np.array([1.25, 0, 0, 0, 0, 0])
    assert time_of_tightest(
        t, q, segment, TightestMoment(1, at, 0.02, "housing with part", np.zeros((2, 3)))
    ) == pytest.approx(3.25)
    at = np.array([0.5, 0, 0, 0, 0, 0])
    assert time_of_tightest(
        t, q, segment, TightestMoment(2, at, 0.02, "housing with part", np.zeros((2, 3)))
    ) == pytest.approx(5.5)


def test_the_moment_of_a_segment_without_a_move_is_its_begin() -> None:
    """A view at home needs no move; a segment also contains the move from the last sample before it."""
    t, q = np.arange(4.0), np.zeros((4, 6))
    q[:, 0] = [0.0, 1.0, 2.0, 3.0]
    segment = np.array([0, 1, 1, 3])
    times = [
        time_of_tightest(t, q, segment, TightestMoment(number, at * np.eye(6)[0], 0.02, "", np.zeros((2, 3))))
        for number, at in ((0, 0.0), (1, 0.25), (2, 2.0), (3, 2.5))
    ]
    assert times == pytest.approx([0.0, 0.25, 2.0, 2.5])


def test_a_motion_that_is_far_from_everything_has_no_tightest_moment() -> None:
    """Without a tightest moment the text is empty."""
    segment = schema.SegmentClearance(minimum_mm=20.0, lower_bound_mm=19.0, between="housing with post")
    assert tightest_moment(schema.Clearance(collision="exact", segments=[segment], tightest=None)) == ""
    tightest = schema.Tightest(
        segment=1, time_s=3.2, distance_mm=12.345, between="housing with post",
        points_in_base_mm=np.zeros((2, 3)).tolist(), q_deg=np.zeros(6).tolist(),
    )  # fmt: skip
    output = tightest_moment(schema.Clearance(collision="exact", segments=[segment] * 3, tightest=tightest))
    assert output == "12.3 mm, housing with post, 3.20 s after the start, on segment 2 of 3"
