"""Localisation: the pose of a part from measured points.

Best fit (`fit_surface`): points on the part's surface, from a placement with an error of centimetres and degrees.
Point-to-plane matching finds the nearest minimum only, and a view of one side of a part has several. So a few points
start at many motions around the nominal placement, and the best continue with more; the remaining distances tell the
correct minimum. All views move together, as one rigid body. The precision follows from the scatter of the points about
the surface, as if their errors were independent. Correlated errors (a form that deviates, a scanner out of calibration)
do not show in the scatter.

Pairs of nominal and measured points (`fit_pairs`): the least-squares rotation and translation by singular values (Arun,
Huang and Blostein, IEEE PAMI 9(5), 1987, doi:10.1109/TPAMI.1987.4767965, with Umeyama's sign, doi:10.1109/34.88573).

3-2-1 rule (`fit_three_two_one`): three points lie on a plane, two on a plane across it, one on a plane across both; a
measured point may lie anywhere on its plane. Six conditions determine six unknowns, so no residual tells the precision.
Metres, radians.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from operator import itemgetter

import numpy as np

from planner.errors import PlannerError
from planner.geometry.closest import ClosestPointQuery
from planner.geometry.rigid import rigid_transform
from planner.registration.cloud import ScanCloud, merge
from planner.registration.observability import RigidFit, split_directions
from planner.registration.registration import MIN_MATCHES, JointProblem, MovingScan, fit_majority
from planner.registration.rigid import (
    length_scale,
    motion_from_vector,
    recentre_directions,
    recentring_matrix,
    remove_free_motion,
    restricted_covariance,
    screw_from_motion,
    skew,
    transform_points,
)
from planner.values import Floats

_COARSE, _FINE = 300, 20_000  # points of all views together; a view has at least those that its match needs
_STARTS = 60
_FIRST, _LATER, _LAST = 8, 25, 40  # steps of a descent
_PROMISING = 6  # starts that continue
_MAJORITY_ROUNDS = 12  # of closest points, from a start that may be some millimetres off
_LOST = 1e-9  # mean square along the normals below which a direction has no match, as `WEAK` of the observability
_STILL = 1e-7  # m; a step with smaller displacements ends a descent
_CAP = 0.02  # of the diagonal: largest distance of a point when starts are compared
_SAME = 0.01  # of the diagonal: placements that are no farther apart are the same
_ALONG = 0.2  # of the distance to another placement along a free direction: its axis is known no better than that
_AS_GOOD = 1.5  # ratio of remaining distances up to which another placement fits about as well
_MAX_OUTLIERS = 0.3  # share of points off the surface above which the fit is doubted
_OUTLIER = 5.0  # robust sigma beyond which a point is off the surface
_NOISE = 0.005  # of the diagonal: more than the noise of any scanner
_ON_LINE = 1e-3  # smallest width of pairs of points, as a share of their length
_COINCIDENT = 1e-6  # m; points that are no farther apart are the same


@dataclass(frozen=True, slots=True)
class SearchRange:
    """Largest deviation from the nominal placement: distance [m] and angle [rad]."""

    distance: float = 0.03
    angle: float = float(np.radians(8.0))


def fit_surface(
    views: Sequence[ScanCloud],
    nearest: ClosestPointQuery,
    centre: Floats,
    search: SearchRange,
    rng: np.random.Generator,
) -> RigidFit:
    """Find the motion T that moves measured points onto the part's surface.

    Args:
        views: clouds in the object frame, as if the part stood at its nominal placement.
        nearest: surface of the part.
        centre: (3,) of the part, about which it may be rotated [m].
        search: largest deviation from the nominal placement.
        rng: of the start motions.

    Raises:
        PlannerError: if too few points lie near the part.
    """
    vertices, diagonal = nearest.mesh.vertices, nearest.mesh.diagonal
    length = float(np.sqrt(((vertices - centre) ** 2).sum(axis=1).mean()))
    farthest = float(np.linalg.norm(vertices - centre, axis=1).max())
    reach = search.distance + 2 * np.sin(search.angle / 2) * farthest
    near = [
        ScanCloud(points, each.sensor)
        for each in views
        if len(points := each.points[nearest.closest(each.points).distance <= reach])
    ]
    if sum(map(len, near)) < MIN_MATCHES:
        raise PlannerError(
            f"only {sum(map(len, near))} points lie within {1000 * reach:.0f} mm of the nominal part, and "
            f"{MIN_MATCHES} are needed; check frame and unit of the points, or widen the search"
        )
    clouds = [merge([cloud]) for cloud in near]
    coarse, fine = (
        _BodyFit([MovingScan(cloud, count) for cloud in clouds], nearest, reach, centre, length)
        for count in (max(total // len(near), MIN_MATCHES) for total in (_COARSE, _FINE))
    )
    candidates = []
    for start in _start_motions(search, centre, rng):
        coarse.set_motion(start)
        coarse.descend(_FIRST)
        candidates.append((coarse.cost(), coarse.T))
    promising = []
    for _, start in sorted(candidates, key=itemgetter(0))[:_PROMISING]:
        coarse.set_motion(start)
        coarse.descend(_LATER)
        promising.append((coarse.cost(), coarse.T))
        # Along a direction in which few faces look, these are outliers of the others; here they count.
        coarse.set_motion(fit_majority(coarse.scanned_points, nearest, coarse.T, reach, _MAJORITY_ROUNDS))
        promising.append((coarse.cost(), coarse.T))
    corners = np.concatenate([np.stack([each.points.min(axis=0), each.points.max(axis=0)]) for each in near])
    results: list[tuple[float, Floats]] = []
    for _, start in sorted(promising, key=itemgetter(0))[:_PROMISING]:
        if all(_distance_between(start, other, corners) > _SAME * diagonal for _, other in results):
            fine.set_motion(start)
            fine.descend(_LAST)
            fine.set_motion(fit_majority(fine.scanned_points, nearest, fine.T, reach))
            # Not the median distance: a block that slides along most of its faces has a small one.
            results.append((float(np.sqrt(fine.cost())), fine.T))
    results.sort(key=itemgetter(0))
    fine.set_motion(results[0][1])
    fine.hold_free_motions()
    fine.descend(_LAST)
    fit = fine.result()
    return replace(fit, alternatives=_alternatives(results, fit, diagonal))


class _BodyFit:
    """Views that move together by T (4, 4), and their matches on the part."""

    def __init__(
        self, views: Sequence[MovingScan], nearest: ClosestPointQuery, reach: float, centre: Floats, length: float
    ) -> None:
        self._centre, self._length = centre, length  # of the part
        self._views, self._nearest = views, nearest
        self._problem = JointProblem(self._views, nearest, reach, overlap=False)
        self.T: Floats = np.eye(4)
        self._held: Floats | None = None

    def set_motion(self, T: Floats) -> None:
        """Start at a motion (4, 4)."""
        self.T = T
        for view in self._views:
            view.T = T

    @property
    def points(self) -> Floats:
        """(N, 3) matched points after the motion [m]."""
        return np.concatenate([view.points for view in self._views])

    @property
    def scanned_points(self) -> Floats:
        """(N, 3) the same before the motion [m]."""
        return transform_points(np.linalg.inv(self.T), self.points)

    def equations(self) -> tuple[Floats, Floats, float, Floats, float]:
        """Return the normal equations of the common motion about the points' centre.

        Returns:
            (6, 6) information, (6,) gradient, weight, centre (3,) of the points and their length.
        """
        points = self.points
        centre = points.mean(axis=0)
        length = float(np.sqrt(((points - centre) ** 2).sum(axis=1).mean()))
        matrix, gradient, weight, _ = self._problem.normal_equations(self._problem.match())
        information, slope = np.zeros((6, 6)), np.zeros(6)
        for number, view in enumerate(self._views):
            block, A = slice(6 * number, 6 * number + 6), recentring_matrix(view.centre - centre)
            information += A.T @ matrix[block, block] @ A
            slope += A.T @ gradient[block]
        return information, slope, float(weight.sum()), centre, length

    def descend(self, steps: int) -> None:
        """Take Gauss-Newton steps in the observed directions until the motion converges."""
        for _ in range(steps):
            information, slope, weight, centre, length = self.equations()
            observed, _ = self._split(information, weight, centre, length)
            if not observed.shape[1]:
                return
            change = -restricted_covariance(information, observed, length) @ slope
            self.set_motion(motion_from_vector(change, centre) @ self.T)
            if np.linalg.norm(change[:3]) + 2 * length * np.linalg.norm(change[3:]) < _STILL:
                return

    def hold_free_motions(self) -> None:
        """Remove the part of the motion along unobserved directions and hold these directions from here on.

        The removed motion is the smallest of the part, not of its scanned points. The directions are held because
        observed or not is a threshold, which a step may cross.
        """
        information, _, weight, points_centre, own_length = self.equations()
        _, free = split_directions(information, weight, own_length)
        self._held = recentre_directions(free, self._centre - points_centre, (own_length, self._length))
        self.set_motion(remove_free_motion(self.T, self._held, self._centre, self._length))

    def cost(self) -> float:
        """Return the mean square distance from the part, each point with a cap [m^2]."""
        cap = _CAP * self._nearest.mesh.diagonal
        return float(np.mean(np.minimum(self._nearest.closest(self.points).distance, cap) ** 2))

    def spread(self) -> float:
        """Return the robust standard deviation of the distances from the part [m]."""
        return 1.4826 * float(np.median(self._nearest.closest(self.points).distance))

    def result(self) -> RigidFit:
        """Return the fit at the current motion, about the part's centre and with its length."""
        information, _, weight, points_centre, own_length = self.equations()
        observed, free = self._split(information, weight, points_centre, own_length)
        A = recentring_matrix(self._centre - points_centre)
        residuals, spread = self._nearest.closest(self.points).distance, self.spread()
        is_inlier = residuals <= _OUTLIER * max(spread, 1e-6)
        doubts = []
        if (used := float(is_inlier.mean())) < 1 - _MAX_OUTLIERS:
            doubts.append(f"{100 * (1 - used):.0f} % of the points lie off the part; they may belong to another object")
        if spread > _NOISE * self._nearest.mesh.diagonal:
            doubts.append(
                f"points lie {1000 * spread:.2g} mm off the part at the best fit; it may be another part, or its "
                "placement error exceeds the search range"
            )
        return RigidFit(
            self.T,
            A @ restricted_covariance(information, observed, own_length) @ A.T,
            recentre_directions(free, self._centre - points_centre, (own_length, self._length)),
            self._centre,
            self._length,
            residuals[is_inlier],
            used,
            doubts=tuple(doubts),
        )

    def _split(
        self, information: Floats, weight: float, points_centre: Floats, own_length: float
    ) -> tuple[Floats, Floats]:
        """Return observed directions and free or held ones, about the points' centre `points_centre` (3,).

        Directions that were observed when others were held, and have lost their matches since, are free as well.
        """
        if self._held is None or not weight > 0:
            return split_directions(information, weight, own_length)
        count = self._held.shape[1]
        free = recentre_directions(self._held, points_centre - self._centre, (self._length, own_length))
        observed = np.linalg.svd(free)[0][:, count:] if count else np.eye(6)
        B = observed / length_scale(own_length)[:, None]
        values, vectors = np.linalg.eigh(B.T @ information @ B / weight)
        if (is_lost := values < _LOST).any():
            free, observed = np.hstack([free, observed @ vectors[:, is_lost]]), observed @ vectors[:, ~is_lost]
        return observed, free


