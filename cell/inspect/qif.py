"""Reading of QIF 3 files (ISO 23952): features and characteristics as tables of the scene.

The QIF file describes the same model as the STEP file. A feature of it names faces of its own model; such a face is the
CAD face of the part on the same surface at whose mesh vertices the corners of the face lie. Values have the unit that
their attribute names, else the primary unit of the file. Every characteristic is either read or named in `unsupported`.
"""

import re
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
from numpy.typing import NDArray
from pydantic import ValidationError

from cell.errors import FileError
from cell.files import file_errors, read_bytes
from cell.inspect.features import same_surface
from cell.part.cad import CadModel, SurfaceKind
from cell.part.workpiece import Workpiece
from cell.scene.features import CharacteristicTable, FeatureTable
from planner.geometry.closest import ClosestPointQuery
from planner.geometry.mesh import TriangleMesh
from planner.values import Bools, Floats

_NEAR = 5e-5  # m; corner of a face from the triangles of the same face: they leave it by up to `cad.DEVIATION_MM`
_SCALE = 1e-3  # largest difference of equal scales
_NAME = 60  # characters; longer names are cut
LENGTHS = {
    "m": 1.0, "meter": 1.0, "metre": 1.0, "cm": 1e-2, "centimeter": 1e-2, "centimetre": 1e-2, "mm": 1e-3,
    "millimeter": 1e-3, "millimetre": 1e-3, "um": 1e-6, "micrometer": 1e-6, "micrometre": 1e-6, "in": 0.0254,
    "inch": 0.0254,
}  # fmt: skip
ANGLES = {"rad": 1.0, "radian": 1.0, "deg": np.pi / 180, "degree": np.pi / 180}
"""Factors to metres and radians of units that a file names without a conversion."""

_SURFACES = {
    "Plane23": SurfaceKind.PLANE,
    "Cylinder23": SurfaceKind.CYLINDER,
    "Cone23": SurfaceKind.CONE,
    "Sphere23": SurfaceKind.SPHERE,
    "Torus23": SurfaceKind.TORUS,
}
_KINDS = {
    "Diameter": "size", "SphericalDiameter": "size", "Width": "size", "Angle": "angle", "AngleBetween": "angle",
    "DistanceBetween": "distance", "Straightness": "straightness",
    "Flatness": "form", "Circularity": "roundness", "Cylindricity": "form", "Sphericity": "form", "Conicity": "form",
    "Position": "position", "Parallelism": "parallelism", "Perpendicularity": "perpendicularity",
    "Angularity": "angularity", "SurfaceProfile": "profile", "CircularRunout": "runout",
    "TotalRunout": "total-runout", "Concentricity": "coaxiality", "Coaxiality": "coaxiality",
}  # fmt: skip
_MEASURED = {
    "Diameter": ("cylinder", "sphere"), "SphericalDiameter": ("cylinder", "sphere"), "Width": ("width",),
    "Angle": ("cone", "width"),
}  # fmt: skip
"""Features of sizes: the size of a cone is its angle."""

_FEATURES = {
    "Plane": "plane", "Cylinder": "cylinder", "CylindricalSegment": "cylinder", "Cone": "cone",
    "ConicalSegment": "cone", "Sphere": "sphere", "SphericalSegment": "sphere", "OppositeParallelPlanes": "width",
    "OppositeAngledPlanes": "width", "OtherNonShape": "surface", "OtherSurface": "surface", "Freeform": "surface",
    "PointDefinedSurface": "surface",
}  # fmt: skip


@dataclass
class QifContent:
    """Content of a QIF file.

    Attributes:
        features: with their characteristics.
        unsupported: a sentence about each item that is left out.
        notes: doubts about the file.
        n_characteristics: number of characteristics in the file.
    """

    features: list[FeatureTable] = field(default_factory=list)
    unsupported: list[str] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    n_characteristics: int = 0


class _UnsupportedError(Exception):
    """An item that cannot be used; the message is the cause."""


