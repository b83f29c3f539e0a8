"""Views of several set-ups moved so that fewer do (`planner.viewpoints.refinement`): each before the arm of its set-up.

As in one plan (`cell.plan.refined`): what each view is needed for is what no other of any set-up measures.
"""

from collections.abc import Mapping

import numpy as np

from cell.plan.candidates import GROWN
from cell.plan.refined import BEYOND
from cell.plan.steps import PlanSession
from cell.setups.measured import Setup
from cell.world.measurability import PartSurface
from planner.measurability.matrix import Measurability
from planner.values import Floats, Ints
from planner.viewpoints.lines_of_sight import RayTargets
from planner.viewpoints.refinement import ViewState, reduce_views
from planner.viewpoints.viewpoints import viewpoints_from_poses


def movable(setups: Mapping[int, Setup]) -> bool:
    """Whether views may be moved: at rest, and grown for what is open."""
    return all(
        setup.job.scene.plan.candidates == GROWN and setup.measured.candidates.T_object_scanner.shape[1] == 1
        for setup in setups.values()
    )


def with_fewer(
    session: PlanSession,
    surface: PartSurface,
    setups: Mapping[int, Setup],
    M: Mapping[int, Measurability],
    views: Mapping[int, Ints],
    goal: float,
) -> tuple[dict[int, Setup], dict[int, Measurability], dict[int, Ints]]:
    """The set-ups, matrices and views with moved views behind the candidates; what was given where none can be spared.

    Args:
        session: of the open run.
        surface: the part.
        setups: all possible ones.
        M: their matrices, over the same rows.
        views: of the set-ups that are used, the chosen candidates.
        goal: area of rows that they measure [m^2].
    """
    used = list(views)
    setup_of = np.repeat(used, [len(views[row]) for row in used])
    chosen = np.concatenate([views[row] for row in used])
    first = M[used[0]].samples
    can = np.logical_or.reduce([np.diff(each.indptr) > 0 for each in M.values()])
    areas = np.where(can, first.areas, 0.0)
    candidates = {row: setups[row].measured.candidates for row in used}
    before = ViewState(
        np.concatenate([candidates[row].T_object_scanner[views[row], 0] for row in used]),
        np.concatenate([candidates[row].standoff[views[row]] for row in used]),
        np.arange(len(chosen)),
        np.zeros(len(chosen), dtype=np.bool_),
        np.hstack([M[row].matrix().tocsc()[:, views[row]].toarray() for row in used]),
    )
    coverable = np.logical_or.reduce([setup.coverable for setup in setups.values()])

    def seen(T_object_scanner: Floats, origin: Ints) -> float:
        poses = {row: T_object_scanner[setup_of[origin] == row][:, None] for row in used}
        found = np.logical_or.reduce([setups[row].visible(T) for row, T in poses.items() if len(T)])
        return float(found.sum() / (coverable | found).sum())

    asked = setups[used[0]].job.scene.plan.coverage
    least = max(min(asked + BEYOND, 1.0), seen(before.T_object_scanner, before.origin))
    arms = {row: setups[row].arm(first) for row in used}
    after = reduce_views(
        before, RayTargets.of(first.points, first.normals), areas, lambda view: arms[int(setup_of[view])],
        goal=min(goal, float(areas[before.measured.any(axis=1)].sum())),
        shortfall=lambda standing: least - seen(standing.T_object_scanner, standing.origin),
    )  # fmt: skip
    known, matrices, left = dict(setups), dict(M), {row: np.array(columns) for row, columns in views.items()}
    if len(after) == len(before):
        return known, matrices, left
    for row in used:
        own = setup_of[after.origin] == row
        moved = own & after.moved
        stays = chosen[after.origin[own & ~after.moved]]
        more = len(candidates[row]) + np.arange(int(moved.sum()))
        if moved.any():
            T = after.T_object_scanner[moved]
            aim = T[:, :3, 3] + after.distance[moved, None] * T[:, :3, 2]
            face = candidates[row].face[chosen[after.origin[moved]]]
            known[row], matrices[row] = setups[row].with_views(
                session, surface, M[row], viewpoints_from_poses(T, aim, face)
            )
        left[row] = np.concatenate([stays, more]).astype(np.int64)
    return known, matrices, {row: columns for row, columns in left.items() if len(columns)}
