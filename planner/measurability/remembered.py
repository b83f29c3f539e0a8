"""Which samples a set of views measures, asked again and again of sets that differ by a few views.

A view is asked about a sample once: only where no other view of the set is known to measure it, and only while that is
not known of the view itself. The answer is that of `planner.measurability.matrix.measured`.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from planner.ports import RayCaster, Scanner
from planner.surface.sample import SurfaceSamples
from planner.values import Bools, Floats, Ints
from planner.viewpoints.lines_of_sight import Targets, flat_poses, free_pairs, in_view

_VIEWS = 256  # that are remembered, those asked about last: 25 MB at 10^5 samples
_BUNDLE = 40_000  # pairs between two looks at which samples are still open
_UNKNOWN, _MISSED, _SEEN = 0, 1, 2


class Remembered:
    """What is known so far of views and samples.

    Args:
        samples: S points, object frame, on the part's triangles.
        scanner: the sensor's law.
        casters: the part's caster and those of occluders.
    """

    def __init__(self, samples: SurfaceSamples, scanner: Scanner, casters: Sequence[RayCaster]) -> None:
        self._targets = Targets.of(samples.points, samples.normals, samples.region)
        self._scanner, self._casters = scanner, casters
        self._known: dict[bytes, NDArray[np.uint8]] = {}

    def measured(self, T_object_scanner: Floats) -> Bools:
        """(S,) samples that any of the views (n, K, 4, 4) [m] measures."""
        poses, K = flat_poses(T_object_scanner), np.shape(T_object_scanner)[1]
        known = [self._of(view) for view in poses.reshape(-1, K, 4, 4)]
        found = np.zeros(len(self._targets), dtype=np.bool_)
        for view in known:
            found |= view == _SEEN

        def rows_of(pose: int) -> Ints:
            view = known[pose // K]
            if pose % K == 0:
                asked[:] = ~found & (view == _UNKNOWN)
                view[asked] = _MISSED
            return in_view(self._targets, poses[pose], self._scanner, np.flatnonzero(asked & (view == _MISSED)))

        asked = np.zeros_like(found)
        for _, pose, row in free_pairs(poses, self._targets, self._scanner, self._casters, rows_of, _BUNDLE):
            found[row] = True
            for number in np.unique(pose // K):
                known[number][row[pose // K == number]] = _SEEN
        return found

    def _of(self, view: Floats) -> NDArray[np.uint8]:
        """(S,) what is known of a view (K, 4, 4)."""
        name = view.tobytes()
        known = self._known.pop(name, None)
        self._known[name] = np.zeros(len(self._targets), dtype=np.uint8) if known is None else known
        if len(self._known) > _VIEWS:
            del self._known[next(iter(self._known))]
        return self._known[name]
