"""Best fit of measured points on the part's surface, from a placement that may be off by centimetres and degrees.

Point-to-plane matching (`cell.reconstruction.matching`) finds the nearest minimum only, and a view of one side of a
part has several. So few points begin at many motions around the nominal placement, and the best go on with more; which
minimum is the part's, the distances that are left say. All views move together, as one rigid body. Object frame,
metres, radians.

How precise the result is follows from the scatter of the points about the surface, as if each erred for itself. Points
that err together (a form that deviates, a scanner out of calibration) are not seen in the scatter.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from cell.errors import FileError
from cell.reconstruction.cloud import ScanCloud
from cell.reconstruction.freedom import split
from cell.reconstruction.matching import FEWEST, JointProblem, MovingScan, small_motion
from cell.reconstruction.rigid import RigidFit, about, covariance_of, moved_basis, screw_of, without_free
from planner.geometry.closest import ClosestPointQuery
from planner.values import Floats

_COARSE, _FINE = 300, 20_000  # points of all views together
_STARTS = 60
_FIRST, _LATER, _LAST = 8, 25, 40  # steps of a descent
_PROMISING = 6  # starts that go on
_STILL = 1e-7  # m; a step that moves no point farther ends a descent
_CAP = 0.02  # of the diagonal: how far off a point counts at most when starts are compared
_SAME = 0.01  # of the diagonal: placements that are no farther apart are one
_ALONG = 0.2  # of the way to another placement that may lie beside what is free: the axis is known so well only
_AS_GOOD = 1.5  # times the distance that is left: another placement that fits about as well
_MOST_OFF = 0.3  # share of points off the surface from which on the fit is doubted
_OFF = 5.0  # robust sigma beyond which a point is off the surface
_NOISE = 0.005  # of the diagonal: what no scanner's noise leaves


@dataclass(frozen=True, slots=True)
class Search:
    """How far off the nominal placement may be.

    Attributes:
        distance: [m].
        angle: [rad].
    """

    distance: float = 0.03
    angle: float = float(np.radians(8.0))


def fit(
    views: Sequence[ScanCloud],
    nearest: ClosestPointQuery,
    centre: Floats,
    search: Search,
    rng: np.random.Generator,
) -> RigidFit:
    """The motion that brings points onto the part's surface.

    Args:
        views: clouds in the object frame, as if the part stood where it is nominally.
        nearest: the part.
        centre: (3,) of the part, about which it may be turned [m].
        search: how far off it may be.
        rng: of the motions that are begun with.

    Returns:
        The motion T: T @ point is the place on the part.

    Raises:
        FileError: if too few points lie near the part.
    """
    vertices = nearest.mesh.vertices
    length = float(np.sqrt(((vertices - centre) ** 2).sum(axis=1).mean()))
    farthest = float(np.linalg.norm(vertices - centre, axis=1).max())
    reach = search.distance + 2 * np.sin(search.angle / 2) * farthest
    near = [_within(cloud, nearest, reach) for cloud in views]
    if sum(map(len, near)) < FEWEST:
        raise FileError(
            f"only {sum(map(len, near))} points lie within {1000 * reach:.0f} mm of the part as it stands nominally, "
            f"and {FEWEST} are needed; look at frame and unit of the points, or widen the search"
        )
    coarse = _Body([MovingScan(cloud, _COARSE // len(near)) for cloud in near], nearest, reach, centre, length)
    found = []
    for start in _starts(search, centre, rng):
        coarse.put(start)
        coarse.descend(_FIRST)
        found.append((coarse.cost(), coarse.T))
    promising = []
    for _, start in sorted(found, key=lambda each: each[0])[:_PROMISING]:
        coarse.put(start)
        coarse.descend(_LATER)
        promising.append((coarse.cost(), coarse.T))
    fine = _Body([MovingScan(cloud, _FINE // len(near)) for cloud in near], nearest, reach, centre, length)
    ended: list[tuple[float, Floats]] = []
    for _, start in sorted(promising, key=lambda each: each[0]):
        if all(_apart(start, other, near) > _SAME * nearest.mesh.diagonal for _, other in ended):
            fine.put(start)
            fine.descend(_LAST)
            ended.append((fine.spread(), fine.T))
    ended.sort(key=lambda each: each[0])
    fine.put(ended[0][1])
    fine.unwind()
    fine.descend(_LAST)
    result = fine.judged()
    return replace(result, rivals=_others(ended, result, nearest.mesh.diagonal))


class _Body:
    """Views that move together, and their matches on the part.

    Attributes:
        T: (4, 4) their motion so far.
    """

    def __init__(
        self, views: Sequence[MovingScan], nearest: ClosestPointQuery, reach: float, centre: Floats, length: float
    ) -> None:
        """Nothing is moved yet.

        Args:
            views: with their sampled points.
            nearest: the part.
            reach: farthest match [m].
            centre: (3,) of the part [m].
            length: of the part [m].
        """
        self._centre, self._length = centre, length
        self._views, self._nearest = [view for view in views if len(view)], nearest
        self._problem = JointProblem(self._views, nearest, reach, overlap=False)
        self.T: Floats = np.eye(4)
        self._held: Floats | None = None

    def put(self, T: Floats) -> None:
        """Begin at a motion (4, 4)."""
        self.T = T
        for view in self._views:
            view.T = T

    @property
    def points(self) -> Floats:
        """(N, 3) the matched points as they are moved [m]."""
        return np.concatenate([view.points for view in self._views])

    def equations(self) -> tuple[Floats, Floats, float, Floats, float]:
        """Information (6, 6), gradient (6,) and weight of one common motion about the points' centre; that; length."""
        points = self.points
        centre = points.mean(axis=0)
        length = float(np.sqrt(((points - centre) ** 2).sum(axis=1).mean()))
        matrix, gradient, weight, _ = self._problem.information(self._problem.match())
        information, slope = np.zeros((6, 6)), np.zeros(6)
        for number, view in enumerate(self._views):
            own, A = slice(6 * number, 6 * number + 6), about(view.centre - centre)
            information += A.T @ matrix[own, own] @ A
            slope += A.T @ gradient[own]
        return information, slope, float(weight.sum()), centre, length

    def descend(self, steps: int) -> bool:
        """Gauss-Newton in the directions that are seen; whether it came to rest."""
        for _ in range(steps):
            information, slope, weight, centre, length = self.equations()
            seen, _ = self._split(information, weight, centre, length)
            if not seen.shape[1]:
                return False
            change = -covariance_of(information, seen, length) @ slope
            self.put(small_motion(change, centre) @ self.T)
            if np.linalg.norm(change[:3]) + 2 * length * np.linalg.norm(change[3:]) < _STILL:
                return True
        return False

    def unwind(self) -> None:
        """Take back what a beginning put into motions that the points do not see: there the part stays as it was.

        What is least is least of the part, not of the points seen of it. From here on these motions are held: seen or
        not is a threshold, which a step may cross.
        """
        information, _, weight, own, own_length = self.equations()
        _, free = split(information, weight, own_length)
        self._held = moved_basis(free, self._centre - own, (own_length, self._length))
        self.put(without_free(self.T, self._held, self._centre, self._length))

    def cost(self) -> float:
        """Mean square distance from the part, of each point a cap at most [m^2]."""
        cap = _CAP * self._nearest.mesh.diagonal
        return float(np.mean(np.minimum(self._nearest.closest(self.points).distance, cap) ** 2))

    def spread(self) -> float:
        """Robust standard deviation of the distances from the part [m]."""
        return 1.4826 * float(np.median(self._nearest.closest(self.points).distance))

    def judged(self) -> RigidFit:
        """The result at the motion so far, about the part's centre and with its length."""
        information, _, weight, own, own_length = self.equations()
        seen, free = self._split(information, weight, own, own_length)
        A = about(self._centre - own)
        residuals = self._nearest.closest(self.points).distance
        counts = residuals <= _OFF * max(self.spread(), 1e-6)
        said = []
        if (used := float(counts.mean())) < 1 - _MOST_OFF:
            said.append(f"{100 * (1 - used):.0f} % of the points lie off the part; they may be of something else")
        if self.spread() > _NOISE * self._nearest.mesh.diagonal:
            said.append(
                f"points lie {1000 * self.spread():.2g} mm off the part where it fits best; it may be another part, or "
                "stand farther off than was searched"
            )
        return RigidFit(
            self.T, A @ covariance_of(information, seen, own_length) @ A.T,
            moved_basis(free, self._centre - own, (own_length, self._length)), self._centre, self._length,
            residuals[counts], used,
            doubts=tuple(said),
        )  # fmt: skip

    def _split(self, information: Floats, weight: float, own: Floats, own_length: float) -> tuple[Floats, Floats]:
        """Directions that are seen and those that are not, or are held, about the points' centre (3,)."""
        if self._held is None:
            return split(information, weight, own_length)
        count = self._held.shape[1]
        free = moved_basis(self._held, own - self._centre, (self._length, own_length))
        return (np.linalg.svd(free)[0][:, count:] if count else np.eye(6)), free