def parse(path: Path) -> ElementTree.Element:
    """Return the root of a QIF file, with tags without namespace.

    Raises:
        FileError: if it is no QIF 3 file.
    """
    with file_errors(f"{path} cannot be read"):
        content = read_bytes(path)
    if b"<!ENTITY" in content:
        raise FileError(f"{path} declares entities, which a QIF file has no use for; export it again")
    try:
        root = ElementTree.fromstring(content)
    except ElementTree.ParseError as error:
        raise FileError(f"{path} is not valid XML: {error}; export it again") from error
    if not root.tag.endswith("}QIFDocument") or "qif3" not in root.tag:
        raise FileError(f"{path} is not a QIF 3 document; export it as QIF 3")
    for element in root.iter():
        element.tag = element.tag.rpartition("}")[2]
    ids = Counter(each.get("id") for each in root.iter() if each.get("id"))
    if twice := next((number for number, count in ids.items() if count > 1), None):
        raise FileError(f"{path} has the id {twice} more than once, so references to it are ambiguous; export it again")
    return root


def read_qif(path: Path, part: Workpiece) -> QifContent:
    """Read features and characteristics of a QIF file for a part with CAD faces.

    Raises:
        FileError: if the file is no QIF 3 file, has results, or the part is a mesh.
    """
    if part.cad is None:
        raise FileError(f"{path} names CAD faces, and {part.name} is a mesh; give the part as STEP")
    root = parse(path)
    if root.find("Results") is not None:
        raise FileError(f"{path} has results, and inspections add their own; give the file without results")
    try:
        return _Reader(root, part, part.cad).read()
    except _UnsupportedError as error:
        raise FileError(f"{path} cannot be read: {error}; export it again") from error


def _number(text: str | None, name: str) -> float:
    try:
        value = float(text or "")
    except ValueError:
        value = np.nan
    if not np.isfinite(value):
        raise _UnsupportedError(f"its {name} is '{text or ''}', and a number is needed")
    return value


