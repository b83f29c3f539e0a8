"""CAD models: the faces of a part with surface kind and parameters, and their reading from STEP files (ISO 10303-21).

Open CASCADE reads and triangulates a file through `cascadio`, an optional dependency. Its result is a GLB in metres,
independent of the unit of the file, with the number and the surface of the face of each triangle in an extension
(`TM_brep_faces`). Surfaces that bound no solid are left out: construction geometry and datum targets would enlarge the
bounding box. Faces are numbered from 1 in the order of the file, as in CAD programs. Object frame, metres, radians.
"""

import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from enum import StrEnum
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from cell.errors import FileError
from cell.part import glb
from cell.part.mesh_checks import Finding, Kind, Severity, bodies, collapsed, double_areas, neighbours
from planner.geometry.mesh import TriangleMesh, concatenate_meshes
from planner.values import Floats, Ints, Ints32, Value


class SurfaceKind(StrEnum):
    """What a face is a piece of."""

    PLANE = "plane"
    CYLINDER = "cylinder"
    CONE = "cone"
    SPHERE = "sphere"
    TORUS = "torus"
    OTHER = "other"
    """A surface without parameters of its own, such as a spline."""


@dataclass(frozen=True, slots=True, eq=False)
class CadFace(Value):
    """One face; what its kind does not have is None.

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

    @property
    def dimensions(self) -> str:
        """Its sizes with their units; "" where it has none."""
        if self.half_angle is not None:
            return f"half angle {np.degrees(self.half_angle):.4g} deg"
        if self.radius is None:
            return ""
        size = f"diameter {2000 * self.radius:.5g} mm"
        return size if self.centre_radius is None else f"tube's {size}, about {2000 * self.centre_radius:.5g} mm"


@dataclass(frozen=True, slots=True, eq=False)
class CadModel(Value):
    """Which face each triangle of a part belongs to.

    Attributes:
        faces: in the order of their numbers; those of what is no solid are missing.
        of_triangle: (F,) index in `faces` of each triangle.
    """

    faces: tuple[CadFace, ...]
    of_triangle: Annotated[Ints32, "F"]

    def counts(self) -> dict[str, int]:
        """How many faces there are of each kind that there is."""
        kinds = [face.kind for face in self.faces]
        return {kind.value: kinds.count(kind) for kind in SurfaceKind if kind in kinds}

    def areas(self, mesh: TriangleMesh) -> Floats:
        """(N,) area of each face [m^2], of the triangles of `mesh`."""
        return np.bincount(self.of_triangle, weights=mesh.areas, minlength=len(self.faces)).astype(np.float64)

    def centres(self, mesh: TriangleMesh) -> Floats:
        """(N, 3) centre of gravity of each face's triangles [m]; zero where it has none."""
        areas, centres = mesh.areas, mesh.centres
        whole = np.maximum(self.areas(mesh), np.finfo(np.float64).tiny)
        sums = [np.bincount(self.of_triangle, weights=areas * axis, minlength=len(self.faces)) for axis in centres.T]
        return np.stack(sums, axis=1) / whole[:, None]


DEVIATION_MM = 0.02
"""How far triangles may lie off the surface that they stand for: of the order of what a scanner is sure to."""

TURN_RAD = 0.2
"""Angle between the normals of neighbouring triangles at most: their tilt counts in the angle of incidence."""

_POINTS = ("origin", "center", "apex")
_AXES = ("normal", "axis")


@dataclass(frozen=True, slots=True, eq=False)
class StepModel:
    """What a STEP file holds.

    Attributes:
        vertices: (V, 3) [m], those of neighbouring faces not yet merged.
        faces: (F, 3).
        cad: the faces of the solids, and which of them each triangle belongs to.
        findings: what was left out.
    """

    vertices: Floats
    faces: Ints
    cad: CadModel
    findings: tuple[Finding, ...]


def read_step(source: str, content: bytes) -> StepModel:
    """The solids of a STEP file.

    Args:
        source: what the sentences call it.
        content: of the file.

    Raises:
        FileError: if `cascadio` is not installed, or the file is broken or holds no surface.
    """
    made = _as_glb(source, content)
    try:
        return _solids(list(_bodies(made)))
    except (glb.BrokenGlbError, KeyError, TypeError, ValueError) as error:
        raise _broken(source) from error


def read_coloured_step(source: str, content: bytes) -> tuple[Floats, Ints, Floats]:
    """The surfaces of a STEP file with the colours that its CAD program gave them: of a face, or of its body.

    Args:
        source: what the sentences call it.
        content: of the file.

    Returns:
        Vertices (V, 3) [m], triangles (F, 3), and red, green and blue (F, 3), 0 to 255; NaN where a face has no colour.

    Raises:
        FileError: if `cascadio` is not installed, or the file is broken or holds no surface.
    """
    try:
        # A primitive for each face: merged ones have the colour of their body alone.
        surfaces = list(glb.primitives(_as_glb(source, content, by_face=True)))
    except glb.BrokenGlbError as error:
        raise _broken(source) from error
    linear = np.array([each.colour or (np.nan,) * 3 for each in surfaces]).reshape(-1, 3)
    # IEC 61966-2-1: what a STEP file and a screen count in.
    counted = 255 * np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)
    vertices, faces, of_face = concatenate_meshes((each.vertices, each.faces) for each in surfaces)
    return vertices, faces, counted[of_face]


