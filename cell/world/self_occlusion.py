"""Self-occlusion: links, bracket and housing that hide samples from the scanner at the joint angles of a plan.

The position of the arm depends on the joint configuration of a view, so it cannot be part of the matrix; only the views
of a finished plan are checked. A view is needed for the samples that no other view of the plan measures. If the arm
hides more than `MAX_OCCLUDED_SHARE` of them, other configurations are used. If all of them hide more, the samples that
the best one hides are removed from the view's column, and the cover has to be solved again. The arm's shapes are those
of the collision check; they enclose the arm, so that in reality it hides no more. Object frame, metres.
"""

from __future__ import annotations

from collections.abc import Sequence
from enum import Enum

import numpy as np
from numpy.typing import NDArray

from cell.world.embree import EmbreeRayCaster
from cell.world.model import World
from cell.world.occluders import arm_occluders, make_caster, occluders_beside_table
from cell.world.prediction import Prediction
from planner.kinematics.reach import Reach
from planner.measurability.matrix import Measurability
from planner.measurability.visibility import find_measured
from planner.ports import RayCaster, Scanner
from planner.values import Bools, Floats, Ints
from planner.viewpoints.lines_of_sight import RayTargets, lines_of_sight_free
from planner.viewpoints.viewpoints import Viewpoints

MAX_OCCLUDED_SHARE = 0.01
"""Largest share of the samples that only one view measures which its own arm may hide."""

_MARGIN = 0.001  # m, around the box of the rays: rounding, and the lift of the samples


class OcclusionUpdate(Enum):
    """Result of a check of the views of a plan."""

    CLEAR = "no view is occluded by the arm"
    OTHER_CONFIGURATIONS = "some views have fewer joint configurations now"
    LESS_MEASURED = "some views measure less now: the cover has to be solved again"


class SelfOcclusion:
    """The matrix and the joint configurations without self-occlusion; both shrink with every check that finds some.

    Attributes:
        M: the matrix without the samples that the arm hides at every configuration of a view.
        reasons: a sentence for each view that lost samples.
    """

    def __init__(
        self, M: Measurability, reached: Reach, candidates: Viewpoints, world: World, scanner: Scanner
    ) -> None:
        """Begin with all configurations.

        Args:
            M: measurability with occluders applied, of views at rest (K = 1).
            reached: joint configurations of the candidates.
            candidates: the columns of M.
            world: arm and placement.
            scanner: has the positions of source and sensor.
        """
        self.M = M
        self.reasons: dict[int, str] = {}
        self._reached, self._candidates, self._world, self._scanner = reached, candidates, world, scanner
        self._left: dict[int, Floats] = {}
        self._targets = RayTargets.of(M.samples.points, M.samples.normals, M.samples.region)

    def configurations(self, view: int) -> Floats:
        """Return the remaining joint configurations (m, axes) of a candidate [rad]."""
        return self._left.get(view, self._reached.configurations_of(view))

    def update(self, views: NDArray[np.int64], q: Floats) -> OcclusionUpdate:
        """Check the views of a plan, and remove configurations or samples of those that their arm occludes.

        Args:
            views: (n,) candidates of a plan.
            q: (n, axes) their joint angles [rad].
        """
        columns = self.M.matrix().tocsc()
        areas = self.M.samples.areas
        seen = [columns.indices[columns.indptr[view] : columns.indptr[view + 1]].astype(np.int64) for view in views]
        visible = [self._visible(int(view), at, rows) for view, at, rows in zip(views, q, seen, strict=True)]
        if all(each.all() for each in visible):
            return OcclusionUpdate.CLEAR
        multiplicity = np.zeros(len(areas), dtype=np.int64)  # views that measure a sample in spite of their arm
        for rows, is_visible in zip(seen, visible, strict=True):
            multiplicity[rows[is_visible]] += 1
        result = OcclusionUpdate.CLEAR
        for view, at, rows, is_visible in zip(views.tolist(), q, seen, visible, strict=True):
            needed = rows[multiplicity[rows] == is_visible]  # by no other view: 1 if this one measures it, else 0
            lost_rows = rows[(multiplicity[rows] == 0) & ~is_visible]
            share = float(areas[lost_rows].sum() / areas[needed].sum()) if len(needed) else 0.0
            if share <= MAX_OCCLUDED_SHARE:
                continue
            result = OcclusionUpdate.OTHER_CONFIGURATIONS if result is OcclusionUpdate.CLEAR else result
            if not self._restrict_configurations(view, needed):
                names = self._occluding_shapes(view, at, lost_rows)
                self.reasons[view] = (
                    f"occluded by its own arm: {', '.join(names)} {'hides' if len(names) == 1 else 'hide'} "
                    f"{100 * share:.1f} % of the surface that only this view measured, and every joint configuration "
                    f"hides more than {100 * MAX_OCCLUDED_SHARE:g} %"
                )
                self._remove_occluded(view, rows)
                result = OcclusionUpdate.LESS_MEASURED
        return result

    def occludes_no_more(self, view: int, q: Floats, alternatives: Floats) -> Bools:
        """Return (n,) whether the arm at (n, axes) alternatives hides only what it hides at q (axes,) too [rad]."""
        rows = np.asarray(self.M.matrix().tocsc()[:, [view]].indices, dtype=np.int64)
        hidden = ~self._visible(view, q, rows)
        return np.array([(self._visible(view, other, rows) | hidden).all() for other in alternatives], dtype=np.bool_)

    def _restrict_configurations(self, view: int, needed: Ints) -> bool:
        """Keep the configurations that hide at most `MAX_OCCLUDED_SHARE` of the needed samples, if there are any."""
        areas, configurations = self.M.samples.areas[needed], self.configurations(view)
        hidden = np.array([areas[~self._visible(view, q, needed)].sum() for q in configurations])
        good = hidden <= MAX_OCCLUDED_SHARE * areas.sum()
        if good.any():
            self._left[view] = configurations[good]
        return bool(good.any())

    def _remove_occluded(self, view: int, rows: Ints) -> None:
        """Keep the configurations that hide least of a column, and remove the samples that they hide from it."""
        configurations = self.configurations(view)
        visible = [self._visible(view, q, rows) for q in configurations]
        best = visible[int(np.argmin([self.M.samples.areas[rows[~each]].sum() for each in visible]))]
        self._left[view] = configurations[[bool(each[best].all()) for each in visible]]
        self.M = _without(self.M, view, rows[~best])

    def _occluding_shapes(self, view: int, q: Floats, rows: Ints) -> tuple[str, ...]:
        """Return the names of the shapes that hide any of the samples."""
        pieces = (*arm_occluders(self._world, q, _ends(self._scanner)), *occluders_beside_table(self._world))
        to_object = np.linalg.inv(self._world.T_base_part(q))
        names = [p.name for p in pieces if not self._unblocked(view, make_caster([p], to_object), rows).all()]
        return tuple(dict.fromkeys(names))  # a link may have several shapes

    def _visible(self, view: int, q: Floats, rows: Ints) -> NDArray[np.bool_]:
        """Return which samples (n,) the arm at joint angles (axes,) [rad] does not hide from a view."""
        arm = arm_caster(self._world, q, self._candidates.T_object_scanner[view, 0], self._scanner)
        return np.ones(len(rows), dtype=np.bool_) if arm is None else self._unblocked(view, arm, rows)

    def _unblocked(self, view: int, caster: RayCaster, rows: Ints) -> NDArray[np.bool_]:
        pose = np.zeros(len(rows), dtype=np.int64)
        poses = self._candidates.T_object_scanner[view, :1]
        return lines_of_sight_free(self._targets, poses, pose, rows, self._scanner, (caster,))


