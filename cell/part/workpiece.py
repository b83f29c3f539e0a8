"""The part: load, check, scale to metres (Section 3.1).

The reference mesh keeps the file's own axes and origin (the object frame) and is scaled to metres, not moved. A part's
*centre* is the middle of its bounding box; that point is what a placement places.
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
from cell.part.cad import CadModel
from cell.part.formats import STEP, units_of, wrong_units
from cell.part.mesh_checks import Finding, Kind, Severity, repair
from planner.geometry.mesh import TriangleMesh
from planner.values import Floats, Value, freeze

__all__ = ["UNITS", "Finding", "Kind", "Severity", "Workpiece", "from_mesh", "load"]

UNITS = {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "um": 1e-6, "in": 0.0254}
"""Metres in one unit of the file."""

PLAUSIBLE_M = (0.02, 1.5)
"""Longest side [m] that a part has: up to half a metre long it is shorter where a file in inches is read as one in
millimetres, and a longer one fits no cell whose arm reaches 1.6 m."""

FARTHEST_SIZES = 1e3
"""Distance of a part from its file's origin, in longest sides, up to which a file in single precision holds its shape:
its coordinates then have steps of 6e-5 of the part."""


@dataclass(frozen=True, slots=True, eq=False)
class Workpiece(Value):
    """A part to be scanned.

    Attributes:
        name: the file's stem, or the built-in part's name.
        reference: the mesh, metres, object frame.
        sha256: of the file's bytes; of the arrays for a built-in part.
        findings: what the checks found and did, in plain sentences.
        cad: the CAD faces that the triangles stand for; None of a part that is a mesh.
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
        vertices = self.reference.vertices[_named(self.reference.vertices, self.reference.faces)]
        bounds = np.stack([vertices.min(axis=0), vertices.max(axis=0)])
        T_object_centre = np.eye(4)
        T_object_centre[:3, 3] = bounds.mean(axis=0)
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
    """A part from a mesh or STEP file, or a built-in one by its name.

    Args:
        source: a mesh file (.stl, .obj, .ply, .off, .glb), a STEP file (.stp, .step) or the name of a built-in part.
        units: what the file's numbers are in: m, cm, mm, um or in. Never guessed; not given for a built-in part or a
            STEP file; a GLB has metres where nothing else is said.

    Raises:
        UsageError: if the units are missing for another file, unknown, or given for a built-in part or a STEP file.
        FileError: if the file cannot be used, in one sentence.
    """
    if isinstance(source, str) and source in builtin.NAMES:
        if units is not None:
            raise UsageError(f"the built-in part '{source}' has its own size; leave --units out")
        return made(source, builtin.load(source))

    from cell.part import mesh_files

    path = Path(source)
    _check_name(path, builtin.NAMES)
    content = mesh_files.read_bytes(path)
    if why := wrong_units(path.name, units):
        raise UsageError(f"{path} {why}")
    units = _known(str(path), units_of(path.name) if units is None else units)
    sha256 = hashlib.sha256(content).hexdigest()
    if path.suffix.lower() in STEP:
        from cell.part import cad as step

        solids = step.read_step(str(path), content)
        merged = mesh_files.checked(str(path), solids.vertices, solids.faces)
        part = from_mesh(path.stem, *merged, units, sha256, solids.cad)
        return replace(part, findings=(*solids.findings, *part.findings))
    return from_mesh(path.stem, *mesh_files.parse(path, content), units, sha256)


def made(name: str, mesh: TriangleMesh) -> Workpiece:
    """A part whose mesh [m] was made here, closed and its faces outward: nothing is checked.

    Args:
        name: what to call it.
        mesh: object frame.
    """
    digest = hashlib.sha256(mesh.vertices.tobytes())
    digest.update(mesh.faces.tobytes())
    return Workpiece(name, mesh, digest.hexdigest())


def from_arrays(name: str, vertices: Floats, faces: NDArray[np.integer], units: str | None) -> Workpiece:
    """A part from a mesh in memory, checked as that of a file is.

    Args:
        name: what to call it.
        vertices: (V, 3) in `units`, the part's own axes.
        faces: (F, 3).
        units: a key of `UNITS`; never guessed.

    Raises:
        UsageError: if the units are missing or unknown.
        FileError: if the mesh cannot be used, in one sentence.
    """
    from cell.part import mesh_files

    units = _known(name, units)
    merged = mesh_files.checked(name, np.asarray(vertices, np.float64), np.asarray(faces, np.int64))
    digest = hashlib.sha256(b"".join(np.ascontiguousarray(array).tobytes() for array in merged)).hexdigest()
    return from_mesh(name, *merged, units, digest)


