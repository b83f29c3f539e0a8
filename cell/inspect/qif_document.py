"""QIF 3 document of features and characteristics that no QIF file defines: shapes, datums, tolerances.

Lengths are in millimetres, angles in degrees, shapes in the frame of the part. A zone without tolerance has no place in
QIF and is left out.
"""

import uuid
from collections.abc import Iterator
from xml.etree import ElementTree

import numpy as np

from cell.inspect.features import Characteristic, Feature, InspectionPlan
from cell.scene.features import LIMITED

NAMESPACE = "http://qifstandards.org/xsd/qif3"

_FEATURES = {"width": "OppositeParallelPlanes", "surface": "OtherNonShape"}
_FORMS = {"plane": "Flatness", "cylinder": "Cylindricity", "cone": "Conicity", "sphere": "Sphericity",
          "circle": "Circularity"}  # fmt: skip
_SIZES = {"width": "Width", "cone": "Angle"}
_KINDS = {
    "roundness": "Circularity", "straightness": "Straightness", "position": "Position", "parallelism": "Parallelism",
    "perpendicularity": "Perpendicularity", "angularity": "Angularity", "profile": "SurfaceProfile",
    "distance": "DistanceBetween", "coaxiality": "Coaxiality", "runout": "CircularRunout",
    "total-runout": "TotalRunout",
}  # fmt: skip
_ORIENTATIONS = ("parallelism", "perpendicularity", "angularity")
_PRECEDENCES = ("PRIMARY", "SECONDARY", "TERTIARY")

Element = ElementTree.Element


def element(tag: str, /, *content: Element | str, **attributes: str) -> Element:
    """Return an element with children, or a text."""
    child = ElementTree.Element(f"{{{NAMESPACE}}}{tag}", attributes)
    for each in content:
        if isinstance(each, str):
            child.text = each
        else:
            child.append(each)
    return child


def counted(tag: str, children: list[Element]) -> Element:
    """Return an element with children, whose number is an attribute."""
    return element(tag, *children, n=str(len(children)))


def number_text(value: float) -> str:
    """Return a number with nine decimals at most, without exponent."""
    text = f"{value:.9f}".rstrip("0").rstrip(".")
    return "0" if text in ("", "-0") else text


def document_of(plan: InspectionPlan) -> tuple[bytes, dict[int, str]]:
    """Return a QIF document of a plan, and the id of each of its characteristics in it."""
    ids = map(str, range(1, 10_000_000))
    standard = next(ids)
    features = {each.name: (next(ids), next(ids), each) for each in plan.features}
    letters = {each.datum: (next(ids), features[each.name][1]) for each in plan.features if each.datum}
    shown = [each for each in plan.characteristics if each.kind in LIMITED or each.upper is not None]
    frames = {datums: next(ids) for datums in dict.fromkeys(each.datums for each in shown if each.datums)}
    rows = [(each, features[each.feature][2], next(ids), next(ids)) for each in shown]
    parts = [
        element("QPId", str(uuid.uuid5(uuid.NAMESPACE_OID, plan.model_dump_json()))),
        counted("StandardsDefinitions", [element(
            "Standard", element("Organization", element("StandardsOrganizationEnum", "ISO")),
            element("Designator", "ISO 1101"), id=standard,
        )]),
        element("FileUnits", element("PrimaryUnits", _unit("Angular", "radian", "degree", f"{np.pi / 180:.15f}"),
                                     _unit("Linear", "meter", "mm", "0.001"))),
        *_datums(letters, frames),
        element(
            "Features",
            counted("FeatureDefinitions", [_definition(number, each) for number, _, each in features.values()]),
            counted("FeatureNominals", [_nominal(*each) for each in features.values()]),
        ),
        element(
            "Characteristics",
            element("FormalStandardId", standard),
            counted("CharacteristicDefinitions", [_tolerance(*row[:3], frames.get(row[0].datums)) for row in rows]),
            counted("CharacteristicNominals", [
                _characteristic(each, feature, definition, number, [features[name][1] for name in _names(each)])
                for each, feature, definition, number in rows
            ]),
        ),
    ]  # fmt: skip
    root = element("QIFDocument", *parts, idMax=str(int(next(ids)) - 1), versionQIF="3.0.0")
    return bytes(ElementTree.tostring(root)), {each.id: number for each, _, _, number in rows}


def _unit(kind: str, base: str, name: str, factor: str) -> Element:
    conversion = element("UnitConversion", element("Factor", factor))
    return element(f"{kind}Unit", element("SIUnitName", base), element("UnitName", name), conversion)


def _names(each: Characteristic) -> list[str]:
    return [each.feature, *([each.to] if each.to else [])]


