"""Quality of measured points: expected standard deviations (sigma) and spacings, and limits on them.

The layer of sigma has one value per entry of M, in the same sparse order; a limit turns it into a binary matrix again.
The scanner computes sigma (`SigmaScanner.sigma`); docs/internals/sigma_model.md derives that of the built-in scanners.
`LimitedScanner` applies limits itself, for predictions that use its conditions and not the matrix. Object frame,
metres.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from planner.errors import PlannerError
from planner.geometry.sampling import SurfaceSamples
from planner.measurability.matrix import Measurability
from planner.measurability.visibility import require_candidates
from planner.ports import RayCaster, Rejection, Scanner, SigmaScanner
from planner.values import Bools, Floats, Ints32
from planner.viewpoints.lines_of_sight import RayTargets, flatten_poses, in_view, lines_of_sight_free
from planner.viewpoints.viewpoints import Viewpoints

_Quantity = Callable[[Floats, Floats], Floats]  # (N,) of (N, 3) points [m] and normals, scanner frame
_ROUNDING = 1e-9  # relative tolerance of a length, as in the built-in scanners: a point on the limit counts


@dataclass(frozen=True, slots=True)
class QualityLimits:
    """Limits that a point must keep to count; inf for no limit.

    Attributes:
        sigma: largest expected standard deviation [m], above 0.
        spacing: largest distance of neighbouring points of the scan [m], above 0.
    """

    sigma: float = np.inf
    spacing: float = np.inf

    def __post_init__(self) -> None:
        for name in ("sigma", "spacing"):
            if not getattr(self, name) > 0:
                raise PlannerError(f"the limit on {name} is {getattr(self, name)} m; it must be above 0")


@dataclass(frozen=True, slots=True, eq=False)
class LimitedScanner:
    """A scanner that also rejects points beyond quality limits; a point on the limit counts.

    Attributes:
        scanner: sensor model without the limits.
        max_sigma: largest expected standard deviation anywhere [m], above 0; inf: no limit.
        regions: additional limits of the part's regions, by their numbers; a point without known region has none.
    """

    scanner: SigmaScanner
    max_sigma: float = np.inf
    regions: tuple[QualityLimits, ...] = ()

    def __post_init__(self) -> None:
        every = (QualityLimits(self.max_sigma), *self.regions)
        for name in ("sigma", "spacing"):
            if min(getattr(each, name) for each in every) < np.inf and not callable(getattr(self.scanner, name, None)):
                raise PlannerError(
                    f"the scanner {type(self.scanner).__name__} does not know its {name}, so no limit can be put on "
                    "it; choose one that does, or omit the limit"
                )

    def __getattr__(self, name: str) -> Any:
        """Return the other attributes of a `SigmaScanner`, and further ones such as the poses of its sweep."""
        if name in ("scanner", "max_sigma", "regions"):  # not set yet
            raise AttributeError(name)
        return getattr(self.scanner, name)

    @property
    def area_limits(self) -> None:
        """None: the quality limits are further conditions (`planner.ports.AreaLimits`)."""

    def reject(self, points: Floats, normals: Floats) -> NDArray[np.uint8]:
        """Return (N,) `Rejection` values: the scanner's own conditions, then TOO_UNCERTAIN.

        Args:
            points: (N, 3) surface points [m], scanner frame.
            normals: (N, 3) outward unit normals, scanner frame.
        """
        codes = np.array(self.scanner.reject(points, normals))
        if self.max_sigma < np.inf:
            limit = np.full(len(codes), self.max_sigma)
            _reject_above(codes, self.scanner.sigma, points, normals, limit, Rejection.TOO_UNCERTAIN)
        return codes

    def reject_in(self, points: Floats, normals: Floats, region: Ints32) -> NDArray[np.uint8]:
        """Return (N,) codes of `reject`, then TOO_SPARSE, TOO_UNCERTAIN by the limits of each point's region (N,)."""
        codes = self.reject(points, normals)
        if not self.regions:
            return codes
        spacing, sigma = (np.array([getattr(each, name) for each in self.regions]) for name in ("spacing", "sigma"))
        if spacing.min() < np.inf:
            quantity: _Quantity = self.spacing
            limit = spacing[region] * (1 + _ROUNDING)
            _reject_above(codes, quantity, points, normals, limit, Rejection.TOO_SPARSE)
        if sigma.min() < np.inf:
            _reject_above(codes, self.scanner.sigma, points, normals, sigma[region], Rejection.TOO_UNCERTAIN)
        return codes


def _reject_above(
    codes: NDArray[np.uint8], quantity: _Quantity, points: Floats, normals: Floats, limit: Floats, code: Rejection
) -> None:
    """Write a code for points that passed so far and exceed their limit (N,) of a quantity."""
    rows = np.flatnonzero((codes == Rejection.MEASURED) & (limit < np.inf))
    if len(rows):
        codes[rows[~(quantity(points[rows], normals[rows]) <= limit[rows])]] = code


