"""What is believed of the part, as `cell plan` wants it: a part to measure, and unseen space that nothing may touch.

Both are surfaces about voxels (marching cubes). The believed part is the tight one, at a distance from their middles:
it is what rays are thought to meet. What arm and housing keep away from holds every voxel that is not free as a whole:
it is at a distance from their corners, as a surface about middles would cut the corners of what sticks out.
"""

from pathlib import Path

import numpy as np
from scipy import ndimage

from cell.explore.hidden import Cylinder, with_stand
from cell.part import workpiece
from cell.part.workpiece import Workpiece
from cell.runs import ply
from cell.runs.schema import UNSEEN
from cell.scene.model import MeshFixture, Scene
from planner.explore.space import FREE, VoxelSpace
from planner.geometry.mesh import TriangleMesh
from planner.values import Bools, Floats

_TIGHT, _SMOOTH = 0.75, 0.7  # of an edge: the believed surface's distance, and how far the distances are smoothed
_ROUGH = 0.87  # of an edge: the distance of the surface before which candidates stand
_BEYOND = 0.37  # of an edge: how far beyond voxels arm and housing keep away from
_BLOCK = 2  # edges: where a surface need not be tight, blocks of voxels do, with a quarter of the faces


def surface_about(space: VoxelSpace, chosen: Bools) -> TriangleMesh:
    """The tight surface about chosen voxels (X, Y, Z) [m]."""
    return _about(space.low, space.edge, chosen, _TIGHT, _SMOOTH)


def part_of(surface: TriangleMesh, name: str, known: str = "believed") -> Workpiece:
    """A believed, or measured, surface as a part, its name saying that it is no model."""
    return workpiece.from_trusted_mesh(f"{name} as {known}", surface)


def rough(space: VoxelSpace, *, whole: bool = False) -> TriangleMesh:
    """A surface of few faces about what is believed [m], before which candidates stand.

    `whole` as in `VoxelSpace.believed`.
    """
    return _about(space.low, _BLOCK * space.edge, _blocks(space.belief_voxels(unlimited=whole)), _ROUGH, _SMOOTH)


def write_unseen(space: VoxelSpace, path: Path) -> None:
    """Write what arm and housing keep away from as a mesh file in millimetres."""
    path.write_bytes(ply.mesh_bytes(enclosing(space, np.asarray(space.state != FREE))))


def enclosing(space: VoxelSpace, chosen: Bools) -> TriangleMesh:
    """A surface of few faces in which every chosen voxel lies as a whole [m]: all corners of its block do."""
    blocks = np.pad(_blocks(chosen), 1)
    x, y, z = (size - 1 for size in blocks.shape)
    corners = np.zeros((x, y, z), dtype=np.bool_)
    for i, j, k in np.ndindex(2, 2, 2):
        corners |= blocks[i : i + x, j : j + y, k : k + z]
    edge = _BLOCK * space.edge
    return _about(space.low - edge / 2, edge, corners, _BEYOND, 0.0)


def scene_of(scene: Scene, cylinder: Cylinder, believed: Workpiece, unseen: Path) -> Scene:
    """The scene of a stage: the believed part where the hidden one stands, unseen space about it.

    Args:
        scene: of the exploration.
        cylinder: about its placement.
        believed: in the explored frame.
        unseen: the file of `write_unseen`.
    """
    place = np.asarray(scene.placement.position_mm)
    centre = place + 1000 * believed.centre
    space = MeshFixture(
        name=UNSEEN, shape="mesh", path=str(unseen.absolute()), units="mm", occludes=False,
        position_mm=tuple(place.tolist()),
    )  # fmt: skip
    scene = with_stand(scene, cylinder)
    placement = scene.placement.model_copy(update={"position_mm": tuple(centre.tolist()), "abc_deg": (0.0, 0.0, 0.0)})
    part = scene.part.model_copy(update={"path": None, "units": None})
    return scene.model_copy(update={"placement": placement, "part": part, "fixtures": (*scene.fixtures, space)})


def _blocks(chosen: Bools) -> Bools:
    """The blocks in which a voxel is chosen: where a surface need not be tight, they do."""
    nx, ny, nz = (n // _BLOCK for n in chosen.shape)  # a grid has even numbers of voxels
    return np.asarray(chosen.reshape(nx, _BLOCK, ny, _BLOCK, nz, _BLOCK).any(axis=(1, 3, 5)))


def _about(low: Floats, edge: float, chosen: Bools, level: float, smooth: float) -> TriangleMesh:
    """The surface at a distance from the middles of cells, and the distances smoothed [edges of a cell]."""
    from skimage.measure import marching_cubes  # takes a third of a second to import

    distance = ndimage.distance_transform_edt(~chosen)
    if smooth and (smoothed := ndimage.gaussian_filter(distance, smooth)).min() < level:  # of lone cells it leaves none
        distance = smoothed
    vertices, faces, _, _ = marching_cubes(distance.astype(np.float32), level, gradient_direction="descent")
    return TriangleMesh(low + edge * (vertices.astype(np.float64) + 0.5), faces.astype(np.int32))
