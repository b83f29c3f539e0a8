"""An indexed table: it turns only while the arm stands still, clear of everything that it turns at any angle.

`JointLimits.q_table_turn` asks for it. Every move is then one of the arm or one of the table, and where the table
moves, its whole range is certified free for the arm's posture: whoever turns the table need not know where to.
"""

from dataclasses import replace

import numpy as np

from planner.path.certified_edge import certify, quantise_inside
from planner.ports import ARM_AXES, CollisionChecker, JointLimits
from planner.values import Floats

STATIONARY = float(np.radians(0.011))
"""What an axis may move and count as still [rad]: an execution may begin 0.01 deg off a leg."""


def may_turn(q: Floats, checker: CollisionChecker, limits: JointLimits) -> tuple[bool, int]:
    """Whether the table may turn while the arm stands at q (axes,) [rad], whatever its own angle there; and the checks.

    True means that the arm's posture is certified free over all angles of the table.
    """
    ends = np.stack([q, q])
    ends[:, ARM_AXES:] = limits.lower[ARM_AXES:], limits.upper[ARM_AXES:]
    ends = quantise_inside(ends, limits)
    if not checker.free(ends).all():
        return False, len(ends)
    certified, checks = certify(ends[0], ends[1], checker)
    return certified, checks + len(ends)


def fix_table(limits: JointLimits, q: Floats) -> JointLimits:
    """Limits of the arm alone, the table staying as at q (axes,) [rad]."""
    lower, upper = (np.append(ends[:ARM_AXES], q[ARM_AXES:]) for ends in (limits.lower, limits.upper))
    return replace(limits, lower=lower, upper=upper, table_turn_q=None)


def table_turn(posture: Floats, q_from: Floats, q_to: Floats) -> Floats:
    """(2, axes) the arm at the posture of a configuration (axes,) while the table goes from q_from to q_to [rad]."""
    stops = np.stack([posture, posture])
    stops[:, ARM_AXES:] = q_from[ARM_AXES:], q_to[ARM_AXES:]
    return stops


def straight_path(q_from: Floats, q_to: Floats, clear_from: bool, clear_to: bool) -> Floats | None:
    """(m, axes) the way of straight moves that turns at a clear end, its ends included [rad]; None where none is clear.

    Args:
        q_from: (axes,) [rad].
        q_to: (axes,) [rad].
        clear_from: whether the table may turn at the first.
        clear_to: whether it may at the second.
    """
    if np.array_equal(q_from[ARM_AXES:], q_to[ARM_AXES:]):
        return np.stack([q_from, q_to])
    if not (clear_from or clear_to):
        return None
    stops = np.stack([q_from, *table_turn(q_from if clear_from else q_to, q_from, q_to), q_to])
    return stops[np.concatenate(([True], (np.diff(stops, axis=0) != 0).any(axis=1)))]


def find_violation(via: Floats, checker: CollisionChecker, limits: JointLimits) -> str:
    """What of a way moves the table otherwise; "" where nothing does, or nothing is asked.

    Args:
        via: (N, axes) via points [rad].
        checker: of the cell.
        limits: with or without `q_table_turn`.
    """
    if limits.table_turn_q is None:
        return ""
    moved = np.abs(np.diff(via, axis=0)) > STATIONARY
    for row in np.flatnonzero(moved[:, ARM_AXES:].any(axis=1)).tolist():
        if moved[row, :ARM_AXES].any():
            return f"moves arm and table at once on the way to via point {row + 1}"
        if not may_turn(via[row], checker, limits)[0]:
            return f"turns the table at via point {row}, where the arm does not stand clear of every angle"
    return ""