def sigma_layer(
    measurability: Measurability, viewpoints: Viewpoints, scanner: SigmaScanner, *, casters: Sequence[RayCaster] = ()
) -> Measurability:
    """Add to M the expected standard deviation of the point of each entry.

    With several poses per viewpoint an entry has the smallest sigma of the poses that measure its sample. If M was
    filled with `rays`, an entry has the sigma of the sample's own point.

    Args:
        measurability: M, occluders applied.
        viewpoints: candidates of M.
        scanner: sensor model with sigma.
        casters: of the part and of occluders; needed only if viewpoints have several poses (K > 1), because M does not
            say which of them measured the sample.
    """
    samples = measurability.samples
    require_candidates(viewpoints, measurability)
    K = viewpoints.T_object_scanner.shape[1]
    if K > 1 and not casters:
        raise PlannerError(f"viewpoints of {K} poses need `casters`: M does not say which pose measured a sample")
    poses = flatten_poses(viewpoints.T_object_scanner)
    targets = RayTargets.of(samples.points, samples.normals, samples.region)
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
                pose = np.full(len(seen), number)
                seen = seen[lines_of_sight_free(targets, poses, pose, rows[seen], scanner, tuple(casters))]
            points = (samples.points[rows[seen]] - T[:3, 3]) @ T[:3, :3]
            best[seen] = np.minimum(best[seen], scanner.sigma(points, samples.normals[rows[seen]] @ T[:3, :3]))
        sigma[entries] = best
    # A stable sort by rows reorders the entries from columns to rows: within a row, columns rise as they do in M.
    to_rows = np.argsort(columns.indices, kind="stable")
    return replace(measurability, sigma=sigma[to_rows])


def within_sigma(measurability: Measurability, max_sigma: float) -> Measurability:
    """Return M with the entries whose sigma is at most `max_sigma` [m]."""
    sigma = _sigma_of(measurability)
    if not max_sigma > 0:
        raise PlannerError(f"the limit on sigma is {max_sigma} m; it must be above 0")
    return measurability.with_entries(sigma <= np.float32(max_sigma))


def best_values(
    quantities: Sequence[_Quantity], T_object_scanner: Floats, samples: SurfaceSamples, seen: Bools, scanner: Scanner
) -> list[Floats]:
    """Return the smallest value of quantities such as sigma and spacing over the views that measure each sample.

    Args:
        quantities: functions that return (N,) values of (N, 3) points [m] and normals, scanner frame.
        T_object_scanner: (n, K, 4, 4) poses of the views [m].
        samples: S of them.
        seen: (S, n) whether each view measures each sample.
        scanner: decides which poses of a sweep have a sample in view.

    Returns:
        (S,) values for each quantity; NaN if no view measures the sample.
    """
    best = [np.full(len(samples), np.inf) for _ in quantities]
    targets = RayTargets.of(samples.points, samples.normals, samples.region)
    for view, column in enumerate(np.asarray(T_object_scanner)):
        rows = np.flatnonzero(seen[:, view])
        for T in column:
            here = rows if len(column) == 1 else rows[np.isin(rows, in_view(targets, T, scanner, rows))]
            points, normals = (samples.points[here] - T[:3, 3]) @ T[:3, :3], samples.normals[here] @ T[:3, :3]
            for values, quantity in zip(best, quantities, strict=True):
                values[here] = np.minimum(values[here], quantity(points, normals))
    return [np.where(np.isfinite(values), values, np.nan) for values in best]


def best_spacing(T_object_scanner: Floats, samples: SurfaceSamples, seen: Bools, scanner: Scanner) -> Floats | None:
    """Return (S,) the smallest spacing of neighbouring points [m] over the views, arguments as in `best_values`.

    NaN if no view measures a sample; None for a scanner without `spacing`.
    """
    spacing = getattr(scanner, "spacing", None)
    return best_values([spacing], T_object_scanner, samples, seen, scanner)[0] if callable(spacing) else None


def best_sigma(measurability: Measurability, views: NDArray[np.integer]) -> Floats:
    """Return (S,) the smallest sigma [m] over the views (n,) that measure each sample; NaN if none does."""
    sigma = _sigma_of(measurability)
    is_selected = np.isin(measurability.indices, views)
    row = np.repeat(np.arange(measurability.shape[0]), np.diff(measurability.indptr))[is_selected]
    best = np.full(measurability.shape[0], np.inf)
    np.minimum.at(best, row, sigma[is_selected].astype(np.float64))
    seen = np.zeros(measurability.shape[0], dtype=np.bool_)
    seen[row] = True
    return np.where(seen, best, np.nan)


def _sigma_of(measurability: Measurability) -> NDArray[np.float32]:
    if measurability.sigma is None:
        raise PlannerError("M has no layer of sigma; calculate it with sigma_layer first")
    return measurability.sigma