def arm_caster(world: World, q: Floats, T_object_scanner: Floats, scanner: Scanner) -> EmbreeRayCaster | None:
    """Create a ray caster on the arm, object frame; None if no ray of the view comes near it.

    Every ray lies in the box, along the scanner's axes, around source, sensor and part. If no triangle of the arm
    reaches into this box, no ray has to be cast.

    Args:
        world: arm, part and placement.
        q: (axes,) joint angles [rad].
        T_object_scanner: (4, 4) pose of the view [m].
        scanner: has the positions of source and sensor.
    """
    ends = _ends(scanner)
    R, t = T_object_scanner[:3, :3], T_object_scanner[:3, 3]
    box = np.concatenate([ends, (world.part_hull.vertices - t) @ R])
    low, high = box.min(axis=0) - _MARGIN, box.max(axis=0) + _MARGIN
    T_base_part = world.T_base_part(q)
    to_scanner = np.linalg.inv(T_base_part @ T_object_scanner)
    near = []
    for piece in (*arm_occluders(world, q, ends), *occluders_beside_table(world)):
        points = piece.vertices @ to_scanner[:3, :3].T + to_scanner[:3, 3]
        if (points.min(axis=0) > high).any() or (points.max(axis=0) < low).any():
            continue
        corners = points[piece.faces]
        if ((corners.min(axis=1) <= high) & (corners.max(axis=1) >= low)).all(axis=1).any():
            near.append(piece)
    return make_caster(near, np.linalg.inv(T_base_part)) if near else None


def coverage_with_arm(
    prediction: Prediction, T_object_scanner: Floats, arms: Sequence[RayCaster | None], visible: Bools
) -> float:
    """Compute the visible coverage of views (n, K, 4, 4) [m], each with its own arm as a further occluder; a fraction.

    `visible` (S,) are the samples that they measure without their arm; no others are tested.
    """
    covered = find_measured(
        T_object_scanner, prediction.samples, prediction.scanner, prediction.casters, own_occluders=arms, among=visible
    )
    areas = prediction.samples.areas
    return float(areas[covered].sum() / areas.sum())


def _without(M: Measurability, view: int, rows: Ints) -> Measurability:
    """Return M without some entries of one column."""
    hidden = np.zeros(M.shape[0], dtype=np.bool_)
    hidden[rows] = True
    return M.with_entries(~((M.indices == view) & np.repeat(hidden, np.diff(M.indptr))))


def _ends(scanner: Scanner) -> Floats:
    return np.stack([scanner.source, scanner.sensor])
