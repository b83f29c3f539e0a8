"""Belief about the part: its surfaces for planning, the unseen space as an obstacle, and causes of uncovered surface.

The **belief surface** encloses voxels that are not free (marching cubes, at a distance from their centres): rays are
expected to meet it. The obstacle for arm and housing encloses every voxel that is not free completely, at a distance
from their corners.

The **measured surface** is reconstructed from all points. Voxels fill tubes and slots narrower than twice the depth of
the belief and hide their walls; the measured surface does not. It is continued beyond its border along its last
normals, where no part lies in front. Where none of its faces has a similar normal, the rest of the belief surface
remains: a lid across a tube, the unseen side of a sheet. Everything in free space is cut off.

The explored frame has its origin at the centre of the cylinder and the axes of base; it is the object frame of every
batch. Metres.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
from scipy import ndimage
from scipy.spatial import cKDTree

from cell.metrology.reconstruct import REACH, ReconstructionStatus, reconstruct
from cell.part import workpiece
from cell.part.workpiece import Workpiece
from cell.runs import ply
from cell.runs.run import ExecutedScan
from cell.runs.schema import UNSEEN, UncoveredArea
from cell.scene.model import CylinderFixture, MeshFixture, Scene
from planner.explore.gain import OpenSamples
from planner.explore.space import FREE, UNKNOWN, VoxelSpace, first_in_cubes
from planner.geometry.mesh import TriangleMesh, concatenate_meshes, without_unused
from planner.geometry.sampling import SurfaceSamples
from planner.kinematics.reach import Reach
from planner.ports import RayCaster, Scanner
from planner.registration.cloud import PointCloud, ScanCloud, merge
from planner.values import Bools, Floats, Ints, Value
from planner.viewpoints.lines_of_sight import RayTargets
from planner.viewpoints.viewpoints import Viewpoints
from planner.why import why
from planner.why.why import REASON_OF_VERDICT, Reason

_TIGHT, _SMOOTH = 0.75, 0.7  # in voxel edges: distance of the belief surface from voxel centres, and sigma of smoothing
_ROUGH = 0.87  # in voxel edges: distance of the surface for candidates
_OBSTACLE_DISTANCE = 0.37  # in voxel edges: distance of the obstacle for arm and housing beyond the voxels
_BLOCK = 2  # in voxel edges: block size of coarse surfaces, which have a quarter of the faces


@dataclass(frozen=True, slots=True)
class Cylinder:
    """An upright cylinder about the placement.

    Attributes:
        radius: [m].
        height: [m].
        is_given: whether the user gave it; else it encloses the simulated part.
    """

    radius: float
    height: float
    is_given: bool


def surface_about(space: VoxelSpace, voxels: Bools) -> TriangleMesh:
    """Return the belief surface about selected voxels (X, Y, Z) [m]."""
    return _surface_at(space.low, space.edge, voxels, _TIGHT, _SMOOTH)


def belief_part(surface: TriangleMesh, name: str, known: str = "believed") -> Workpiece:
    """Return a belief or measured surface as a part, named as such."""
    return workpiece.from_trusted_mesh(f"{name} as {known}", surface)


def coarse_surface(space: VoxelSpace, *, unlimited: bool = False) -> TriangleMesh:
    """Return a surface with few faces about the belief [m]; `unlimited` disregards the votes of missing returns."""
    return _surface_at(
        space.low, _BLOCK * space.edge, _blocks(space.belief_voxels(unlimited=unlimited)), _ROUGH, _SMOOTH
    )


def write_unseen(space: VoxelSpace, path: Path) -> None:
    """Write the obstacle for arm and housing as a mesh file in millimetres."""
    path.write_bytes(ply.mesh_bytes(enclosing_surface(space, np.asarray(space.state != FREE))))


def enclosing_surface(space: VoxelSpace, voxels: Bools) -> TriangleMesh:
    """Return a surface with few faces that encloses every selected voxel completely [m]."""
    blocks = np.pad(_blocks(voxels), 1)
    x, y, z = (size - 1 for size in blocks.shape)
    corners = np.zeros((x, y, z), dtype=np.bool_)
    for i, j, k in np.ndindex(2, 2, 2):
        corners |= blocks[i : i + x, j : j + y, k : k + z]
    edge = _BLOCK * space.edge
    return _surface_at(space.low - edge / 2, edge, corners, _OBSTACLE_DISTANCE, 0.0)


def batch_scene(scene: Scene, cylinder: Cylinder, surface: Workpiece, unseen: Path) -> Scene:
    """Return the scene of a batch: the belief in place of the part, with the unseen space as a fixture.

    Args:
        scene: of the exploration.
        cylinder: about its placement.
        surface: the belief as a part, explored frame.
        unseen: file of `write_unseen`.
    """
    place = np.asarray(scene.placement.position_mm)
    centre = place + 1000 * surface.centre
    space = MeshFixture(
        name=UNSEEN, shape="mesh", path=str(unseen.absolute()), units="mm", occludes=False,
        position_mm=tuple(place.tolist()),
    )  # fmt: skip
    scene = with_stand(scene, cylinder)
    placement = scene.placement.model_copy(update={"position_mm": tuple(centre.tolist()), "abc_deg": (0.0, 0.0, 0.0)})
    part = scene.part.model_copy(update={"path": None, "units": None})
    return scene.model_copy(update={"placement": placement, "part": part, "fixtures": (*scene.fixtures, space)})


def _blocks(voxels: Bools) -> Bools:
    """Return the blocks of voxels that contain a selected one."""
    nx, ny, nz = (n // _BLOCK for n in voxels.shape)  # a grid has even numbers of voxels
    return np.asarray(voxels.reshape(nx, _BLOCK, ny, _BLOCK, nz, _BLOCK).any(axis=(1, 3, 5)))


def _surface_at(low: Floats, edge: float, cells: Bools, level: float, smooth: float) -> TriangleMesh:
    """Return the surface at a distance from the centres of cells, with smoothed distances [edges of a cell]."""
    from skimage.measure import marching_cubes  # takes a third of a second to import

    distance = ndimage.distance_transform_edt(~cells)
    if smooth and (smoothed := ndimage.gaussian_filter(distance, smooth)).min() < level:  # of lone cells it leaves none
        distance = smoothed
    vertices, faces, _, _ = marching_cubes(distance.astype(np.float32), level, gradient_direction="descent")
    return TriangleMesh(low + edge * (vertices.astype(np.float64) + 0.5), faces.astype(np.int32))


CYLINDER_MARGIN = 1.05
"""Ratio of the default cylinder to a simulated part: the precision of a user's estimate of its size."""

