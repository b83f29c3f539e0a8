"""Inspection of points: characteristics of a scene or a QIF file, alignment, evaluation, files of the results."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree

from cell.errors import SceneError
from cell.files import read_bytes
from cell.inspect import pictures, qif
from cell.inspect.alignment import fit_reference_points
from cell.inspect.artefacts import FEATURES, PAGE, POINTS, QIF_RESULTS, QIF_SOURCE, RESULTS, TABLE
from cell.inspect.evaluation import Evaluation, Measurement
from cell.inspect.features import InspectionPlan, resolve_features
from cell.inspect.measured import Association, MeasuredFeature, MeasuredPoints, measure_features
from cell.inspect.prediction import PlannedViews, predict_features, predicted_measurements
from cell.inspect.qif_document import document_of
from cell.inspect.qif_results import qif_results
from cell.inspect.results import InspectionResult, as_csv, inspection_result, markdown, points_csv
from cell.part.workpiece import Workpiece
from cell.runs.run import Run
from cell.runs.schema import parsed
from cell.scene.model import Region, Scene
from planner.geometry.mesh import TriangleMesh
from planner.registration.cloud import PointCloud
from planner.registration.registration import fit_majority, register
from planner.registration.rigid import transform_points
from planner.values import Floats, Ints

_RPS_POINTS = 12  # measured points near a reference point, whose mean is used
EXACT_POSES = (
    "U contains no pose errors: the plan has none; --pose-sd states them, but then coverage counts samples that are "
    "measured at a confidence, poses are not searched, and no views are added for U"
)
_FIT_POINTS = 20_000  # of the best fit


def plan_inspection(scene: Scene, part: Workpiece) -> InspectionPlan | None:
    """Return the features and characteristics of a scene and its QIF file on a part; None if there are none.

    Raises:
        SceneError: if a feature does not fit the part.
        FileError: if the QIF file cannot be used.
    """
    if not scene.has_features:
        return None
    settings, tables = scene.inspection, list(scene.feature)
    features, characteristics = resolve_features(part, tables)
    source, unsupported, notes = "scene", list[str](), list[str]()
    if settings.qif is not None:
        content = qif.read_qif(Path(settings.qif), part)
        unsupported, notes = content.unsupported, content.notes
        more, further = resolve_features(part, content.features, unsupported)
        if twice := {each.datum for each in features if each.datum} & {each.datum for each in more}:
            raise SceneError(
                f"the scene and the QIF file both define the datum {min(map(str, twice))}; omit one of them"
            )
        start = len(characteristics)
        characteristics += tuple(each.model_copy(update={"id": each.id + start}) for each in further)
        features += more
        source = Path(settings.qif).name + (" and scene" if tables else "")
    return InspectionPlan(
        source=source,
        features=features,
        characteristics=characteristics,
        unsupported=tuple(unsupported),
        notes=tuple(notes),
        u_over_t=settings.u_over_t,
        alignment=settings.alignment,
        rps=tuple((each.point_mm, each.direction, each.weight) for each in settings.rps),
        edge_mm=settings.edge_mm,
        reach_mm=settings.reach_mm,
    )


def with_feature_regions(scene: Scene, part: Workpiece) -> tuple[Scene, str]:
    """Return the scene with a region for each feature, so that a plan measures `inspection.share` of each.

    Returns:
        The scene, and a note if its requests exclude regions.

    Raises:
        CellError: if features do not fit the part.
    """
    options = scene.plan
    plan = plan_inspection(scene, part)
    if plan is None or scene.inspection.share is None or part.reference.region is not None:
        return scene, ""
    has_request = options.max_views or options.overlap_mm2 or options.overlap_share or options.fill == "rays"
    if scene.region or has_request or options.pose_sd_mm or options.pose_sd_deg:
        reason = "the scene has regions" if scene.region else "they exclude overlap, pose errors, max_views and rays"
        return scene, f"features have no coverage target of their own: {reason}"
    used_faces: set[int] = set()
    regions = []
    for feature in plan.features:
        if faces := tuple(face for face in feature.faces if face not in used_faces):
            used_faces |= set(faces)
            regions.append(Region(name=feature.name[:60].strip(), faces=faces, coverage=scene.inspection.share))
    return scene.model_copy(update={"region": tuple(regions)}), ""


def read_plan(run: Run) -> InspectionPlan | None:
    """Return the features and characteristics of a run; None without them."""
    return parsed(InspectionPlan, run.artefact(FEATURES), run.folder / FEATURES) if run.has(FEATURES) else None


def qif_of_run(run: Run) -> bytes | None:
    """Return the QIF file of a run; None without one."""
    return run.artefact(QIF_SOURCE) if run.has(QIF_SOURCE) else None


def qif_source(scene: Scene) -> bytes | None:
    """Return the content of the QIF file of a scene; None without one."""
    return None if scene.inspection.qif is None else read_bytes(Path(scene.inspection.qif))


@dataclass(frozen=True, slots=True, eq=False)
class Inspected:
    """Result of an inspection with its measured features.

    Attributes:
        result: content of features.json.
        features: measured, by name.
        plan: features and characteristics.
        reference: the part.
    """

    result: InspectionResult
    features: dict[str, MeasuredFeature]
    plan: InspectionPlan
    reference: TriangleMesh

    def write(self, write: Callable[[str, bytes], None], source: bytes | None) -> None:
        """Write features.json, the tables of characteristics and points, the page and the QIF results.

        Args:
            write: writes a file by its name.
            source: the QIF file of the characteristics; None without one.
        """
        result = self.result
        write(RESULTS, (result.model_dump_json(indent=2) + "\n").encode())
        write(TABLE, as_csv(result).encode())
        write(POINTS, points_csv(self.features).encode())
        write(PAGE, pictures.features_page(self.reference, self.plan, result, self.features).encode())
        if source is None:
            source, ids = document_of(self.plan)
            rows = [each.model_copy(update={"source_id": ids.get(each.id)}) for each in result.characteristics]
            result = result.model_copy(update={"characteristics": tuple(rows)})
        if any(each.source_id for each in result.characteristics):
            write(QIF_RESULTS, qif_results(source, result))

    def section(self) -> list[str]:
        """Return the section of a report."""
        return markdown(self.result)


def inspect_points(
    plan: InspectionPlan,
    reference: TriangleMesh,
    measured: MeasuredPoints,
    *,
    part: str,
    source: str,
    is_simulated: bool,
    on_reference: bool = False,
    alignment: str = "",
    T_located: Floats | None = None,
    notes: tuple[str, ...] = (),
) -> Inspected:
    """Align points, associate them with the features, and evaluate the characteristics.

    Args:
        plan: features and characteristics.
        reference: the part.
        measured: points near the part, object frame.
        part: its name.
        source: of the points, in words.
        is_simulated: whether they are simulated.
        on_reference: whether they were simulated on the triangles of the reference; these approximate its surfaces.
        alignment: alignment that the points have already, in words.
        T_located: (4, 4) motion of the points to the part that was made before; None: none.
        notes: for the results.
    """
    association = Association(reference, plan)
    if on_reference:
        measured = replace(measured, points=association.without_facets(measured.points))
    T, words = align(plan, association, measured.points)
    if not np.array_equal(T, np.eye(4)):
        measured = replace(
            measured, points=transform_points(T, measured.points), origins=transform_points(T, measured.origins)
        )
    features = measure_features(association, measured)
    measurements = Evaluation(plan, features, association.nearest, measured.pose_sd).measure_all()
    result = inspection_result(
        plan, measurements, features, part=part, source=source, alignment="; ".join(filter(None, [alignment, words])),
        is_simulated=is_simulated, T_part_points=T if T_located is None else T @ T_located, notes=notes,
    )  # fmt: skip
    return Inspected(result, features, plan, reference)


def align(plan: InspectionPlan, association: Association, points: Floats) -> tuple[Floats, str]:
    """Return the motion (4, 4) of points (N, 3) to the part, and the alignment in words."""
    frames = sorted({"|".join(each.datums) for each in plan.characteristics if each.datums})
    datums = f"; by the datums of each characteristic: {', '.join(frames)}" if frames else ""
    if plan.alignment == "none" or not len(points):
        return np.eye(4), f"points as given{datums}"
    if plan.alignment == "best-fit":
        sample = points[np.linspace(0, len(points) - 1, min(len(points), _FIT_POINTS)).astype(np.int64)]
        normals = association.nearest.normals(association.nearest.closest(sample))
        cloud = PointCloud(sample, normals, np.zeros(len(sample), dtype=np.int32))
        scan = register([cloud], association.nearest).scans[0]
        if not scan.is_corrected:
            return scan.T_correction, f"best fit of all points, not applied: {scan.status.value}{datums}"
        reach = association.plan.reach_mm / 1000
        return fit_majority(sample, association.nearest, scan.T_correction, reach), f"best fit of most points{datums}"
    nominal = np.array([point for point, _, _ in plan.rps]) / 1000
    directions = np.array([direction for _, direction, _ in plan.rps], dtype=np.float64)
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    weights, T = np.array([weight for _, _, weight in plan.rps]), np.eye(4)
    for _ in range(3):  # other points are nearest after each step
        points_on_part = transform_points(T, points)
        rows: Ints = np.asarray(cKDTree(points_on_part).query(nominal, min(_RPS_POINTS, len(points)))[1])
        near = points_on_part[rows.reshape(len(nominal), -1)]
        normals = association.nearest.normals(association.nearest.closest(near.mean(axis=1)))
        step, left = fit_reference_points(nominal, directions, weights, near.mean(axis=1), normals)
        T = step @ T
    worst = 1000 * float(np.abs(left).max())
    return T, f"reference point system of {len(nominal)} points, largest deviation {worst:.4f} mm{datums}"


def predict_plan(
    plan: InspectionPlan, reference: TriangleMesh, setups: Sequence[PlannedViews], pose_sd: tuple[float, float],
    part: str,
) -> InspectionResult:  # fmt: skip
    """Predict the uncertainty of the characteristics by the views of one or several set-ups.

    Args:
        plan: features and characteristics.
        reference: the part.
        setups: their views.
        pose_sd: standard deviations of executed poses [mm, deg].
        part: its name.
    """
    association, count = Association(reference, plan), sum(len(each.T_object_poses) for each in setups)
    features = predict_features(association, setups)
    sd = np.tile([pose_sd[0] / 1000, np.radians(pose_sd[1])], (count, 1))
    measurements = predicted_measurements(plan, association, features, sd)
    if len(setups) > 1:
        own = [predict_features(association, [each]) for each in setups]
        measurements = [_with_setups(plan, each, own) for each in measurements]
    source = f"{count} planned views" + (f" in {len(setups)} set-ups" if len(setups) > 1 else "")
    return inspection_result(
        plan, measurements, features, part=part, source=source, alignment="", is_simulated=False, is_predicted=True,
        notes=() if any(pose_sd) else (EXACT_POSES,),
    )  # fmt: skip


def _with_setups(
    plan: InspectionPlan, measurement: Measurement, setups: Sequence[Mapping[str, MeasuredFeature]]
) -> Measurement:
    """Return a predicted measurement with a cause if no set-up measures all its features."""
    names = [feature.name for feature in plan.features_of(measurement.characteristic)]
    measuring = {
        name: [k for k, features in enumerate(setups, 1) if all(p.is_measured for p in features[name].patches)]
        for name in names
    }
    if measurement.value is None or set.intersection(*map(set, measuring.values())):
        return measurement
    where = ", ".join(
        f"{name} in {' and '.join(map(str, numbers)) or 'parts of several'}" for name, numbers in measuring.items()
    )
    cause = f"no set-up measures all its features ({where}): the registration of the set-ups adds to U"
    return replace(measurement, cause="; ".join(filter(None, [measurement.cause, cause])))
