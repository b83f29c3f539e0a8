"""The regions of a scene on its part: the region of each triangle of the reference.

The sides of a box cut the triangles that they cross, and a painted mesh splits large triangles, so that every triangle
belongs to one region. The surface does not change. Object frame, metres.
"""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import cast

import numpy as np

from cell.errors import SceneError
from cell.part import mesh_files
from cell.part.cad import CadModel
from cell.part.formats import own_units
from cell.part.workpiece import Workpiece
from cell.scene.model import Region, RegionTargets, Scene, with_rest
from planner.geometry.closest import closest_facing_faces
from planner.geometry.decimation import split_long_edges
from planner.geometry.mesh import TriangleMesh, cut_at_plane, faces_in_box
from planner.measurability.quality import LimitedScanner, QualityLimits
from planner.ports import Scanner, SigmaScanner
from planner.values import Bools, Ints

_FINE = 0.01  # of the diagonal: longest edge of triangles that take colours of another mesh
_SPLITS = 12  # halvings that make an edge as long as the diagonal shorter than that


def with_regions(part: Workpiece, scene: Scene) -> Workpiece:
    """Return the part with the region of each triangle; unchanged without regions, or if it has them already.

    Raises:
        SceneError: if a region selects nothing, or by a property that the part does not have.
        FileError: if a painted mesh cannot be read.
    """
    if not scene.region or part.reference.region is not None:
        return part
    regions = with_rest(scene.region)
    part = _cut(part, regions)
    number = np.full(len(part.reference.faces), len(regions), dtype=np.int32)
    free = np.ones(len(number), dtype=np.bool_)
    for k, region in enumerate(regions):
        is_inside = free & (_selected(region, part, scene) if region.selects else True)
        if region.selects and not is_inside.any():
            raise SceneError(_empty_region(region, part, free))
        number[is_inside] = k if region.is_measured else -1
        free &= ~is_inside
    if not (number >= 0).any():
        raise SceneError("no surface of the part is to be measured; remove care = 'no' from the regions to be measured")
    return replace(part, reference=replace(part.reference, region=number))


def region_areas(part: Workpiece, scene: Scene) -> dict[str, float]:
    """Return the area [mm^2] of each measured region by name; the rest only if it has any."""
    if (number := part.reference.region) is None:
        return {}
    regions = with_rest(scene.region)
    areas = 1e6 * np.bincount(number[number >= 0], part.reference.areas[number >= 0], len(regions))
    return {region.name: round(float(area), 3) for region, area in zip(regions, areas, strict=True) if area > 0}


def _cut(part: Workpiece, regions: tuple[Region, ...]) -> Workpiece:
    """Return the part with triangles that no side of a box crosses, and small ones for painted meshes."""
    mesh, parent = part.reference, np.arange(len(part.reference.faces))
    for box in (region.box_mm for region in regions if region.box_mm is not None):
        for k, at in enumerate(box):
            mesh, parent_of = cut_at_plane(mesh, k % 3, at / 1000)
            parent = parent[parent_of]
    if any(region.painted is not None for region in regions):
        mesh, parent_of = _fine(mesh)
        parent = parent[parent_of]
    cad = part.cad and replace(part.cad, of_triangle=part.cad.of_triangle[parent])
    return replace(part, reference=mesh, cad=cad)


def _fine(mesh: TriangleMesh) -> tuple[TriangleMesh, Ints]:
    """Return the mesh with short edges, and the original triangle of each triangle."""
    vertices, faces = mesh.vertices, mesh.faces
    for _ in range(_SPLITS * 2):
        before = len(faces)
        vertices, faces = split_long_edges(vertices, faces, _FINE * mesh.diagonal)
        if len(faces) == before:
            break
    fine = TriangleMesh(vertices, faces)
    return fine, closest_facing_faces(fine.centres, fine.normals, mesh).astype(np.int64)


