"""Description of a part and of its CAD faces, as `cell part` shows it. Millimetres, object frame."""

import numpy as np
from pydantic import JsonValue

from cell.part.cad import CadFace, CadModel
from cell.part.workpiece import Workpiece
from planner.values import Floats


def volume(part: Workpiece) -> float:
    """Return the enclosed volume [m^3]; meaningless for an open surface."""
    corners = part.reference.vertices[part.reference.faces] - part.centre  # far from the origin, digits would cancel
    return float(np.einsum("fj,fj->", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])) / 6)


def rows(part: Workpiece) -> list[tuple[str, str]]:
    """Return names and values of the part."""
    low, high = 1000 * part.bounds
    rows = [
        ("size", " x ".join(f"{side:.6g}" for side in 1000 * part.size) + " mm"),
        ("from", f"{_list(low)} to {_list(high)} mm in the file's axes"),
        ("surface", f"{1e6 * float(part.reference.areas.sum()):,.1f} mm²"),
        ("volume", f"{1e9 * volume(part):,.1f} mm³"),
        ("triangles", f"{len(part.reference.faces):,}"),
    ]
    if part.cad is not None:
        counts = part.cad.counts()
        rows.append(("CAD faces", f"{len(part.cad.faces)}: " + ", ".join(f"{n} {kind}" for kind, n in counts.items())))
    return rows + [(finding.severity.value, finding.sentence) for finding in part.findings]


def face_table(part: Workpiece, cad: CadModel) -> tuple[list[str], list[list[str]]]:
    """Return heading and rows of the table of the faces."""
    areas, centres = cad.areas(part.reference), cad.centres(part.reference)
    rows = [
        [str(face.number), face.kind.value, face.dimensions, f"{1e6 * area:.6g}", _list(1000 * centre)]
        for face, area, centre in zip(cad.faces, areas, centres, strict=True)
    ]
    return ["face", "kind", "size", "area mm²", "middle mm"], rows


def summary(part: Workpiece) -> dict[str, JsonValue]:
    """Return the description as JSON values."""
    result: dict[str, JsonValue] = {
        "name": part.name,
        "sha256": part.sha256,
        "extents_mm": _rounded(1000 * part.size),
        "bounds_mm": [_rounded(1000 * corner) for corner in part.bounds],
        "area_mm2": round(1e6 * float(part.reference.areas.sum()), 3),
        "volume_mm3": round(1e9 * volume(part), 3),
        "triangles": len(part.reference.faces),
        "findings": [finding.sentence for finding in part.findings],
    }
    if (cad := part.cad) is None:
        return result
    areas, centres = cad.areas(part.reference), cad.centres(part.reference)
    kinds: dict[str, JsonValue] = dict(cad.counts())
    faces: list[JsonValue] = [
        _face(face, float(area), centre) for face, area, centre in zip(cad.faces, areas, centres, strict=True)
    ]
    return {**result, "kinds": kinds, "faces": faces}


def _face(face: CadFace, area: float, centre: Floats) -> dict[str, JsonValue]:
    """Return the parameters of a face; absent ones have no key."""
    result: dict[str, JsonValue] = {
        "number": face.number,
        "kind": face.kind.value,
        "area_mm2": round(1e6 * area, 6),
        "middle_mm": _rounded(1000 * centre),
    }
    if face.point is not None:
        result["point_mm"] = _rounded(1000 * face.point)
    if face.axis is not None:
        result["axis"] = _rounded(face.axis, 9)
    if face.radius is not None:
        result["diameter_mm"] = round(2000 * face.radius, 6)
    if face.centre_radius is not None:
        result["centre_radius_mm"] = round(1000 * face.centre_radius, 6)
    if face.half_angle is not None:
        result["half_angle_deg"] = round(float(np.degrees(face.half_angle)), 6)
    return result


def _rounded(values: Floats, digits: int = 6) -> list[JsonValue]:
    return [round(float(value), digits) + 0.0 for value in values]


def _list(values: Floats) -> str:
    return ", ".join(f"{value:g}" for value in np.round(values, 2) + 0.0)
