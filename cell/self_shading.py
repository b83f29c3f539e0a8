"""Views that their own arm shades: links, bracket and housing at the joint angles of the final plan as occluders.

Where the arm is depends on the joint solution, so it cannot be part of the matrix; only the views of a finished plan
are asked. What a view is needed for are the samples that no other view of the plan measures. A view that loses more of
them to its own arm than `SHADED_SHARE` is not kept as it is: the caller takes another joint solution, or another view.
The arm's shapes are those that are checked for collision; they enclose the arm, so that it hides no more in reality.
Object frame, metres.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cell.embree import EmbreeRayCaster
from cell.occluders import Occluder, arm_triangles
from cell.prediction import Prediction
from cell.world import World
from planner.legs import Indices, Targets, flat_poses, in_view, legs_free
from planner.measurability import Measurability, measured
from planner.ports import Floats, RayCaster, Scanner
from planner.viewpoints import Viewpoints

SHADED_SHARE = 0.01
"""Share of what a view alone is needed for that its own arm may hide; more, and the view is replaced."""


@dataclass(frozen=True, slots=True, eq=False)
class OwnShade:
    """A view that its own arm shades.

    Attributes:
        stop: its number in visiting order, from 0.
        share: of the area that only this view measures, hidden by its arm.
        by: the shapes of the arm that hide some of it.
        needed: (n,) samples of the matrix that only this view measures.
    """

    stop: int
    share: float
    by: tuple[str, ...]
    needed: Indices
    _legs: _Legs

    @property
    def sentence(self) -> str:
        """Why the view was not kept."""
        return (
            f"its own arm shades it: {', '.join(self.by)} {'hides' if len(self.by) == 1 else 'hide'} "
            f"{100 * self.share:.1f} % of what only this view measures, at every joint solution more than "
            f"{100 * SHADED_SHARE:g} %"
        )

    def free_of_shade(self, configurations: Floats) -> Floats:
        """Those of (m, 6) joint solutions [rad] at which the arm hides at most `SHADED_SHARE` of what is needed."""
        areas = self._legs.M.features.areas[self.needed]
        kept = [
            float(areas[~self._legs.free(q, self.needed)].sum()) <= SHADED_SHARE * float(areas.sum())
            for q in configurations
        ]
        chosen: Floats = configurations[np.array(kept, dtype=np.bool_)]
        return chosen


def own_shade(
    M: Measurability,
    candidates: Viewpoints,
    stops: NDArray[np.int64],
    q: Floats,
    world: World,
    scanner: Scanner,
) -> tuple[OwnShade, ...]:
    """The views of a plan that their own arm shades.

    Args:
        M: the matrix that the plan was made on.
        candidates: its columns. A view of several poses is judged with the arm as it stands at the view's joint angles.
        stops: (n,) chosen candidates, in visiting order.
        q: (n, 6) their joint angles [rad].
        world: arm and placement.
        scanner: where source and sensor are.
    """
    columns = M.matrix().tocsc()
    targets = Targets.of(M.features.points, M.features.normals)
    legs = [_Legs(M, targets, candidates, int(view), world, scanner) for view in stops]
    seen = [columns.indices[columns.indptr[view] : columns.indptr[view + 1]].astype(np.int64) for view in stops]
    free = [leg.free(joints, rows) for leg, joints, rows in zip(legs, q, seen, strict=True)]
    if all(view.all() for view in free):
        return ()
    keepers = np.zeros(M.shape[0], dtype=np.int64)  # views that still measure a sample with their arm in the way
    for rows, kept in zip(seen, free, strict=True):
        keepers[rows[kept]] += 1
    found = []
    for stop, (leg, rows, kept) in enumerate(zip(legs, seen, free, strict=True)):
        needed = keepers[rows] == kept  # nobody else: 1 where the view keeps the sample itself, 0 where it loses it
        total = float(M.features.areas[rows[needed]].sum())
        lost = float(M.features.areas[rows[needed & ~kept]].sum())
        if total > 0 and lost > SHADED_SHARE * total:
            by = leg.hidden_by(q[stop], rows[needed & ~kept])
            found.append(OwnShade(stop, lost / total, by, rows[needed], leg))
    return tuple(found)


def arm_caster(world: World, q: Floats, scanner: Scanner) -> EmbreeRayCaster:
    """Casts on the arm at (6,) joint angles [rad], object frame."""
    return _caster(arm_triangles(world, q, _ends(scanner)), world)


def visible_with_arm(prediction: Prediction, T_object_scanner: Floats, arms: Sequence[RayCaster]) -> float:
    """Visible coverage of views (n, K, 4, 4) [m], each with its own arm as one more occluder; a fraction."""
    covered = measured(T_object_scanner, prediction.samples, prediction.scanner, prediction.casters, own=arms)
    areas = prediction.samples.areas
    return float(areas[covered].sum() / areas.sum())


@dataclass(frozen=True, slots=True, eq=False)
class _Legs:
    """The legs of one view."""

    M: Measurability
    targets: Targets
    candidates: Viewpoints
    view: int
    world: World
    scanner: Scanner

    def free(self, q: Floats, rows: Indices) -> NDArray[np.bool_]:
        """(n,) which of the samples that the view measures it still measures with its arm at (6,) angles [rad]."""
        return self._past(arm_caster(self.world, q, self.scanner), rows)

    def hidden_by(self, q: Floats, rows: Indices) -> tuple[str, ...]:
        """Names of the arm's shapes that hide any of the samples."""
        pieces = arm_triangles(self.world, q, _ends(self.scanner))
        return tuple(piece.name for piece in pieces if not self._past(_caster([piece], self.world), rows).all())

    def _past(self, arm: RayCaster, rows: Indices) -> NDArray[np.bool_]:
        poses = flat_poses(self.candidates.T_object_scanner[self.view][None])
        free = np.zeros(len(rows), dtype=np.bool_)
        for number in range(len(poses)):
            asked = np.flatnonzero(~free)
            if len(poses) > 1:  # the matrix does not say which pose measures a sample
                asked = asked[np.isin(rows[asked], in_view(self.targets, poses[number], self.scanner, rows[asked]))]
            pose = np.full(len(asked), number)
            free[asked] = legs_free(self.targets, poses, pose, rows[asked], self.scanner, (arm,))
        return free


def _ends(scanner: Scanner) -> Floats:
    return np.stack([scanner.source, scanner.sensor])


def _caster(pieces: Sequence[Occluder], world: World) -> EmbreeRayCaster:
    first = np.cumsum([0, *(len(piece.vertices) for piece in pieces)])
    faces = [piece.faces + start for piece, start in zip(pieces, first[:-1], strict=True)]
    to_object = np.linalg.inv(world.T_base_object)
    vertices = np.concatenate([piece.vertices for piece in pieces])
    return EmbreeRayCaster(vertices @ to_object[:3, :3].T + to_object[:3, 3], np.concatenate(faces).astype(np.int32))