def _start_motions(search: SearchRange, centre: Floats, rng: np.random.Generator) -> list[Floats]:
    """Return start motions: the identity, and others evenly in the balls of translations and rotations."""
    starts = [np.eye(4)]
    for _ in range(_STARTS - 1):
        shift, turn = (_in_unit_ball(rng) * size for size in (search.distance, search.angle))
        starts.append(motion_from_vector(np.concatenate([shift, turn]), centre))
    return starts


def _in_unit_ball(rng: np.random.Generator) -> Floats:
    direction = rng.standard_normal(3)
    return np.asarray(direction / np.linalg.norm(direction) * rng.uniform() ** (1 / 3))


def _distance_between(one: Floats, other: Floats, corners: Floats) -> float:
    """Return the largest distance between the positions of a point of (N, 3) corners [m] after two motions [m]."""
    both = [transform_points(T, corners) for T in (one, other)]
    return float(np.linalg.norm(both[0] - both[1], axis=1).max())


def _alternatives(results: Sequence[tuple[float, Floats]], fit: RigidFit, diagonal: float) -> tuple[str, ...]:
    """Describe another placement that fits about as well and does not differ by a free motion alone."""
    (best, T), *others = results
    observed = np.eye(6) - fit.free @ fit.free.T
    for remaining, other in others:
        change = screw_from_motion(other @ np.linalg.inv(T), fit.centre)
        scaled = change * length_scale(fit.length)
        same = _SAME * diagonal + (_ALONG * float(np.linalg.norm(scaled)) if fit.free.shape[1] else 0.0)
        if remaining <= _AS_GOOD * best and np.linalg.norm(observed @ scaled) > same:
            return (
                f"the points fit as well {1000 * np.linalg.norm(change[:3]):.1f} mm and "
                f"{np.degrees(np.linalg.norm(change[3:])):.1f} deg away ({1000 * remaining:.2g} mm off the part there, "
                f"{1000 * best:.2g} mm here): measure points of another view to decide",
            )
    return ()