STAND = "stand"
"""Name of the post as a fixture. A post of the scene would move with the belief surface of a stage."""


@dataclass(frozen=True, slots=True, eq=False)
class GroundTruth:
    """The part in the cell, which the planner does not know.

    Attributes:
        mesh: in the explored frame [m].
        T_explored_object: (4, 4) from the object frame [m].
    """

    mesh: TriangleMesh
    T_explored_object: Floats

    @classmethod
    def of(cls, scene: Scene, part: Workpiece) -> "GroundTruth":
        """Return the part at the placement of the scene."""
        T = np.eye(4)
        T[:3, :3] = scene.placement.T[:3, :3]
        T[:3, 3] = -T[:3, :3] @ part.centre
        vertices = part.reference.vertices @ T[:3, :3].T + T[:3, 3]
        return cls(TriangleMesh(vertices, part.reference.faces), T)


def enclosing_cylinder(hidden: GroundTruth) -> Cylinder:
    """Return the cylinder about a simulated part, wider by `CYLINDER_MARGIN`; its bottom is the lowest point."""
    vertices = hidden.mesh.vertices
    radius = float(np.hypot(vertices[:, 0], vertices[:, 1]).max())
    return Cylinder(CYLINDER_MARGIN * radius, 2 * float(np.abs(vertices[:, 2]).max()), is_given=False)


def with_stand(scene: Scene, cylinder: Cylinder) -> Scene:
    """Return the scene with a fixture below the cylinder instead of its post."""
    if not scene.post.enabled:
        return scene
    x, y, z = scene.placement.position_mm
    bottom, floor = z - 500 * cylinder.height, -scene.robot.pedestal_height_mm
    if bottom <= floor:
        return scene.model_copy(update={"post": scene.post.model_copy(update={"enabled": False})})
    stand = CylinderFixture(
        name=STAND, shape="cylinder", position_mm=(x, y, (bottom + floor) / 2),
        size_mm=(scene.post.diameter_mm, bottom - floor),
    )  # fmt: skip
    post = scene.post.model_copy(update={"enabled": False})
    return scene.model_copy(update={"post": post, "fixtures": (*scene.fixtures, stand)})


_CONTINUATION = 4.0
"""Continuation of the surface beyond its border, in voxel edges. 4 measures more of tubes than 6 and 8."""

