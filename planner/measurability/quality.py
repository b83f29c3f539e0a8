"""How good a measured point will be: a layer of expected standard deviations over the measurability matrix.

The layer has one value for every entry of M, in the same sparse order; a limit turns it into a binary matrix again.
The scanner knows the law (`SigmaScanner.sigma`); docs/internals/sigma_model.md derives that of the built-in scanners.
`Limited` is a scanner that keeps the limit itself, for predictions, which ask for conditions, not for a matrix.
Object frame, metres.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from planner.errors import PlannerError
from planner.geometry.sampling import SurfaceSamples
from planner.measurability.matrix import Measurability
from planner.ports import RayCaster, Rejection, Scanner, SigmaScanner
from planner.values import Bools, Floats, Ints32
from planner.viewpoints.lines_of_sight import RayTargets, flatten_poses, in_view, lines_of_sight_free
from planner.viewpoints.viewpoints import Viewpoints

_Law = Callable[[Floats, Floats], Floats]  # (N,) of (N, 3) points [m] and normals, scanner frame


@dataclass(frozen=True, slots=True)
class QualityLimits:
    """What a point must be to count; inf where nothing is asked.

    Attributes:
        sigma: expected standard deviation at most [m], above 0.
        spacing: distance of neighbouring points of the scan at most [m], above 0.
    """

    sigma: float = np.inf
    spacing: float = np.inf

    def __post_init__(self) -> None:
        if not self.sigma > 0:
            raise PlannerError(f"the limit on sigma is {self.sigma} m; it must be above 0")
        if not self.spacing > 0:
            raise PlannerError(f"the limit on spacing is {self.spacing} m; it must be above 0")


@dataclass(frozen=True, slots=True, eq=False)
class LimitedScanner:
    """A scanner that refuses points that are worse than a limit, the limit itself allowed.

    Attributes:
        scanner: the law without the limits.
        max_sigma: largest expected standard deviation anywhere [m], above 0; inf: not limited.
        regions: limits of the part's regions on top, by their numbers; a point of unknown region has none of them.
    """

    scanner: SigmaScanner
    max_sigma: float = np.inf
    regions: tuple[QualityLimits, ...] = ()

    def __post_init__(self) -> None:
        every = (QualityLimits(self.max_sigma), *self.regions)
        for what in ("sigma", "spacing"):
            if min(getattr(each, what) for each in every) < np.inf and not callable(getattr(self.scanner, what, None)):
                raise PlannerError(
                    f"the scanner {type(self.scanner).__name__} does not know its {what}, so no limit can be put on "
                    "it; choose one that does, or leave the limit out"
                )

    def __getattr__(self, name: str) -> Any:
        """What the scanner has beyond the protocol, such as the poses of its sweep."""
        if name in ("scanner", "max_sigma", "regions"):  # not set yet: nothing to ask
            raise AttributeError(name)
        return getattr(self.scanner, name)

    @property
    def source(self) -> Floats:
        """(3,) the laser source [m], scanner frame."""
        return self.scanner.source

    @property
    def sensor(self) -> Floats:
        """(3,) the sensor [m], scanner frame."""
        return self.scanner.sensor

    @property
    def grid_shape(self) -> tuple[int, int]:
        """(n_v, n_h) rays of one scan."""
        return self.scanner.grid_shape

    def ray_directions(self) -> Floats:
        """(n_v * n_h, 3) unit directions, scanner frame, row by row."""
        return self.scanner.ray_directions()

    def sigma(self, points: Floats, normals: Floats) -> Floats:
        """(N,) the scanner's expected standard deviation [m]; arguments as in `reject`."""
        return self.scanner.sigma(points, normals)

    def reject(self, points: Floats, normals: Floats) -> NDArray[np.uint8]:
        """(N,) `Rejection` values: the scanner's own conditions, then TOO_UNCERTAIN.

        Args:
            points: (N, 3) surface points [m], scanner frame.
            normals: (N, 3) outward unit normals, scanner frame.
        """
        codes = np.array(self.scanner.reject(points, normals))
        if self.max_sigma < np.inf:
            every = np.full(len(codes), self.max_sigma)
            _refuse(codes, self.scanner.sigma, points, normals, every, Rejection.TOO_UNCERTAIN)
        return codes

    def reject_in(self, points: Floats, normals: Floats, region: Ints32) -> NDArray[np.uint8]:
        """(N,) as `reject`, and then by the limits of the (N,) region of each point: TOO_SPARSE, TOO_UNCERTAIN."""
        codes = self.reject(points, normals)
        if not self.regions:
            return codes
        spacing, sigma = (np.array([getattr(each, name) for each in self.regions]) for name in ("spacing", "sigma"))
        if spacing.min() < np.inf:
            law: _Law = self.spacing
            _refuse(codes, law, points, normals, spacing[region] * (1 + _ROUNDING), Rejection.TOO_SPARSE)
        if sigma.min() < np.inf:
            _refuse(codes, self.scanner.sigma, points, normals, sigma[region], Rejection.TOO_UNCERTAIN)
        return codes


