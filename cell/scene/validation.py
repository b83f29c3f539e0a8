"""What a plan may ask for although it is beyond where the methods are good: a sentence each, none where all is well.

The numbers are the borders of the maps of docs/internals/stability.md, which read them from here.

Limits of regions that a scanner cannot keep anywhere, with the device or the resolution that would.
"""

from math import floor, log10

import numpy as np

from cell import scanners
from cell.errors import SceneError
from cell.scene import sensors
from cell.scene.model import Scene
from cell.scene.settle import LARGE, MEDIUM, SMALL
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


_ROUNDING = 1e-3  # of a spacing: what is below the limit by no more is taken for it


def require_attainable(scene: Scene, scanner: Scanner) -> None:
    """Refuse a spacing that no surface in the scanner's range has, however it stands.

    Args:
        scene: settled.
        scanner: of the scene.

    Raises:
        SceneError: naming spacing, range, and what helps.
    """
    least = getattr(scanner, "least_spacing_mm", None)
    for region in scene.region:
        if least is None or region.max_spacing_mm is None or region.max_spacing_mm >= least * (1 - _ROUNDING):
            continue
        limit, given = region.max_spacing_mm, scene.scanner
        grid = (
            ""
            if "resolution_deg" not in (scanners.keys(given.type) or ())
            else f" at {max(given.resolution_deg):g} deg"
        )
        near = "" if given.range_mm is None else f", whose range begins at {given.range_mm[0]:g} mm,"
        raise SceneError(
            f"the region '{region.name}' asks for points at most {limit:g} mm apart, and {given.sensor or given.type}"
            f"{near} has them {least:.3g} mm apart at its nearest{grid}; {_what_helps(scene, limit, least)}"
        )


def _what_helps(scene: Scene, limit: float, least: float) -> str:
    """The resolution with which this device keeps a limit, and the device that does with this resolution [mm]."""
    ways = [f"allow {least:.3g} mm"]
    if "resolution_deg" in (scanners.keys(scene.scanner.type) or ()):
        finer = [_down(angle * limit / least) for angle in scene.scanner.resolution_deg]
        ways.append(f"set scanner.resolution_deg = [{finer[0]:g}, {finer[1]:g}]")
    for name in (LARGE, MEDIUM, SMALL):  # the one with the longest range of those that keep it
        own = sensors.load(name)
        if own.type != scene.scanner.type or name == scene.scanner.sensor:
            continue
        keys = {"resolution_deg": scene.scanner.resolution_deg, "fov_deg": scene.scanner.fov_deg, **own.keys}
        there = getattr(scanners.make(own.type, keys), "least_spacing_mm", float("inf"))
        if there <= limit:
            ways.append(
                f"take --sensor {name} ({there:.3g} mm at its nearest, {(own.figures.range_mm or (0.0,))[0]:g} mm)"
            )
            break
    return ", or ".join([", ".join(ways[:-1]), ways[-1]] if len(ways) > 1 else ways)


def _down(angle: float) -> float:
    """An angle rounded down to two digits."""
    step = 10.0 ** (floor(log10(angle)) - 1)
    return floor(angle / step + 1e-9) * step