_CUBE = 0.5
"""Size of the cubes that keep one point each, in voxel edges. A finer surface does not improve the sampled plan."""

_MAX_CUBES = 40_000
"""Largest number of cubes; more are avoided by larger cubes. This halves the planning time of a stage."""

_GRID = 1.5  # grid of the reconstruction, in sides of those cubes
_MARGIN_AHEAD = 0.5  # in voxel edges: the belief surface is cut off from here in front of the measured one
_NEARBY, _FACES = 2.0, 3
"""Edges about a face of the believed surface, and how many faces of the other one next to it, of which one looks to the
same side where the believed one has no place."""


def reconstruct_scans(scans: Sequence[ExecutedScan]) -> TriangleMesh | None:
    """Return the surface of all scans, explored frame [m]; None without one."""
    return reconstruct(merge([ScanCloud(scan.points, scan.T_reported[:3, 3]) for scan in scans])).mesh


def continue_surface(scans: Sequence[ExecutedScan], space: VoxelSpace, solid: Bools) -> TriangleMesh | None:
    """Return the measured surface of thinned points with its continuation, explored frame [m].

    Args:
        scans: all scans.
        space: voxels after them; free and rejected voxels end the continuation.
        solid: (X, Y, Z) voxels of the belief.

    Returns:
        The surface for planning; None if there are too few points.
    """
    points, apart = _thin_points(scans, _CUBE * space.edge)
    reconstruction = reconstruct(merge(points), grid=_GRID * apart, reach=_CONTINUATION * space.edge)
    if reconstruction.status is ReconstructionStatus.TOO_FEW_POINTS:
        return None
    parts, tree = list[TriangleMesh](), cKDTree(reconstruction.cloud.points, balanced_tree=False, compact_nodes=False)
    if reconstruction.mesh is not None:
        middles = reconstruction.mesh.centres
        near = tree.query(middles, distance_upper_bound=REACH * reconstruction.spacing, workers=2)[0]
        parts += _submesh(
            reconstruction.mesh, np.isfinite(near) | space.values_at(middles, space.maybe_part).astype(np.bool_)
        )
    lids = surface_about(space, solid & ~_ahead_of(reconstruction.cloud, tree, space, solid))
    parts += _submesh(lids, ~_has_similar_normal(lids, parts[0], _NEARBY * space.edge)) if parts else [lids]
    vertices, faces, _ = concatenate_meshes([(each.vertices, each.faces) for each in parts])
    return TriangleMesh(vertices, faces.astype(np.int32))


def _thin_points(scans: Sequence[ExecutedScan], apart: float) -> tuple[list[ScanCloud], float]:
    """Return the first point of each cube of an edge [m], by scan, and the edge, larger for too many cubes."""
    points = np.concatenate([scan.points for scan in scans]) if scans else np.empty((0, 3))
    number = np.repeat(np.arange(len(scans)), [len(scan.points) for scan in scans])
    rows = first_in_cubes(points, apart)
    while len(rows) > _MAX_CUBES:
        apart *= np.sqrt(len(rows) / _MAX_CUBES) + 0.01
        rows = rows[first_in_cubes(points[rows], apart)]
    points, number = points[rows], number[rows]
    clouds = [ScanCloud(points[number == each], scan.T_reported[:3, 3]) for each, scan in enumerate(scans)]
    return clouds, apart


def _ahead_of(cloud: PointCloud, tree: cKDTree, space: VoxelSpace, solid: Bools) -> Bools:
    """Return (X, Y, Z) belief voxels in front of a cloud's surface and its continuation, except hit ones."""
    doubtful = solid & (space.state == UNKNOWN)
    centres = space.centres(doubtful)
    nearest, at = map(np.asarray, tree.query(centres, distance_upper_bound=_CONTINUATION * space.edge, workers=2))
    near = np.isfinite(nearest)
    legs, normals = centres[near] - cloud.points[at[near]], cloud.normals[at[near]]
    ahead, of_near = np.zeros(doubtful.shape, dtype=np.bool_), np.zeros(len(near), dtype=np.bool_)
    of_near[near] = np.einsum("nj,nj->n", legs, normals) > _MARGIN_AHEAD * space.edge
    ahead[doubtful] = of_near
    return ahead


