"""CAD models: the faces of a part with surface kind and parameters, and their reading from STEP files (ISO 10303-21).

Open CASCADE reads and triangulates a file through `cascadio`, an optional dependency. Its result is a GLB in metres,
independent of the unit of the file, with the number and the surface of the face of each triangle in an extension
(`TM_brep_faces`). Surfaces that bound no solid are left out: construction geometry and datum targets would enlarge the
bounding box. Faces are numbered from 1 in the order of the file, as in CAD programs. Object frame, metres, radians.
"""

import re
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from enum import StrEnum
from importlib.util import find_spec
from pathlib import Path
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from cell.errors import FileError, UsageError
from cell.part import glb, open_cascade
from cell.part.formats import UNITS
from cell.part.mesh_checks import Finding, Kind, Severity, adjacent_faces, double_areas, is_collapsed, label_bodies
from planner.geometry.mesh import TriangleMesh, concatenate_meshes
from planner.values import Floats, Ints, Ints32, Value


class SurfaceKind(StrEnum):
    """Kind of surface of a face."""

    PLANE = "plane"
    CYLINDER = "cylinder"
    CONE = "cone"
    SPHERE = "sphere"
    TORUS = "torus"
    OTHER = "other"
    """A surface without parameters, such as a spline."""


@dataclass(frozen=True, slots=True, eq=False)
class CadFace(Value):
    """A face; parameters that its kind does not have are None.

    Attributes:
        number: 1, 2, ... in the order of the file.
        kind: of its surface.
        point: (3,) on the plane or the axis, the centre of a sphere or torus, the apex of a cone [m].
        axis: (3,) unit: the plane's normal, the axis of a cylinder, cone or torus.
        radius: of a cylinder or sphere; of a torus that of its tube [m].
        centre_radius: of a torus: from its centre to the middle of its tube [m].
        half_angle: of a cone, between axis and surface [rad].
    """

    number: int
    kind: SurfaceKind
    point: Annotated[Floats, "3"] | None = None
    axis: Annotated[Floats, "3"] | None = None
    radius: float | None = None
    centre_radius: float | None = None
    half_angle: float | None = None

    def distance(self, points: Floats) -> Floats:
        """Return the distances of points (..., 3) [m] from a plane, cylinder, cone, sphere or torus."""
        if self.point is None:
            raise ValueError("a surface without parameters has no distance")
        offset, radius = points - self.point, self.radius or 0.0
        signed: Floats
        if self.axis is None:
            signed = np.linalg.norm(offset, axis=-1) - radius
            return np.abs(signed)
        along = np.abs(offset @ self.axis)
        across = np.linalg.norm(offset - (offset @ self.axis)[..., None] * self.axis, axis=-1)
        if self.kind is SurfaceKind.PLANE:
            signed = along
        elif self.half_angle is not None:
            signed = across * np.cos(self.half_angle) - along * np.sin(self.half_angle)
        elif self.centre_radius is not None:
            signed = np.hypot(across - self.centre_radius, along) - radius
        else:
            signed = across - radius
        return np.abs(signed)

    @property
    def dimensions(self) -> str:
        """Its sizes with units; "" without sizes."""
        if self.half_angle is not None:
            return f"half angle {np.degrees(self.half_angle):.4g} deg"
        if self.radius is None:
            return ""
        size = f"diameter {2000 * self.radius:.5g} mm"
        return size if self.centre_radius is None else f"tube's {size}, about {2000 * self.centre_radius:.5g} mm"


@dataclass(frozen=True, slots=True, eq=False)
class CadModel(Value):
    """The faces of a part, and the face of each triangle.

    Attributes:
        faces: in the order of their numbers, without those that bound no solid.
        of_triangle: (F,) index in `faces` of each triangle.
    """

    faces: tuple[CadFace, ...]
    of_triangle: Annotated[Ints32, "F"]

    def counts(self) -> dict[str, int]:
        """Return the number of faces of each kind that occurs."""
        kinds = [face.kind for face in self.faces]
        return {kind.value: kinds.count(kind) for kind in SurfaceKind if kind in kinds}

    def areas(self, mesh: TriangleMesh) -> Floats:
        """Return the area (N,) of each face [m^2], by the triangles of `mesh`."""
        return np.bincount(self.of_triangle, weights=mesh.areas, minlength=len(self.faces)).astype(np.float64)

    def centres(self, mesh: TriangleMesh) -> Floats:
        """Return the centroid (N, 3) of each face's triangles [m]; zero without triangles."""
        areas, centres = mesh.areas, mesh.centres
        total = np.maximum(self.areas(mesh), np.finfo(np.float64).tiny)
        sums = [np.bincount(self.of_triangle, weights=areas * axis, minlength=len(self.faces)) for axis in centres.T]
        return np.stack(sums, axis=1) / total[:, None]


