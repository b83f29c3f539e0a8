"""The motion of a finished run, taken up again as it is: for an edit after which the views are the same."""

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from cell.run.planned import PlannedRun
from planner.order.tour import Tour, TourStatus
from planner.timing.motion import Motion
from planner.values import Floats, Ints

_SAME = 1e-9  # rad; set-points are multiples of 1e-4 deg


def known_motion(run: PlannedRun) -> Callable[[Ints, Sequence[Floats]], Tour | None]:
    """Gives the run's motion for its own views at their joint solutions, and None for others (`Request.known`)."""

    def known(views: Ints, configurations: Sequence[Floats]) -> Tour | None:
        if sorted(views.tolist()) != sorted(run.candidate.tolist()):
            return None
        index = {int(view): k for k, view in enumerate(views)}
        order = np.array([index[candidate] for candidate in run.candidate.tolist()], dtype=np.int64)
        found = [_entered(run.motion, stop, configurations[view]) for stop, view in enumerate(order)]
        entered = [row for row, _ in found if row >= 0]
        if len(entered) < len(order):
            return None
        return _tour(run, index, order, np.array(entered), np.array([choice for _, choice in found]))

    return known


def _entered(motion: Motion, leg: int, configurations: Floats) -> tuple[int, int]:
    """Via point of a leg at which its view is entered, and which of its joint solutions that is; -1 where none is."""
    rows = np.flatnonzero(motion.segment == leg)
    apart = np.abs(motion.via_q[rows][:, None] - configurations[None]).max(axis=2, initial=0.0)
    at = np.argwhere(apart <= _SAME)
    return (int(rows[at[0][0]]), int(at[0][1])) if len(at) else (-1, -1)


def _tour(run: PlannedRun, index: Mapping[int, int], order: Ints, entered: Ints, choice: Ints) -> Tour:
    motion, said, legs = run.motion, run.report.motion, len(order) + 1
    last = np.flatnonzero(np.diff(motion.segment, append=legs))  # via point at which each leg ends
    arrives = np.append(entered, len(motion.via_q) - 1)
    left = np.concatenate(([0], last[: legs - 1]))
    return Tour(
        order=order,
        choice=choice,
        q=motion.via_q[motion.stops],
        via=motion.via_q,
        segment=motion.segment,
        view=np.array([index.get(view, -1) for view in motion.view.tolist()]),
        pose=motion.pose,
        entered=entered,
        detour=arrives - left > 1,
        duration=motion.duration,
        baseline_duration=said.baseline_duration_s,
        lower_bound=said.lower_bound_s,
        dropped=(),
        status=TourStatus.COMPLETE,
        home_blocker="",
        rounds=0,
    )
