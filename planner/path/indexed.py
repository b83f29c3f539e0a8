"""Moves with an indexed table, which turns only while the arm is at rest and clear of the table at any angle.

`JointLimits.table_turn_q` requires it. Each move is then one of the arm or one of the table. Wherever the table moves,
its full range is certified free for the configuration of the arm, so an operator may turn it by any angle.
"""

from dataclasses import replace

import numpy as np

from planner.path.certified_edge import certify, quantise_inside
from planner.ports import ARM_AXES, CollisionChecker, JointLimits
from planner.values import Floats

STATIONARY = float(np.radians(0.011))
"""Largest motion of an axis that counts as still [rad]: an execution may begin 0.01 deg off a segment."""


def may_turn(q: Floats, checker: CollisionChecker, limits: JointLimits) -> tuple[bool, int]:
    """Return whether the table may turn while the arm is at q (axes,) [rad], and the checks.

    True means that the arm is certified free over all angles of the table; the table's angle in q does not matter.
    """
    ends = np.stack([q, q])
    ends[:, ARM_AXES:] = limits.lower[ARM_AXES:], limits.upper[ARM_AXES:]
    ends = quantise_inside(ends, limits)
    if not checker.free(ends).all():
        return False, len(ends)
    certified, checks = certify(ends[0], ends[1], checker)
    return certified, checks + len(ends)


def fix_table(limits: JointLimits, q: Floats) -> JointLimits:
    """Return the limits with the table fixed at its angle in q (axes,) [rad]."""
    lower, upper = (np.append(ends[:ARM_AXES], q[ARM_AXES:]) for ends in (limits.lower, limits.upper))
    return replace(limits, lower=lower, upper=upper, table_turn_q=None)


def table_turn(posture: Floats, q_from: Floats, q_to: Floats) -> Floats:
    """Return (2, axes) the move of the table from its angle in q_from to that in q_to, with the arm as in `posture`."""
    stops = np.stack([posture, posture])
    stops[:, ARM_AXES:] = q_from[ARM_AXES:], q_to[ARM_AXES:]
    return stops


def straight_path(q_from: Floats, q_to: Floats, may_turn_from: bool, may_turn_to: bool) -> Floats | None:
    """Return (m, axes) straight moves [rad] with a table turn at one of the ends, or None if it may turn at neither."""
    if np.array_equal(q_from[ARM_AXES:], q_to[ARM_AXES:]):
        return np.stack([q_from, q_to])
    if not (may_turn_from or may_turn_to):
        return None
    stops = np.stack([q_from, *table_turn(q_from if may_turn_from else q_to, q_from, q_to), q_to])
    return stops[np.concatenate(([True], (np.diff(stops, axis=0) != 0).any(axis=1)))]


def find_violation(via: Floats, checker: CollisionChecker, limits: JointLimits) -> str:
    """Return how a path (N, axes) [rad] breaks the rule of an indexed table, or "" if it does not."""
    if limits.table_turn_q is None:
        return ""
    moved = np.abs(np.diff(via, axis=0)) > STATIONARY
    for row in np.flatnonzero(moved[:, ARM_AXES:].any(axis=1)).tolist():
        if moved[row, :ARM_AXES].any():
            return f"moves arm and table at once before via point {row + 1}"
        if not may_turn(via[row], checker, limits)[0]:
            return f"turns the table at via point {row}, where the arm is not clear of it at every angle"
    return ""