def _selected(region: Region, part: Workpiece, scene: Scene) -> Bools:
    """Return the triangles (F,) for which all selectors of a region hold."""
    mesh = part.reference
    is_selected = np.ones(len(mesh.faces), dtype=np.bool_)
    if any(key is not None for key in (region.faces, region.kind, region.diameter_above_mm, region.diameter_below_mm)):
        if part.cad is None:
            raise SceneError(
                f"the region '{region.name}' selects CAD faces, and {part.name} is a mesh, which has none; give the "
                "part as STEP, or select by a box or a colour"
            )
        is_selected &= _by_face(region, part.cad)[part.cad.of_triangle]
    if region.box_mm is not None:
        low, high = np.array(region.box_mm).reshape(2, 3) / 1000
        within = np.zeros(len(is_selected), dtype=np.bool_)
        within[faces_in_box(mesh, low, high)] = True
        is_selected &= within
    if region.colour is not None:
        is_selected &= _by_colour(region, region.colour, mesh, scene)
    return is_selected


def _by_face(region: Region, cad: CadModel) -> Bools:
    """Return the CAD faces (N,) with the number, kind and diameter of a region."""
    is_selected = np.ones(len(cad.faces), dtype=np.bool_)
    if region.faces is not None:
        numbers = [face.number for face in cad.faces]
        if missing := [number for number in region.faces if number not in numbers]:
            raise SceneError(
                f"the region '{region.name}' names face {missing[0]}, which the part does not have; cell part lists "
                f"{numbers[0]} to {numbers[-1]}"
            )
        is_selected &= np.isin(numbers, region.faces)
    if region.kind is not None:
        is_selected &= np.array([face.kind == region.kind for face in cad.faces])
    diameter = np.array([np.nan if face.radius is None else 2000 * face.radius for face in cad.faces])
    if region.diameter_below_mm is not None:
        is_selected &= diameter < region.diameter_below_mm
    if region.diameter_above_mm is not None:
        is_selected &= diameter > region.diameter_above_mm
    return np.asarray(is_selected)


def _by_colour(region: Region, colour: str, mesh: TriangleMesh, scene: Scene) -> Bools:
    """Return the triangles (F,) whose middle has a colour on the painted mesh, by default the part's own file."""
    source = region.painted or scene.part.path
    if source is None:
        raise SceneError(
            f"the region '{region.name}' selects by colour, and {scene.part.name} is not a coloured file; give "
            "region.painted, a coloured mesh of the part"
        )
    units = (scene.part.units if region.painted is None else region.painted_units) or own_units(source)
    assert units is not None, "the scene requires units"
    canvas, colours = mesh_files.read_coloured(Path(source), units)
    return mesh_files.is_colour(colours, colour)[closest_facing_faces(mesh.centres, mesh.normals, canvas)]


def _empty_region(region: Region, part: Workpiece, free: Bools) -> str:
    """Describe a region without triangles."""
    cause = "its surface belongs to regions before it" if not free.all() else "no surface of the part matches"
    bounds = ", ".join(f"{value:g}" for value in (1000 * part.bounds).round(3).ravel() + 0.0)
    return f"the region '{region.name}' is empty: {cause}; the part reaches from {bounds} mm (lowest, highest corner)"


def with_limits(scanner: Scanner, max_sigma_mm: float | None, regions: Sequence[RegionTargets]) -> Scanner:
    """Return a sensor model with the limit on sigma of a plan and the limits of its regions, by their numbers.

    Raises:
        SceneError: if the scanner has no model of a limited quantity.
    """
    inf = float("inf")
    region_limits = tuple(
        QualityLimits((each.max_sigma_mm or inf) / 1000, (each.max_spacing_mm or inf) / 1000) for each in regions
    )
    if all(each == QualityLimits() for each in region_limits):
        region_limits = ()
    if max_sigma_mm is None and not region_limits:
        return scanner
    for region in regions:
        for key, quantity in (("max_spacing_mm", "spacing"), ("max_sigma_mm", "sigma")):
            if getattr(region, key) is not None and not callable(getattr(scanner, quantity, None)):
                raise SceneError(
                    f"the region '{region.name}' has {key}, but the scanner {type(scanner).__name__} has no model of "
                    f"its {quantity}; omit the limit, or choose another scanner"
                )
    return cast(Scanner, LimitedScanner(cast(SigmaScanner, scanner), (max_sigma_mm or inf) / 1000, region_limits))