DEVIATION_MM = 0.02
"""Largest distance of the triangles from their surface, of the order of a scanner's uncertainty."""

MAX_VOLUME_ERROR = 1e-3
"""Largest difference between the volumes of triangles and surfaces; a part above it is triangulated finer."""

TURN_RAD = 0.2
"""Largest angle between normals of adjacent triangles; it adds to the angle of incidence."""

_POINTS = ("origin", "center", "apex")
_AXES = ("normal", "axis")


@dataclass(frozen=True, slots=True, eq=False)
class StepModel:
    """The solids of a STEP file.

    Attributes:
        vertices: (V, 3) [m]; vertices of adjacent faces are not merged.
        faces: (F, 3).
        cad: the faces of the solids, and the face of each triangle.
        findings: about omitted surfaces.
    """

    vertices: Floats
    faces: Ints
    cad: CadModel
    findings: tuple[Finding, ...]


def read_step(source: str, content: bytes, units: str = "m") -> StepModel:
    """Read the solids of a STEP file.

    Args:
        source: its name in messages.
        content: of the file.
        units: unit of a file that does not state it, a key of `UNITS`; "m" for a file that states its unit.

    Raises:
        UsageError: if both the file and the caller state a unit, or neither does.
        FileError: if `cascadio` is not installed, or the file is broken or has no surface.
    """
    others = _other_files(content)
    content = _without_separators(content)
    factor = _factor_to_metres(source, content, units)
    content, n_hidden = _without_hidden_bodies(content)
    groups = _solids_and_sheets(_without_styles(content))
    model = _read_groups(source, groups, 1.0, factor)
    if not len(model.faces):
        raise _no_surface(source, others)
    error = _volume_error(source, groups, model)
    if error > MAX_VOLUME_ERROR:
        scale = max((MAX_VOLUME_ERROR / (2 * error)) ** 0.5, 1 / 16)  # the error grows with the square of the angle
        model = _read_groups(source, groups, scale, factor)
        error = _volume_error(source, groups, model, scale)
    if error > MAX_VOLUME_ERROR:
        sentence = f"the triangles differ from the surfaces of the file by {100 * error:.2g} % of the volume"
        model = replace(model, findings=(*model.findings, Finding(Kind.COARSE, sentence, Severity.WARNING)))
    if others:
        sentence = f"parts in other files are missing ({others}); export all as one file to measure them"
        model = replace(model, findings=(Finding(Kind.OTHER_FILES, sentence, Severity.WARNING), *model.findings))
    if n_hidden:
        bodies = "1 hidden body is" if n_hidden == 1 else f"{n_hidden} hidden bodies are"
        note = Finding(Kind.HIDDEN, f"{bodies} left out; show them in the CAD program to measure them", Severity.NOTE)
        model = replace(model, findings=(note, *model.findings))
    return model if factor == 1 else _scaled(model, factor)


def _factor_to_metres(source: str, content: bytes, units: str) -> float:
    """Return the factor from the lengths that Open CASCADE reads to metres: without a unit it assumes millimetres.

    Raises:
        UsageError: if both the file and the caller state a unit, or neither does.
    """
    if states_unit(content):
        if units != "m":
            raise UsageError(f"{source} states its own unit; omit the units")
    elif units == "m" and b"SHAPE_REPRESENTATION" in content:
        raise UsageError(f"{source} does not state its unit; give the units: mm, cm, um or in")
    return 1.0 if units == "m" else UNITS[units] / UNITS["mm"]


_TEXT = re.compile(rb"/\*.*?(?:\*/|\Z)|'[^']*'", re.DOTALL)
_SEPARATORS = bytes.maketrans(b"();#", b"____")


def _without_separators(content: bytes) -> bytes:
    """Remove comments, and the brackets, semicolons and number signs of names, which separate entities elsewhere."""
    return _TEXT.sub(lambda match: b" " if match[0][:1] == b"/" else match[0].translate(_SEPARATORS), content)


