"""Explore a part without a model, one batch of views at a time (`cell explore`).

`explore` is the whole method: a batch is planned on the belief surface as if that were the part (`cell.explore.stage`),
executed on the real part, and its rays update the belief.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from cell.errors import FileError, UnreachableError
from cell.explore import belief, report
from cell.explore.belief import UncoveredReport, continue_surface
from cell.explore.execution import execute_batch
from cell.explore.frustum import SensorFrustum, area_below_min_range, should_keep_min_range
from cell.explore.options import ANY_BATCH, ExploreOptions
from cell.explore.policy import POLICIES, Batch, BatchRequest, ExplorationState
from cell.explore.prepare import ExplorationContext, initial_file, prepare_exploration
from cell.explore.stage import StopReason, explain_uncovered, plan_stage
from cell.explore.state import Belief, read_scans
from cell.files import file_errors
from cell.part.workpiece import Workpiece
from cell.runs import ply
from cell.runs.run import ExecutedScan, open_finished
from cell.runs.schema import BELIEVED, MEASURED, ExploredBatch, ExploreFile, SurfaceName, UncoveredArea
from cell.scan import safety
from cell.scan.options import ScanOptions
from cell.scan.safety import ANY_MOTION
from cell.scene.model import Scene
from cell.session import Session
from planner.explore.gain import N_LATEST_BATCHES, gain_ratio
from planner.explore.space import OCCUPIED, VoxelSpace
from planner.geometry.sampling import SurfaceSamples
from planner.values import Bools, Floats

_FILES = "files:"
FINAL_STAGE = "merge and reconstruct"
"""First stage after the last batch."""

_MAX_OUTSIDE = 0.01
"""Largest share of a batch's points outside the cylinder, or in free space, without an error."""

_MAX_PASSED, _MARGIN = 0.25, 2.0
"""Share of known points that a view looked past, above which the part was moved (at most 14 % for thin sheets seen
edge-on, else 2 %, if it was not moved), and margin in voxel edges."""

_MAX_BEYOND_LIMITS = 0.01
"""Share of the measured surface beyond the sigma or spacing limits, above which a note is printed."""


def explore(session: Session[None], scene: Scene, options: ExploreOptions, scanning: ScanOptions) -> ExploreFile:
    """Explore, or continue a stopped exploration with the same options.

    Args:
        session: `out` is the folder of the exploration.
        scene: validated; its part is in the cell, `plan.max_views` is the budget of views.
        options: of the exploration.
        scanning: of each execution.
    """
    work = prepare_exploration(session, scene, options, scanning)
    file = work.paths.begin(initial_file(work))
    with safety.exclusive(work.paths.root):
        known = work.paths.known(len(file.batches), work.unknown)
        if file.status != "finished":
            # Missing scans are reported before anything moves.
            known = replace(known, scans=read_scans(work.paths, file.batches))
        while file.status != "finished":
            number = len(file.batches) + 1
            folder = _plan_next(work, file, known, *_next_batches(work, file))
            if isinstance(folder, StopReason):
                uncovered = explain_remaining(work, file, known)
                causes = () if uncovered is None else uncovered.by_area()
                file = _finish(work, file, known.scans, folder.sentence, causes)
                break
            on = MEASURED if work.paths.measured(number).is_file() else BELIEVED
            scans = _execute(work, folder)
            require_plausible(known.space, folder, [(scan.points, scan.T_reported) for scan in scans], work.frustum)
            expected = _expected_gain(folder, known.space, on)
            before, known = known, _update_belief(known, expected, scans, work.frustum)
            work.paths.keep(number, known)
            stage = _batch_entry(folder, scans, expected, before.space, known, work.frustum)
            file = file.model_copy(update={"batches": (*file.batches, stage)})
            work.paths.write(file)
    return file


def _next_batches(work: ExplorationContext, file: ExploreFile) -> tuple[Sequence[Batch], str]:
    """Return the next batches by priority, and the stop reason if there is none."""
    budget, limit = work.scene.plan.max_views, work.options.max_seconds
    left = None if budget is None else budget - file.views
    if left is not None and left <= 0:
        return (), f"the budget of {budget} views is used"
    seconds = sum(stage.seconds for stage in file.batches)
    if limit is not None and seconds >= limit:
        return (), f"the budget of {limit:g} s of motion is used"
    on = file.batches[-1].planning_surface if file.batches else BELIEVED
    so = ExplorationState(len(file.batches), left, report.has_limits(work.scene), on)
    return POLICIES[work.options.policy](work.options, so), "no batch of the policy has the minimum expected gain"


