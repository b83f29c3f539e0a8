"""Step 3: candidates by the scene's generator; `targeted` goes on until nothing more becomes coverable.

`targeted` begins with its base set, made before reach and measurability are asked, like the other generators'
candidates. `grow` then goes round: it takes a spread of the open features (those that no reachable candidate measures),
makes views of each over the whole family (`planner.viewpoints.targeted.aimed_at`), keeps those that measure their
feature past the part and the occluders and that the arm reaches, and appends the few that measure most of what is open.

It stops when every open feature has been aimed at, when a round makes nothing coverable, or after `ROUNDS` rounds. Each
round aims at `TARGETS` features at most, spread over the open surface, so a round in vain says that what is left lies
between surface that the whole family fails on. Nothing is random: equal inputs give equal candidates.
"""

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from cell.errors import SceneError
from cell.part.workpiece import Workpiece
from cell.scene.resolve import Settings
from cell.scene.scene import Scene
from planner.measurability.columns import join_measurability
from planner.measurability.matrix import Measurability
from planner.ports import Progress, RayCaster, Scanner
from planner.reach.reach import Reach, join_reach
from planner.surface.mesh import TriangleMesh
from planner.viewpoints import targeted
from planner.viewpoints.lines_of_sight import Targets
from planner.viewpoints.sphere import view_sphere
from planner.viewpoints.viewpoints import Viewpoints, join_viewpoints, pick_viewpoints
from planner.viewpoints.zone import optimal_scanning_zone

TARGETS = 96
"""Open features that are aimed at in one round."""

ROUNDS = 8
"""Rounds at most: with `TARGETS` the bound of the work."""

_LOOKS = 24  # reachable views of each feature that are compared by what else they measure
_DEPTH = 8  # views that a feature gets where it can: with one, the selection would have nothing to choose from


def first(scene: Scene, settings: Settings, part: Workpiece, planning: TriangleMesh) -> Viewpoints:
    """The generator's candidates; of `targeted`, the base set."""
    step_x, step_y = np.deg2rad(scene.plan.view_sphere_step_deg)
    if scene.plan.candidates == "view-sphere":
        return view_sphere(part.centre, settings.sphere_radius, step_x, step_y, settings.rolls)
    if scene.plan.candidates == "targeted":
        return targeted.base_set(
            planning, part.centre, settings.sphere_radius, (step_x, step_y), settings.standoffs, settings.rolls
        )
    return optimal_scanning_zone(planning, settings.standoffs, settings.rolls)


def grow(
    candidates: Viewpoints,
    reached: Reach,
    measurability: Measurability,
    *,
    standoff: float,
    scanner: Scanner,
    casters: Sequence[RayCaster],
    reach_of: Callable[[Viewpoints], Reach],
    measure: Callable[[Viewpoints], Measurability],
    progress: Progress | None = None,
) -> tuple[Viewpoints, Reach, Measurability]:
    """Append candidates until nothing more becomes coverable.

    Args:
        candidates: the base set, viewpoints of one pose.
        reached: its reach.
        measurability: its M, occluders applied.
        standoff: the default one [m].
        scanner: the sensor's law.
        casters: the part's and the occluders', object frame.
        reach_of: verdicts and joint solutions of viewpoints.
        measure: M of viewpoints with occluders applied, over the same features.
        progress: called with (open features aimed at, open features).

    Returns:
        All candidates, those that were there first, with their reach and their M.

    Raises:
        SceneError: if the viewpoints have several poses.
    """
    if candidates.T_object_scanner.shape[1] != 1:
        raise SceneError(
            "plan.candidates = 'targeted' aims single poses, and this scanner sweeps; choose "
            "'optimal-scanning-zone' or 'view-sphere'"
        )
    features = measurability.features
    targets = Targets.of(features.points, features.normals)
    within = targeted.limits(scanner, standoff)
    views_of, reaches, matrices = [candidates], [reached], [measurability]
    is_open = ~_measured_by(measurability, reached)
    untried = is_open.copy()
    for _ in range(ROUNDS):
        if not untried.any():
            break
        rows = np.flatnonzero(untried)
        rows = rows[targeted.spread(features.points[rows], features.normals[rows], TARGETS, standoff)]
        untried[rows] = False
        views = _reachable_views(rows, features.planning_face, targets, standoff, within, scanner, casters, reach_of)
        if not len(views):
            break
        still = np.flatnonzero(is_open)
        seen = targeted.measured_rows(views, targets, still, scanner, casters)
        views = pick_viewpoints(views, targeted.most_useful(seen, features.areas[still], _DEPTH))
        views_of.append(views)
        reaches.append(reach_of(views))
        matrices.append(measure(views))
        is_open &= ~_measured_by(matrices[-1], reaches[-1])
        untried &= is_open
        if progress is not None:
            progress(int((is_open & ~untried).sum()), int(is_open.sum()))
    return join_viewpoints(views_of), join_reach(reaches), join_measurability(matrices)


def _measured_by(M: Measurability, reached: Reach) -> NDArray[np.bool_]:
    """(S,) True where a reachable candidate measures the feature."""
    return np.asarray(M.matrix() @ reached.reachable.astype(np.int32) > 0)


def _reachable_views(
    rows: NDArray[np.int64],
    planning_face: NDArray[np.int32],
    targets: Targets,
    standoff: float,
    within: targeted.Limits,
    scanner: Scanner,
    casters: Sequence[RayCaster],
    reach_of: Callable[[Viewpoints], Reach],
) -> Viewpoints:
    """Up to `_LOOKS` views of each row that measure it and are reached, spread over the family."""
    views, owner = targeted.aimed_at(
        targets.points[:, rows].T, targets.normals[:, rows].T, planning_face[rows], standoff, within
    )
    which = np.flatnonzero(targeted.sees_its_point(views, targets, rows[owner], scanner, casters))
    which = which[reach_of(pick_viewpoints(views, which)).reachable]
    kept = [np.empty(0, dtype=np.int64)]
    for target in range(len(rows)):
        mine = which[owner[which] == target]
        kept.append(mine[np.unique(np.linspace(0, len(mine) - 1, min(_LOOKS, len(mine))).round().astype(np.int64))])
    return pick_viewpoints(views, np.concatenate(kept))