_ENTITY = re.compile(rb"#(\d+)\s*=\s*(\w+)\s*\(([^;]*)\)\s*;")
_REFERENCE = re.compile(rb"#(\d+)")


def _without_hidden_bodies(content: bytes) -> tuple[bytes, int]:
    """Remove bodies that are INVISIBLE, themselves or by their layer, from their representations; return their number.

    Open CASCADE reads hidden bodies like any other.
    """
    if b"INVISIBILITY" not in content:
        return content, 0
    entities = {number: (kind.upper(), parameters) for number, kind, parameters in _ENTITY.findall(content)}
    hidden: set[bytes] = set()
    for kind, parameters in entities.values():
        todo = _REFERENCE.findall(parameters) if kind == b"INVISIBILITY" else []
        while todo:
            number = todo.pop()
            kind_of, inside = entities.get(number, (b"", b""))
            if kind_of in (b"STYLED_ITEM", b"OVER_RIDING_STYLED_ITEM", b"PRESENTATION_LAYER_ASSIGNMENT"):
                todo += _REFERENCE.findall(inside)[-1:] if kind_of == b"STYLED_ITEM" else _REFERENCE.findall(inside)
            elif kind_of.endswith((b"_BREP", b"_SURFACE_MODEL", b"BREP_WITH_VOIDS", b"TESSELLATED_SOLID")):
                hidden.add(number)

    return _without_items(content, hidden), len(hidden)


def _without_items(content: bytes, items: set[bytes]) -> bytes:
    """Remove items, by their numbers, from all shape representations of a STEP file."""

    def remaining(match: re.Match[bytes]) -> bytes:
        number, kind, parameters = match[1], match[2], match[3]
        if not kind.upper().endswith(b"SHAPE_REPRESENTATION"):
            return match[0]
        head, opened, item_list = parameters.partition(b"(")
        item_list, closed, tail = item_list.partition(b")")
        references = [item for item in item_list.split(b",") if item.strip().lstrip(b"#") not in items]
        return b"#" + number + b"=" + kind + b"(" + head + opened + b",".join(references) + closed + tail + b");"

    return _ENTITY.sub(remaining, content)


_STYLE = re.compile(rb"=\s*(?:OVER_RIDING_)?STYLED_ITEM\s*\([^;]*;", re.IGNORECASE)


def _without_styles(content: bytes) -> bytes:
    """Remove the colours: Open CASCADE would split a product by colour, and describe the faces of one of them only."""
    return _STYLE.sub(b"=REPRESENTATION_ITEM('');", content)


_SOLIDS = (b"SOLID_BREP", b"FACETED_BREP", b"BREP_WITH_VOIDS", b"TESSELLATED_SOLID")
_PLACES = (b"AXIS2_PLACEMENT_3D", b"MAPPED_ITEM")


@dataclass(frozen=True, slots=True)
class _Group:
    """A part of a STEP file that is read by itself, and whether it has solids only."""

    content: bytes
    only_solids: bool


def _solids_and_sheets(content: bytes) -> list[_Group]:
    """Return the solids of a file, and its other surfaces; the file as it is if it has not both.

    Surfaces beside a solid can cover it or share its edges, so the triangles of both together are not closed. The
    tessellated copy of an exact solid, and the faces of solids to which annotations refer, are left out.
    """
    entities = {number: (kind.upper(), parameters) for number, kind, parameters in _ENTITY.findall(content)}
    shape_items = {
        item
        for kind, parameters in entities.values()
        if kind.endswith(b"SHAPE_REPRESENTATION")
        for item in _REFERENCE.findall(parameters.partition(b"(")[2].partition(b")")[0])
    }
    kinds = {item: entities.get(item, (b"", b""))[0] for item in shape_items}
    solids = {item for item, kind in kinds.items() if kind.endswith(_SOLIDS)}
    copies = {
        item for item in solids
        if kinds[item] == b"TESSELLATED_SOLID" and solids & set(_REFERENCE.findall(entities[item][1])[-1:])
    }  # fmt: skip
    for kind, parameters in entities.values():
        copies |= kinds.keys() & _REFERENCE.findall(parameters) if kind == b"CLOSED_SHELL" else set()
    sheets = {item for item, kind in kinds.items() if kind and kind not in _PLACES} - solids - copies
    if not solids or not (sheets or copies):
        return [_Group(content, bool(solids))]
    groups = [_Group(_without_items(content, sheets | copies), only_solids=True)]
    return [*groups, _Group(_without_items(content, solids | copies), only_solids=False)] if sheets else groups