def _known(source: str, units: str | None) -> str:
    known = ", ".join(UNITS)
    if units is None:
        raise UsageError(f"{source} does not say what its numbers are in; pass --units with one of {known}")
    if units not in UNITS:
        close = difflib.get_close_matches(units.lower(), UNITS, n=1)
        hint = f"did you mean '{close[0]}'? " if close else ""
        raise UsageError(f"the units '{units}' are unknown; {hint}Valid are {known}")
    return units


def from_mesh(
    name: str, vertices: Floats, faces: NDArray[np.integer], units: str, sha256: str, cad: CadModel | None = None
) -> Workpiece:
    """A checked part from arrays in the given units.

    Args:
        name: what to call it.
        vertices: (V, 3) in `units`, file axes, equal ones merged.
        faces: (F, 3).
        units: a key of `UNITS`.
        sha256: of where the arrays come from.
        cad: which CAD face each of the faces belongs to; None of a mesh.

    Raises:
        FileError: if no face has an area.
    """
    faces, kept, findings = repair(vertices, faces.astype(np.int64))
    if not len(faces):
        raise FileError(f"every face of {name} has zero area; export the mesh again, or check its scale")
    used = _named(vertices, faces)
    metres = vertices[used] * UNITS[units]
    mesh = TriangleMesh(metres, (np.cumsum(used, dtype=np.int32) - np.int32(1))[faces])
    given = units if cad is None else None
    findings = (*findings, *size_findings(np.ptp(metres, axis=0), given), *_place_findings(metres))
    return Workpiece(
        name, mesh, sha256, findings, None if cad is None else replace(cad, of_triangle=cad.of_triangle[kept])
    )


def _named(vertices: Floats, faces: NDArray[np.integer]) -> NDArray[np.bool_]:
    """(V,) which vertices a face uses."""
    named = np.zeros(len(vertices), dtype=np.bool_)
    named[faces] = True
    return named


def _check_name(path: Path, names: tuple[str, ...]) -> None:
    """A bare word that is neither a file nor a built-in part is most likely a misspelt part."""
    if path.suffix or len(path.parts) != 1 or path.exists():
        return
    close = difflib.get_close_matches(path.name.lower(), names, n=1, cutoff=0.5)
    hint = f"did you mean '{close[0]}'? " if close else ""
    raise FileError(f"'{path}' is neither a file nor a built-in part; {hint}Built in are {', '.join(names)}")


def size_findings(size: Floats, units: str | None, name: str = "the part") -> list[Finding]:
    """Doubts about the units, and about a lack of thickness.

    Args:
        size: (3,) sides of the bounding box [m].
        units: what the file was read in; None where it names its own.
        name: what a sentence calls it.
    """
    findings = []
    longest = float(size.max())
    plausible = PLAUSIBLE_M[0] <= longest <= PLAUSIBLE_M[1]
    if not plausible and units is None:
        sentence = f"{name} is {_length(longest)} long; is the unit that the file names right?"
        findings.append(Finding(Kind.UNITS, sentence, Severity.WARNING))
    elif not plausible and units is not None:
        in_file = longest / UNITS[units]
        fitting = [
            f"{_length(in_file * metres)} in {unit}"
            for unit, metres in UNITS.items()
            if 0.01 <= in_file * metres <= 1.5  # where the parts lie that an arm of 1.6 m reach scans
        ]
        hint = f" It would be {' or '.join(fitting)}." if fitting else ""
        sentence = f"{name} is {_length(longest)} long; are the units ({units}) right?{hint}"
        findings.append(Finding(Kind.UNITS, sentence, Severity.WARNING))
    if float(size.min()) < 1e-6 * longest:
        sentence = f"{name} is flat (its bounding box is {_length(float(size.min()))} thick); only one side is scanned"
        findings.append(Finding(Kind.FLAT, sentence, Severity.WARNING))
    return findings


def _place_findings(vertices: Floats) -> list[Finding]:
    """A part far from its file's origin: its coordinates may have lost the digits that its shape needs."""
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    away, longest = float(np.linalg.norm((low + high) / 2)), float((high - low).max())
    if away <= FARTHEST_SIZES * longest:
        return []
    sentence = (
        f"the part lies {_length(away)} from its file's origin, more than {FARTHEST_SIZES:g} times its length; a file "
        "in single precision (every binary STL) has lost part of its shape there, so export it near the origin"
    )
    return [Finding(Kind.FAR, sentence, Severity.WARNING)]


def _length(metres: float) -> str:
    """A length with the unit that keeps its number short: 0.2 mm, 188 mm, 12 m."""
    return f"{metres:.3g} m" if metres >= 1 else f"{metres * 1e3:.3g} mm"