def _plan_next(
    work: ExplorationContext, file: ExploreFile, known: Belief, batches: Sequence[Batch], ended: str
) -> Path | StopReason:
    """Return the run folder of a batch, planned now unless it was finished before the exploration was stopped.

    If no batch is worth its views, the reason is that of the last batch on the believed surface.
    """
    if (folder := work.paths.stage(len(file.batches) + 1)).is_dir():
        return folder
    stop = StopReason(ended)
    for batch in batches:
        work.paths.clear(len(file.batches) + 1)
        plan = _plan_on_measured if batch.on == MEASURED else _plan_on_belief
        outcome = plan(work, file, known, batch)
        if not isinstance(outcome, StopReason):
            return outcome
        stop = outcome if batch.on == BELIEVED else stop
    return stop


def explain_remaining(work: ExplorationContext, file: ExploreFile, known: Belief) -> UncoveredReport | None:
    """Return the uncovered belief surface by cause; None if all is covered."""
    number, request = len(file.batches) + 1, BatchRequest(known.space, known.record, Batch(0), 0.0)
    work.paths.clear(number)
    whole = known.space.belief_voxels(unlimited=True)
    surface = belief.belief_part(belief.surface_about(known.space, whole), work.name)
    scene = _batch_scene(work, request, number, surface)
    uncovered_report = explain_uncovered(work.session, scene, surface, request, work.paths.stage(number))
    work.paths.clear(number)
    return uncovered_report


def _plan_on_belief(work: ExplorationContext, file: ExploreFile, known: Belief, batch: Batch) -> Path | StopReason:
    """Plan a batch on the boundary of unseen space; if keeping the minimum range yields nothing, plan without it."""
    number = len(file.batches) + 1
    least = work.options.min_gain if number > 1 else 0.0
    part = belief.belief_part(known.surface, work.name)
    request = BatchRequest(known.space, known.record, batch, least, _measured_area(file), _belief_gain_ratio(file))
    if should_keep_min_range(_min_range_history(file)):
        outcome = _stage(work, replace(request, keep_min_range=True), number, part)
        if not isinstance(outcome, StopReason):
            return outcome
        work.paths.clear(number)
    return _stage(work, request, number, part)


def _plan_on_measured(work: ExplorationContext, file: ExploreFile, known: Belief, batch: Batch) -> Path | StopReason:
    """Plan a batch on the surface of all points and its continuation."""
    number = len(file.batches) + 1
    surface = continue_surface(known.scans, known.space, known.solid)
    if surface is None:
        return StopReason("the points describe no surface")
    work.paths.measured(number).write_bytes(ply.mesh_bytes(surface))
    poses = np.stack([scan.T_reported for scan in known.scans])
    latest = tuple(
        (s.views, s.expected_gain_mm2 / 1e6 if s.planning_surface == MEASURED else 0.0)
        for s in file.batches[-N_LATEST_BATCHES:]
    )
    request = BatchRequest(
        known.space, known.record, batch, work.options.min_gain, _measured_area(file), poses=poses, latest=latest
    )
    return _stage(work, request, number, belief.belief_part(surface, work.name, MEASURED))


def _stage(work: ExplorationContext, request: BatchRequest, number: int, surface: Workpiece) -> Path | StopReason:
    """Plan a batch on a surface; arm and housing stay out of unseen space."""
    scene = _batch_scene(work, request, number, surface)
    return plan_stage(work.session, scene, surface, request, work.paths.stage(number))


def _batch_scene(work: ExplorationContext, request: BatchRequest, number: int, surface: Workpiece) -> Scene:
    """Return the scene of a batch, with the unseen space as an obstacle."""
    belief.write_unseen(request.space, work.paths.unseen(number))
    scene = report.without_limits(work.scene) if request.batch.rough else work.scene
    return belief.batch_scene(scene, work.cylinder, surface, work.paths.unseen(number))


def _measured_area(file: ExploreFile) -> float:
    """Return the measured area of the belief surface [m^2]."""
    return 1e-6 * file.batches[-1].measured_mm2 if file.batches else 0.0


