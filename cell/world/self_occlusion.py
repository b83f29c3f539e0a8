"""Views that their own arm shades: links, bracket and housing at the joint angles of the final plan as occluders.

Where the arm is depends on the joint solution, so it cannot be part of the matrix; only the views of a finished plan
are asked. What a view is needed for are the samples that no other view of the plan measures. A view that loses more of
them to its own arm than `SHADED_SHARE` is not kept as it is: other joint solutions are taken; where they all shade, the
samples that the best of them hides are taken out of the view's column, and the cover has to be solved again. The arm's
shapes are those that are checked for collision; they enclose the arm, so that it hides no more in reality. Object
frame, metres.
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
"""Share of what a view alone is needed for that its own arm may hide; more, and it is not kept as it is."""


_MARGIN = 0.001  # m, around the box of legs: rounding, and the lift of the points


class OcclusionUpdate(Enum):
    """What a look at the views of a plan changed."""

    CLEAR = "no view is shaded"
    OTHER_SOLUTIONS = "some views have fewer joint solutions now"
    LESS_MEASURED = "some views measure less now: the cover has to be solved again"


class SelfOcclusion:
    """The matrix and the joint solutions as the arm leaves them; they shrink with every look that finds shade.

    Attributes:
        M: the matrix without the samples that a view's own arm hides at every joint solution.
        reasons: for each view that lost samples, one sentence.
    """

    def __init__(
        self, M: Measurability, reached: Reach, candidates: Viewpoints, world: World, scanner: Scanner
    ) -> None:
        """Begin without any shade.

        Args:
            M: measurability with occluders applied; its views are at rest (K = 1).
            reached: joint solutions of the candidates.
            candidates: the columns of M.
            world: arm and placement.
            scanner: where source and sensor are.
        """
        self.M = M
        self.reasons: dict[int, str] = {}
        self._reached, self._candidates, self._world, self._scanner = reached, candidates, world, scanner
        self._left: dict[int, Floats] = {}
        self._targets = RayTargets.of(M.samples.points, M.samples.normals, M.samples.region)

    def configurations(self, view: int) -> Floats:
        """(m, axes) joint solutions of a candidate that are left [rad]."""
        return self._left.get(view, self._reached.configurations_of(view))

    def update(self, views: NDArray[np.int64], q: Floats) -> OcclusionUpdate:
        """Look for views that their own arm shades, and take out what does it.

        Args:
            views: (n,) candidates of a plan.
            q: (n, axes) their joint angles [rad].
        """
        columns = self.M.matrix().tocsc()
        areas = self.M.samples.areas
        seen = [columns.indices[columns.indptr[view] : columns.indptr[view + 1]].astype(np.int64) for view in views]
        free = [self._free(int(view), at, rows) for view, at, rows in zip(views, q, seen, strict=True)]
        if all(kept.all() for kept in free):
            return OcclusionUpdate.CLEAR
        keepers = np.zeros(len(areas), dtype=np.int64)  # views that still measure a sample with their arm in the way
        for rows, kept in zip(seen, free, strict=True):
            keepers[rows[kept]] += 1
        found = OcclusionUpdate.CLEAR
        for view, at, rows, kept in zip(views.tolist(), q, seen, free, strict=True):
            needed = rows[keepers[rows] == kept]  # by no other view: 1 if the view keeps the sample itself, else 0
            lost = rows[(keepers[rows] == 0) & ~kept]
            share = float(areas[lost].sum() / areas[needed].sum()) if len(needed) else 0.0
            if share <= MAX_OCCLUDED_SHARE:
                continue
            found = OcclusionUpdate.OTHER_SOLUTIONS if found is OcclusionUpdate.CLEAR else found
            if not self._other_solutions(view, needed):
                by = self._hidden_by(view, at, lost)
                self.reasons[view] = (
                    f"its own arm shades it: {', '.join(by)} {'hides' if len(by) == 1 else 'hide'} {100 * share:.1f} % "
                    "of what only this view measured, and every joint solution more than "
                    f"{100 * MAX_OCCLUDED_SHARE:g} %"
                )
                self._take_out(view, rows)
                found = OcclusionUpdate.LESS_MEASURED
        return found

    def occludes_no_more(self, view: int, q: Floats, others: Floats) -> Bools:
        """(n,) whether the arm at others (n, axes) hides nothing of a view that it shows at q (axes,) [rad]."""
        rows = np.asarray(self.M.matrix().tocsc()[:, [view]].indices, dtype=np.int64)
        hidden = ~self._free(view, q, rows)
        return np.array([(self._free(view, other, rows) | hidden).all() for other in others], dtype=np.bool_)

    def _other_solutions(self, view: int, needed: Ints) -> bool:
        """Keep the joint solutions that hide at most `SHADED_SHARE` of what is needed, if there are any."""
        areas, configurations = self.M.samples.areas[needed], self.configurations(view)
        hidden = np.array([areas[~self._free(view, q, needed)].sum() for q in configurations])
        good = hidden <= MAX_OCCLUDED_SHARE * areas.sum()
        if good.any():
            self._left[view] = configurations[good]
        return bool(good.any())

    def _take_out(self, view: int, rows: Ints) -> None:
        """Keep the joint solutions that hide least of a column, and take what they hide out of it."""
        configurations = self.configurations(view)
        free = [self._free(view, q, rows) for q in configurations]
        best = free[int(np.argmin([self.M.samples.areas[rows[~kept]].sum() for kept in free]))]
        self._left[view] = configurations[[bool(kept[best].all()) for kept in free]]
        self.M = _without(self.M, view, rows[~best])

    def _hidden_by(self, view: int, q: Floats, rows: Ints) -> tuple[str, ...]:
        """Names of the arm's shapes that hide any of the samples."""
        pieces = arm_occluders(self._world, q, _ends(self._scanner))
        pieces += occluders_beside_table(self._world)
        to_object = np.linalg.inv(self._world.T_base_part(q))
        hiding = [p.name for p in pieces if not self._past(view, make_caster([p], to_object), rows).all()]
        return tuple(dict.fromkeys(hiding))  # a link may have several shapes

    def _free(self, view: int, q: Floats, rows: Ints) -> NDArray[np.bool_]:
        """(n,) which samples the arm at (axes,) joint angles [rad] does not hide from a view."""
        arm = arm_caster(self._world, q, self._candidates.T_object_scanner[view, 0], self._scanner)
        return np.ones(len(rows), dtype=np.bool_) if arm is None else self._past(view, arm, rows)

    def _past(self, view: int, caster: RayCaster, rows: Ints) -> NDArray[np.bool_]:
        pose = np.zeros(len(rows), dtype=np.int64)
        poses = self._candidates.T_object_scanner[view, :1]
        return lines_of_sight_free(self._targets, poses, pose, rows, self._scanner, (caster,))


