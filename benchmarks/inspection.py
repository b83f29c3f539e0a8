"""Inspection of repeated virtual scans: predicted and observed uncertainty, as-built errors, error rates of verdicts.

The part is a block of 60 x 40 x 30 mm with a bore of diameter 16 mm. Each scan has noise by the scanner's model and a
new pose error of every view. The observed uncertainty of a characteristic is the 95 % quantile of its errors over the
scans for zones and offsets from zero, else twice their root mean square. As-built parts have a bore that is larger and
moved, and a tilted top; their true values are known. Verdicts are those of the bore's diameter with limits at given
distances from its true value.
"""

import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from cell.inspect.evaluation import Evaluation, verdict_of
from cell.inspect.features import InspectionPlan, resolve_features
from cell.inspect.measured import Association, measure_features
from cell.inspect.prediction import predict_features, predicted_measurements
from cell.metrology.inspect import points_of_views
from cell.part.workpiece import Workpiece, load
from cell.scan.simulated import Disturbance
from cell.scanners.laser_area import LaserArea
from cell.scene.features import CharacteristicTable, FeatureTable
from cell.world import virtual_scan
from cell.world.embree import EmbreeRayCaster
from planner.geometry.mesh import TriangleMesh
from planner.values import Floats
from tests.step_files import bored_block

SCANS = 200
POSE_MM, POSE_DEG = 0.01, 0.003
BORE = np.array([0.030, 0.020])  # its axis [m]
_VIEWS = ((0, 0, 1), (0.5, 0.3, 1), (-0.5, 0.3, 1), (0.1, -0.7, 1), (1, 0, 0.3), (-1, 0, 0.3), (0, 1, 0.3),
          (0, -1, 0.3), (0.4, 0.2, -1), (-0.4, -0.2, -1))  # fmt: skip

Deform = Callable[[Floats], Floats]


@dataclass(frozen=True)
class Bench:
    """Part, characteristics and views of the benchmark."""

    part: Workpiece
    plan: InspectionPlan
    association: Association
    scanner: LaserArea
    views: Floats

    @property
    def pose_sd(self) -> Floats:
        """(V, 2) standard deviations of the poses [m, rad]."""
        return np.tile([POSE_MM / 1000, np.radians(POSE_DEG)], (len(self.views), 1))


