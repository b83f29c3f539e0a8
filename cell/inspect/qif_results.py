"""Results in QIF 3: the QIF file of the characteristics with items and measurements added.

Each evaluated characteristic becomes an item that refers to its nominal characteristic, and a measurement of the item.
Its combined uncertainty is U / 2. Lengths are in millimetres, angles in the file's unit of angle.
"""

import uuid
from xml.etree import ElementTree

import numpy as np

from cell.errors import FileError
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
    angle = _angle_factor(root)
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
        _add_value(measurement, each, angle)
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


def _add_value(parent: ElementTree.Element, each: MeasuredCharacteristic, angle: float) -> None:
    if each.value is None:
        return
    factor, uncertainty = (1.0, {"linearUnit": "mm"}) if each.unit == "mm" else (angle, {})
    if each.expanded_uncertainty is not None:
        half = factor * each.expanded_uncertainty / 2
        uncertainty |= {"combinedUncertainty": number_text(half), "meanError": "0"}
    _add(parent, "Value", **uncertainty).text = number_text(factor * each.value)


def _angle_factor(root: ElementTree.Element) -> float:
    """Return the file's units of angle in a degree."""
    units = root.find(_tag("FileUnits") + "/" + _tag("PrimaryUnits"))
    for name in ("PMIAngularUnit", "AngularUnit"):
        unit = None if units is None else units.find(_tag(name))
        if unit is not None:
            factor = unit.findtext(_tag("UnitConversion") + "/" + _tag("Factor"))
            return float(np.radians(1.0) / float(factor or 1.0))
    return float(np.radians(1.0))
