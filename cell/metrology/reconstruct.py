"""Surface of a merged cloud: signed distance on a sparse grid and marching cubes, only where points were measured.

The grid is filled only along the surface: first the corners of the cells with points, then from cell to cell across
faces with a change of sign, until no datum is near. Marching cubes (scikit-image) turns the filled cells into faces,
each vertex is moved onto the implicit surface, and surface farther than two point spacings from any datum is cut away:
holes stay holes. Up to that cut the surface extends past the last data: the border of a sheet whose edges no ray met,
and the rim of a hole, get an unmeasured and unmarked strip up to two spacings wide. A larger `reach` widens it. Object
frame, metres.
"""

from dataclasses import dataclass
from enum import Enum
from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from planner.errors import PlannerError
from planner.geometry.mesh import TriangleMesh
from planner.registration.cloud import PointCloud, point_spacing
from planner.registration.surface import FieldValues, ImplicitSurface, close_holes
from planner.values import Floats, Ints, Value, freeze

REACH = 2.0
"""Surface farther than this many point spacings from any datum is cut away."""

SPARSEST = 0.015
"""Point spacing, as a share of the cloud's diagonal, beyond which the surface between the points is a guess."""

NOISIEST = 0.33
"""Scatter of the points about their neighbours' planes, in point spacings, beyond which the surface follows the noise;
the planes follow it too, so a noise sigma of 0.6 spacings appears as this scatter."""

_GRID = 1.25  # of the point spacing: a finer grid costs with its square and, measured, hardly gains
_MAX_NODES = 60_000_000  # of the box round the part (4 bytes and a byte of mask each); a larger grid is coarsened
_MIN_POINTS = 12
_ISOLATED = 3.0  # spacings: a point with a more distant fourth neighbour is an outlier
_OFF_SURFACE = 5.0  # robust standard deviations: a point farther off its neighbours' surface is an outlier
_LEAST = 1e-3  # of a cell: nearer than this to a node or a wall counts as on it
_SIXTEENTHS = np.array([[i, j, 4 - i - j] for i in range(5) for j in range(5 - i)]) / 4.0  # barycentric
_CORNERS = np.array([[i, j, k] for i in (0, 1) for j in (0, 1) for k in (0, 1)])


class ReconstructionStatus(Enum):
    """Result of a reconstruction; the value is a sentence."""

    DONE = "the surface was reconstructed"
    TOO_FEW_POINTS = f"fewer than {_MIN_POINTS} usable points: no surface"
    NO_SURFACE = "the points do not describe a surface: no cell of the grid changes sign near them"


@dataclass(frozen=True, slots=True, eq=False)
class Reconstruction(Value):
    """A reconstructed surface.

    Attributes:
        status: DONE, or the reason for a missing mesh.
        mesh: the surface, object frame; None unless DONE.
        closed: (F,) True for faces that close a hole, which were not measured.
        spacing: point spacing, which determines the resolution [m]; NaN without points.
        grid: edge of a grid cell [m]; larger than requested if the grid would have too many nodes; NaN without a grid.
        nodes: number of evaluated grid nodes.
        outliers: number of points excluded because they are isolated or off their neighbours' surface.
        holes: number of open boundary loops of the measured surface (closed ones included).
        noise: robust standard deviation of the points from the plane of their neighbours [m], including curvature and
            edges; NaN without a mesh.
        extent: diagonal of the box round the points [m]; NaN without a mesh.
        cloud: the points without the outliers.
    """

    status: ReconstructionStatus
    mesh: TriangleMesh | None
    closed: Annotated[NDArray[np.bool_], "F"]
    spacing: float
    grid: float
    nodes: int
    outliers: int
    holes: int
    cloud: PointCloud
    noise: float = float("nan")
    extent: float = float("nan")

    def __post_init__(self) -> None:
        freeze(self, F=0 if self.mesh is None else len(self.mesh.faces))

    @property
    def doubts(self) -> tuple[str, ...]:
        """One sentence for each reason why the surface may be inaccurate."""
        sentences = []
        if self.spacing > SPARSEST * self.extent:
            sentences.append(
                f"the points lie {1e3 * self.spacing:.3g} mm apart, more than {100 * SPARSEST:g} % of their extent: "
                "the surface between them is uncertain; scan at a finer resolution"
            )
        if self.noise > NOISIEST * self.spacing:
            sentences.append(
                f"the points scatter by {1e3 * self.noise:.3g} mm about the surface, more than {NOISIEST:g} of their "
                f"spacing of {1e3 * self.spacing:.3g} mm: the surface follows the noise"
            )
        return tuple(sentences)


