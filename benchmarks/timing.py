"""Time of joint moves: pairs per second with and without jerk limits, and the error compared with ruckig.

Pairs are drawn in the KR 16's range with the limits of models/kr16.xml, and with limits whose ratios differ by axis,
which need three maxima over the axes instead of one.
"""

from dataclasses import replace
from time import process_time
from typing import Any

import numpy as np
import ruckig

from cell.robot import model as robot
from planner.ports import JointLimits
from planner.timing.limits import without_jerk_limit
from planner.timing.move_time import move_time
from planner.values import Floats

_REPEATS, _COMPARED = 5, 500


def run() -> list[dict[str, Any]]:
    """Return one row for each number of pairs and kind of limits."""
    limits = robot.limits(robot.load())
    uneven = replace(limits, jerk=limits.jerk * [1, 1, 1, 1, 1, 0.5])
    bound_limits = without_jerk_limit(limits)
    rng = np.random.default_rng(0)
    rows = []
    for n, m in ((1, 96), (100, 100), (1500, 1500)):
        a, b = (rng.uniform(limits.lower, limits.upper, (k, 6)) for k in (n, m))
        free = _best(lambda a=a, b=b: move_time(a[:, None], b, bound_limits))
        for name, law in (("one ratio", limits), ("ratios differ", uneven)):
            seconds = _best(lambda a=a, b=b, law=law: move_time(a[:, None], b, law))
            times, bound = move_time(a[:, None], b, law), move_time(a[:, None], b, without_jerk_limit(law))
            rows.append(
                {
                    "pairs": n * m,
                    "limits": name,
                    "million pairs/CPU s": n * m / seconds / 1e6,
                    "time / time without jerk": seconds / free,
                    "worst error against ruckig": _error(a, b, law),
                    "of": _COMPARED,
                    "moves / jerk-free bound": float((times / bound).mean()),
                }
            )
    return rows


def _best(work: Any) -> float:
    """Return the shortest processor time of a call [s]."""
    best = np.inf
    for _ in range(_REPEATS):
        begin, calls = process_time(), 0
        while process_time() - begin < 0.05:
            work()
            calls += 1
        best = min(best, (process_time() - begin) / calls)
    return best


def _error(a: Floats, b: Floats, limits: JointLimits) -> float:
    """Return the largest relative difference to ruckig's time along the straight segment; our margin is 1e-8.

    Ruckig's own synchronisation leaves the straight line if limits differ, so it gets the segment as one axis.
    """
    rng, worst = np.random.default_rng(1), 0.0
    for _ in range(_COMPARED):
        p, q = a[rng.integers(len(a))], b[rng.integers(len(b))]
        request, found = ruckig.InputParameter(1), ruckig.Trajectory(1)
        request.current_position, request.target_position = [0.0], [1.0]
        request.max_velocity = [float((limits.velocity / np.abs(q - p)).min())]
        request.max_acceleration = [float((limits.acceleration / np.abs(q - p)).min())]
        request.max_jerk = [float((limits.jerk / np.abs(q - p)).min())]
        ruckig.Ruckig(1).calculate(request, found)
        worst = max(worst, abs(float(move_time(p, q, limits)) / found.duration - 1.0))
    return worst