_ROUNDING = 1e-9  # of a length, as the built-in scanners allow it: a point on the limit counts


def _refuse(
    codes: NDArray[np.uint8], law: _Law, points: Floats, normals: Floats, limit: Floats, code: Rejection
) -> None:
    """Give a code to what passed so far and is above its (N,) limit by a law of the scanner."""
    asked = np.flatnonzero((codes == Rejection.MEASURED) & (limit < np.inf))
    if len(asked):
        codes[asked[~(law(points[asked], normals[asked]) <= limit[asked])]] = code


def sigma_layer(
    measurability: Measurability, viewpoints: Viewpoints, scanner: SigmaScanner, *, casters: Sequence[RayCaster] = ()
) -> Measurability:
    """M with the expected standard deviation of the point that each entry gives.

    With several poses per viewpoint an entry has the smallest sigma of the poses that measure its feature. With the
    fill `rays` an entry stands for its feature's own point.

    Args:
        measurability: M, occluders applied.
        viewpoints: the candidates that M was filled for.
        scanner: knows its sigma.
        casters: the part's and the occluders'; needed only where viewpoints have several poses (K > 1), because M does
            not say which of them measured the feature.

    Raises:
        PlannerError: if the viewpoints are not M's, or casters are missing.
    """
    features = measurability.samples
    if len(viewpoints) != measurability.n_viewpoints:
        raise PlannerError(
            f"M has {measurability.n_viewpoints} viewpoints and {len(viewpoints)} were given; they must be the same"
        )
    K = viewpoints.T_object_scanner.shape[1]
    if K > 1 and not casters:
        raise PlannerError(f"viewpoints of {K} poses need `casters`: M does not say which pose measured a feature")
    poses = flatten_poses(viewpoints.T_object_scanner)
    targets = RayTargets.of(features.points, features.normals, features.region)
    columns = measurability.matrix().tocsc()
    columns.sort_indices()
    sigma = np.full(len(columns.indices), np.inf, dtype=np.float32)
    for view in range(len(viewpoints)):
        entries = slice(columns.indptr[view], columns.indptr[view + 1])
        rows = columns.indices[entries].astype(np.int64)
        best = np.full(len(rows), np.inf)
        for number in range(view * K, (view + 1) * K):
            T = poses[number]
            seen = np.arange(len(rows))
            if K > 1:
                seen = np.flatnonzero(np.isin(rows, in_view(targets, T, scanner, rows)))
                seen = seen[
                    lines_of_sight_free(targets, poses, np.full(len(seen), number), rows[seen], scanner, tuple(casters))
                ]
            points = (features.points[rows[seen]] - T[:3, 3]) @ T[:3, :3]
            best[seen] = np.minimum(best[seen], scanner.sigma(points, features.normals[rows[seen]] @ T[:3, :3]))
        sigma[entries] = best
    # Entries go from columns to rows by a stable sort of their rows: within a row, columns rise as they do in M.
    to_rows = np.argsort(columns.indices, kind="stable")
    return Measurability(
        measurability.indptr, measurability.indices, features, measurability.n_viewpoints, sigma[to_rows]
    )


