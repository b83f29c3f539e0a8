"""What a plan says of its motion's clearance: per segment, and the tightest moment of all."""

import numpy as np

from cell.runs.schema import Clearance, SegmentClearance, Tightest
from cell.world.clearance import MotionClearance, time_of_tightest
from planner.errors import PlannerError
from planner.ports import ARM_AXES
from planner.timing.motion import Motion


def clearance_of(measured: MotionClearance, motion: Motion, collision: str) -> Clearance:
    """The clearance as plan.json and report.json say it.

    Args:
        measured: of the motion.
        motion: timed.
        collision: what stood for the part: hull or exact.
    """
    tightest = measured.tightest
    angles = [] if tightest is None else np.degrees(tightest.q).round(6).tolist()
    return Clearance(
        collision=collision,
        segments=[
            SegmentClearance(minimum_mm=_mm(nearest), at_least_mm=_mm(proven), between=between)
            for nearest, proven, between in zip(measured.distance, measured.lower_bound, measured.between, strict=True)
        ],
        tightest=None
        if tightest is None
        else Tightest(
            segment=tightest.segment,
            time_s=round(time_of_tightest(motion.t, motion.q, motion.segment_of_sample, tightest), 6),
            distance_mm=_mm(tightest.distance),
            between=tightest.between,
            points_in_base_mm=(1000 * tightest.points).round(4).tolist(),
            q_deg=angles[:ARM_AXES],
            e_deg=angles[ARM_AXES:] or None,
        ),
    )


def require_no_contact(measured: MotionClearance) -> None:
    """The last look at a motion before it is written; certified moves pass it, so what does not is a bug.

    Raises:
        PlannerError: if a segment is not proven to be free of contact.
    """
    for number, (proven, between) in enumerate(zip(measured.lower_bound, measured.between, strict=True), start=1):
        if proven <= 0:
            raise PlannerError(
                f"segment {number} of the motion is not proven to be free of contact ({between}, "
                f"{1000 * measured.distance[number - 1]:.3f} mm measured); every segment must be"
            )


def tightest_sentence(clearance: Clearance) -> str:
    """The tightest moment for a person; "" where there is none."""
    tightest = clearance.tightest
    if tightest is None:
        return ""
    return (
        f"{tightest.distance_mm:.1f} mm, {tightest.between}, {tightest.time_s:.2f} s after the start, on the "
        f"way of segment {tightest.segment + 1} of {len(clearance.segments)}"
    )


def _mm(metres: float) -> float:
    return round(1000 * float(metres), 4)
