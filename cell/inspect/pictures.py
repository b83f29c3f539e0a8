"""Page and picture of the features of a part, coloured by verdict. Object frame, metres."""

import textwrap
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from cell.inspect.features import InspectionPlan
from cell.inspect.measured import MeasuredFeature
from cell.inspect.results import InspectionResult, table_rows
from cell.view.packed import Layer, quantised_layer
from cell.view.palette import VERDICTS, rgb
from cell.view.part_page import draw_numbered, selectable_page, split_vertices
from planner.geometry.mesh import TriangleMesh
from planner.values import Floats, Ints

_COLOURS = {"other surface": "#d9dee3", **VERDICTS}
_A4 = (11.7, 8.3)  # inches, landscape
_PDF_ROWS, _PDF_LINES, _PDF_WIDTH = 32, 42, 140  # of a page
_WORST_FIRST = ("fail", "undecided", "not measured", "pass", "no tolerance")


def features_picture(path: Path, mesh: TriangleMesh, plan: InspectionPlan, result: InspectionResult | None) -> None:
    """Draw the features from four sides, with their numbers in the list of features from 1."""
    of_triangle, verdicts = _feature_of_triangle(mesh, plan), _verdicts(plan, result)
    colours = np.array([rgb(_COLOURS["other surface"]), *(rgb(_COLOURS[verdict]) for verdict in verdicts)])
    draw_numbered(path, mesh, of_triangle, colours[of_triangle + 1], [str(k + 1) for k in range(len(plan.features))])


def features_page(
    mesh: TriangleMesh, plan: InspectionPlan, result: InspectionResult, measured: Mapping[str, MeasuredFeature]
) -> str:
    """Return a page on which a click on a feature shows its characteristics with values and verdicts."""
    of_triangle, verdicts = _feature_of_triangle(mesh, plan), _verdicts(plan, result)
    split, group = split_vertices(mesh, of_triangle + 1)
    order = list(_COLOURS)
    code = np.array([0, *(order.index(verdict) for verdict in verdicts)])[group].astype(np.uint8)
    layers = [Layer("Verdict", "named", code, named=list(_COLOURS.items()))]
    deviations = _deviations(split, group, plan, measured)
    if np.isfinite(deviations).any():
        limit = max(float(np.nanquantile(np.abs(deviations), 0.95)), 1e-3)
        note = "cell means from the fitted element or the nominal surface"
        layers.append(quantised_layer(deviations, "Deviation of features", "signed", (-limit, limit), note))
    items = [{"number": 0, "rows": [("feature", "none")]}]
    for number, feature in enumerate(plan.features, 1):
        rows = [("feature", feature.name), ("kind", feature.description)]
        rows += [("datum", feature.datum)] if feature.datum else []
        rows += [
            ("points", f"{each.n_points:,} on {each.share:.0%} of the area, sd {each.sd_mm:.4f} mm")
            for each in result.features
            if each.feature == feature.name
        ]
        for each in result.characteristics:
            if each.feature == feature.name:
                value = each.cause or f"{each.value:.4f} ± {each.expanded_uncertainty:.4f} {each.unit}: {each.verdict}"
                value += f" ({each.note})" if each.note else ""
                rows.append((f"{each.name} ({each.kind})", f"{each.tolerance_text} → {value}"))
        items.append({"number": number, "rows": rows})
    source = "simulated points" if result.is_simulated else result.source
    rows = [("characteristics", result.summary), ("points", source), ("rule", result.rule)]
    rows += [
        (each.name, f"{each.verdict}: " + (each.cause or f"{each.value:.4f} {each.unit}"))
        for each in result.characteristics
    ]
    return selectable_page(
        result.part, split, layers, "Feature", items, group, rows, [*result.notes, *result.unsupported]
    )


def _feature_of_triangle(mesh: TriangleMesh, plan: InspectionPlan) -> Ints:
    """Return the number of the feature of each triangle from 0; -1 for other surface. The first one counts."""
    numbers = np.full(len(mesh.faces), -1, dtype=np.int64)
    for number, feature in reversed(list(enumerate(plan.features))):
        for patch in feature.patches:
            numbers[np.array(patch.triangles, dtype=np.int64)] = number
    return numbers