def _has_similar_normal(lids: TriangleMesh, surface: TriangleMesh, distance: float) -> Bools:
    """Return (F,) whether a face of `surface` within `distance` [m] has a normal to the same side as each lid."""
    _, at = cKDTree(surface.centres).query(lids.centres, _FACES, distance_upper_bound=distance, workers=2)
    normals = np.concatenate([surface.normals, np.zeros((1, 3))])[np.asarray(at)]  # the last row: no face nearby
    return np.asarray((np.einsum("fkj,fj->fk", normals, lids.normals) > 0).any(axis=1))


def _submesh(mesh: TriangleMesh, selection: Bools) -> list[TriangleMesh]:
    """Return the mesh of selected faces as a list, empty without any."""
    return [without_unused(mesh.vertices, mesh.faces[selection])] if selection.any() else []


REMAINDER, MISSED, NOT_SELECTED = -3, -2, -1
"""Causes beside `Reason`: surface that its views missed, near measured surface and far from it; and surface of a view
that was not selected."""

NEAR_MEASURED = 2.0
"""Distance from the middle of a measured voxel [voxel edges] within which missed surface is a remainder: its believed
position and normal are too uncertain for any other reason."""

_OCCLUDED = (Reason.SOURCE_SHADED_BY_PART, Reason.SENSOR_SHADED_BY_PART, Reason.SOURCE_SHADED, Reason.SENSOR_SHADED)

_SENTENCES: dict[int, str] = {
    REMAINDER: "remainder within two voxels of measured surface, missed by the views for it",
    MISSED: "missed by views that should measure it: too steep, or not part of the surface",
    NOT_SELECTED: "measurable by a reachable view that was not selected",
    **dict.fromkeys(_OCCLUDED, "laser or sensor occluded"),
    Reason.OUT_OF_REACH: "views that might measure it are out of reach",
    Reason.JOINT_LIMIT: "views that might measure it are beyond a joint limit",
    Reason.COLLISION: "views that might measure it are in collision, or too close to unseen space",
}
"""Sentences about belief surface. Which line of sight is occluded, and by what, is not known within a voxel."""


@dataclass(frozen=True, slots=True, eq=False)
class UncoveredReport(Value):
    """Uncovered samples of the belief surface with their causes.

    Attributes:
        samples: N samples.
        reason: (N,) `Reason` values, `REMAINDER`, `MISSED` or `NOT_SELECTED`.
        candidates: tested viewpoints.
    """

    samples: SurfaceSamples
    reason: Annotated[Ints, "N"]
    candidates: Viewpoints

    def by_area(self) -> tuple[UncoveredArea, ...]:
        """Return the area by cause, largest first."""
        causes = np.array([describe_cause(code) for code in self.reason.tolist()], dtype=object)
        areas = {
            cause: 1e6 * float(self.samples.areas[causes == cause].sum()) for cause in dict.fromkeys(causes.tolist())
        }
        return tuple(
            UncoveredArea(cause=cause, area_mm2=round(area, 3))
            for cause, area in sorted(areas.items(), key=lambda item: -item[1])
        )


def describe_cause(code: int) -> str:
    """Return a cause in words."""
    return _SENTENCES.get(code) or Reason(code).sentence


def assign_causes(
    samples: SurfaceSamples,
    of: OpenSamples,
    candidates: Viewpoints,
    reached: Reach,
    scanner: Scanner,
    casters: Sequence[RayCaster],
) -> UncoveredReport:
    """Return uncovered samples with their causes.

    Args:
        samples: uncovered samples of the belief surface.
        of: their classes.
        candidates: tested viewpoints.
        reached: their verdicts.
        scanner: the scanner.
        casters: ray casters of the belief and of the occluders.
    """
    closest = closest_causes(samples, candidates, reached, scanner, casters)
    reason = np.where(closest == Reason.NOT_SELECTED, np.where(of.tries > 0, MISSED, NOT_SELECTED), closest)
    # Occlusion by other objects so close is a voxel of belief inside the support of the part.
    reason[(of.tries > 0) & (of.distance_edges <= NEAR_MEASURED) & (closest >= Reason.SOURCE_SHADED)] = REMAINDER
    return UncoveredReport(samples, reason, candidates)


def closest_causes(
    samples: SurfaceSamples, candidates: Viewpoints, reached: Reach, scanner: Scanner, casters: Sequence[RayCaster]
) -> Ints:
    """Return (S,) the `Reason` of the candidate that comes closest to measuring each sample."""
    targets, rows = RayTargets.of(samples.points, samples.normals), np.arange(len(samples))
    diagnosis = why.diagnose(targets, rows, candidates, scanner, casters, REASON_OF_VERDICT[reached.verdict])
    return diagnosis.reason.astype(np.int64)