def _datums(letters: dict[str, tuple[str, str]], frames: dict[tuple[str, ...], str]) -> Iterator[Element]:
    """Yield the definitions of datums, and the frames of them; A-B is a common datum."""

    def simple(letter: str) -> Element:
        modifiers = element("MaterialModifier", "REGARDLESS"), element("ReferencedComponent", "ACTUAL")
        return element("SimpleDatum", element("DatumDefinitionId", letters[letter][0]), *modifiers)

    def datum(name: str, precedence: str) -> Element:
        parts = [
            element("Datum", simple(each), element("SequenceNumber", str(k)))
            for k, each in enumerate(name.split("-"), 1)
        ]
        own = simple(name) if len(parts) == 1 else counted("CompoundDatum", parts)
        return element("Datum", own, element("Precedence", element("PrecedenceEnum", precedence)))

    if letters:
        yield counted("DatumDefinitions", [
            element("DatumDefinition", element("DatumLabel", letter), _references([feature]), id=number)
            for letter, (number, feature) in letters.items()
        ])  # fmt: skip
    if frames:
        yield counted("DatumReferenceFrames", [
            element("DatumReferenceFrame",
                    counted("Datums", [datum(*each) for each in zip(datums, _PRECEDENCES, strict=False)]), id=number)
            for datums, number in frames.items()
        ])  # fmt: skip


def _references(ids: list[str]) -> Element:
    return counted("FeatureNominalIds", [element("Id", each) for each in ids])


def _definition(number: str, feature: Feature) -> Element:
    """Return the size of a feature."""
    first, content = feature.patches[0], list[Element]()
    diameter = 2 * first.radius_mm / np.cos(np.radians(first.half_angle_deg))
    if feature.kind in ("cylinder", "cone", "sphere", "circle"):
        content = [element("Diameter", number_text(diameter))]
    if feature.kind == "cone":
        content.append(element("HalfAngle", number_text(first.half_angle_deg)))
    if feature.kind == "width":
        off = np.array(feature.patches[1].point_mm) - np.array(first.point_mm)
        width = number_text(abs(float(off @ np.array(first.axis))))
        content = [element("Width", width), element("EndType", element("SlotEndEnum", "UNDEFINED"))]
    if content:
        content.insert(0, element("InternalExternal", "NOT_APPLICABLE"))
    if feature.kind == "surface":
        content = [element("Description", f"CAD faces {', '.join(map(str, feature.faces))}")]
    return element(f"{_qif_name(feature)}FeatureDefinition", *content, id=number)


def _nominal(definition: str, number: str, feature: Feature) -> Element:
    """Return the place of a feature."""
    first, place = feature.patches[0], np.array(feature.patches[0].point_mm)
    if feature.kind == "width":
        place = (place + np.array(feature.patches[1].point_mm)) / 2
    point, axis = (" ".join(number_text(each) for each in values) for values in (place, first.axis))
    content = {
        "plane": [element("Location", point), element("Normal", axis)],
        "circle": [element("Location", point), element("Normal", axis)],
        "sphere": [element("Location", point)],
        "width": [element("CenterPlane", element("Point", point), element("Normal", axis))],
        "surface": [],
    }.get(feature.kind, [element("Axis", element("AxisPoint", point), element("Direction", axis))])
    head = element("Name", feature.name), element("FeatureDefinitionId", definition)
    return element(f"{_qif_name(feature)}FeatureNominal", *head, *content, id=number)


def _qif_name(feature: Feature) -> str:
    return _FEATURES.get(feature.kind, feature.kind.capitalize())


def _qif_kind(each: Characteristic, feature: Feature) -> str:
    if each.kind == "size":
        return _SIZES.get(feature.kind, "Diameter")
    if each.kind == "angle":
        return "AngleBetween" if each.to else "Angle"
    return _FORMS[feature.kind] if each.kind == "form" else _KINDS[each.kind]


def _tolerance(each: Characteristic, feature: Feature, number: str, frame: str | None) -> Element:
    """Return the definition of a characteristic: its limits, or the zone with its datums."""
    if each.kind in LIMITED:
        limits = [
            element(tag, number_text(limit))
            for tag, limit in (("MaxValue", each.upper), ("MinValue", each.lower))
            if limit is not None
        ]
        content = [element("Tolerance", *limits, element("DefinedAsLimit", "true"))]
        if not limits:
            content = [element("NonTolerance", "MEASURED")]
    else:
        content = [element("ToleranceValue", number_text(each.upper or 0.0))]
        content += [element("DatumReferenceFrameId", frame)] if frame else []
        if each.kind in ("position", *_ORIENTATIONS):
            content.append(element("MaterialCondition", "REGARDLESS"))
        is_planar = feature.kind in ("plane", "width") or each.kind == "straightness"
        planar = "PlanarZone" if each.kind in _ORIENTATIONS else "NonDiametricalZone"
        zone = planar if is_planar else "SphericalZone" if feature.kind == "sphere" else "DiametricalZone"
        if each.kind in ("position", "coaxiality", "straightness", *_ORIENTATIONS):
            content.append(element("ZoneShape", element(zone)))
    return element(f"{_qif_kind(each, feature)}CharacteristicDefinition", *content, id=number)


def _characteristic(
    each: Characteristic, feature: Feature, definition: str, number: str, features: list[str]
) -> Element:
    """Return a characteristic of one or two features."""
    content = [element("CharacteristicDefinitionId", definition), _references(features), element("Name", each.name)]
    if each.kind in LIMITED:
        content.append(element("TargetValue", number_text(each.nominal)))
    kind = _qif_kind(each, feature)
    if kind.endswith("Between"):
        content.append(element("AnalysisMode", "THREEDIMENSIONAL"))
    return element(f"{kind}CharacteristicNominal", *content, id=number)