def _within(cloud: ScanCloud, nearest: ClosestPointQuery, reach: float) -> ScanCloud:
    """The points that may be of the part."""
    return ScanCloud(cloud.points[nearest.closest(cloud.points).distance <= reach], cloud.sensor)


def _starts(search: Search, centre: Floats, rng: np.random.Generator) -> list[Floats]:
    """Motions to begin with: none, and others evenly in the ball of shifts and that of turns about the centre."""
    starts = [np.eye(4)]
    for _ in range(_STARTS - 1):
        shift, turn = (_in_ball(rng) * size for size in (search.distance, search.angle))
        starts.append(small_motion(np.concatenate([shift, turn]), centre))
    return starts


def _in_ball(rng: np.random.Generator) -> Floats:
    direction = rng.standard_normal(3)
    return np.asarray(direction / np.linalg.norm(direction) * rng.uniform() ** (1 / 3))


def _apart(one: Floats, other: Floats, views: Sequence[ScanCloud]) -> float:
    """How far apart two motions bring any of the points [m]."""
    corners = np.concatenate([np.stack([cloud.points.min(axis=0), cloud.points.max(axis=0)]) for cloud in views])
    both = [corners @ T[:3, :3].T + T[:3, 3] for T in (one, other)]
    return float(np.linalg.norm(both[0] - both[1], axis=1).max())


def _others(ended: Sequence[tuple[float, Floats]], fit: RigidFit, diagonal: float) -> tuple[str, ...]:
    """A sentence about another placement that fits about as well as the first, and is not it moved as it is free to."""
    (best, T), *others = ended
    seen = np.eye(6) - fit.free @ fit.free.T
    for left, other in others:
        change = screw_of(other @ np.linalg.inv(T), fit.centre)
        scaled = change * np.array([1.0, 1.0, 1.0, *[fit.length] * 3])
        same = _SAME * diagonal + (_ALONG * float(np.linalg.norm(scaled)) if fit.free.shape[1] else 0.0)
        if left <= _AS_GOOD * best and np.linalg.norm(seen @ scaled) > same:
            return (
                f"the points fit as well {1000 * np.linalg.norm(change[:3]):.1f} mm and "
                f"{np.degrees(np.linalg.norm(change[3:])):.1f} deg away ({1000 * left:.2g} mm off the part there, "
                f"{1000 * best:.2g} mm here): which of the two it is, points of another view tell",
            )
    return ()
