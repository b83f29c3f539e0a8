"""Inspection of repeated virtual scans: predicted and observed uncertainty, as-built errors, error rates of verdicts.

    python -m benchmarks inspection                        the block of the tests, 60 x 40 x 30 mm with a bore of 16 mm
    python -m benchmarks inspection sim_runs/a sim_runs/b  planned parts with their characteristics

The rays of all views are traced once. Each scan adds noise by the scanner's model and a new pose error of every view to
their points, and fits and evaluates as `cell inspect`. The observed uncertainty is the 95 % quantile of the errors for
zones and offsets from zero, else twice their root mean square. An as-built part has a cylinder that is 0.1 mm larger, a
plane that is tilted by 0.1 deg and a feature that is moved by 0.05 mm. Verdicts are those of a size with limits at
given distances from its true value.
"""

import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer
from rich.console import Console
from rich.table import Table

from cell.inspect.evaluation import Evaluation, Measurement, verdict_of
from cell.inspect.features import InspectionPlan, resolve_features
from cell.inspect.inspection import read_plan
from cell.inspect.measured import Association, MeasuredFeature, measure_patch
from cell.inspect.prediction import PlannedViews, predict_features, predicted_measurements
from cell.metrology.inspect import points_of_views
from cell.part.workpiece import load
from cell.runs.cell import read_cell
from cell.runs.run import open_finished
from cell.scan.simulated import Disturbance
from cell.scanners.laser_area import LaserArea
from cell.scene.features import CharacteristicTable, FeatureTable
from cell.world import virtual_scan
from cell.world.embree import EmbreeRayCaster
from planner.geometry.mesh import TriangleMesh
from planner.ports import Scanner
from planner.values import Floats, Ints
from tests.step_files import bored_block

SCANS = 200
STATED = 10
POSE_MM, POSE_DEG = 0.01, 0.003
LARGER_MM, TILT_DEG, MOVED_MM = 0.1, 0.1, 0.05
_TILTED = ("perpendicularity", "parallelism", "angularity", "total-runout")
_VIEWS = ((0, 0, 1), (0.5, 0.3, 1), (-0.5, 0.3, 1), (0.1, -0.7, 1), (1, 0, 0.3), (-1, 0, 0.3), (0, 1, 0.3),
          (0, -1, 0.3), (0.4, 0.2, -1), (-0.4, -0.2, -1))  # fmt: skip


@dataclass(frozen=True)
class Bench:
    """Part, characteristics and views of the benchmark; occluders are None without any."""

    part: TriangleMesh
    plan: InspectionPlan
    association: Association
    scanner: Scanner
    views: Floats
    occluders: EmbreeRayCaster | None = None

    @property
    def pose_sd(self) -> Floats:
        """(V, 2) standard deviations of the poses [m, rad]."""
        return np.tile([POSE_MM / 1000, np.radians(POSE_DEG)], (len(self.views), 1))

    def predict(self) -> list[Measurement]:
        """Return the predicted uncertainties."""
        casters = [EmbreeRayCaster(self.part.vertices, self.part.faces), *filter(None, [self.occluders])]
        features = predict_features(self.association, [PlannedViews(self.views[:, None], self.scanner, casters)])
        return predicted_measurements(self.plan, self.association, features, self.pose_sd)

    def only(self, characteristics: Sequence[int]) -> "Bench":
        """Return the benchmark of some characteristics, with the features on which these depend."""
        chosen = [self.plan.characteristics[k] for k in characteristics]
        needed = {feature.name for each in chosen for feature in self.plan.features_of(each)}
        features = tuple(each for each in self.plan.features if each.name in needed)
        plan = self.plan.model_copy(update={"features": features, "characteristics": tuple(chosen)})
        return replace(self, plan=plan, association=Association(self.part, plan))


def block_bench() -> Bench:
    """Return the benchmark of the block with 13 characteristics."""
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
    return Bench(part.reference, plan, Association(part.reference, plan), scanner, views)


def run_bench(folder: Path) -> Bench:
    """Return the benchmark of a run with characteristics."""
    run = open_finished(folder)
    cell, plan = read_cell(run), read_plan(run)
    assert plan is not None, f"{folder} has no characteristics"
    T = run.T_object_scanner
    return Bench(run.reference, plan, Association(run.reference, plan), cell.scanner, T, cell.occluder_caster)


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