def _as_glb(source: str, content: bytes, *, by_face: bool = False) -> bytes:
    """What Open CASCADE makes of a file: a primitive for each body with its faces described, or one for each face."""
    try:
        import cascadio  # an optional dependency of 104 MB
    except ImportError as error:
        raise FileError(
            f"{source} is a STEP file, which takes cascadio to read: pip install 'scan-cell[step]', or export a mesh"
        ) from error
    if b"ISO-10303-21" not in content[:2000]:
        raise FileError(f"{source} is no STEP file (ISO 10303-21); export it again")
    with _in_silence():
        made: bytes = cascadio.load(
            content, file_type="step", tol_linear=DEVIATION_MM, tol_angular=TURN_RAD, use_parallel=False,
            include_brep=not by_face, merge_primitives=not by_face,
        )  # fmt: skip
    if not made:
        raise FileError(f"{source} holds no surface that Open CASCADE can read; export its solids again")
    return made


def _broken(source: str) -> FileError:
    return FileError(f"{source} cannot be read as STEP; it is broken or cut short, export it again")


@contextmanager
def _in_silence() -> Iterator[None]:
    """Open CASCADE writes on both streams of the process, one of which is for `--json`; its words are not passed on."""
    kept = [(stream, os.dup(stream)) for stream in (1, 2)]
    nowhere = os.open(os.devnull, os.O_WRONLY)
    try:
        for stream, _ in kept:
            os.dup2(nowhere, stream)
        yield
    finally:
        for stream, own in kept:
            os.dup2(own, stream)
            os.close(own)
        os.close(nowhere)


@dataclass(frozen=True, slots=True, eq=False)
class _Body:
    """One surface of the file: a solid, several of them, or none."""

    vertices: Floats
    faces: Ints
    face_of: Ints
    cad: tuple[CadFace, ...]
    solid: NDArray[np.bool_]


def _bodies(made: bytes) -> Iterator[_Body]:
    """The surfaces with their CAD faces, numbered through."""
    count = 0
    for primitive in glb.primitives(made):
        told = primitive.extensions.get("TM_brep_faces")
        described = told.get("faces", []) if isinstance(told, Mapping) else [None]
        face_of = primitive.numbers(told["faceIndices"]) if told else np.zeros(len(primitive.faces), np.int64)
        if len(face_of) != len(primitive.faces):
            raise ValueError("a face number for each triangle")
        described = described or [None] * (int(face_of.max(initial=-1)) + 1)
        cad = tuple(cad_face(count + k + 1, each or {}, primitive.T) for k, each in enumerate(described))
        yield _Body(primitive.vertices, primitive.faces, face_of, cad, _bounds_solid(primitive))
        count += len(cad)


def cad_face(number: int, described: glb.Table, T: Floats) -> CadFace:
    """A face as the extension describes it, placed by its node.

    Args:
        number: of the face.
        described: "type" and the parameters of the surface [m, rad]; none of them for a surface without.
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


def _bounds_solid(primitive: glb.Primitive) -> NDArray[np.bool_]:
    """(F,) whether each triangle belongs to a closed surface; those without area belong where their face does."""
    _, place = np.unique(primitive.vertices, axis=0, return_inverse=True)
    faces = place.ravel()[primitive.faces]
    whole = ~collapsed(faces)
    closed = np.ones(len(faces), dtype=np.bool_)
    if whole.any():
        one, two, _, uses = neighbours(faces[whole])
        body, count = bodies(int(whole.sum()), one, two)
        rim = np.zeros(count, dtype=np.bool_)
        rim[body[(uses == 1).reshape(3, -1).any(axis=0)]] = True
        closed[whole] = ~rim[body]
    return closed


def _solids(found: list[_Body]) -> StepModel:
    """One surface of all solids; of all surfaces where nothing is a solid, which the mesh check then says."""
    some = any(body.solid.any() for body in found)
    kept = [(body, body.solid if some else np.ones(len(body.faces), dtype=np.bool_)) for body in found]
    left_out = sum(float(double_areas(body.vertices, body.faces[~own]).sum()) / 2 for body, own in kept)
    vertices, faces, _ = concatenate_meshes((body.vertices, body.faces[own]) for body, own in kept)
    every: list[CadFace] = []
    index: list[Ints] = [np.zeros(0, np.int64)]
    for body, own in kept:
        index.append(body.face_of[own] + len(every))
        every += body.cad
    there, of_triangle = np.unique(np.concatenate(index), return_inverse=True)
    cad = CadModel(tuple(every[k] for k in there.tolist()), of_triangle.astype(np.int32))
    findings: tuple[Finding, ...] = ()
    if left_out:
        sentence = (
            f"surfaces of {1e6 * left_out:.4g} mm² bound no solid and were left out; if they are the part's, close "
            "them in the CAD program"
        )
        findings = (Finding(Kind.NO_SOLID, sentence, Severity.WARNING),)
    return StepModel(vertices, faces, cad, findings)