def _belief_gain_ratio(file: ExploreFile) -> float:
    """Return realised / expected gain on the belief surface, at least 1.

    Surface behind an uncovered patch is larger than the patch. Batches with too little gain are recorded where they
    looked and do not count here. The first batch does not count, since it is planned for the cylinder.
    """
    batches = [(s.expected_gain_mm2, s.realised_gain_mm2) for s in file.batches[1:] if s.planning_surface == BELIEVED]
    return max(1.0, gain_ratio(batches))


def _min_range_history(file: ExploreFile) -> list[tuple[float, float]]:
    """Return area below the minimum range and expected area of each batch except the first."""
    return [(stage.below_range_mm2, stage.expected_gain_mm2) for stage in file.batches[1:]]


def _execute(work: ExplorationContext, folder: Path) -> tuple[ExecutedScan, ...]:
    """Return the scans of a batch; its motion is confirmed by its own digest, or with all of the exploration."""
    word = work.options.confirm_motion
    if word == ANY_BATCH:
        word = ANY_MOTION
    options = work.scanning.model_copy(update={"confirm_motion": word})
    if options.acquire.startswith(_FILES):  # views are numbered from 1 in each stage
        options = options.model_copy(update={"acquire": f"{options.acquire.rstrip('/')}/{folder.name}"})
        _make_points_folder(Path(options.acquire.removeprefix(_FILES)).expanduser())
    true_part = None if work.ground_truth is None else work.ground_truth.mesh
    return execute_batch(work.session, folder, options, true_part=true_part)


def _make_points_folder(folder: Path) -> None:
    """Create the folder for the points of a batch, if the user made its parent."""
    if folder.parent.is_dir():
        with file_errors(f"{folder} cannot be created", "create it for the points of this stage"):
            folder.mkdir(exist_ok=True)


@dataclass(frozen=True, slots=True, eq=False)
class _ExpectedGain:
    """Uncovered samples that the views of a batch should measure.

    Attributes:
        samples: N samples of the surface it was planned on.
        sees: (N, views) samples of each view.
        surface: area of the surface [m^2].
        on: which surface that was.
    """

    samples: SurfaceSamples
    sees: Bools
    surface: float
    on: SurfaceName


def _update_belief(
    known: Belief, request: _ExpectedGain, scans: Sequence[ExecutedScan], frustum: SensorFrustum
) -> Belief:
    """Return the belief after a batch."""
    before, after, expected = known.space, known.space, request.samples
    is_measured = np.zeros(len(expected), dtype=np.bool_)
    for view, scan in enumerate(scans):
        T = scan.T_reported
        source, sensor = (T[:3, :3] @ place + T[:3, 3] for place in (frustum.source, frustum.sensor))
        after = after.with_points(scan.points, [source, sensor]).with_surface_between(
            frustum.between(scan.points, T, before.gap)
        )
        after = after.with_votes(scan.points, source, sensor, frustum.blank(scan.points, T), frustum.near, frustum.far)
        is_measured |= request.sees[:, view] & frustum.answered(
            expected.points, scan.points[before.is_new(scan.points)], T
        )
    all_scans = (*known.scans, *scans)
    if request.on == MEASURED:  # gains on the measured surface do not change the record of the belief surface
        return Belief(after, known.record, all_scans)
    record = known.record
    if (before.state == OCCUPIED).any():  # the ring was planned for the cylinder, which is no guess at the part
        of = before.open_samples_at(expected.points, expected.normals)
        record = record.with_batch(
            of, expected.areas / record.weights(of) / request.surface, is_measured.astype(np.float64)
        )
    return Belief(
        after.with_tries(expected.points[after.is_still_open(expected.points, expected.normals)]), record, all_scans
    )