def scan_values(
    bench: Bench, scans: int, made: TriangleMesh | None = None, n_stated: int = STATED
) -> tuple[Floats, Floats]:
    """Return values and stated uncertainties (scans, characteristics) of repeated scans [mm, deg]; NaN without one.

    Args:
        bench: part, characteristics and views.
        scans: number of scans.
        made: surface as built, with the triangles of the part; None is the nominal one.
        n_stated: scans whose uncertainties are evaluated; they hardly differ, and their mean stands for all.
    """
    mesh, association = made or bench.part, bench.association
    caster = EmbreeRayCaster(mesh.vertices, mesh.faces)
    traced = [virtual_scan.scan(bench.scanner, T, caster, mesh, bench.occluders) for T in bench.views]
    points = np.concatenate([scan.points for scan in traced])
    rows = association.rows(points)
    used, back = np.unique(np.concatenate([own for each in rows.values() for own in each]), return_inverse=True)
    points = association.without_facets(points[used])
    normals = mesh.normals[np.concatenate([scan.face for scan in traced])[used]]
    sigma = np.concatenate([scan.sigma(bench.scanner, mesh) for scan in traced])[used]
    view: Ints = np.repeat(np.arange(len(traced)), [len(scan.points) for scan in traced])[used]
    start, of_patch = 0, dict[str, list[Ints]]()
    for name, each in rows.items():
        of_patch[name] = []
        for own in each:
            of_patch[name].append(back[start : start + len(own)])
            start += len(own)
    off = Disturbance(position=POSE_MM / 1000, rotation=float(np.radians(POSE_DEG)), by_model=True)
    values, stated = [], []
    for seed in range(scans):
        rng, reported = np.random.default_rng(seed), np.empty_like(points)
        for number, T in enumerate(bench.views):
            own, T_true = view == number, off.true_pose(T, rng)
            reported[own] = off.reported_points(points[own], T_true, T, bench.scanner.source, rng, sigma[own])
        measured = points_of_views(reported, normals, sigma, view, bench.views[:, :3, 3], (POSE_MM, POSE_DEG))
        features = {
            feature.name: MeasuredFeature(feature, tuple(
                measure_patch(association, feature, patch, surface, own, measured)
                for patch, surface, own in zip(
                    feature.patches, association.surfaces[feature.name], of_patch[feature.name], strict=True)))
            for feature in bench.plan.features
        }  # fmt: skip
        evaluation = Evaluation(bench.plan, features, association.nearest, bench.pose_sd, seed)
        values.append(evaluation.values())
        if seed < n_stated:
            stated.append([each.expanded_uncertainty for each in evaluation.measure_all()])
    mean = np.mean(np.array(stated, dtype=np.float64), axis=0)
    return np.array(values), np.tile(mean, (scans, 1))


def _observed(error: Floats, *, is_zone: bool) -> float:
    return float(np.quantile(np.abs(error), 0.9545) if is_zone else 2 * np.sqrt(np.mean(error**2)))


def as_built(bench: Bench) -> tuple[TriangleMesh, dict[int, float]]:
    """Return the surface as built, and the true values of the changed characteristics by their index [mm].

    The first cylinder with a size is larger, another plane with an orientation or runout is tilted about its middle,
    and another feature with a position or coaxiality is moved across its axis.
    """
    vertices, true, used = bench.part.vertices.copy(), dict[int, float](), set[str]()
    for index, each in enumerate(bench.plan.characteristics):
        feature = bench.plan.feature(each.feature)
        shape, kind = feature.patches[0].shape, feature.kind
        if shape is None or feature.name in used or (feature.datum and each.kind not in (*_TILTED, "size")):
            continue
        own = [np.unique(bench.part.faces[np.array(patch.triangles)]) for patch in feature.patches]
        every = np.concatenate(own)
        if each.kind == "size" and kind == "cylinder" and "size" not in used:
            vertices[every] += LARGER_MM / 2000 * shape.normals(bench.part.vertices[every])
            true[index], used = each.nominal + LARGER_MM, used | {"size", feature.name}
        elif each.kind in _TILTED and kind == "plane" and "tilt" not in used:
            base = bench.plan.datum(each.datums[0]).patches[0].shape
            assert base is not None, "a datum has a shape"
            along = base.axis - (base.axis @ shape.axis) * shape.axis
            length = float(np.linalg.norm(along))
            along = along / length if length > 1e-6 else shape.frame[:, 0]
            slope = float(np.tan(np.radians(TILT_DEG)))
            vertices[every] += slope * ((bench.part.vertices[every] - shape.point) @ along)[:, None] * shape.axis
            extent = np.ptp(bench.part.vertices[every] @ along)
            true[index], used = float(1000 * extent * np.sin(np.radians(TILT_DEG))), used | {"tilt", feature.name}
        elif each.kind in ("position", "coaxiality") and "moved" not in used:
            across = shape.axis if kind in ("plane", "width") else shape.frame[:, 0]
            vertices[every] += MOVED_MM / 1000 * across
            true[index], used = 2 * MOVED_MM, used | {"moved", feature.name}
    return TriangleMesh(vertices, bench.part.faces), true