def _verdicts(plan: InspectionPlan, result: InspectionResult | None) -> list[str]:
    """Return the worst verdict of the characteristics of each feature."""
    verdicts = []
    for feature in plan.features:
        own = {each.verdict for each in (result.characteristics if result else ()) if each.feature == feature.name}
        verdicts.append(next((verdict for verdict in _WORST_FIRST if verdict in own), "no tolerance"))
    return verdicts


def _deviations(
    mesh: TriangleMesh, group: Ints, plan: InspectionPlan, measured: Mapping[str, MeasuredFeature]
) -> Floats:
    """Return the deviation of the nearest cell of each vertex [mm]; NaN outside measured features."""
    from scipy.spatial import cKDTree

    deviations = np.full(len(mesh.vertices), np.nan)
    for number, feature in enumerate(plan.features, 1):
        cells = [
            patch for patch in measured[feature.name].patches if patch.cells is not None and patch.shape is not None
        ]
        own = np.flatnonzero(group == number)
        if not cells or not len(own):
            continue
        points = np.concatenate([patch.cells.points for patch in cells if patch.cells is not None])
        off = np.concatenate([patch.deviations for patch in cells])
        deviations[own] = 1000 * off[np.asarray(cKDTree(points).query(mesh.vertices[own])[1])]
    return deviations


def report_pdf(path: Path, picture: Path, result: InspectionResult) -> None:
    """Write a PDF of the results: picture, summary, one row for each characteristic, notes; equal for equal results."""
    from matplotlib.backends.backend_pdf import FigureCanvasPdf, PdfPages
    from matplotlib.figure import Figure
    from PIL import Image

    heading, rows = table_rows(result)
    simulated = "SIMULATED POINTS. " if result.is_simulated else ""
    words = [f"{simulated}Points: {result.source}.", f"{result.summary}.", f"Verdicts: {result.rule}.",
             f"Alignment: {result.alignment}."]  # fmt: skip
    sentences = [*(f"{each.name}: {each.cause}" for each in result.characteristics if each.cause), *result.notes,
                 *(f"not supported: {each}" for each in result.unsupported)]  # fmt: skip
    lines = [line for each in [*words, *sentences] for line in textwrap.wrap(each, _PDF_WIDTH)]
    with PdfPages(path, metadata={"CreationDate": None, "Title": f"Inspection of {result.part}"}) as pdf:
        figure = Figure(figsize=_A4)
        figure.text(0.05, 0.94, f"Inspection of {result.part}", size=16, parse_math=False)  # names may contain $
        axes = figure.add_axes((0.05, 0.05, 0.9, 0.85))
        axes.imshow(Image.open(picture))
        axes.axis("off")
        FigureCanvasPdf(figure).print_pdf(pdf)  # type: ignore[no-untyped-call]
        for start in range(0, len(rows), _PDF_ROWS):
            figure = Figure(figsize=_A4)
            axes = figure.add_axes((0.03, 0.03, 0.94, 0.94))
            axes.axis("off")
            table = axes.table(rows[start : start + _PDF_ROWS], colLabels=heading, loc="upper left", cellLoc="left")
            table.auto_set_font_size(False)
            table.set_fontsize(8)
            table.auto_set_column_width(list(range(len(heading))))
            for (row, column), cell in table.get_celld().items():
                cell.get_text().set_parse_math(False)
                if row and column == len(heading) - 1:
                    cell.set_facecolor(VERDICTS.get(cell.get_text().get_text(), "white") + "60")
            FigureCanvasPdf(figure).print_pdf(pdf)  # type: ignore[no-untyped-call]
        for start in range(0, len(lines), _PDF_LINES):
            figure = Figure(figsize=_A4)
            text = "\n".join(lines[start : start + _PDF_LINES])
            figure.text(0.05, 0.95, text, size=9, va="top", parse_math=False)
            FigureCanvasPdf(figure).print_pdf(pdf)  # type: ignore[no-untyped-call]
