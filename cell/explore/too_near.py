"""Views that stand so near that the part, where nobody has looked yet, may begin before the scanner measures.

What is believed of a part goes on a little behind what was measured; the part itself may bulge out of that towards the
scanner, through space that nobody has seen free. A ray that meets it before the range gives no point, and views that
are planned for the same surface from as near give none either. So where a batch stood too near the next ones keep off:
a leg of a view is free only where what may be the part's lies no nearer than the range. Always asked for, that costs
small parts a third more views.
"""

from collections.abc import Sequence

import numpy as np

from cell.explore import belief
from cell.explore.prepare import Eye
from cell.world.embree import EmbreeRayCaster
from planner.explore.gain import N_LATEST_BATCHES
from planner.explore.space import VoxelSpace
from planner.geometry.sampling import SurfaceSamples
from planner.ports import Hits, RayCaster
from planner.values import Bools, Floats

_MOST = 0.5
"""Share of what a batch was to measure that the part may hide before the range, above which the next ones keep off."""


def too_near(
    samples: SurfaceSamples, sees: Bools, views: Sequence[tuple[Floats, Floats]], before: VoxelSpace, eye: Eye
) -> float:
    """What gave no point, of what views were to measure, as the part may begin before the range [m^2].

    Args:
        samples: N that they were to measure.
        sees: (N, views) which of them each was.
        views: of each the points (N, 3) [m] and the pose (4, 4) of the scanner [m].
        before: what was known before them.
        eye: of the scanner.
    """
    hidden, answered = np.zeros((2, len(samples)), dtype=np.bool_)
    for (points, T), its in zip(views, sees.T, strict=True):
        hidden |= its & ~before.is_ray_clear(eye.source_at(T), eye.towards(samples.points, T), eye.near)
        answered |= its & eye.answered(samples.points, points, T)
    return float(samples.areas[hidden & ~answered].sum())


def keep_off(batches: Sequence[tuple[float, float]]) -> bool:
    """Whether views keep off: one of the latest batches stood too near.

    Args:
        batches: of each what was too near (`too_near`), and what it was to measure [the same unit].
    """
    return any(near > _MOST * expected for near, expected in batches[-N_LATEST_BATCHES:])


class BeyondNear:
    """What blocks legs, and what may be the part's up to where a scanner begins to measure.

    Args:
        occluders: cast as they are; None: there are none.
        space: what is known, something hit [m].
        near: where the range begins [m].
    """

    def __init__(self, occluders: RayCaster | None, space: VoxelSpace, near: float) -> None:
        surface = belief.enclosing(space, space.maybe_part)
        self._occluders, self._near = occluders, near
        self._possible = EmbreeRayCaster(surface.vertices, surface.faces)

    def first_hit(self, origins: Floats, directions: Floats) -> Hits:
        """As the occluders'."""
        assert self._occluders is not None
        return self._occluders.first_hit(origins, directions)

    def blocked(self, origins: Floats, targets: Floats) -> Bools:
        """As `RayCaster.blocked`."""
        nothing = np.zeros(len(origins), dtype=np.bool_)
        found = nothing if self._occluders is None else np.array(self._occluders.blocked(origins, targets))
        left = np.flatnonzero(~found)
        legs = targets[left] - origins[left]
        share = np.minimum(self._near / np.maximum(np.linalg.norm(legs, axis=1, keepdims=True), 1e-12), 1.0)
        found[left] = self._possible.blocked(origins[left], origins[left] + share * legs)
        return found