def arm_caster(world: World, q: Floats, T_object_scanner: Floats, scanner: Scanner) -> EmbreeRayCaster | None:
    """Casts on the arm, object frame; None where no leg of the view comes near any of it.

    Every leg lies in the box, along the scanner's axes, around source, sensor and part: where no triangle of the arm
    reaches into it, nothing has to be cast.

    Args:
        world: arm, part and placement.
        q: (axes,) joint angles [rad].
        T_object_scanner: (4, 4) pose of the view [m].
        scanner: where source and sensor are.
    """
    ends = _ends(scanner)
    R, t = T_object_scanner[:3, :3], T_object_scanner[:3, 3]
    legs = np.concatenate([ends, (world.part_hull.vertices - t) @ R])
    low, high = legs.min(axis=0) - _MARGIN, legs.max(axis=0) + _MARGIN
    T_base_part = world.T_base_part(q)
    to_scanner = np.linalg.inv(T_base_part @ T_object_scanner)
    near = []
    for piece in (*arm_occluders(world, q, ends), *occluders_beside_table(world)):
        corners = (piece.vertices @ to_scanner[:3, :3].T + to_scanner[:3, 3])[piece.faces]
        if ((corners.min(axis=1) <= high) & (corners.max(axis=1) >= low)).all(axis=1).any():
            near.append(piece)
    return make_caster(near, np.linalg.inv(T_base_part)) if near else None


def coverage_with_arm(
    prediction: Prediction, T_object_scanner: Floats, arms: Sequence[RayCaster | None], visible: Bools
) -> float:
    """Visible coverage of views (n, K, 4, 4) [m], each with its own arm as one more occluder; a fraction.

    `visible` (S,) says which samples they measure where no arm hides: no others are asked about.
    """
    covered = find_measured(
        T_object_scanner, prediction.samples, prediction.scanner, prediction.casters, own=arms, among=visible
    )
    areas = prediction.samples.areas
    return float(areas[covered].sum() / areas.sum())


def _without(M: Measurability, view: int, rows: Ints) -> Measurability:
    """M without some entries of one column."""
    hidden = np.zeros(M.shape[0], dtype=np.bool_)
    hidden[rows] = True
    kept = ~((M.indices == view) & np.repeat(hidden, np.diff(M.indptr)))
    before = np.concatenate([[0], np.cumsum(kept)])
    sigma = None if M.sigma is None else M.sigma[kept]
    return Measurability(before[M.indptr], M.indices[kept], M.samples, M.n_viewpoints, sigma)


def _ends(scanner: Scanner) -> Floats:
    return np.stack([scanner.source, scanner.sensor])
