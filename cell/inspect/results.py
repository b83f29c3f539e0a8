"""Results of an inspection: features.json, the section of a report, CSV. Millimetres and degrees, object frame."""

import csv
import html
import io
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Literal

import numpy as np
from pydantic import Field

from cell.inspect.evaluation import RULE, Measurement
from cell.inspect.features import InspectionPlan, TolerancedCharacteristic
from cell.inspect.measured import MeasuredFeature, MeasuredPatch
from cell.runs.schema import JsonTable, Triple
from planner.fitting.shapes import ShapeKind
from planner.values import Floats

if TYPE_CHECKING:
    import pandas as pd

_COLUMNS = (
    "id", "name", "feature", "kind", "datums", "nominal", "lower", "upper", "value", "deviation",
    "expanded_uncertainty", "unit", "verdict", "method", "note", "cause",
)  # fmt: skip


class MeasuredCharacteristic(TolerancedCharacteristic):
    """Measured value of a characteristic in its unit."""

    value: float | None = Field(description="null if it is not measured")
    deviation: float | None = Field(description="value minus nominal value")
    expanded_uncertainty: float | None = Field(description="U, k = 2")
    verdict: Literal["pass", "fail", "undecided", "no tolerance", "not measured"]
    method: str = Field(description="evaluation of the value")
    note: str = Field(description="deviation from the standard, or doubt about the value")
    cause: str = Field(description="reason for a missing value")
    source_id: str | None = Field(description="id in the QIF file")

    @property
    def u_over_t(self) -> float | None:
        """Expanded uncertainty as a share of the tolerance; None without either."""
        if self.expanded_uncertainty is None or not self.tolerance:
            return None
        return self.expanded_uncertainty / self.tolerance


class MeasuredElement(JsonTable):
    """Least-squares element of a patch of a feature."""

    feature: str
    kind: str
    n_points: int = Field(description="points of the fit")
    n_outliers: int = Field(description="points off the element, not used")
    share: float = Field(description="of the area that has points")
    point_mm: Triple | None = Field(description="on the plane or axis, or the centre; null without points")
    axis: Triple | None
    diameter_mm: float | None
    full_angle_deg: float | None
    sd_mm: float = Field(description="standard deviation of the points about the element")
    spacing_mm: float | None = Field(default=None, description="mean distance of neighbouring points")


class InspectionResult(JsonTable):
    """features.json of an execution, or of `cell inspect`."""

    part: str
    source: str = Field(description="origin of the points")
    is_simulated: bool
    is_predicted: bool = Field(description="whether it is the prediction of a plan, whose values are nominal")
    characteristics_source: str = Field(description="origin of the characteristics")
    alignment: str = Field(description="of points without datums, in words")
    T_part_points: tuple[tuple[float, float, float, float], ...] | None = Field(
        default=None, description="motion of the points to the part by search and alignment, rows [mm]; null: none"
    )
    rule: str = Field(description="decision rule of the verdicts")
    characteristics: tuple[MeasuredCharacteristic, ...]
    features: tuple[MeasuredElement, ...]
    unsupported: tuple[str, ...] = Field(description="items of the source that are left out, with their causes")
    notes: tuple[str, ...]

    def count(self, verdict: str) -> int:
        """Return the number of characteristics with a verdict."""
        return sum(each.verdict == verdict for each in self.characteristics)

    @property
    def summary(self) -> str:
        """Numbers of verdicts in words."""
        order = ("pass", "fail", "undecided", "no tolerance", "not measured")
        counts = [f"{number} {verdict}" for verdict in order if (number := self.count(verdict))]
        return f"{len(self.characteristics)} characteristics: {', '.join(counts)}"

    def to_dataframe(self) -> "pd.DataFrame":
        """Return the characteristics as a table, one row each.

        Raises:
            UsageError: if pandas is not installed.
        """
        from cell.errors import UsageError

        try:
            import pandas as pd
        except ImportError as error:
            raise UsageError("to_dataframe needs pandas: pip install pandas") from error
        return pd.DataFrame([each.model_dump() for each in self.characteristics])


def inspection_result(
    plan: InspectionPlan,
    measurements: Sequence[Measurement],
    features: Mapping[str, MeasuredFeature],
    *,
    part: str,
    source: str,
    alignment: str,
    is_simulated: bool,
    is_predicted: bool = False,
    T_part_points: Floats | None = None,
    notes: Sequence[str] = (),
) -> InspectionResult:
    """Return the results as values of features.json."""
    return InspectionResult(
        part=part,
        source=source,
        is_simulated=is_simulated,
        is_predicted=is_predicted,
        characteristics_source=plan.source,
        alignment=alignment,
        T_part_points=None if T_part_points is None else _rows(T_part_points),
        rule=RULE,
        characteristics=tuple(map(_measured, measurements)),
        features=tuple(_element(name, patch) for name, feature in features.items() for patch in feature.patches),
        unsupported=plan.unsupported,
        notes=(*plan.notes, *notes),
    )


def _measured(measurement: Measurement) -> MeasuredCharacteristic:
    c, value = measurement.characteristic, measurement.value
    uncertainty = measurement.expanded_uncertainty
    return MeasuredCharacteristic(
        **c.model_dump(include={"id", "name", "feature", "kind", "unit", "source_id"}),
        nominal=round(c.nominal, 9),
        lower=None if c.lower is None else round(c.lower, 9),
        upper=None if c.upper is None else round(c.upper, 9),
        datums=c.datums,
        value=None if value is None else round(value, 6),
        deviation=None if value is None else round(value - c.nominal, 6),
        expanded_uncertainty=None if uncertainty is None else round(uncertainty, 6),
        verdict=measurement.verdict.value,
        method=measurement.method,
        note="; ".join(filter(None, [c.note, measurement.note])),
        cause=measurement.cause,
    )