def rows_of(bench: Bench, scans: int) -> list[dict[str, Any]]:
    """Return one row for each characteristic, and for each limit of a size."""
    predicted, (values, uncertainties) = bench.predict(), scan_values(bench, scans)
    rows: list[dict[str, Any]] = []
    for k, each in enumerate(predicted):
        name = f"{each.characteristic.name} ({each.characteristic.kind})"
        if each.expanded_uncertainty is None or not np.isfinite(values[:, k]).all():
            rows.append({"row": name, "cause": each.cause or "not measured in every scan"})
            continue
        error = values[:, k] - each.characteristic.nominal
        observed = _observed(error, is_zone=each.characteristic.nominal == 0)
        rows.append({
            "row": name, "predicted U": each.expanded_uncertainty, "observed U": observed,
            "predicted / observed": each.expanded_uncertainty / observed,
            "stated / observed": float(np.mean(uncertainties[:, k])) / observed,
            "within U %": 100 * float(np.mean(np.abs(error) <= uncertainties[:, k])),
        })  # fmt: skip
    k = next(
        (
            k
            for k, each in enumerate(predicted)
            if each.characteristic.kind == "size" and np.isfinite(values[:, k]).all()
        ),
        None,
    )
    for step in (-0.5, 0.5, -3.0, 3.0) if k is not None else ():
        verdicts = [
            verdict_of(value, u, None, predicted[k].characteristic.nominal - step * u)
            for value, u in zip(values[:, k], uncertainties[:, k], strict=True)
        ]
        shares = {f"{verdict} %": 100 * verdicts.count(verdict) / scans for verdict in dict.fromkeys(verdicts)}
        rows.append({"row": f"{predicted[k].characteristic.name} at T {step:+g} U", **shares})
    return rows


def as_built_rows(bench: Bench, scans: int) -> list[dict[str, Any]]:
    """Return one row for each as-built value; only the features on which these depend are evaluated."""
    made, true = as_built(bench)
    built, stated = scan_values(bench.only(list(true)), scans, made)
    rows: list[dict[str, Any]] = []
    for column, (k, value) in enumerate(true.items()):
        error = np.abs(built[:, column] - value)
        rows.append({
            "row": f"as built: {bench.plan.characteristics[k].name}", "true": value,
            "mean": float(built[:, column].mean()), "observed U": _observed(built[:, column] - value, is_zone=False),
            "stated U": float(stated[0, column]),
            "within U %": 100 * float(np.mean(error <= stated[:, column])),
            "within 2 U %": 100 * float(np.mean(error <= 2 * stated[:, column])),
        })  # fmt: skip
    return rows


app = typer.Typer(add_completion=False)


@app.command()
def main(
    runs: Annotated[
        list[Path] | None, typer.Argument(help="folders of plans with characteristics; none: the block")
    ] = None,
    scans: Annotated[int, typer.Option(help="number of simulated scans")] = SCANS,
    name: Annotated[list[str] | None, typer.Option(help="characteristics to evaluate, all by default")] = None,
    nominal: Annotated[bool, typer.Option(help="scan the nominal part")] = True,
    built: Annotated[bool, typer.Option(help="scan the part as built")] = True,
) -> None:
    """Compare predicted and observed uncertainty of repeated simulated scans."""
    benches = {"block": block_bench()} if not runs else {folder.name: run_bench(folder) for folder in runs}
    for title, bench in benches.items():
        if name:
            bench = bench.only([k for k, each in enumerate(bench.plan.characteristics) if each.name in name])
        start = time.process_time()
        rows = [*(rows_of(bench, scans) if nominal else ()), *(as_built_rows(bench, scans) if built else ())]
        seconds = time.process_time() - start
        table = Table(title=f"{title}: {scans} scans of {len(bench.views)} views, {seconds:.0f} s of processor time")
        columns = list(dict.fromkeys(key for row in rows for key in row))
        for column in columns:
            table.add_column(column)
        for row in rows:
            table.add_row(
                *(
                    f"{value:.4g}" if isinstance(value := row.get(column, ""), float) else str(value)
                    for column in columns
                )
            )
        Console(width=200).print(table)