def _read_groups(source: str, groups: list[_Group], scale: float, factor: float = 1.0) -> StepModel:
    """Return the solids of all groups, triangulated with scaled tolerances; a length is `factor` metres in findings."""
    bodies: list[_Body] = []
    for number, group in enumerate(groups):
        glb_content = _triangulate(source, group.content, scale=scale, may_be_empty=number > 0)
        try:
            count = sum(len(body.cad) for body in bodies)
            bodies += _bodies(glb_content, count, of_solid=group.only_solids) if glb_content else []
        except (glb.GlbError, KeyError, TypeError, ValueError) as error:
            raise _broken_file(source) from error
    try:
        return _join_solids(bodies, factor)
    except ValueError as error:
        raise _broken_file(source) from error


def _volume_error(source: str, groups: list[_Group], model: StepModel, scale: float = 1.0) -> float:
    """Return the difference between the volumes of triangles and surfaces, as a share of the volume.

    The distance of surfaces with parameters is integrated over their triangles, at the middles of their edges, which is
    exact to the second order. For other surfaces, the volume is compared with that of half the tolerances.
    """
    corners = model.vertices[model.faces] - model.vertices.mean(axis=0)
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    volume = abs(float(np.einsum("fj,fj->", corners[:, 0], cross)) / 6)
    if volume <= 0:
        return 0.0
    areas = np.linalg.norm(cross, axis=1) / 2
    is_other = np.array([face.kind is SurfaceKind.OTHER for face in model.cad.faces])[model.cad.of_triangle]
    if areas[is_other].sum() > 0.01 * areas.sum():
        fine = _read_groups(source, groups, scale / 2)
        finer = fine.vertices[fine.faces] - model.vertices.mean(axis=0)
        other = abs(float(np.einsum("fj,fj->", finer[:, 0], np.cross(finer[:, 1], finer[:, 2]))) / 6)
        return abs(other - volume) * 4 / 3 / volume
    missing = 0.0
    counts = np.bincount(model.cad.of_triangle, minlength=len(model.cad.faces))
    rows_of = np.split(np.argsort(model.cad.of_triangle, kind="stable"), np.cumsum(counts)[:-1])
    for face, rows in zip(model.cad.faces, rows_of, strict=True):
        if face.kind in (SurfaceKind.CYLINDER, SurfaceKind.SPHERE, SurfaceKind.CONE, SurfaceKind.TORUS):
            triangles = model.vertices[model.faces[rows]]
            middles = (triangles + np.roll(triangles, -1, axis=1)) / 2
            outside = (
                middles + 1e-6 * (cross[rows] / np.linalg.norm(cross[rows], axis=1, keepdims=True).clip(1e-30))[:, None]
            )
            distance, moved = face.distance(middles), face.distance(outside)
            missing += float((areas[rows, None] * np.where(moved > distance, distance, -distance)).sum() / 3)
    return abs(missing) / volume


def _scaled(model: StepModel, factor: float) -> StepModel:
    """Return a model with all its lengths multiplied."""
    faces = tuple(
        replace(
            face,
            point=None if face.point is None else face.point * factor,
            radius=None if face.radius is None else face.radius * factor,
            centre_radius=None if face.centre_radius is None else face.centre_radius * factor,
        )
        for face in model.cad.faces
    )
    return replace(model, vertices=model.vertices * factor, cad=replace(model.cad, faces=faces))


def read_coloured_step(source: str, content: bytes, units: str = "m") -> tuple[Floats, Ints, Floats]:
    """Read the surfaces of a STEP file with their colours, of the face or of its body; arguments as of `read_step`.

    Returns:
        Vertices (V, 3) [m], triangles (F, 3), and red, green and blue (F, 3), 0 to 255; NaN for a face without colour.

    Raises:
        UsageError: if both the file and the caller state a unit, or neither does.
        FileError: if `cascadio` is not installed, or the file is broken or has no surface.
    """
    content = _without_separators(content)
    factor = _factor_to_metres(source, content, units)
    try:
        # With one primitive per face; merged ones would have only the colour of their body.
        surfaces = list(glb.primitives(_triangulate(source, content, by_face=True)))
    except glb.GlbError as error:
        raise _broken_file(source) from error
    linear = np.array([each.colour or (np.nan,) * 3 for each in surfaces]).reshape(-1, 3)
    # sRGB (IEC 61966-2-1), as in STEP files and on screens.
    colours = 255 * np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)
    vertices, faces, of_face = concatenate_meshes((each.vertices, each.faces) for each in surfaces)
    return vertices * factor, faces, colours[of_face]