def require_plausible(
    space: VoxelSpace, folder: Path, views: Sequence[tuple[Floats, Floats]], frustum: SensorFrustum
) -> None:
    """Raise FileError if the points of a batch are impossible, so that later views would be wrong.

    Args:
        space: voxels before the batch.
        folder: run folder of the batch.
        views: points (N, 3) [m] and scanner pose (4, 4) [m] of each view.
        frustum: of the scanner.
    """
    points = np.concatenate([points for points, _ in views])
    if not len(points):
        if (space.state == OCCUPIED).any():
            return
        raise FileError(f"no ray of {folder} hit a surface; check --place, --cylinder and the scanner's range")
    if (out := float(space.outside(points).mean())) > _MAX_OUTSIDE:
        raise FileError(
            f"{100 * out:.1f} % of the points of {folder} lie outside the cylinder, and the exploration ends; "
            "start a new one with a larger --cylinder or another --place, and remove the points of the part's support"
        )
    moved = "the part was moved, or the poses are wrong; the exploration ends, start a new one"
    if (share := space.contradicted_share(points)) > _MAX_OUTSIDE:
        raise FileError(
            f"{100 * share:.1f} % of the points of {folder} lie in space that was measured as free; {moved}"
        )
    passed = max(frustum.passed(space.points, points, T, _MARGIN * space.edge) for points, T in views)
    if passed > _MAX_PASSED:
        raise FileError(
            f"{100 * passed:.1f} % of the known points in sight of {folder} were not measured again; {moved}"
        )


def _expected_gain(folder: Path, before: VoxelSpace, on: SurfaceName) -> _ExpectedGain:
    """Return the rows of a batch's matrix that its views should measure."""
    run = open_finished(folder)
    M, views = run.measurability, run.plan.views
    sees = M.matrix()[:, [view.id for view in views]].toarray()
    rows = np.asarray(sees.any(axis=1))
    if on == BELIEVED:  # a batch may include covered surface
        rows = rows & ~before.is_measured(M.samples.points, M.samples.normals)
    surface = float(run.mesh("reference.ply").areas.sum())
    return _ExpectedGain(M.samples.pick(rows), sees[rows], surface, on)


def _batch_entry(
    folder: Path,
    scans: Sequence[ExecutedScan],
    expected: _ExpectedGain,
    before: VoxelSpace,
    known: Belief,
    frustum: SensorFrustum,
) -> ExploredBatch:
    """Return the explore.json entry of a batch."""
    run, mesh = open_finished(folder), known.surface
    clouds = [(scan.points, scan.T_reported) for scan in scans]
    seen, new = known.space.measured_since(before, mesh.centres, mesh.normals)
    return ExploredBatch(
        folder=f"{folder.parent.name}/{folder.name}",
        digest=run.digest,
        views=len(scans),
        planning_surface=expected.on,
        points=sum(len(scan.points) for scan in scans),
        seconds=round(run.motion.duration, 6),
        expected_gain_mm2=round(1e6 * float(expected.samples.areas.sum()), 3),
        below_range_mm2=round(1e6 * area_below_min_range(expected.samples, expected.sees, clouds, before, frustum), 3),
        surface_mm2=round(1e6 * float(mesh.areas.sum()), 3),
        realised_gain_mm2=round(1e6 * float(mesh.areas[new].sum()), 3),
        uncovered_mm2=round(1e6 * float(mesh.areas[~seen].sum()), 3),
        unseen_mm3=round(1e9 * known.space.unseen_volume, 3),
    )


def _finish(
    work: ExplorationContext,
    file: ExploreFile,
    scans: tuple[ExecutedScan, ...],
    ended: str,
    still_open: tuple[UncoveredArea, ...],
) -> ExploreFile:
    """Write the model of all scans, the report and the finished explore.json."""
    if not file.batches:
        raise UnreachableError(f"no view can be planned: {ended}; move the part (--place), or change the scanner")
    with work.session.stage(FINAL_STAGE):
        model = report.write_model(work.paths.root, scans)
    middle = None if model is None else report.middle_of(model, np.asarray(work.scene.placement.position_mm))
    missed = None
    if model is not None and report.has_limits(work.scene):
        missed = report.share_beyond_limits(work.scene, model, np.stack([scan.T_reported for scan in scans]))
        if missed > _MAX_BEYOND_LIMITS:
            work.session.note(
                f"{100 * missed:.1f} % of the measured surface exceeds the sigma or spacing limit; plan on "
                f"{report.MODEL} with the same limits"
            )
    file = file.model_copy(
        update={
            "status": "finished", "stop_reason": ended, "uncovered": still_open,
            "model": "" if middle is None else report.MODEL, "model_centre_mm": middle, "share_beyond_limits": missed,
        }
    )  # fmt: skip
    report.write(work.paths.root, file)
    work.paths.write(file)
    return file
