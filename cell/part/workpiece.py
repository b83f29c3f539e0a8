"""The part: loaded, checked and scaled to metres (Section 3.1).

The reference mesh keeps the axes and the origin of the file (the object frame). The *centre* of a part is the centre of
its bounding box; a placement is the pose of this point.
"""

import difflib
import hashlib
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from cell.errors import FileError, UsageError
from cell.part import builtin
from cell.part.cad import CadModel, read_step
from cell.part.formats import STEP, UNITS, own_units, units_problem
from cell.part.mesh_checks import Finding, Kind, Severity, repair
from planner.geometry.mesh import TriangleMesh
from planner.geometry.rigid import translation
from planner.values import Floats, Value, freeze

__all__ = ["UNITS", "Finding", "Kind", "Severity", "Workpiece", "from_mesh", "load"]

PLAUSIBLE_LENGTH_M = (0.02, 1.5)
"""Plausible longest side of a part [m]. A part of up to half a metre is shorter if a file in inches is read in
millimetres; a longer one fits no cell of an arm with 1.6 m reach."""

MAX_DISTANCE_SIZES = 1e3
"""Distance of a part from the origin, in longest sides, up to which single precision represents its shape: its
coordinates then have steps of 6e-5 of the part."""


@dataclass(frozen=True, slots=True, eq=False)
class Workpiece(Value):
    """A part to be scanned.

    Attributes:
        name: stem of the file, or name of the built-in part.
        reference: the mesh [m], object frame.
        sha256: of the file's bytes; of the arrays for a built-in part.
        findings: of the checks.
        cad: the CAD faces of the triangles; None for a mesh.
        bounds: (2, 3) lowest and highest corner of the bounding box [m], object frame.
        centre: (3,) middle of the bounding box [m], object frame.
        T_object_centre: (4, 4) the centre as a frame, axes parallel to the object's.
    """

    name: str
    reference: TriangleMesh
    sha256: str
    findings: tuple[Finding, ...] = ()
    cad: CadModel | None = None
    bounds: Annotated[Floats, "2 3"] = field(init=False)
    centre: Annotated[Floats, "3"] = field(init=False)
    T_object_centre: Annotated[Floats, "4 4"] = field(init=False)

    def __post_init__(self) -> None:
        vertices = self.reference.vertices[_used_vertices(self.reference.vertices, self.reference.faces)]
        bounds = np.stack([vertices.min(axis=0), vertices.max(axis=0)])
        T_object_centre = translation(bounds.mean(axis=0))
        object.__setattr__(self, "bounds", bounds)
        object.__setattr__(self, "centre", bounds.mean(axis=0))
        object.__setattr__(self, "T_object_centre", T_object_centre)
        freeze(self)

    @property
    def size(self) -> Floats:
        """(3,) sides of the bounding box [m]."""
        sides: Floats = self.bounds[1] - self.bounds[0]
        return sides


def load(source: str | Path, units: str | None = None) -> Workpiece:
    """Load a part from a mesh or STEP file, or a built-in part by its name.

    Args:
        source: a mesh file (.stl, .obj, .ply, .off, .glb, .gltf, .3mf), a STEP file (.stp, .step) or the name of a
            built-in part.
        units: unit of the file: m, cm, mm, um or in. It is never guessed; None for a built-in part and 3MF, for glTF in
            metres, and for a STEP file that states its unit.

    Raises:
        UsageError: if the units are missing, unknown, or given although the file states them.
        FileError: if the file cannot be used.
    """
    if isinstance(source, str) and source in builtin.NAMES:
        if units is not None:
            raise UsageError(f"the built-in part '{source}' has its own size; omit --units")
        return from_trusted_mesh(source, builtin.load(source))

    from cell.part import mesh_files

    path = Path(source)
    _require_file_or_name(path, builtin.NAMES)
    content = mesh_files.read_bytes(path)
    if why := units_problem(path.name, units):
        raise UsageError(f"{path} {why}")
    units = _require_units(str(path), own_units(path.name) if units is None else units)
    sha256 = hashlib.sha256(content).hexdigest()
    if path.suffix.lower() in STEP:
        solids = read_step(str(path), content, units)
        merged = mesh_files.check_mesh(str(path), solids.vertices, solids.faces)
        part = from_mesh(path.stem, *merged, "m", sha256, solids.cad)
        return replace(part, findings=(*solids.findings, *part.findings))
    states_unit = own_units(path.name) is not None
    return from_mesh(path.stem, *mesh_files.parse(path, content), units, sha256, states_unit=states_unit)


def from_trusted_mesh(name: str, mesh: TriangleMesh) -> Workpiece:
    """Return a part from a closed mesh [m] with outward faces, without checks."""
    digest = hashlib.sha256(mesh.vertices.tobytes())
    digest.update(mesh.faces.tobytes())
    return Workpiece(name, mesh, digest.hexdigest())


def from_arrays(name: str, vertices: Floats, faces: NDArray[np.integer], units: str | None) -> Workpiece:
    """Return a part from a mesh in memory, with the checks of a file.

    Args:
        name: of the part.
        vertices: (V, 3) in `units`, object frame.
        faces: (F, 3).
        units: a key of `UNITS`; never guessed.

    Raises:
        UsageError: if the units are missing or unknown.
        FileError: if the mesh cannot be used.
    """
    from cell.part import mesh_files

    units = _require_units(name, units)
    merged = mesh_files.check_mesh(name, np.asarray(vertices, np.float64), np.asarray(faces, np.int64))
    digest = hashlib.sha256(b"".join(np.ascontiguousarray(array).tobytes() for array in merged)).hexdigest()
    return from_mesh(name, *merged, units, digest)