def _triangulate(
    source: str, content: bytes, *, by_face: bool = False, scale: float = 1.0, may_be_empty: bool = False
) -> bytes:
    """Return the GLB of Open CASCADE: one primitive per body with descriptions of its faces, or one per face.

    Args:
        source: name of the file in messages.
        content: of the file.
        by_face: one primitive per face.
        scale: of the tolerances.
        may_be_empty: return b"" if there is no surface.
    """
    if find_spec("cascadio") is None:  # an optional dependency of 104 MB
        raise FileError(
            f"{source} is a STEP file, which needs cascadio: pip install 'scan-cell[step]', or export a mesh"
        )
    content = content.removeprefix(b"\xef\xbb\xbf")
    if b"ISO-10303-21" not in content[:2000]:
        raise FileError(f"{source} is not a STEP file (ISO 10303-21); export it again")
    if b"END-ISO-10303-21" not in content[-2000:]:
        raise FileError(f"{source} is cut short: it has no END-ISO-10303-21; export or copy it again")
    with tempfile.TemporaryDirectory() as folder:
        step_file, glb_file = Path(folder) / "part.step", Path(folder) / "part.glb"
        step_file.write_bytes(content)
        words = [str(step_file), str(glb_file), str(DEVIATION_MM * scale), str(TURN_RAD * scale), str(int(by_face))]
        process = subprocess.run(
            [sys.executable, str(Path(open_cascade.__file__)), *words],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            check=False,
        )
        if process.returncode or not glb_file.exists():
            raise FileError(f"{source} makes Open CASCADE fail (exit code {process.returncode}); export it again")
        glb_content = glb_file.read_bytes()
    if not glb_content and not may_be_empty:
        raise _no_surface(source, _other_files(content))
    return glb_content


def states_unit(content: bytes) -> bool:
    """Return whether a STEP file states its unit of length, in the units of a context."""
    for units in re.findall(rb"GLOBAL_UNIT_ASSIGNED_CONTEXT\s*\(\s*\(([^)]*)\)", content):
        for number in _REFERENCE.findall(units):
            entity = re.search(rb"#" + number + rb"\s*=\s*([^;]*);", content)
            if entity is not None and b"LENGTH_UNIT" in entity[1]:
                return True
    return False


def _other_files(content: bytes) -> str:
    """Return the names of the STEP files to which an assembly refers, as text."""
    found = re.findall(rb"DOCUMENT_FILE\s*\(\s*'([^']*\.(?:stp|step))'", content, re.IGNORECASE)
    names = [name.decode(errors="replace") for name in dict.fromkeys(found)]
    return ", ".join([*names[:5], *(["..."] if len(names) > 5 else [])])


def _no_surface(source: str, others: str) -> FileError:
    if others:
        return FileError(f"{source} has no surface, its parts are in other files ({others}); export all as one file")
    return FileError(f"{source} has no surface that Open CASCADE can read; export its solids again")


def _broken_file(source: str) -> FileError:
    return FileError(f"{source} cannot be read as STEP; it is broken or cut short, export it again")


@dataclass(frozen=True, slots=True, eq=False)
class _Body:
    """A surface of the file: one solid, several, or none; `of_solid` if the file says so, `closed` by triangle."""

    vertices: Floats
    faces: Ints
    face_of: Ints
    cad: tuple[CadFace, ...]
    of_solid: bool
    closed: NDArray[np.bool_]

    def area(self, mask: NDArray[np.bool_]) -> float:
        """Return the area of triangles [m^2]."""
        return float(double_areas(self.vertices, self.faces[mask]).sum()) / 2


