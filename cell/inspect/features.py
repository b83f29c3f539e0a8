"""Features of a part: nominal shapes with their triangles on the reference, and characteristics with tolerances.

A feature has one or more patches. A patch is the union of CAD faces on one surface: the two halves of a bore are one
patch, a slot between parallel planes has two. Planes point out of the material, cones from the apex to the open side.
Files are in millimetres and degrees, arrays in metres and radians, object frame.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from cell.errors import SceneError
from cell.part.cad import CadFace, CadModel, SurfaceKind
from cell.part.workpiece import Workpiece
from cell.runs.schema import JsonTable, Triple
from cell.scene.features import LIMITED, CharacteristicTable, FeatureTable, Kind
from planner.fitting.shapes import Shape, ShapeKind
from planner.geometry.mesh import TriangleMesh
from planner.values import Bools, Floats, Ints, Value

_SAME = 2e-6  # m, and rad times the extent of a part of 1 m: surfaces of faces that differ by less are one
_COMMON_MM, _COMMON_ANGLE = 0.01, 1e-4  # largest nominal offset and tilt [rad] of the features of a common datum
_SHAPES = {
    SurfaceKind.PLANE: ShapeKind.PLANE,
    SurfaceKind.CYLINDER: ShapeKind.CYLINDER,
    SurfaceKind.CONE: ShapeKind.CONE,
    SurfaceKind.SPHERE: ShapeKind.SPHERE,
}


class Patch(JsonTable):
    """A surface of a feature and its triangles."""

    kind: Literal["plane", "cylinder", "cone", "sphere", "mesh"] = Field(description="mesh: without parameters")
    point_mm: Triple = Field(description="nearest to the middle of the patch, on the plane or axis; centre of a sphere")
    axis: Triple = Field(description="outward normal of a plane; axis; of a cone towards its open side")
    radius_mm: float = Field(description="of a cylinder or sphere; of a cone the distance of `point` from the surface")
    half_angle_deg: float = Field(description="of a cone")
    triangles: tuple[int, ...] = Field(description="faces of reference.ply, from 0")

    @property
    def shape(self) -> Shape | None:
        """Nominal shape; None without parameters."""
        if self.kind == "mesh":
            return None
        point, axis = np.array(self.point_mm) / 1000, np.array(self.axis)
        return Shape(ShapeKind(self.kind), point, axis, self.radius_mm / 1000, float(np.radians(self.half_angle_deg)))


class Feature(JsonTable):
    """A geometric element of the part."""

    name: str
    kind: Literal["plane", "cylinder", "cone", "sphere", "circle", "width", "surface"]
    faces: tuple[int, ...] = Field(description="CAD faces by number")
    datum: str | None = Field(description="letter of the datum that it establishes")
    patches: tuple[Patch, ...]

    @property
    def description(self) -> str:
        """Kind and size in words."""
        first = self.patches[0]
        match self.kind:
            case "cylinder" | "sphere" | "circle":
                return f"{self.kind}, diameter {2 * first.radius_mm:.5g} mm"
            case "cone":
                return f"cone, {2 * first.half_angle_deg:.4g} deg"
            case "surface":
                return f"surface of {len(self.faces)} face{'s' * (len(self.faces) != 1)}"
        return str(self.kind)


class TolerancedCharacteristic(JsonTable):
    """A characteristic of a feature, with limits on its value in mm, or in deg for an angle."""

    id: int = Field(description="number from 1")
    name: str
    feature: str = Field(description="name of its feature")
    kind: Kind
    unit: Literal["mm", "deg"]
    nominal: float = Field(description="nominal value; 0 for a zone")
    lower: float | None = Field(description="smallest conforming value; null: no limit")
    upper: float | None = Field(description="largest conforming value; null: no limit")
    datums: tuple[str, ...] = Field(description="in their order of precedence; A-B is a common datum")

    @property
    def tolerance(self) -> float | None:
        """Width between two limits, or of the zone; None without one."""
        if self.upper is None:
            return None
        if self.kind not in LIMITED:
            return self.upper
        return None if self.lower is None else self.upper - self.lower

    @property
    def tolerance_text(self) -> str:
        """Tolerance in words."""
        datums = f" {'|'.join(self.datums)}" if self.datums else ""
        if self.kind not in LIMITED:
            return ("measured only" if self.upper is None else f"{self.upper:.6g} {self.unit}") + datums
        off = [round(limit - self.nominal, 9) + 0.0 for limit in (self.lower, self.upper) if limit is not None]
        limits = "/".join(f"{each:+.6g}" for each in off) or "(measured only)"
        return f"{self.nominal:.6g} {limits} {self.unit}"


class Characteristic(TolerancedCharacteristic):
    """A characteristic with its evaluation."""

    to: str | None = Field(description="other feature of a distance or angle")
    criterion: Literal["least-squares", "circumscribed", "inscribed"] = Field(description="of a size")
    zone: Literal["planar", "cylindrical"] | None = Field(description="shape of the zone of a position or orientation")
    source_id: str | None = Field(description="id in the QIF file")
    note: str = Field(default="", description="deviation from the standard in its evaluation")


class InspectionPlan(JsonTable):
    """features.json of a run: features, characteristics and settings of the inspection."""

    source: str = Field(description="origin of the characteristics")
    features: tuple[Feature, ...]
    characteristics: tuple[Characteristic, ...]
    unsupported: tuple[str, ...] = Field(description="a sentence about each item of the source that is left out")
    notes: tuple[str, ...] = Field(description="doubts about the source")
    u_over_t: float | None = Field(description="required ratio of expanded uncertainty and tolerance")
    alignment: Literal["best-fit", "rps", "none"]
    rps: tuple[tuple[Triple, Triple, float], ...] = Field(description="points [mm], directions, weights")
    edge_mm: float = Field(description="points nearer to the edge of a feature are not used")
    reach_mm: float = Field(description="points farther from the nominal surface are not used")

    def feature(self, name: str) -> Feature:
        """Return a feature by its name."""
        return next(each for each in self.features if each.name == name)

    def datum(self, letter: str) -> Feature:
        """Return the feature of a datum."""
        return next(each for each in self.features if each.datum == letter)

    def datum_features(self, datum: str) -> list[Feature]:
        """Return the features of a datum: of a common datum, such as A-B, those of all its letters."""
        return [self.datum(letter) for letter in datum.split("-")]

    def features_of(self, characteristic: Characteristic) -> list[Feature]:
        """Return the features that a value depends on: its own, the other one, the datums."""
        names = [characteristic.feature, *([characteristic.to] if characteristic.to else [])]
        datums = [feature for datum in characteristic.datums for feature in self.datum_features(datum)]
        return list(dict.fromkeys([*map(self.feature, names), *datums]))


@dataclass(frozen=True, slots=True, eq=False)
class PatchSurface(Value):
    """Triangles of a patch, and points on its outline.

    Attributes:
        triangles: (F,) of the reference.
        outline: (B, 3) points on the edges to other surface, at most a tenth of its width apart [m].
        width: about the smaller side [m]: twice the area divided by the length of the outline.
    """

    triangles: Annotated[Ints, "F"]
    outline: Annotated[Floats, "B 3"]
    width: float


def patch_surface(mesh: TriangleMesh, triangles: Sequence[int]) -> PatchSurface:
    """Return the outline and width of some triangles."""
    own = np.array(triangles, dtype=np.int64)
    faces = mesh.faces[own]
    edges = np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), axis=1)
    unique, count = np.unique(edges, axis=0, return_counts=True)
    rim = mesh.vertices[unique[count == 1]]
    lengths = np.linalg.norm(rim[:, 1] - rim[:, 0], axis=1)
    width = 2 * float(mesh.areas[own].sum()) / max(float(lengths.sum()), np.finfo(float).tiny)
    points = [
        a + (b - a) * np.linspace(0, 1, int(np.ceil(10 * length / width)) + 1)[:, None]
        for (a, b), length in zip(rim, lengths, strict=True)
    ]
    return PatchSurface(own, np.concatenate([np.empty((0, 3)), *points]), width)


def resolve_features(
    part: Workpiece, tables: Iterable[FeatureTable], unsupported: list[str] | None = None
) -> tuple[tuple[Feature, ...], tuple[Characteristic, ...]]:
    """Return the features and characteristics of tables on a part.

    Args:
        part: with CAD faces.
        tables: features of the scene or of a file.
        unsupported: receives a sentence about each characteristic that its feature cannot have; None raises.

    Raises:
        SceneError: if the part has no CAD faces, or a feature does not fit its faces.
    """
    tables = tuple(tables)
    if not tables:
        return (), ()
    if part.cad is None:
        raise SceneError(f"features are CAD faces, and {part.name} is a mesh, which has none; give the part as STEP")
    features = tuple(_feature(part, part.cad, table) for table in tables)
    named = {each.name: each for each in features}
    characteristics: list[Characteristic] = []
    for table in tables:
        for each in table.characteristic:
            try:
                characteristics.append(_characteristic(len(characteristics) + 1, table, each, named))
            except SceneError as error:
                if unsupported is None:
                    raise
                unsupported.append(str(error))
    return features, tuple(characteristics)


def _feature(part: Workpiece, cad: CadModel, table: FeatureTable) -> Feature:
    by_number = {face.number: k for k, face in enumerate(cad.faces)}
    if missing := [number for number in table.faces if number not in by_number]:
        raise SceneError(
            f"the feature '{table.name}' names face {missing[0]}, which the part does not have; cell part lists them"
        )
    indices = [by_number[number] for number in table.faces]
    patches = tuple(_patches(part.reference, cad, indices))
    kinds = [patch.kind for patch in patches]
    default = kinds[0] if len(kinds) == 1 and kinds[0] != "mesh" else "width" if _is_width(patches) else "surface"
    kind = table.kind or default
    expected = {"width": "two parallel or opposite planes", "circle": "the faces of one cylinder"}
    special = {"surface": True, "width": kinds == ["plane", "plane"], "circle": kinds == ["cylinder"]}
    fits = special.get(kind, kinds == [kind])
    if not fits:
        raise SceneError(
            f"the feature '{table.name}' is a {kind}, which needs {expected.get(kind, f'the faces of one {kind}')}; "
            f"its faces are on: {', '.join(kinds)}"
        )
    return Feature(name=table.name, kind=kind, faces=table.faces, datum=table.datum, patches=patches)


def _is_width(patches: Sequence[Patch]) -> bool:
    return [each.kind for each in patches] == ["plane", "plane"] and abs(
        float(np.dot(patches[0].axis, patches[1].axis))
    ) > np.cos(1e-4)


def _patches(mesh: TriangleMesh, cad: CadModel, indices: Sequence[int]) -> list[Patch]:
    """Return the patches of CAD faces: faces on the same surface together."""
    groups: list[list[int]] = []
    for index in indices:
        same = next((group for group in groups if same_surface(cad.faces[group[0]], cad.faces[index])), None)
        if same is None:
            groups.append([index])
        else:
            same.append(index)
    return [_patch(mesh, cad.faces[group[0]], np.isin(cad.of_triangle, group)) for group in groups]


def same_surface(a: CadFace, b: CadFace) -> bool:
    """Return whether two faces lie on one surface."""
    if a.kind != b.kind or a.kind not in _SHAPES or a.point is None or b.point is None:
        return False
    sizes = abs((a.radius or 0) - (b.radius or 0)) + abs((a.half_angle or 0) - (b.half_angle or 0))
    off = b.point - a.point
    if a.axis is None or b.axis is None:
        return sizes < _SAME and float(np.linalg.norm(off)) < _SAME
    turned = float(np.linalg.norm(np.cross(a.axis, b.axis)))
    shift = {SurfaceKind.PLANE: abs(float(off @ a.axis)), SurfaceKind.CONE: float(np.linalg.norm(off))}
    across = float(np.linalg.norm(np.cross(a.axis, off)))
    return sizes + turned + shift.get(a.kind, across) < _SAME


def _patch(mesh: TriangleMesh, face: CadFace, own: Bools) -> Patch:
    triangles = np.flatnonzero(own)
    areas = mesh.areas[triangles]
    weights = (areas / areas.sum())[:, None]
    centre, normal = (weights * mesh.centres[triangles]).sum(axis=0), (weights * mesh.normals[triangles]).sum(axis=0)
    kind, point = _SHAPES.get(face.kind), face.point
    if kind is None or point is None:
        shape = Shape(ShapeKind.PLANE, centre, np.array([0.0, 0.0, 1.0]))
    else:
        axis = np.array([0.0, 0.0, 1.0]) if face.axis is None else face.axis
        toward = normal if kind is ShapeKind.PLANE else centre - point if kind is ShapeKind.CONE else axis
        axis = axis if float(axis @ toward) >= 0 else -axis
        shape = Shape(kind, point, axis / np.linalg.norm(axis), face.radius or 0.0, face.half_angle or 0.0)
        shape = shape.at_foot(centre)
    return Patch(
        kind="mesh" if kind is None else kind.value,
        point_mm=_triple(1000 * shape.point),
        axis=_triple(shape.axis),
        radius_mm=float(1000 * shape.size),
        half_angle_deg=float(np.degrees(shape.half_angle)),
        triangles=tuple(triangles.tolist()),
    )


def _characteristic(
    number: int, table: FeatureTable, given: CharacteristicTable, named: dict[str, Feature]
) -> Characteristic:
    feature = named[table.name]
    where = f"the characteristic {given.name or given.kind} of '{feature.name}'"
    _require_suitable(where, given, feature)
    for datum in given.datums:
        if "-" in datum:
            _require_common(where, datum, [each for each in named.values() if each.datum in datum.split("-")])
    nominal, notes = given.nominal, [given.note] if given.note else []
    unit: Literal["mm", "deg"] = "mm"
    if given.kind == "angle" or (given.kind == "size" and feature.kind == "cone"):
        unit = "deg"
    if given.kind in LIMITED:
        drawn = _nominal_value(given, feature, None if given.to is None else named[given.to])
        if unit == "deg" and nominal is not None and abs(180 - drawn - nominal) < abs(drawn - nominal):
            drawn = 180 - drawn
        nominal = drawn if nominal is None else nominal
        limit = 0.02 * max(abs(nominal), 1.0)
        if abs(drawn - nominal) > limit:
            notes.append(f"the part has {drawn:.6g} {unit} there, the nominal value is {nominal:.6g} {unit}")
        if given.kind == "size" and given.criterion == "least-squares" and unit == "mm" and feature.kind != "width":
            notes.append("by least squares")
    if given.kind == "position" and feature.kind in ("cylinder", "cone") and given.zone == "planar":
        raise SceneError(f"{where} has a planar zone without direction; give zone = 'cylindrical'")
    lower = None if given.lower is None or nominal is None else nominal + given.lower
    upper = given.tolerance_mm if given.upper is None or nominal is None else nominal + given.upper
    return Characteristic(
        id=number,
        name=given.name or f"{feature.name}: {given.kind}",
        feature=feature.name,
        kind=given.kind,
        unit=unit,
        nominal=nominal or 0.0,
        lower=lower,
        upper=upper,
        datums=given.datums,
        to=given.to,
        criterion=given.criterion,
        zone=given.zone,
        source_id=given.source_id,
        note="; ".join(notes),
    )


_SUITABLE: dict[str, tuple[str, ...]] = {
    "size": ("cylinder", "sphere", "circle", "cone", "width"),
    "form": ("plane", "cylinder", "cone", "sphere", "circle"),
    "roundness": ("cylinder", "cone"),
    "straightness": ("cylinder", "cone"),
    "position": ("cylinder", "sphere", "circle", "cone", "width", "plane"),
    "parallelism": ("plane", "cylinder", "cone"),
    "perpendicularity": ("plane", "cylinder", "cone"),
    "angularity": ("plane", "cylinder", "cone"),
    "profile": ("plane", "cylinder", "cone", "sphere", "width", "surface"),
    "distance": ("plane", "cylinder", "sphere", "circle", "cone"),
    "angle": ("plane", "cylinder", "cone", "width"),
    "coaxiality": ("cylinder", "cone"),
    "runout": ("plane", "cylinder", "cone"),
    "total-runout": ("plane", "cylinder"),
}


def _require_suitable(where: str, table: CharacteristicTable, feature: Feature) -> None:
    if feature.kind not in _SUITABLE[table.kind]:
        raise SceneError(f"{where} is not defined for a {feature.kind}; possible: {', '.join(_SUITABLE[table.kind])}")
    if table.criterion != "least-squares" and (table.kind != "size" or feature.kind in ("cone", "width")):
        raise SceneError(f"{where} has the criterion {table.criterion}, which only diameters have")
    if table.kind == "angle" and table.to is None and feature.kind != "width":
        raise SceneError(f"{where} needs the name of another feature as 'to'")


def _require_common(where: str, datum: str, features: Sequence[Feature]) -> None:
    """Refuse a common datum whose features have neither one axis nor one plane."""
    first, *others = (feature.patches[0] for feature in features)
    offs = [np.array(each.point_mm) - np.array(first.point_mm) for each in others]
    kinds = {feature.kind for feature in features}
    if kinds == {"plane"}:
        is_common = all(abs(float(off @ np.array(first.axis))) < _COMMON_MM for off in offs)
    else:
        is_common = kinds <= {"cylinder", "cone"} and all(
            float(np.linalg.norm(np.cross(first.axis, off))) < _COMMON_MM for off in offs
        )
    if not is_common or any(float(np.linalg.norm(np.cross(first.axis, each.axis))) > _COMMON_ANGLE for each in others):
        raise SceneError(
            f"{where} refers to the common datum {datum}, whose features have neither one axis nor one plane, which is "
            "not supported; give several datums in their order"
        )


def _nominal_value(table: CharacteristicTable, feature: Feature, other: Feature | None) -> float:
    """Return the value on the nominal part [mm, deg]."""
    first = feature.patches[0]
    if table.kind == "size" and feature.kind == "cone":
        return 2 * first.half_angle_deg
    if table.kind == "size" and feature.kind != "width":
        return 2 * first.radius_mm
    second = feature.patches[1] if other is None else other.patches[0]
    if table.kind == "angle":
        return float(np.degrees(np.arccos(np.clip(np.dot(first.axis, second.axis), -1, 1))))
    off = np.array(second.point_mm) - np.array(first.point_mm)
    return distance_between(off, first.kind, np.array(first.axis), second.kind, np.array(second.axis))


def distance_between(off: Floats, kind: str, axis: Floats, other_kind: str, other_axis: Floats) -> float:
    """Return the distance of two elements whose points differ by `off` (3,), in the unit of `off`.

    Along the normal of a plane (the other one if both are), across the axis of a cylinder or cone, else in space.
    """
    if "plane" in (kind, other_kind):
        return abs(float(off @ (other_axis if other_kind == "plane" else axis)))
    if other_kind in ("cylinder", "cone") or kind in ("cylinder", "cone"):
        return float(np.linalg.norm(np.cross(other_axis if other_kind in ("cylinder", "cone") else axis, off)))
    return float(np.linalg.norm(off))


def _triple(values: Floats) -> Triple:
    x, y, z = (float(value) + 0.0 for value in values)
    return x, y, z