def fit_pairs(nominal: Floats, measured: Floats, centre: Floats, length: float, sd: float | None = None) -> RigidFit:
    """Compute T_base_object from pairs of points.

    Args:
        nominal: (N, 3) on the part, object frame [m].
        measured: (N, 3) the same points, base [m].
        centre: (3,) of the part [m], object frame.
        length: of the part [m].
        sd: standard deviation of a measured coordinate [m]; default from the residuals, if there are any.

    Raises:
        PlannerError: if there are fewer than three pairs, or all points coincide.
    """
    if len(nominal) < 3:
        raise PlannerError(
            f"{len(nominal)} pairs of points do not determine the placement; give at least three, not on a line"
        )
    middle, there = nominal.mean(axis=0), measured.mean(axis=0)
    if np.linalg.norm(nominal - middle, axis=1).max() < _COINCIDENT:
        raise PlannerError("all pairs name the same point; give at least three, not on a line")
    for kind, points in (("nominal", nominal), ("measured", measured)):
        sides = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
        if sides[1] < max(_ON_LINE * sides[0], _COINCIDENT):
            raise PlannerError(
                f"the {kind} points lie on a line, and any rotation about it fits as well; add a pair beside the line"
            )
    left_axes, _, right_axes = np.linalg.svd((measured - there).T @ (nominal - middle))
    T = np.eye(4)
    T[:3, :3] = left_axes @ np.diag([1.0, 1.0, np.sign(np.linalg.det(left_axes @ right_axes))]) @ right_axes
    T[:3, 3] = there - T[:3, :3] @ middle
    residuals = measured @ T[:3, :3] - (T[:3, 3] @ T[:3, :3]) - nominal  # in object axes
    J = np.concatenate([np.broadcast_to(np.eye(3), (len(nominal), 3, 3)), -skew(nominal - centre)], axis=2)
    J = J.reshape(-1, 6)
    observed, free = split_directions(J.T @ J, 3.0 * len(nominal), length)
    surplus = 3 * len(nominal) - observed.shape[1]
    if sd is None and surplus > 0:
        sd = float(np.sqrt((residuals**2).sum() / surplus))
    covariance = None if sd is None else sd**2 * restricted_covariance(J.T @ J, observed, length)
    return RigidFit(T, covariance, free, centre, length, np.linalg.norm(residuals, axis=1))