class _Reader:
    """Conversion of a document."""

    def __init__(self, root: ElementTree.Element, part: Workpiece, cad: CadModel) -> None:
        self._root, self._cad = root, cad
        self._by_id = {each.get("id"): each for each in root.iter() if each.get("id")}
        shapes, primary = self._units("LinearUnit", LENGTHS)
        sizes, size_primary = self._units("PMILinearUnit", LENGTHS)  # overrides that of points in characteristics
        self._linear, self._primary = shapes | sizes, size_primary or primary
        angles = [self._units(tag, ANGLES) for tag in ("AngularUnit", "PMIAngularUnit")]  # likewise
        self._angular = {name: factor for factors, _ in angles for name, factor in factors.items()}
        self._primary_angle = next((primary for _, primary in reversed(angles) if primary), "radian")
        self._metres = shapes.get(primary, 1e-3)
        self._faces = _FaceFinder(self._by_id, self._metres, part, cad)
        self._tables: dict[tuple[str | int, ...], dict[str, object]] = {}
        self._result = QifContent()
        self._letters: dict[str, str] = {}
        self._linear_units_used: dict[str, list[str]] = {}

    def read(self) -> QifContent:
        content = self._result
        try:
            scale, ratio = self._faces.scale(), self._size_ratio()
        except _UnsupportedError:  # its items are named below
            scale, ratio = 1.0, 1.0
        if abs(scale - 1) > _SCALE and abs(scale * ratio - 1) < _SCALE:
            self._faces.rescale(1 / scale)
            content.notes.append(
                f"the model of the file is {scale:.4g} times as large as the part and as its own sizes; its faces are "
                "found at the size of the part"
            )
        for definition in self._root.iterfind("DatumDefinitions/DatumDefinition"):
            letter = definition.findtext("DatumLabel") or ""
            try:
                self._add_datum(letter, definition)
            except _UnsupportedError as error:
                content.unsupported.append(f"datum {letter}: {error}")
        for nominal in self._root.iterfind("Characteristics/CharacteristicNominals/*"):
            content.n_characteristics += 1
            kind, name = nominal.tag.removesuffix("CharacteristicNominal"), self._name(nominal)
            try:
                self._add_characteristic(kind, name, nominal)
            except _UnsupportedError as error:
                content.unsupported.append(f"{name} ({kind}): {error}")
        content.features += [FeatureTable.model_validate(table) for table in self._tables.values()]
        if not content.features and self._faces.has_unknown:
            cause = "it is the file of another part, or its model has another place or unit"
            if abs(scale - 1) > _SCALE:
                cause = f"its model is {scale:.4g} times as large"
            content.notes.append(
                f"no face of the file is a face of the part: {cause}; export it from the model of the STEP file"
            )
        used = {unit: kinds for unit, kinds in self._linear_units_used.items() if kinds}
        if len(used) > 1:
            text = "; ".join(f"{unit} for {', '.join(dict.fromkeys(kinds))}" for unit, kinds in used.items())
            content.notes.append(
                f"the file mixes units of length ({text}); they are read as stated, so check one against the drawing"
            )
        return content

    def _size_ratio(self) -> float:
        """Return the median ratio of stated diameters to those in the file's model; 0 without diameters."""
        ratios = [0.0]
        for nominal in self._root.iter("DiameterCharacteristicNominal"):
            place = nominal
            for step in ("FeatureNominalIds/Id", "EntityInternalIds/Id", "Surface/Id"):
                place = self._by_id.get(place.findtext(step), nominal)
            target, drawn = nominal.find("TargetValue"), place.findtext(".//Diameter")
            if target is not None and drawn and (size := _number(drawn, "diameter")) > 0:
                unit = self._linear.get(target.get("linearUnit") or self._primary, 0.0)
                ratios.append(_number(target.text, "value") * unit / (size * self._metres))
        return float(np.median(ratios[1:] or ratios))

    def _units(self, tag: str, known: Mapping[str, float]) -> tuple[dict[str, float], str]:
        """Return the factor of each unit to the SI unit, and the name of the primary unit."""
        factors: dict[str, float] = {}
        for unit in self._root.iterfind(f"FileUnits//{tag}"):
            factors[unit.findtext("UnitName") or ""] = self._factor(unit, known)
        primary = self._root.findtext(f"FileUnits/PrimaryUnits/{tag}/UnitName") or ""
        return factors, primary

    def _factor(self, unit: ElementTree.Element, known: Mapping[str, float]) -> float:
        """Return the factor of a unit to the SI unit, without a conversion that of a known name."""
        name, base = unit.findtext("UnitName") or "", unit.findtext("SIUnitName")
        if (text := unit.findtext("UnitConversion/Factor")) is None:
            factor = known.get(name, 1.0 if name == base else None)
            if factor is None:
                raise _UnsupportedError(f"its unit '{name}' has no conversion, and is none of {', '.join(known)}")
            return factor
        if (value := _number(text, "factor of a unit")) <= 0:
            raise _UnsupportedError(f"its factor of the unit '{name}' is {value:g}, not above 0")
        return value

    def _name(self, nominal: ElementTree.Element) -> str:
        name = (nominal.findtext("Name") or "").replace("|", "/")
        return " ".join(name.split())[:_NAME] or f"characteristic {nominal.get('id')}"

    def _element(self, number: str | None) -> ElementTree.Element:
        if (element := self._by_id.get(number)) is None:
            raise _UnsupportedError(f"the file has no item {number}")
        return element

    def _length_mm(self, element: ElementTree.Element, kind: str) -> float:
        unit = element.get("linearUnit") or self._primary
        if not unit or unit not in self._linear:
            raise _UnsupportedError(
                f"the file does not define the unit '{unit}'" if unit else "the file states no unit of length"
            )
        self._linear_units_used.setdefault(unit, []).append(kind)
        return round(_number(element.text, "value") * self._linear[unit] * 1000, 12)

    def _angle_deg(self, element: ElementTree.Element) -> float:
        unit = element.get("angularUnit") or self._primary_angle
        factor = self._angular.get(unit, ANGLES.get(unit))
        if factor is None:
            raise _UnsupportedError(f"the file does not define the unit '{unit}'")
        return round(float(np.degrees(_number(element.text, "value") * factor)), 9)

    def _add_datum(self, letter: str, definition: ElementTree.Element) -> None:
        if not re.fullmatch("[A-Z]{1,2}", letter):
            raise _UnsupportedError("its label has not one or two capital letters")
        ids = [each.text for each in definition.iterfind("FeatureNominalIds/Id")]
        if not ids:
            raise _UnsupportedError("it is defined by datum targets, which are not supported")
        if len(ids) == 1:
            table = self._feature(self._element(ids[0]))
        else:  # faces on one surface are one feature
            groups = self._faces.groups([n for each in ids for n in self._table_faces(self._element(each))])
            if len(groups) > 1:
                raise _UnsupportedError(f"its features lie on {len(groups)} surfaces, and one is supported")
            table = self._table(*groups[0], name=f"datum {letter}")
        if table.get("datum"):
            raise _UnsupportedError(f"its feature is also the datum {table['datum']}")
        table["datum"] = letter
        self._letters[definition.get("id") or ""] = letter

    def _feature(self, nominal: ElementTree.Element) -> dict[str, object]:
        """Return the table of a feature; it is added at the first call."""
        numbers = self._table_faces(nominal)
        kind = _FEATURES[nominal.tag.removesuffix("FeatureNominal")]
        kinds = [] if kind == "surface" else [each for _, each in self._faces.groups(numbers)]
        if kinds != {"surface": [], "width": ["plane", "plane"]}.get(kind, [kind]):
            raise _UnsupportedError(f"its feature is a {kind} with faces on {len(kinds)} surfaces: {', '.join(kinds)}")
        return self._table(numbers, kind, f"{kind} {nominal.get('id')}")

    def _table(self, numbers: tuple[int, ...], kind: str, name: str) -> dict[str, object]:
        key: tuple[str | int, ...] = (kind, *numbers)
        return self._tables.setdefault(key, {"name": name, "faces": numbers, "kind": kind, "characteristic": []})

    def _add_characteristic(self, kind: str, name: str, nominal: ElementTree.Element) -> None:
        if kind not in _KINDS:
            raise _UnsupportedError("this kind is not supported")
        definition = self._element(nominal.findtext("CharacteristicDefinitionId"))
        if definition.findtext("DimensionType") == "BASIC_OR_TED":
            raise _UnsupportedError("a basic dimension has no tolerance; positions refer to the model")
        content = self._content(kind, definition, nominal) | {"kind": _KINDS[kind], "source_id": nominal.get("id")}
        features = [self._element(each.text) for each in nominal.iterfind("FeatureNominalIds/Id")]
        if not features:
            raise _UnsupportedError("it names no feature")
        if kind in ("DistanceBetween", "AngleBetween"):
            tables = self._two_features(features)
            self._append(tables[0], content | {"name": name, "to": tables[1]["name"]})
            return
        for number, feature in enumerate(features, 1):
            own = f"{name} [{number}/{len(features)}]" if len(features) > 1 else name
            table = self._feature(feature)
            if table["kind"] not in _MEASURED.get(kind, (table["kind"],)):
                raise _UnsupportedError(f"{kind} of a {table['kind']} is not supported")
            is_cone = kind == "Angle" and table["kind"] == "cone"
            self._append(table, content | {"name": own} | ({"kind": "size"} if is_cone else {}))

    def _two_features(self, nominals: Sequence[ElementTree.Element]) -> list[dict[str, object]]:
        """Return two features; coplanar faces of several nominals are one."""
        numbers = [number for each in nominals for number in self._table_faces(each)]
        groups = self._faces.groups(numbers)
        if len(groups) != 2:
            raise _UnsupportedError(f"its features lie on {len(groups)} surfaces, and two are needed")
        return [self._table(group, kind, f"{kind} {group[0]}") for group, kind in groups]

    def _table_faces(self, nominal: ElementTree.Element) -> tuple[int, ...]:
        kind = nominal.tag.removesuffix("FeatureNominal")
        if kind not in _FEATURES:
            raise _UnsupportedError(f"its feature is a {kind}, which is not supported")
        numbers = self._faces.numbers([each.text or "" for each in nominal.iterfind("EntityInternalIds/Id")])
        if _FEATURES[kind] == "surface":  # of faces of any kind
            return numbers
        # A blind hole has its bottom, too.
        groups = self._faces.groups(numbers)
        own = tuple(sorted(n for group, each in groups if each == _FEATURES[kind] for n in group))
        return own or numbers

    def _append(self, table: dict[str, object], content: dict[str, object]) -> None:
        try:
            characteristic = CharacteristicTable.model_validate(content)
        except ValidationError as error:
            raise _UnsupportedError(str(error.errors()[0]["msg"]).removeprefix("Value error, ").lstrip(".")) from error
        characteristics = table["characteristic"]
        assert isinstance(characteristics, list)
        characteristics.append(characteristic)

    def _content(self, kind: str, definition: ElementTree.Element, nominal: ElementTree.Element) -> dict[str, object]:
        """Return tolerance, nominal value, datums and zone."""
        content: dict[str, object] = {}
        is_angle = _KINDS[kind] == "angle"

        def measure(element: ElementTree.Element) -> float:
            return self._angle_deg(element) if is_angle else self._length_mm(element, kind)

        target = nominal.find("TargetValue")
        if target is not None:
            content["nominal"] = measure(target)
        low, high = definition.find("Tolerance/MinValue"), definition.find("Tolerance/MaxValue")
        absolute = (definition.findtext("Tolerance/DefinedAsLimit") or "").strip() in ("true", "1")
        if absolute and target is None:
            raise _UnsupportedError("its limits have no nominal value")
        base = float(str(content.get("nominal", 0.0))) if absolute else 0.0
        for key, element in (("lower", low), ("upper", high)):
            if element is not None:
                content[key] = round(measure(element) - base, 9)
        if definition.find("ToleranceZonePerUnitArea") is not None:
            raise _UnsupportedError("a tolerance per unit area is not supported")
        if (value := definition.find("ToleranceValue")) is not None:
            if (tolerance := self._length_mm(value, kind)) <= 0:
                raise _UnsupportedError(f"its tolerance is {tolerance:g} mm, and one above 0 is needed")
            content["tolerance_mm"] = tolerance
        if (frame := definition.findtext("DatumReferenceFrameId")) is not None:
            content["datums"] = tuple(self._frame(self._element(frame)))
        if definition.findtext("MaterialCondition") in ("MAXIMUM", "LEAST"):
            content["note"] = "regardless of feature size: the bonus of its material condition is not added"
        zones = {"DiametricalZone": "cylindrical", "PlanarZone": "planar", "NonDiametricalZone": "planar"}
        if (zone := definition.find("ZoneShape/*")) is not None:
            content["zone"] = zones.get(zone.tag)
        return content

    def _frame(self, frame: ElementTree.Element) -> Iterator[str]:
        order = {"PRIMARY": 0, "SECONDARY": 1, "TERTIARY": 2}
        datums = frame.findall("Datums/Datum")
        for datum in sorted(datums, key=lambda each: order.get(each.findtext("Precedence/PrecedenceEnum") or "", 3)):
            ids = [each.text or "" for each in datum.iter("DatumDefinitionId")]
            for each in ids:
                if each not in self._by_id:
                    raise _UnsupportedError(
                        f"it refers to the datum with the id {each}, which the file does not define"
                    )
                if each not in self._letters:
                    label = self._element(each).findtext("DatumLabel")
                    raise _UnsupportedError(f"it refers to the datum {label}, which is not supported")
            yield "-".join(self._letters[each] for each in ids)