def reconstruct(
    cloud: PointCloud, *, grid: float | None = None, close: bool = False, reach: float = 0.0
) -> Reconstruction:
    """Reconstruct the surface of a cloud.

    The two faces of a sheet stay separate if the sheet is thicker than one grid cell; a thinner one needs a finer grid.

    Args:
        cloud: merged scans with normals, object frame.
        grid: edge of a cell [m]; default 1.25 point spacings.
        close: whether to close the remaining holes with faces marked in `closed`.
        reach: distance from the nearest datum up to which the surface extends, if larger than `REACH` spacings [m];
            surface beyond those is extrapolated and not marked.
    """
    if grid is not None and not grid > 0:
        raise PlannerError(f"grid is {grid}; it must be positive (in metres)")
    if not reach >= 0:
        raise PlannerError(f"reach is {reach}; it must not be negative (in metres)")
    spacing = point_spacing(cloud.points, cloud.scan)
    kept, noise = cloud, float("nan")
    if len(cloud) >= _MIN_POINTS and spacing > 0:
        kept, noise = _without_outliers(cloud, spacing)
    outliers = len(cloud) - len(kept)

    def no_mesh(status: ReconstructionStatus, step: float = float("nan"), nodes: int = 0) -> Reconstruction:
        return Reconstruction(status, None, np.empty(0, np.bool_), spacing, step, nodes, outliers, 0, kept)

    if len(kept) < _MIN_POINTS or not spacing > 0:
        return no_mesh(ReconstructionStatus.TOO_FEW_POINTS)
    surface = ImplicitSurface(kept)
    cut = max(REACH * spacing, reach)
    volume = _Grid(kept.points, _GRID * spacing if grid is None else grid, cut)
    volume.fill(surface, kept.points)
    contour = volume.contour()
    if contour is None:
        return no_mesh(ReconstructionStatus.NO_SURFACE, volume.step, volume.nodes)
    vertices, faces = _refine_and_cut(surface, *contour, cut, volume.step)
    if not len(faces):
        return no_mesh(ReconstructionStatus.NO_SURFACE, volume.step, volume.nodes)
    mesh, closed, holes = close_holes(TriangleMesh(vertices, faces), close=close)
    extent = float(np.linalg.norm(np.ptp(kept.points, axis=0)))
    done = ReconstructionStatus.DONE
    return Reconstruction(done, mesh, closed, spacing, volume.step, volume.nodes, outliers, holes, kept, noise, extent)


def _without_outliers(cloud: PointCloud, spacing: float) -> tuple[PointCloud, float]:
    """Return the cloud without outliers, and the robust deviation from the planes of the neighbours [m]."""
    tree = cKDTree(cloud.points, balanced_tree=False, compact_nodes=False)
    distance, index = map(np.asarray, tree.query(cloud.points, min(9, len(cloud)), workers=2))
    is_isolated = distance[:, 4] > _ISOLATED * spacing
    # The height over the neighbours' planes; an outlier among the neighbours does not change the median.
    offset = cloud.points[:, None, :] - cloud.points[index[:, 1:]]
    height = np.abs(np.median(np.einsum("nkj,nkj->nk", offset, cloud.normals[index[:, 1:]]), axis=1))
    noise = 1.4826 * float(np.median(height))
    # Points at edges are off their neighbours' planes, so a quarter of a spacing is the smallest limit.
    is_off = height > max(_OFF_SURFACE * noise, 0.25 * spacing)
    keep = ~(is_isolated | is_off)
    return PointCloud(cloud.points[keep], cloud.normals[keep], cloud.scan[keep]), noise


