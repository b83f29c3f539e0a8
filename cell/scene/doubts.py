"""What a plan may ask for although it is beyond where the methods are good: a sentence each, none where all is well.

The numbers are the borders of the maps of docs/internals/stability.md, which read them from here.
"""

import numpy as np

from cell.scene.scene import Scene
from planner.geometry.mesh import TriangleMesh
from planner.geometry.sampling import SurfaceSamples
from planner.ports import Scanner

STEEPEST_GRAZING_DEG = 77.0
"""Surface at more than this to the rays counts as measured up to 90 degrees, but a scan hardly has a point on it."""

COARSEST_MESH = 0.01
"""How far a twentieth of the part's surface may lie off the planning mesh, as a share of its diagonal; farther off, the
mesh's candidates miss surface that those of a finer mesh measure."""


def of_scene(scene: Scene) -> list[str]:
    """Doubts about a scene, whatever its part.

    Args:
        scene: a checked scene.
    """
    limit = getattr(scene.scanner, "grazing_max_deg", None)
    found = grazing(float(limit)) if limit is not None else ""
    return [found] if found else []


def of_scanner(scanner: Scanner) -> list[str]:
    """What a person has to know about a scanner that sweeps."""
    T_view_scanner = getattr(scanner, "T_view_scanner", None)
    if T_view_scanner is None:
        return []
    return [
        f"each view is a sweep of {len(T_view_scanner)} poses, driven as a line; the arm's own shadow along it is not "
        "judged"
    ]


def grazing(limit_deg: float) -> str:
    """About a grazing limit [deg]."""
    if limit_deg <= STEEPEST_GRAZING_DEG:
        return ""
    return (
        f"scanner.grazing_max_deg is {limit_deg:g}: surface at more than {STEEPEST_GRAZING_DEG:g} deg to the rays "
        "counts as measured here, but the points of a scan lie so far apart on it that it is hardly found"
    )


def off_mesh(features: SurfaceSamples, planning: TriangleMesh) -> float:
    """How far 95 % of surface samples at most lie off their planning faces' planes, as a share of the mesh's diagonal.

    Args:
        features: samples of the part (the centres of the planning faces themselves, of `rays`, are 0 off).
        planning: the planning mesh.
    """
    off = features.points - planning.centres[features.planning_face]
    height = np.abs(np.einsum("nj,nj->n", off, planning.normals[features.planning_face]))
    return float(np.quantile(height, 0.95) / planning.diagonal)


def other_count(came_out: int, wanted: int) -> str:
    """About a planning mesh that is not as coarse as asked for; the plan uses what came out."""
    if abs(came_out - wanted) <= max(2, 0.02 * wanted):
        return ""
    return (
        f"the planning mesh has {came_out} faces in place of {wanted}: this mesh does not come closer (slivers, "
        "several bodies, or fewer faces than asked for); the plan uses these"
    )


def planning_mesh(off: float, faces: int) -> str:
    """About a planning mesh.

    Args:
        off: from `off_mesh`.
        faces: how many it has.
    """
    if off <= COARSEST_MESH:
        return ""
    return (
        f"the planning mesh of {faces} faces is coarse: a twentieth of the surface is {100 * off:.1f} % of the part's "
        f"diagonal or more off it, above {100 * COARSEST_MESH:g} %; its candidates miss surface; "
        "ask for more --faces"
    )
