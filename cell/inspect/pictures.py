"""Page and picture of the features of a part, coloured by verdict. Object frame, metres."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from cell.inspect.features import InspectionPlan
from cell.inspect.measured import MeasuredFeature
from cell.inspect.results import InspectionResult, tolerance_text
from cell.view.packed import Layer, quantised_layer
from cell.view.palette import VERDICTS, rgb
from cell.view.part_page import draw_numbered, selectable_page, split_vertices
from planner.geometry.mesh import TriangleMesh
from planner.values import Floats, Ints

_COLOURS = {"other surface": "#d9dee3", **VERDICTS}
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
                rows.append((f"{each.name} ({each.kind})", f"{tolerance_text(each)} → {value}"))
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
    found = np.full(len(mesh.faces), -1, dtype=np.int64)
    for number, feature in reversed(list(enumerate(plan.features))):
        for patch in feature.patches:
            found[np.array(patch.triangles, dtype=np.int64)] = number
    return found


def _verdicts(plan: InspectionPlan, result: InspectionResult | None) -> list[str]:
    """Return the worst verdict of the characteristics of each feature."""
    found = []
    for feature in plan.features:
        own = {each.verdict for each in (result.characteristics if result else ()) if each.feature == feature.name}
        found.append(next((verdict for verdict in _WORST_FIRST if verdict in own), "no tolerance"))
    return found


def _deviations(
    mesh: TriangleMesh, group: Ints, plan: InspectionPlan, measured: Mapping[str, MeasuredFeature]
) -> Floats:
    """Return the deviation of the nearest cell of each vertex [mm]; NaN outside measured features."""
    from scipy.spatial import cKDTree

    found = np.full(len(mesh.vertices), np.nan)
    for number, feature in enumerate(plan.features, 1):
        cells = [
            patch for patch in measured[feature.name].patches if patch.cells is not None and patch.shape is not None
        ]
        own = np.flatnonzero(group == number)
        if not cells or not len(own):
            continue
        points = np.concatenate([patch.cells.points for patch in cells if patch.cells is not None])
        off = [
            shape.distances(patch.cells.points) if (shape := patch.shape) and patch.cells else np.empty(0)
            for patch in cells
        ]
        found[own] = 1000 * np.concatenate(off)[np.asarray(cKDTree(points).query(mesh.vertices[own])[1])]
    return found