def _bodies(glb_content: bytes, count: int, *, of_solid: bool) -> Iterator[_Body]:
    """Yield the surfaces with their CAD faces, numbered consecutively from `count` + 1."""
    for primitive in glb.primitives(glb_content):
        extension = primitive.extensions.get("TM_brep_faces")
        described = extension.get("faces", []) if isinstance(extension, Mapping) else [None]
        face_of = primitive.numbers(extension["faceIndices"]) if extension else np.zeros(len(primitive.faces), np.int64)
        if len(face_of) != len(primitive.faces):
            raise ValueError("not every triangle has a face number")
        described = described or [None] * (int(face_of.max(initial=-1)) + 1)
        cad = tuple(cad_face(count + k + 1, each or {}, primitive.T) for k, each in enumerate(described))
        yield _Body(primitive.vertices, primitive.faces, face_of, cad, of_solid, _is_closed(primitive))
        count += len(cad)


def cad_face(number: int, described: glb.Table, T: Floats) -> CadFace:
    """Return a face by its description in the extension.

    Args:
        number: of the face.
        described: "type" and the parameters of the surface [m, rad]; empty for a surface without parameters.
        T: (4, 4) of the node.
    """
    kind = described.get("type")
    if kind not in set(SurfaceKind) - {SurfaceKind.OTHER}:
        return CadFace(number, SurfaceKind.OTHER)
    point = next(np.array(described[key], dtype=np.float64) for key in _POINTS if key in described)
    axis = next((np.array(described[key], dtype=np.float64) for key in _AXES if key in described), None)
    torus, cone = kind == SurfaceKind.TORUS, kind == SurfaceKind.CONE
    return CadFace(
        number,
        SurfaceKind(kind),
        point @ T[:3, :3].T + T[:3, 3],
        None if axis is None else axis @ T[:3, :3].T,
        radius=described["minor_radius"] if torus else described.get("radius"),
        centre_radius=described["major_radius"] if torus else None,
        half_angle=abs(described["semi_angle"]) if cone else None,
    )


def _is_closed(primitive: glb.Primitive) -> NDArray[np.bool_]:
    """Return whether each triangle (F,) belongs to a closed surface; triangles without area count as closed."""
    _, place = np.unique(primitive.vertices, axis=0, return_inverse=True)
    faces = place.ravel()[primitive.faces]
    has_area = ~is_collapsed(faces)
    closed = np.ones(len(faces), dtype=np.bool_)
    if has_area.any():
        one, two, _, uses = adjacent_faces(faces[has_area])
        body, count = label_bodies(int(has_area.sum()), one, two)
        rim = np.zeros(count, dtype=np.bool_)
        rim[body[(uses == 1).reshape(3, -1).any(axis=0)]] = True
        closed[has_area] = ~rim[body]
    return closed


def _join_solids(bodies: list[_Body], factor: float) -> StepModel:
    """Join all solids; without any solid join all surfaces, which the mesh check then reports as open."""
    any_solid = any(body.of_solid or body.area(body.closed) > 0 for body in bodies)
    selection = [(body, body.closed | (body.of_solid or not any_solid)) for body in bodies]
    omitted = factor**2 * sum(body.area(~mask) for body, mask in selection)
    gaps = factor**2 * sum(body.area(~body.closed) for body in bodies if body.of_solid)
    vertices, faces, _ = concatenate_meshes((body.vertices, body.faces[mask]) for body, mask in selection)
    every: list[CadFace] = []
    index: list[Ints] = [np.zeros(0, np.int64)]
    for body, mask in selection:
        index.append(body.face_of[mask] + len(every))
        every += body.cad
    there, of_triangle = np.unique(np.concatenate(index), return_inverse=True)
    cad = CadModel(tuple(every[k] for k in there.tolist()), of_triangle.astype(np.int32))
    findings: tuple[Finding, ...] = ()
    if omitted:
        sentence = (
            f"surfaces of {1e6 * omitted:.4g} mm² bound no solid and were omitted; if they belong to the part, close "
            "them in the CAD program"
        )
        findings = (Finding(Kind.NO_SOLID, sentence, Severity.WARNING),)
    if gaps:
        sentence = (
            f"solids with a surface of {1e6 * gaps:.4g} mm² have gaps: Open CASCADE left out faces, or their edges do "
            "not meet; repair them in the CAD program"
        )
        findings = (*findings, Finding(Kind.GAPS, sentence, Severity.WARNING))
    return StepModel(vertices, faces, cad, findings)