def within_sigma(measurability: Measurability, max_sigma: float) -> Measurability:
    """The entries whose sigma is at most the limit: the binary matrix of a plan with a limit.

    Args:
        measurability: M with its layer of sigma.
        max_sigma: [m], inclusive.

    Raises:
        PlannerError: if M has no layer, or the limit is not above 0.
    """
    if measurability.sigma is None:
        raise PlannerError("M has no layer of sigma; calculate it with sigma_layer first")
    if not max_sigma > 0:
        raise PlannerError(f"the limit on sigma is {max_sigma} m; it must be above 0")
    kept = measurability.sigma <= np.float32(max_sigma)
    before = np.concatenate([[0], np.cumsum(kept)])
    return Measurability(
        before[measurability.indptr],
        measurability.indices[kept],
        measurability.samples,
        measurability.n_viewpoints,
        measurability.sigma[kept],
    )


def best_values(
    laws: Sequence[Callable[[Floats, Floats], Floats]],
    T_object_scanner: Floats,
    samples: SurfaceSamples,
    seen: Bools,
    scanner: Scanner,
) -> list[Floats]:
    """What views give samples of the surface, by laws of the scanner such as its sigma and its spacing.

    Args:
        laws: each gives (N,) values of (N, 3) points [m] and normals, scanner frame; the smaller is the better.
        T_object_scanner: (n, K, 4, 4) poses of the views [m].
        samples: S of them.
        seen: (S, n) which of them each view measures.
        scanner: says which poses of a sweep measure a sample.

    Returns:
        (S,) for each law, from the best of the views that measure the sample; NaN where none does.
    """
    best = [np.full(len(samples), np.inf) for _ in laws]
    targets = RayTargets.of(samples.points, samples.normals, samples.region)
    for view, column in enumerate(np.asarray(T_object_scanner)):
        rows = np.flatnonzero(seen[:, view])
        for T in column:
            here = rows if len(column) == 1 else rows[np.isin(rows, in_view(targets, T, scanner, rows))]
            points, normals = (samples.points[here] - T[:3, 3]) @ T[:3, :3], samples.normals[here] @ T[:3, :3]
            for values, law in zip(best, laws, strict=True):
                values[here] = np.minimum(values[here], law(points, normals))
    return [np.where(np.isfinite(values), values, np.nan) for values in best]


def best_spacing(T_object_scanner: Floats, samples: SurfaceSamples, seen: Bools, scanner: Scanner) -> Floats | None:
    """(S,) distance of neighbouring points that views give samples [m], arguments as in `best_of_views`.

    NaN where no view measures a sample; None of a scanner that does not know its spacing.
    """
    law = getattr(scanner, "spacing", None)
    return best_values([law], T_object_scanner, samples, seen, scanner)[0] if callable(law) else None


def best_sigma(measurability: Measurability, views: NDArray[np.integer]) -> Floats:
    """What a plan gives each feature: the smallest sigma of the chosen views that measure it.

    Args:
        measurability: M with its layer of sigma.
        views: (n,) chosen columns.

    Returns:
        (S,) [m]; NaN where no chosen view measures the feature.

    Raises:
        PlannerError: if M has no layer.
    """
    if measurability.sigma is None:
        raise PlannerError("M has no layer of sigma; calculate it with sigma_layer first")
    chosen = np.isin(measurability.indices, views)
    row = np.repeat(np.arange(measurability.shape[0]), np.diff(measurability.indptr))[chosen]
    best = np.full(measurability.shape[0], np.inf)
    np.minimum.at(best, row, measurability.sigma[chosen].astype(np.float64))
    seen = np.zeros(measurability.shape[0], dtype=np.bool_)
    seen[row] = True
    return np.where(seen, best, np.nan)
