"""Candidates where they are needed: a thinned mix of view sphere and normals, and views aimed at what stays open.

The base set holds the view sphere (Section 3.4.1), which sees the part as a whole, and a well-spread subset of the
optimal scanning zone (Section 3.4.2), which sees its niches; the paper's generators take one or the other, whole. What
no candidate of the base set measures is then aimed at: one surface point after another is looked at along directions
from its normal to the grazing limit, from several standoffs in the scanner's range, at four rolls. The limits are asked
of the scanner's own law, so they are those of any scanner.

This file makes candidates; whether they are reached and what they measure is asked by `cell.plan.candidates`. Object
frame, metres, radians.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from planner.errors import PlannerError
from planner.ports import RayCaster, Rejection, Scanner
from planner.surface.mesh import TriangleMesh, face_areas, face_centres, face_normals
from planner.values import Bools, Floats, Ints
from planner.viewpoints.lines_of_sight import Targets, flat_poses, free_pairs, in_view, legs_free
from planner.viewpoints.sphere import view_sphere
from planner.viewpoints.viewpoints import Viewpoints, join_viewpoints, looking_at, pick_viewpoints
from planner.viewpoints.zone import optimal_scanning_zone

NORMALS = 200
"""Faces whose normals join the view sphere; benchmarks/candidates.py is drawn with it."""

_MARGIN = 0.02  # of the range: rounded joint angles move the source by micrometres, and a view at the limit would fail
_MARGIN_TILT = np.deg2rad(2.0)  # the same of the grazing limit
_TILTS = (0.0, 0.4, 0.75, 1.0)  # shares of the largest tilt
_AZIMUTHS = 8
_ROLLS = tuple(np.deg2rad((0.0, 90.0, 180.0, 270.0)).tolist())


@dataclass(frozen=True, slots=True)
class Limits:
    """How far aimed views may go, by the scanner's own law.

    Attributes:
        near: smallest standoff [m].
        far: largest standoff [m].
        tilt: largest angle between the viewing direction and the surface's normal [rad].
    """

    near: float
    far: float
    tilt: float


def base_set(
    planning: TriangleMesh,
    centre: ArrayLike,
    radius: float,
    steps: tuple[float, float],
    standoffs: Sequence[float],
    rolls: Sequence[float],
    *,
    normals: int = NORMALS,
) -> Viewpoints:
    """The view sphere, then the optimal scanning zone of a well-spread subset of the faces.

    Args:
        planning: the decimated mesh, object frame.
        centre: (3,) point that the sphere's views look at [m].
        radius: of the sphere [m].
        steps: of the sphere, about x and about y [rad].
        standoffs: of the normals' views [m].
        rolls: of both [rad].
        normals: number of faces; a coarser mesh gives all of its faces.
    """
    sphere = view_sphere(centre, radius, steps[0], steps[1], rolls)
    zone = optimal_scanning_zone(planning, standoffs, rolls)
    face = np.flatnonzero(face_areas(planning) > 0)
    kept = face[spread(face_centres(planning)[face], face_normals(planning)[face], normals, standoffs[0])]
    return join_viewpoints([sphere, pick_viewpoints(zone, np.isin(zone.face, kept))])


def spread(points: Floats, normals: Floats, count: int, scale: float) -> Ints:
    """A subset whose members differ in place and direction: each is the one farthest from those before it.

    Farthest-point sampling [1] on (point / scale, normal), so that a turn by one radian counts as much as a way of
    one scale. It starts at the point farthest from the mean; ties go to the smaller index.

    [1] T. F. Gonzalez, Clustering to minimize the maximum intercluster distance, Theoretical Computer Science 38,
        1985, doi:10.1016/0304-3975(85)90224-5.

    Args:
        points: (N, 3) [m].
        normals: (N, 3) unit vectors.
        count: how many are wanted; at most N come back.
        scale: length that counts as much as one radian [m].

    Returns:
        (min(count, N),) indices, in the order in which they were taken.

    Raises:
        PlannerError: if the scale is not positive.
    """
    if not scale > 0:
        raise PlannerError(f"the scale of a spread is {scale:g} m; it must be above 0")
    count = min(count, len(points))
    taken = np.empty(count, dtype=np.int64)
    if not count:
        return taken
    where = np.concatenate([points / scale, normals], axis=1)
    distance = ((where - where.mean(axis=0)) ** 2).sum(axis=1)
    nearest = np.full(len(where), np.inf)
    for place in range(count):
        taken[place] = int(distance.argmax())
        nearest = np.minimum(nearest, ((where - where[taken[place]]) ** 2).sum(axis=1))
        nearest[taken[place]] = -1.0  # of two equal ones, each is taken before any is taken twice
        distance = nearest
    return taken


def limits(scanner: Scanner, standoff: float) -> Limits:
    """Range and tilt within which a view that is aimed at a point can measure it, asked of the scanner.

    The range is the longest stretch of distances about the standoff at which a point on the axis, facing the scanner,
    is measured (looked at from a tenth to ten times the standoff in steps of 0.5 %); the tilt is the largest whole
    degree at which such a point at the standoff is, leaning towards any of eight sides. Both keep a margin.

    Args:
        scanner: the sensor's law.
        standoff: the default one [m].
    """
    distances = standoff * np.exp(np.arange(-460, 461) * 0.005)
    facing = np.tile([0.0, 0.0, -1.0], (len(distances), 1))
    good = scanner.reject(distances[:, None] * [0.0, 0.0, 1.0], facing) == Rejection.MEASURED
    middle = len(distances) // 2
    if not good[middle]:
        return Limits(standoff, standoff, 0.0)
    below, above = np.flatnonzero(~good[:middle]), np.flatnonzero(~good[middle:])
    near = distances[below[-1] + 1] if len(below) else distances[0]
    far = distances[middle + above[0] - 1] if len(above) else distances[-1]
    angles, around = np.meshgrid(np.deg2rad(np.arange(91)), np.arange(_AZIMUTHS) * (2 * np.pi / _AZIMUTHS))
    leaning = np.stack(
        [np.sin(angles) * np.cos(around), np.sin(angles) * np.sin(around), -np.cos(angles)], axis=-1
    ).reshape(-1, 3)
    codes = scanner.reject(np.tile([0.0, 0.0, standoff], (len(leaning), 1)), leaning).reshape(angles.shape)
    tilt = float(angles[codes == Rejection.MEASURED].max(initial=0.0))
    return Limits(
        min(near * (1 + _MARGIN), standoff), max(far * (1 - _MARGIN), standoff), max(tilt - _MARGIN_TILT, 0.0)
    )


def aimed_at(
    points: Floats, normals: Floats, face: NDArray[np.integer], standoff: float, within: Limits
) -> tuple[Viewpoints, Ints]:
    """Views at each point: every direction, standoff and roll of the family; small tilts and the default first.

    Args:
        points: (n, 3) surface points [m].
        normals: (n, 3) outward unit normals.
        face: (n,) planning faces that the points lie on.
        standoff: the default one [m].
        within: how far the family goes.

    Returns:
        The views, and the (V,) index of the point that each is aimed at.
    """
    lean = within.tilt * np.array([_TILTS[0], *np.repeat(_TILTS[1:], _AZIMUTHS)])
    around = np.concatenate([[0.0], np.tile(np.arange(_AZIMUTHS) * (2 * np.pi / _AZIMUTHS), len(_TILTS) - 1)])
    across = np.cross(normals, np.eye(3)[np.abs(normals).argmin(axis=1)])
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    along = np.cross(normals, across)
    sideways = np.cos(around)[:, None] * across[:, None] + np.sin(around)[:, None] * along[:, None]
    outward = np.cos(lean)[:, None] * normals[:, None] + np.sin(lean)[:, None] * sideways
    lengths = [standoff, (within.near + standoff) / 2, (standoff + within.far) / 2, within.near, within.far]
    standoffs = list(dict.fromkeys(float(length) for length in lengths))
    directions = len(lean)
    owner = np.repeat(np.arange(len(points)), directions)
    views = looking_at(points[owner], outward.reshape(-1, 3), np.asarray(face)[owner], standoffs, _ROLLS)
    return views, np.repeat(owner, len(standoffs) * len(_ROLLS))


def sees_its_point(
    views: Viewpoints, targets: Targets, row: Ints, scanner: Scanner, casters: Sequence[RayCaster]
) -> Bools:
    """Whether each view measures the one feature that it is aimed at: conditions first, then its two legs.

    Args:
        views: V views of one pose.
        targets: S features.
        row: (V,) feature of each view.
        scanner: the sensor's law.
        casters: the part's and those of occluders.
    """
    poses = flat_poses(views.T_object_scanner)
    R, origin = poses[:, :3, :3], poses[:, :3, 3]
    local = np.einsum("nij,ni->nj", R, targets.points[:, row].T - origin)
    seen = scanner.reject(local, np.einsum("nij,ni->nj", R, targets.normals[:, row].T)) == Rejection.MEASURED
    pose = np.flatnonzero(seen)
    seen[pose] = legs_free(targets, poses, pose, row[pose], scanner, casters)
    return np.asarray(seen)


def measured_rows(
    views: Viewpoints, targets: Targets, rows: Ints, scanner: Scanner, casters: Sequence[RayCaster]
) -> Bools:
    """Which of some features each view measures.

    Args:
        views: V views of one pose.
        targets: S features.
        rows: (n,) the features to ask about.
        scanner: the sensor's law.
        casters: the part's and those of occluders.

    Returns:
        (n, V) True where the view measures the feature.
    """
    poses = flat_poses(views.T_object_scanner)
    result = np.zeros((len(targets), len(poses)), dtype=np.bool_)
    for _, pose, row in free_pairs(
        poses, targets, scanner, casters, lambda i: in_view(targets, poses[i], scanner, rows)
    ):
        result[row, pose] = True
    return result[rows]


def most_useful(measured: Bools, areas: Floats, depth: int) -> Ints:
    """Few views that measure what any of the views measures, each feature by `depth` of them where that many can.

    Greedy: the view that adds most area to features which still want views; ties go to the smaller index.

    Args:
        measured: (n, V) what each view measures.
        areas: (n,) [m^2].
        depth: choice that is left to the selection.

    Returns:
        Views, ascending.
    """
    wants = np.minimum(measured.sum(axis=1), depth)
    left = measured.copy()
    taken: list[int] = []
    while (wants > 0).any():
        gain = (areas * (wants > 0)) @ left
        best = int(gain.argmax())
        taken.append(best)
        wants = wants - left[:, best]
        left[:, best] = False
    return np.array(sorted(taken), dtype=np.int64)