def _require_units(source: str, units: str | None) -> str:
    known = ", ".join(UNITS)
    if units is None:
        raise UsageError(f"{source} does not state its units; give --units with one of {known}")
    if units not in UNITS:
        close = difflib.get_close_matches(units.lower(), UNITS, n=1)
        hint = f"did you mean '{close[0]}'? " if close else ""
        raise UsageError(f"the units '{units}' are unknown; {hint}Valid are {known}")
    return units


def from_mesh(
    name: str,
    vertices: Floats,
    faces: NDArray[np.integer],
    units: str,
    sha256: str,
    cad: CadModel | None = None,
    *,
    states_unit: bool = False,
) -> Workpiece:
    """Check and repair a mesh, scale it to metres and return the part.

    Args:
        name: of the part.
        vertices: (V, 3) in `units`, object frame, equal ones merged.
        faces: (F, 3).
        units: a key of `UNITS`.
        sha256: of the source of the arrays.
        cad: the CAD face of each triangle; None for a mesh.
        states_unit: whether the file states its unit, so the user cannot.

    Raises:
        FileError: if no face has an area.
    """
    faces, remaining, findings = repair(vertices, faces.astype(np.int64))
    if not len(faces):
        raise FileError(f"every face of {name} has zero area; export the mesh again, or check its scale")
    used = _used_vertices(vertices, faces)
    metres = vertices[used] * UNITS[units]
    mesh = TriangleMesh(metres, (np.cumsum(used, dtype=np.int32) - np.int32(1))[faces])
    user_units = None if states_unit or cad is not None else units
    findings = (*findings, *size_findings(np.ptp(metres, axis=0), user_units), *_distance_findings(metres))
    return Workpiece(
        name, mesh, sha256, findings, None if cad is None else replace(cad, of_triangle=cad.of_triangle[remaining])
    )


def _used_vertices(vertices: Floats, faces: NDArray[np.integer]) -> NDArray[np.bool_]:
    """Return which vertices (V,) belong to a face."""
    used = np.zeros(len(vertices), dtype=np.bool_)
    used[faces] = True
    return used


def _require_file_or_name(path: Path, names: tuple[str, ...]) -> None:
    """Refuse a bare word that is neither a file nor a built-in part: it is most likely a misspelt part."""
    if path.suffix or len(path.parts) != 1 or path.exists():
        return
    close = difflib.get_close_matches(path.name.lower(), names, n=1, cutoff=0.5)
    hint = f"did you mean '{close[0]}'? " if close else ""
    raise FileError(f"'{path}' is neither a file nor a built-in part; {hint}Built in are {', '.join(names)}")


def size_findings(size: Floats, units: str | None, name: str = "the part") -> list[Finding]:
    """Return findings about an implausible size, and about a flat part.

    Args:
        size: (3,) sides of the bounding box [m].
        units: unit in which the file was read; None if it states its own.
        name: its name in sentences.
    """
    findings = []
    longest = float(size.max())
    plausible = PLAUSIBLE_LENGTH_M[0] <= longest <= PLAUSIBLE_LENGTH_M[1]
    if not plausible and units is None:
        sentence = f"{name} is {_length(longest)} long; check the unit in the file"
        findings.append(Finding(Kind.UNITS, sentence, Severity.WARNING))
    elif not plausible and units is not None:
        in_file = longest / UNITS[units]
        fitting = [
            f"{_length(in_file * metres)} in {unit}"
            for unit, metres in UNITS.items()
            if 0.01 <= in_file * metres <= 1.5  # parts for an arm with 1.6 m reach
        ]
        hint = f" It would be {' or '.join(fitting)}." if fitting else ""
        sentence = f"{name} is {_length(longest)} long; check the units ({units}).{hint}"
        findings.append(Finding(Kind.UNITS, sentence, Severity.WARNING))
    if float(size.min()) < 1e-6 * longest:
        sentence = (
            f"{name} is flat (its bounding box is {_length(float(size.min()))} thick); only one side can be scanned"
        )
        findings.append(Finding(Kind.FLAT, sentence, Severity.WARNING))
    return findings


def _distance_findings(vertices: Floats) -> list[Finding]:
    """Return a finding about a part far from the origin, whose coordinates can lack significant digits."""
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    away, longest = float(np.linalg.norm((low + high) / 2)), float((high - low).max())
    if away <= MAX_DISTANCE_SIZES * longest:
        return []
    sentence = (
        f"the part is {_length(away)} from the origin of its file, more than {MAX_DISTANCE_SIZES:g} times its length; "
        "in single precision (every binary STL) part of its shape is lost, so export it near the origin"
    )
    return [Finding(Kind.FAR, sentence, Severity.WARNING)]


def _length(metres: float) -> str:
    """Format a length in mm below one metre, else in m."""
    return f"{metres:.3g} m" if metres >= 1 else f"{metres * 1e3:.3g} mm"