class _Grid:
    """A box of nodes, filled only along the surface; indices are flat, C order."""

    def __init__(self, points: Floats, step: float, cut: float) -> None:
        low, high = points.min(axis=0), points.max(axis=0)
        # The margin lets the surface extend up to the cut, and one more cell.
        while True:
            self.step = step
            margin = cut + 2 * step
            self.shape = tuple(int(n) for n in np.ceil((high - low + 2 * margin) / step).astype(int) + 1)
            if np.prod([float(n) for n in self.shape]) <= _MAX_NODES:
                break
            step *= 1.05
        self.origin: Floats = low - margin
        self._stride = np.array([self.shape[1] * self.shape[2], self.shape[2], 1], dtype=np.int64)
        self._corner = _CORNERS @ self._stride
        self._cut = cut + np.sqrt(3) * step  # includes all nodes of a cell with surface within the cut
        self._value = np.full(int(np.prod(self.shape)), np.nan, dtype=np.float32)
        self._is_evaluated = np.zeros(len(self._value), dtype=np.bool_)
        self._is_active = np.zeros(len(self._value), dtype=np.bool_)
        self.nodes = 0

    def fill(self, surface: ImplicitSurface, points: Floats) -> None:
        """Evaluate the nodes along the surface, outward from the cells with points."""
        # A point on the wall between two cells belongs to both: rounding decides in which of them the surface lies.
        place = (points - self.origin) / self.step
        cells = _distinct(
            np.concatenate(
                [_distinct(np.floor(place + _LEAST * (2 * c - 1)).astype(np.int64) @ self._stride) for c in _CORNERS]
            )
        )
        is_visited = np.zeros(len(self._value), dtype=np.bool_)
        while len(cells):
            is_visited[cells] = True
            nodes = (cells[:, None] + self._corner).ravel()
            nodes = _distinct(nodes[~self._is_evaluated[nodes]])
            self._is_evaluated[nodes] = True
            self._evaluate(surface, nodes)
            corners = self._value[cells[:, None] + self._corner]
            inside = corners < 0
            complete = ~np.isnan(corners).any(axis=1)
            crossed = complete & inside.any(axis=1) & ~inside.all(axis=1)
            self._is_active[cells[crossed]] = True
            cells = self._neighbours(cells[crossed], inside[crossed])
            cells = cells[~is_visited[cells]]

    def _evaluate(self, surface: ImplicitSurface, nodes: Ints) -> None:
        """Evaluate the signed distance at nodes; NaN remains where no datum is near."""
        index = np.stack(np.unravel_index(nodes, self.shape), axis=1)
        field = surface.evaluate(self.origin + self.step * index)
        # A surface through a node would make faces without area; the vertices are corrected at the end.
        least = np.float32(_LEAST * self.step)
        distance = np.where(field.distance < 0, np.minimum(field.distance, -least), np.maximum(field.distance, least))
        self._value[nodes] = np.where(field.nearest <= self._cut, distance, np.float32(np.nan))
        self.nodes += len(nodes)

    def _neighbours(self, cells: Ints, inside: NDArray[np.bool_]) -> Ints:
        """Return the cells behind faces of active cells with a change of sign."""
        neighbours = [np.empty(0, dtype=np.int64)]
        for axis in range(3):
            for side in (0, 1):
                face = inside[:, _CORNERS[:, axis] == side]
                changes = face.any(axis=1) & ~face.all(axis=1)
                neighbours.append(cells[changes] + (2 * side - 1) * self._stride[axis])
        return _distinct(np.concatenate(neighbours))

    def contour(self) -> tuple[Floats, NDArray[np.int32]] | None:
        """Return vertices [m] and faces of the zero level; None if the surface crosses no cell."""
        if not self._is_active.any():
            return None
        from skimage.measure import marching_cubes  # takes a third of a second to import

        # scikit-image takes a cell when the mask is set at its far corner.
        mask = np.zeros_like(self._is_active)
        mask[self._corner[-1] :] = self._is_active[: -self._corner[-1]]
        volume = np.where(np.isnan(self._value), np.float32(self.step), self._value).reshape(self.shape)
        vertices, faces, _, _ = marching_cubes(volume, 0.0, mask=mask.reshape(self.shape), gradient_direction="descent")
        return self.origin + self.step * vertices.astype(np.float64), faces.astype(np.int32)


def _refine_and_cut(
    surface: ImplicitSurface, vertices: Floats, faces: NDArray[np.int32], cut: float, step: float
) -> tuple[Floats, NDArray[np.int32]]:
    """Move vertices onto the implicit surface; drop faces beyond the cut and faces opposite to their data's normals."""
    field: FieldValues = surface.evaluate(vertices)
    shift = np.clip(field.distance, -step / 2, step / 2)  # the error of linear interpolation along an edge is smaller
    vertices = vertices - (shift[:, None] * field.normal).astype(np.float64)
    near = field.nearest <= cut
    corners = vertices[faces]
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    agrees = np.einsum("fj,fcj->f", cross, field.normal[faces].astype(np.float64)) > 0
    faces = faces[near[faces].all(axis=1) & agrees]
    faces = faces[_is_near_throughout(surface, vertices, faces, field.nearest + np.abs(shift), cut)]
    is_used = np.zeros(len(vertices), dtype=np.bool_)
    is_used[faces] = True
    return vertices[is_used], (np.cumsum(is_used, dtype=np.int32) - 1)[faces]


def _is_near_throughout(
    surface: ImplicitSurface, vertices: Floats, faces: NDArray[np.int32], nearest: NDArray[np.float32], cut: float
) -> NDArray[np.bool_]:
    """Return (F,) whether a face lies within the cut entirely: a face may span a gap between its corners.

    A face is evaluated at the corners of its 16 equal parts. No point of it is farther from one of these than the
    longest edge of a part over the root of three, so the cut is reduced by that distance (limited, because a grid far
    coarser than the points would leave nothing).
    """
    corners = vertices[faces]
    farthest = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(axis=1) / np.sqrt(3)
    is_near = np.ones(len(faces), dtype=np.bool_)
    doubtful = np.flatnonzero(nearest[faces].max(axis=1) + farthest > cut)
    places = np.einsum("pc,fcj->fpj", _SIXTEENTHS, corners[doubtful])
    distance = surface.evaluate(places.reshape(-1, 3)).nearest.reshape(places.shape[:2])
    reduction = np.minimum(farthest[doubtful] / 4, cut / 4)
    is_near[doubtful] = (distance <= (cut - reduction)[:, None]).all(axis=1)
    return is_near


def _distinct(values: Ints) -> Ints:
    """Return sorted unique values; NumPy's `unique` hashes, which takes several times as long for millions."""
    ordered = np.sort(values)
    return ordered[np.concatenate([[True], ordered[1:] != ordered[:-1]])] if len(ordered) else ordered