def fit_three_two_one(
    nominal: Floats, measured: Floats, centre: Floats, length: float, sd: float | None = None
) -> RigidFit:
    """Compute T_base_object by the 3-2-1 rule.

    The residuals are the distances of measured from nominal points along their planes, which the rule leaves free.

    Args:
        nominal: (6, 3) on the part, object frame [m]: three of the first plane, two of the second, one of the third.
        measured: (6, 3) on the same planes, base [m].
        centre: (3,) of the part [m], object frame.
        length: of the part [m].
        sd: standard deviation of a measured coordinate [m]; None if not known.

    Raises:
        PlannerError: if there are not six pairs, the first three lie on a line, or the next two on a normal of their
            plane.
    """
    if len(nominal) != 6 or len(measured) != 6:
        raise PlannerError(f"3-2-1 takes six pairs of points, three, two and one; there are {len(nominal)}")
    T_object_frame, T_base_frame = _frame("nominal", nominal), _frame("measured", measured)
    T: Floats = T_base_frame @ np.linalg.inv(T_object_frame)
    along = measured @ T[:3, :3] - (T[:3, 3] @ T[:3, :3]) - nominal
    normals = T_object_frame[:3, :3].T[[2, 2, 2, 1, 1, 0]]
    J = np.hstack([normals, np.cross(nominal - centre, normals)])
    covariance = None if sd is None else sd**2 * restricted_covariance(J.T @ J, np.eye(6), length)
    residuals = np.linalg.norm(along - (along * normals).sum(axis=1)[:, None] * normals, axis=1)
    return RigidFit(T, covariance, np.empty((6, 0)), centre, length, residuals)


def _frame(kind: str, points: Floats) -> Floats:
    """Return the frame (4, 4) of six points: z normal to the first plane, x along the two, origin in all planes."""
    a, b, c, d, e, f = points
    across = np.cross(b - a, c - a)
    size = max(float(np.linalg.norm(b - a) * np.linalg.norm(c - a)), _COINCIDENT**2)
    if np.linalg.norm(across) < 1e-3 * size:
        raise PlannerError(f"the first three {kind} points lie on a line and do not determine a plane; spread them")
    z = across / np.linalg.norm(across)
    x = (e - d) - z * (z @ (e - d))
    if np.linalg.norm(x) < max(1e-3 * float(np.linalg.norm(e - d)), _COINCIDENT):
        raise PlannerError(
            f"the fourth and the fifth of the {kind} points lie on a normal of the plane of the first three; choose "
            "them side by side"
        )
    x = x / np.linalg.norm(x)
    y = np.cross(z, x)
    return rigid_transform(np.stack([x, y, z], axis=1), x * (x @ f) + y * (y @ d) + z * (z @ a))