def _element(name: str, patch: MeasuredPatch) -> MeasuredElement:
    shape = None if patch.cells is None or patch.patch.kind == "mesh" else patch.shape
    round_ = shape is not None and shape.kind in (ShapeKind.CYLINDER, ShapeKind.SPHERE, ShapeKind.CIRCLE)
    return MeasuredElement(
        feature=name,
        kind=patch.patch.kind,
        n_points=patch.n_points,
        n_outliers=patch.n_outliers,
        share=round(patch.share, 4),
        point_mm=None if shape is None else _triple(1000 * shape.point, 6),
        axis=None if shape is None else _triple(shape.axis, 9),
        diameter_mm=round(2000 * shape.size, 6) if shape is not None and round_ else None,
        full_angle_deg=round(float(np.degrees(2 * shape.half_angle)), 6)
        if shape is not None and shape.kind is ShapeKind.CONE
        else None,
        sd_mm=round(1000 * patch.sigma, 6),
        spacing_mm=None if patch.spacing is None else round(1000 * patch.spacing, 4),
    )


def _triple(values: Floats, digits: int) -> Triple:
    x, y, z = (round(float(value), digits) + 0.0 for value in values)
    return x, y, z


def _rows(T: Floats) -> tuple[tuple[float, float, float, float], ...]:
    """Return the rows of a motion (4, 4) in millimetres."""
    inner = T * np.array([[1, 1, 1, 1000.0]] * 3 + [[1, 1, 1, 1]])
    return tuple((float(a), float(b), float(c), float(d)) for a, b, c, d in np.round(inner, 12).tolist())


def as_csv(result: InspectionResult) -> str:
    """Return the characteristics as CSV, one row each, with a header."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow([*_COLUMNS, "simulated"])
    for each in result.characteristics:
        values = {**each.model_dump(), "datums": "|".join(each.datums)}
        cells = ["" if values[key] is None else values[key] for key in _COLUMNS]
        writer.writerow([*cells, "yes" if result.is_simulated else "no"])
    return text.getvalue()


def points_csv(features: Mapping[str, MeasuredFeature]) -> str:
    """Return the cell means of the features as CSV: place, and deviation from the fitted element or the nominal one."""
    lines = ["feature,x_mm,y_mm,z_mm,deviation_mm"]
    for name, feature in features.items():
        for patch in feature.patches:
            if patch.cells is not None and patch.shape is not None:
                rows = np.column_stack([1000 * patch.cells.points, 1000 * patch.deviations])
                quoted = '"' + name.replace('"', '""') + '"'
                lines += [",".join([quoted, *(f"{each:.4f}" for each in row)]) for row in rows]
    return "\n".join(lines) + "\n"


def table_rows(result: InspectionResult) -> tuple[list[str], list[list[str]]]:
    """Return heading and rows of the table of characteristics."""
    heading = ["", "characteristic", "feature", "tolerance", "value", "U (k = 2)", "U/T", "verdict"]
    if result.is_predicted:
        heading = [*heading[:4], "spacing of points", *heading[5:7], "result"]
    rows = []
    for each in result.characteristics:
        ratio = each.u_over_t
        cells = [
            str(each.id), f"{each.name} ({each.kind})", each.feature, each.tolerance_text,
            "-" if each.value is None else f"{each.value:.4f} {each.unit}",
            "-" if each.expanded_uncertainty is None else f"{each.expanded_uncertainty:.4f} {each.unit}",
            "-" if ratio is None else f"{ratio:.3f}",
            each.cause if each.cause and result.is_predicted else "met" if result.is_predicted else each.verdict,
        ]  # fmt: skip
        if result.is_predicted:
            own = [e.spacing_mm for e in result.features if e.feature == each.feature and e.spacing_mm is not None]
            cells[4] = f"{max(own):.2f} mm" if own else "-"
        rows.append(cells)
    return heading, rows


def markdown(result: InspectionResult) -> list[str]:
    """Return the section of a report."""
    heading, rows = table_rows(result)
    title = "Predicted uncertainty of the characteristics" if result.is_predicted else "Characteristics"
    begin = [] if result.is_predicted else [f"{result.summary}."]
    begin += ["**Simulated points.**"] if result.is_simulated and not result.is_predicted else []
    lines = [f"## {title}", "", " ".join([*begin, f"Source: {html.escape(result.characteristics_source)}."]), ""]
    lines += ["| " + " | ".join(heading) + " |", "|" + "---|" * len(heading)]
    lines += ["| " + " | ".join(html.escape(cell).replace("|", "\\|") for cell in row) + " |" for row in rows]
    if not result.is_predicted:
        lines += ["", f"Verdicts: {result.rule}. Alignment: {result.alignment}."]
    causes = [f"{each.name}: {each.cause}" for each in result.characteristics if each.cause and not result.is_predicted]
    methods = sorted({f"{each.kind}: {each.method}" for each in result.characteristics if each.method})
    notes = [
        f"{each.name}: {each.note}" for each in result.characteristics if each.note and each.note != "by least squares"
    ]
    for name, sentences in (
        ("Not measured", causes), ("Methods", methods), ("Notes", [*result.notes, *notes]),
        ("Not supported", result.unsupported),
    ):  # fmt: skip
        if sentences:
            lines += ["", f"{name}:", "", *(f"- {html.escape(sentence)}" for sentence in sentences)]
    return [*lines, ""]