class _FaceFinder:
    """CAD faces of the part for faces of the file's own model."""

    def __init__(
        self, by_id: dict[str | None, ElementTree.Element], metres: float, part: Workpiece, cad: CadModel
    ) -> None:
        self._by_id, self._cad, self._mesh, self._metres = by_id, cad, part.reference, metres
        self._surfaces: dict[int, tuple[NDArray[np.int32], Floats, Floats]] = {}
        self._queries: dict[int, ClosestPointQuery] = {}
        self._matches: dict[str, list[int]] = {}
        self.has_unknown = False  # whether a face of the file was no face of the part

    def numbers(self, ids: Sequence[str]) -> tuple[int, ...]:
        """Return the numbers of the CAD faces of QIF faces, ascending."""
        if not ids:
            raise _UnsupportedError("its feature names no face of the model")
        for each in ids:
            if each not in self._matches:
                self._matches[each] = self._matching(each)
        return tuple(sorted({number for each in ids for number in self._matches[each]}))

    def scale(self) -> float:
        """Return the size of the file's model, by its solids if it has any, in sizes of the part; 1 if unknown."""
        solids = [body for body in self._by_id.values() if body.tag == "Body" and body.get("form") == "SOLID"]
        numbers = {each.text for body in solids for each in body.iterfind("FaceIds/Id")}
        corners = np.concatenate([
            np.zeros((0, 3)),
            *(self._corners(face) for number, face in self._by_id.items()
              if face.tag == "Face" and (number in numbers or not solids)),
        ])  # fmt: skip
        if not len(corners):
            return 1.0
        scales = np.ptp(corners, axis=0) / np.ptp(self._mesh.vertices, axis=0).clip(1e-12)
        return float(scales.mean()) if np.ptp(scales) < _SCALE * scales.max() else 1.0

    def rescale(self, factor: float) -> None:
        """Multiply the lengths of the file's model."""
        self._metres *= factor

    def groups(self, numbers: Sequence[int]) -> list[tuple[tuple[int, ...], str]]:
        """Return faces on the same surface together, with the kind of the surface."""
        faces = {face.number: face for face in self._cad.faces}
        groups: list[list[int]] = []
        for number in sorted(set(numbers)):
            same = next((group for group in groups if same_surface(faces[group[0]], faces[number])), None)
            if same is None:
                groups.append([number])
            else:
                same.append(number)
        kinds = [faces[group[0]].kind.value for group in groups]
        shapes = _FEATURES.values()
        return [
            (tuple(group), kind if kind in shapes else "surface") for group, kind in zip(groups, kinds, strict=True)
        ]

    def _matching(self, face_id: str) -> list[int]:
        """Return the numbers of the CAD faces that contain all corners of a face: the halves of a bore share theirs.

        Without one, those on one surface that contain all corners together: programs cut a bore at other places.
        """
        face = self._by_id.get(face_id)
        if face is None or face.tag != "Face":
            raise _UnsupportedError(f"its feature is {'missing' if face is None else f'an {face.tag}'}, not a face")
        surface = self._by_id.get(face.findtext("Surface/Id"))
        kind = _SURFACES.get("" if surface is None else surface.tag, SurfaceKind.OTHER)
        corners = self._corners(face)
        near = {
            index: self._near(index, corners)
            for index, candidate in enumerate(self._cad.faces)
            if candidate.kind == kind and len(corners)
        }
        numbers = [self._cad.faces[index].number for index, each in near.items() if each.all()]
        if not numbers:
            touched = {self._cad.faces[index].number: each for index, each in near.items() if each.any()}
            complete = [
                group
                for group, _ in self.groups([*touched])
                if np.any([touched[number] for number in group], axis=0).all()
            ]
            numbers = list(complete[0]) if len(complete) == 1 else []
        if not numbers:
            self.has_unknown = True
            raise _UnsupportedError(f"face {face_id} of the file is no face of the part")
        return numbers

    def _near(self, index: int, points: Floats) -> Bools:
        """Return which points (N, 3) lie on a CAD face."""
        faces, low, high = self._surface(index)
        near: Bools = np.all((points >= low - _NEAR) & (points <= high + _NEAR), axis=1)
        if near.any():
            if index not in self._queries:
                self._queries[index] = ClosestPointQuery(TriangleMesh(self._mesh.vertices, faces))
            near[near] = self._queries[index].closest(points[near]).distance < _NEAR
        return near

    def _surface(self, index: int) -> tuple[NDArray[np.int32], Floats, Floats]:
        """Return the triangles (F, 3) of a CAD face, and the lowest and the highest corner (3,) of their box [m]."""
        if index not in self._surfaces:
            faces = self._mesh.faces[self._cad.of_triangle == index]
            corners = self._mesh.vertices[faces].reshape(-1, 3)
            low, high = corners.min(axis=0, initial=np.inf), corners.max(axis=0, initial=-np.inf)
            self._surfaces[index] = faces, low, high
        return self._surfaces[index]

    def _corners(self, face: ElementTree.Element) -> Floats:
        """Return the corners (N, 3) of a face [m]."""
        points: dict[str, list[float]] = {}
        for loop in (self._by_id.get(each.text) for each in face.iterfind("LoopIds/Id")):
            for edge in () if loop is None else loop.iterfind("CoEdges/CoEdge/EdgeOriented/Id"):
                ends = self._by_id.get(edge.text)
                for end in ("VertexBeg/Id", "VertexEnd/Id"):
                    vertex = None if ends is None else self._by_id.get(ends.findtext(end))
                    point = None if vertex is None else self._by_id.get(vertex.findtext("Point/Id"))
                    if point is not None and (text := point.findtext("XYZ")):
                        points[text] = [_number(word, "coordinate") for word in text.split()]
                        if len(points[text]) != 3:
                            raise _UnsupportedError(f"a corner of its face has the coordinates '{text}', not three")
        return self._metres * np.array(list(points.values())).reshape(-1, 3)
