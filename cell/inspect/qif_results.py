"""Results in QIF 3: the QIF file of the characteristics with items and measurements added.

Each evaluated characteristic becomes an item that refers to its nominal characteristic, and a measurement of the item.
Its combined uncertainty is U / 2. Lengths are in millimetres if the file defines this unit, else in its primary unit;
angles are in its primary unit.
"""

import uuid
from collections.abc import Mapping, Sequence
from xml.etree import ElementTree

import numpy as np

from cell.errors import FileError
from cell.inspect.qif import ANGLES, LENGTHS
from cell.inspect.qif_document import NAMESPACE, number_text
from cell.inspect.results import InspectionResult, MeasuredCharacteristic

_STATUS = {
    "pass": "PASS", "fail": "FAIL", "undecided": "INDETERMINATE", "no tolerance": "NOT_ANALYZED",
    "not measured": "NOT_ANALYZED",
}  # fmt: skip


def qif_results(source: bytes, result: InspectionResult) -> bytes:
    """Return a QIF document with the results of an inspection.

    Args:
        source: the QIF file of the characteristics.
        result: of the inspection.

    Raises:
        FileError: if the document has results already.
    """
    ElementTree.register_namespace("", NAMESPACE)
    root = ElementTree.fromstring(source)
    if root.find(_tag("Results")) is not None:
        raise FileError("the QIF file has results already; give the file without results")
    nominals = {each.get("id"): each for each in root.iterfind(".//" + _tag("CharacteristicNominals") + "/*")}
    measured = [each for each in result.characteristics if each.source_id in nominals]
    number = max(int(each.get("id") or 0) for each in root.iter() if (each.get("id") or "").isdigit())
    length, angle = _length_unit(root), _factor(np.pi / 180, root, ("PMIAngularUnit", "AngularUnit"), ANGLES)
    aspects = root.find(_tag("Characteristics"))
    if aspects is None or not measured:
        raise FileError("the QIF file has no characteristic with results")
    items = ElementTree.Element(_tag("CharacteristicItems"), n=str(len(measured)))
    place = [child.tag for child in aspects].index(_tag("CharacteristicNominals")) + 1
    aspects.insert(place, items)
    results = ElementTree.Element(_tag("Results"))
    order = [child.tag for child in root]
    after = _tag("Plan") if _tag("Plan") in order else _tag("Characteristics")
    root.insert(order.index(after) + 1, results)
    one = _add(_add(results, "MeasurementResultsSet", n="1"), "MeasurementResults", id=str(number + 1))
    number += 1
    _note(one, result)
    list_ = _add(_add(one, "MeasuredCharacteristics"), "CharacteristicMeasurements", n=str(len(measured)))
    for each in measured:
        kind = nominals[each.source_id].tag.rpartition("}")[2].removesuffix("CharacteristicNominal")
        item = _add(items, f"{kind}CharacteristicItem", id=str(number + 1))
        _add(item, "Name").text = each.name
        _add(item, "CharacteristicNominalId").text = each.source_id
        measurement = _add(list_, f"{kind}CharacteristicMeasurement", id=str(number + 2))
        _add(_add(measurement, "Status"), "CharacteristicStatusEnum").text = _STATUS[each.verdict]
        _add(measurement, "CharacteristicItemId").text = str(number + 1)
        _add_value(measurement, each, *(length if each.unit == "mm" else (angle, {})))
        number += 2
    verdicts = {each.verdict for each in measured}
    overall = "FAIL" if "fail" in verdicts else "PASS" if verdicts <= {"pass", "no tolerance"} else "UNKNOWN"
    _add(_add(one, "InspectionStatus"), "InspectionStatusEnum").text = overall
    root.set("idMax", str(number))
    if (
        document := root.find(_tag("QPId"))
    ) is not None:  # another document than its source, the same for equal results
        document.text = str(uuid.uuid5(uuid.NAMESPACE_OID, (document.text or "") + result.model_dump_json()))
    return bytes(ElementTree.tostring(root, encoding="utf-8", xml_declaration=True)) + b"\n"


def _tag(name: str) -> str:
    return f"{{{NAMESPACE}}}{name}"


def _add(parent: ElementTree.Element, tag: str, /, **attributes: str) -> ElementTree.Element:
    return ElementTree.SubElement(parent, _tag(tag), attributes)


def _note(parent: ElementTree.Element, result: InspectionResult) -> None:
    """Add source and rule as attributes of the results."""
    facts = {
        "scan-cell.source": result.source,
        "scan-cell.simulated": str(result.is_simulated).lower(),
        "scan-cell.rule": result.rule,
        "scan-cell.alignment": result.alignment,
    }
    attributes = _add(parent, "Attributes", n=str(len(facts)))
    for name, value in facts.items():
        _add(attributes, "AttributeStr", name=name, value=value)


def _add_value(parent: ElementTree.Element, each: MeasuredCharacteristic, factor: float, unit: dict[str, str]) -> None:
    """Add the value times a factor, with its uncertainty and the attributes of its unit."""
    if each.value is None:
        return
    uncertainty = {}
    if each.expanded_uncertainty is not None:
        half = factor * each.expanded_uncertainty / 2
        uncertainty = {"combinedUncertainty": number_text(half), "meanError": "0"}
    _add(parent, "Value", **unit, **uncertainty).text = number_text(factor * each.value)


def _length_unit(root: ElementTree.Element) -> tuple[float, dict[str, str]]:
    """Return the number of a unit of length in a millimetre, and the attributes that name it."""
    units = root.iterfind(f"{_tag('FileUnits')}//{_tag('LinearUnit')}")
    if any(unit.findtext(_tag("UnitName")) == "mm" for unit in units):
        return 1.0, {"linearUnit": "mm"}
    return _factor(1e-3, root, ("PMILinearUnit", "LinearUnit"), LENGTHS), {}


def _factor(size: float, root: ElementTree.Element, tags: Sequence[str], known: Mapping[str, float]) -> float:
    """Return the number of the file's primary units in a size [m or rad]; the first of the tags that it has counts."""
    for tag in tags:
        unit = root.find("/".join(map(_tag, ("FileUnits", "PrimaryUnits", tag))))
        if unit is not None:
            factor = unit.findtext(_tag("UnitConversion") + "/" + _tag("Factor"))
            return size / (float(factor) if factor else known.get(unit.findtext(_tag("UnitName")) or "", 1.0))
    return size