def make_bench() -> Bench:
    """Return the benchmark with 13 characteristics."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "block.step"
        path.write_text(bored_block())
        part = load(path)
    features, characteristics = resolve_features(part, _tables())
    plan = InspectionPlan(
        source="benchmark", features=features, characteristics=characteristics, unsupported=(), notes=(), u_over_t=0.1,
        alignment="none", rps=(), edge_mm=1.0, reach_mm=1.0,
    )  # fmt: skip
    middle = part.centre
    views = np.stack([_look(middle + 0.2 * np.array(at) / np.linalg.norm(at), middle) for at in _VIEWS])
    scanner = LaserArea(fov_deg=(30.0, 30.0), resolution_deg=(0.25, 0.25))
    return Bench(part, plan, Association(part.reference, plan), scanner, views)


def _tables() -> list[FeatureTable]:
    def one(kind: str, **keys: object) -> CharacteristicTable:
        return CharacteristicTable.model_validate({"kind": kind, **keys})

    zone = {"tolerance_mm": 0.5}
    limits = {"lower": -0.2, "upper": 0.2}
    abc = ("A", "B", "C")
    rows: list[tuple[str, int, str | None, Sequence[CharacteristicTable]]] = [
        ("top", 6, "A", [one("form", **zone), one("profile", name="top: own profile", **zone)]),
        ("front", 3, "B", [one("perpendicularity", datums=("A",), **zone)]),
        ("left", 1, "C", []),
        ("right", 2, None, [one("distance", to="left", **limits), one("profile", datums=abc, **zone)]),
        ("bottom", 5, None, [one("parallelism", datums=("A",), **zone), one("distance", to="top", **limits)]),
        ("back", 4, None, [one("angle", to="top", **limits)]),
        ("bore", 7, None, [
            one("size", **limits), one("form", **zone), one("position", datums=abc, **zone),
            one("perpendicularity", datums=("A",), **zone), one("distance", to="front", **limits),
        ]),
    ]  # fmt: skip
    return [
        FeatureTable(name=name, faces=(face,), datum=datum, characteristic=tuple(own))
        for name, face, datum, own in rows
    ]


def _look(at: Floats, target: Floats) -> Floats:
    z = (target - at) / np.linalg.norm(target - at)
    x = np.cross([0.0, 1.0, 0.1], z)
    x /= np.linalg.norm(x)
    T = np.eye(4)
    T[:3] = np.column_stack([x, np.cross(z, x), z, at])
    return T


def scan_values(bench: Bench, scans: int, deform: Deform | None = None) -> tuple[Floats, Floats]:
    """Return values and uncertainties (scans, characteristics) of repeated scans [mm, deg]."""
    reference = bench.part.reference
    mesh = reference if deform is None else TriangleMesh(deform(reference.vertices), reference.faces)
    caster = EmbreeRayCaster(mesh.vertices, mesh.faces)
    off = Disturbance(position=POSE_MM / 1000, rotation=float(np.radians(POSE_DEG)), by_model=True)
    rows = []
    for seed in range(scans):
        rng = np.random.default_rng(seed)
        points, normals, sigmas, view = [], [], [], []
        for number, T in enumerate(bench.views):
            T_true = off.true_pose(T, rng)
            scan = virtual_scan.scan(bench.scanner, T_true, caster, mesh)
            sigma = scan.sigma(bench.scanner, mesh)
            points.append(off.reported_points(scan.points, T_true, T, bench.scanner.source, rng, sigma))
            normals.append(mesh.normals[scan.face])
            sigmas.append(sigma)
            view.append(np.full(len(sigma), number))
        exact = bench.association.without_facets(np.concatenate(points))
        measured = points_of_views(
            exact, np.concatenate(normals), np.concatenate(sigmas), np.concatenate(view), bench.views[:, :3, 3],
            (POSE_MM, POSE_DEG),
        )  # fmt: skip
        features = measure_features(bench.association, measured)
        found = Evaluation(bench.plan, features, bench.association.nearest, bench.pose_sd, seed).measure_all()
        rows.append([(each.value or 0.0, each.expanded_uncertainty or np.nan) for each in found])
    values, uncertainties = np.moveaxis(np.array(rows, dtype=np.float64), 2, 0)
    return values, uncertainties


def _observed(error: Floats, *, is_zone: bool) -> float:
    return float(np.quantile(np.abs(error), 0.9545) if is_zone else 2 * np.sqrt(np.mean(error**2)))


def as_built(vertices: Floats) -> Floats:
    """Return the vertices of a part whose bore is 0.1 mm larger and 0.05 mm off, and whose top is tilted by 0.1 deg."""
    made, radial = vertices.copy(), vertices[:, :2] - BORE
    distance = np.linalg.norm(radial, axis=1)
    bore = distance < 0.0081
    made[bore, :2] += 0.00005 * radial[bore] / distance[bore, None] + [0.00005, 0.0]
    top = vertices[:, 2] > 0.0299
    made[top, 2] += np.tan(np.radians(0.1)) * (made[top, 0] - 0.03)
    return made


TRUE_AS_BUILT: dict[str, float] = {
    "bore: size": 16.1,
    "top: form": 0.0,
    "right: distance": 60.0,
    "bore: perpendicularity": float(30 * np.sin(np.radians(0.1))),
}
"""True values of the as-built part [mm]."""


def run(scans: int = SCANS) -> list[dict[str, Any]]:
    """Return one row for each characteristic, as-built value and limit."""
    bench = make_bench()
    features = predict_features(
        bench.association, bench.views[:, None], bench.scanner,
        [EmbreeRayCaster(bench.part.reference.vertices, bench.part.reference.faces)],
    )  # fmt: skip
    predicted = predicted_measurements(bench.plan, bench.association, features, bench.pose_sd)
    values, uncertainties = scan_values(bench, scans)
    rows: list[dict[str, Any]] = []
    for k, each in enumerate(predicted):
        error = values[:, k] - each.characteristic.nominal
        observed = _observed(error, is_zone=each.characteristic.nominal == 0)
        rows.append({
            "row": f"{each.characteristic.name} ({each.characteristic.kind})",
            "predicted U": each.expanded_uncertainty,
            "observed U": observed,
            "predicted / observed": (each.expanded_uncertainty or np.nan) / observed,
            "stated / observed": float(np.mean(uncertainties[:, k])) / observed,
            "within U %": 100 * float(np.mean(np.abs(error) <= uncertainties[:, k])),
        })  # fmt: skip
    built, stated = scan_values(bench, scans, as_built)
    names = [each.characteristic.name for each in predicted]
    for name, true in TRUE_AS_BUILT.items():
        k = names.index(name)
        within = np.abs(built[:, k] - true) <= stated[:, k]
        rows.append({"row": f"as built: {name}", "true": true, "mean": float(built[:, k].mean()),
                     "observed U": _observed(built[:, k] - true, is_zone=true == 0),
                     "within U %": 100 * float(np.mean(within))})  # fmt: skip
    k = names.index("bore: size")
    for step in (-0.5, 0.5, -3.0, 3.0):
        found = [
            verdict_of(value, sd, None, 16.0 - step * sd)
            for value, sd in zip(values[:, k], uncertainties[:, k], strict=True)
        ]
        rows.append(
            {
                "row": f"diameter at T {step:+g} U",
                **{f"{v} %": 100 * found.count(v) / scans for v in dict.fromkeys(found)},
            }
        )
    return rows
