"""`cell explore`: views of a part that nobody has a model of, a batch at a time.

`explore` shows the whole on one screen. What is believed of the part is planned for as a part (`cell.explore.stage`),
the batch is executed on the part that stands there, and its rays change what is believed.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from cell.errors import FileError, UnreachableError
from cell.explore import belief, report, specification
from cell.explore.asked import Asked
from cell.explore.execution import executed
from cell.explore.measured_surface import continued
from cell.explore.options import EVERY_BATCH, ExploreOptions
from cell.explore.policies import POLICIES, Batch, So
from cell.explore.prepare import Exploring, Eye, begun, prepared
from cell.explore.reasons import StillOpen
from cell.explore.stage import StopReason, explain_uncovered, plan_stage
from cell.explore.state import Known, scans_of
from cell.explore.too_near import keep_off, too_near
from cell.part.workpiece import Workpiece
from cell.runs import ply
from cell.runs.run import ExecutedScan, open_finished
from cell.runs.schema import BELIEVED, MEASURED, ExploredStage, ExploreFile, OpenReason, SurfaceName
from cell.scan import safety
from cell.scan.options import ScanOptions
from cell.scan.safety import ANY_MOTION
from cell.scene.model import Scene
from cell.session import Session
from planner.explore.gain import N_LATEST_BATCHES, gain_ratio
from planner.explore.space import OCCUPIED, VoxelSpace
from planner.geometry.sampling import SurfaceSamples, pick_samples
from planner.values import Bools, Floats

_FILES = "files:"
LAST_STAGE = "merge and reconstruct"
"""What is told first when no further batch is planned."""

_OUTSIDE = 0.01
"""Share of a stage's points beyond the cylinder, or in space that was seen free, above which something is wrong."""

_PASSED, _MARGIN = 0.25, 2.0
"""Share of known points past which a view looked above which the part was moved (where it was not, 14 % of thin sheets
that are seen edge-on, else 2 % at most), and by how many edges of a voxel."""

_MISSED = 0.01
"""Share of what was measured, beyond the limits of sigma and spacing, above which a person is told."""


def explore(session: Session[None], scene: Scene, options: ExploreOptions, scanning: ScanOptions) -> ExploreFile:
    """Explore, or go on with an exploration of the same options that was stopped.

    Args:
        session: `out` is the folder of the exploration.
        scene: the checked scene; its part is what stands there, `plan.max_views` the budget of views.
        options: of the exploration.
        scanning: of each execution.

    Raises:
        CellError: with one sentence and the exit code; what was finished stays in the folder.
    """
    work = prepared(session, scene, options, scanning)
    file = work.paths.begin(begun(work))
    with safety.exclusive(work.paths.root):
        known = work.paths.known(len(file.stages), work.unknown)
        if file.status != "finished":
            # What is missing is told before anything moves.
            known = replace(known, scans=scans_of(work.paths, file.stages))
        while file.status != "finished":
            number = len(file.stages) + 1
            folder = _planned(work, file, known, *_next(work, file))
            if isinstance(folder, StopReason):
                uncovered = stays_open(work, file, known)
                causes = () if uncovered is None else uncovered.by_area()
                file = _finished(work, file, known.scans, folder.sentence, causes)
                break
            on = MEASURED if work.paths.measured(number).is_file() else BELIEVED
            scans = _executed(work, folder)
            require_plausible(known.space, folder, [(scan.points, scan.T_reported) for scan in scans], work.eye)
            expected = _expected(folder, known.space, on)
            before, known = known, _learned(known, expected, scans, work.eye)
            work.paths.keep(number, known)
            stage = _stage_of(folder, scans, expected, before.space, known, work.eye)
            file = file.model_copy(update={"stages": (*file.stages, stage)})
            work.paths.write(file)
    return file


def _next(work: Exploring, file: ExploreFile) -> tuple[Sequence[Batch], str]:
    """The next batches, of which the first is taken that is worth its views; none, and why there is none."""
    budget, limit = work.scene.plan.max_views, work.options.max_seconds
    left = None if budget is None else budget - file.views
    if left is not None and left <= 0:
        return (), f"the {budget} views of the budget are used up"
    seconds = sum(stage.seconds for stage in file.stages)
    if limit is not None and seconds >= limit:
        return (), f"the {limit:g} s of motion of the budget are used up"
    on = file.stages[-1].planned_on if file.stages else BELIEVED
    so = So(len(file.stages), left, specification.asked(work.scene), on)
    return POLICIES[work.options.policy](work.options, so), "no batch of the policy is left that is worth its views"


def _planned(
    work: Exploring, file: ExploreFile, known: Known, batches: Sequence[Batch], ended: str
) -> Path | StopReason:
    """Return the run folder of a batch, planned now unless it was finished before the exploration was stopped.

    If no batch is worth its views, the reason is that of the last batch on the believed surface.
    """
    if (folder := work.paths.stage(len(file.stages) + 1)).is_dir():
        return folder
    stop = StopReason(ended)
    for batch in batches:
        work.paths.clear(len(file.stages) + 1)
        plan = _on_measured if batch.on == MEASURED else _on_believed
        found = plan(work, file, known, batch)
        if not isinstance(found, StopReason):
            return found
        stop = found if batch.on == BELIEVED else stop
    return stop


def stays_open(work: Exploring, file: ExploreFile, known: Known) -> StillOpen | None:
    """Return the uncovered surface of all that the part may be, by cause; None if there is none."""
    number, asked = len(file.stages) + 1, Asked(known.space, known.record, Batch(0), 0.0)
    work.paths.clear(number)
    whole = known.space.belief_voxels(unlimited=True)
    surface = belief.part_of(belief.surface_about(known.space, whole), work.name)
    scene = _scene_of(work, asked, number, surface)
    found = explain_uncovered(work.session, scene, surface, asked, work.paths.stage(number))
    work.paths.clear(number)
    return found


def _on_believed(work: Exploring, file: ExploreFile, known: Known, batch: Batch) -> Path | StopReason:
    """Plan a batch on the boundary of unseen space; if keeping the minimum range yields nothing, plan without it."""
    number = len(file.stages) + 1
    least = work.options.min_gain if number > 1 else 0.0
    part = belief.part_of(known.believed, work.name)
    asked = Asked(known.space, known.record, batch, least, _measured_area(file), _came(file))
    if keep_off(_nearness(file)):
        found = _stage(work, replace(asked, cautious=True), number, part)
        if not isinstance(found, StopReason):
            return found
        work.paths.clear(number)
    return _stage(work, asked, number, part)


def _on_measured(work: Exploring, file: ExploreFile, known: Known, batch: Batch) -> Path | StopReason:
    """Plan a batch on the surface of all points and its continuation."""
    number = len(file.stages) + 1
    surface = continued(known.scans, known.space, known.solid)
    if surface is None:
        return StopReason("the points describe no surface")
    work.paths.measured(number).write_bytes(ply.mesh_bytes(surface))
    poses = np.stack([scan.T_reported for scan in known.scans])
    latest = tuple(
        (s.views, s.expected_mm2 / 1e6 if s.planned_on == MEASURED else 0.0) for s in file.stages[-N_LATEST_BATCHES:]
    )
    asked = Asked(
        known.space, known.record, batch, work.options.min_gain, _measured_area(file), poses=poses, latest=latest
    )
    return _stage(work, asked, number, belief.part_of(surface, work.name, MEASURED))


def _stage(work: Exploring, asked: Asked, number: int, surface: Workpiece) -> Path | StopReason:
    """Plan a batch on a surface; arm and housing stay out of unseen space."""
    scene = _scene_of(work, asked, number, surface)
    return plan_stage(work.session, scene, surface, asked, work.paths.stage(number))


def _scene_of(work: Exploring, asked: Asked, number: int, surface: Workpiece) -> Scene:
    """Return the scene of a batch, with the unseen space as an obstacle."""
    belief.write_unseen(asked.space, work.paths.unseen(number))
    scene = specification.without(work.scene) if asked.batch.rough else work.scene
    return belief.scene_of(scene, work.cylinder, surface, work.paths.unseen(number))


def _measured_area(file: ExploreFile) -> float:
    """Area of the believed surface that was measured [m^2]."""
    return 1e-6 * file.stages[-1].measured_mm2 if file.stages else 0.0


def _came(file: ExploreFile) -> float:
    """How many times as much as expected comes on the believed surface, 1 at least.

    What lies behind an open patch is larger than the patch. Batches that bring too little are in the record of what
    they looked at; they say nothing of the rest. Nor does the ring, planned for the cylinder: no guess at the part.
    """
    batches = [(s.expected_mm2, s.new_mm2) for s in file.stages[1:] if s.planned_on == BELIEVED]
    return max(1.0, gain_ratio(batches))


def _nearness(file: ExploreFile) -> list[tuple[float, float]]:
    """Of each batch what the part may have hidden before the range, and what it was to measure; not of the ring."""
    return [(stage.too_near_mm2, stage.expected_mm2) for stage in file.stages[1:]]


def _executed(work: Exploring, folder: Path) -> tuple[ExecutedScan, ...]:
    """The scans of a stage; its motion is released by its own digest, or with all others of the exploration."""
    word = work.options.confirm_motion
    if word == EVERY_BATCH:
        word = ANY_MOTION
    options = work.scanning.model_copy(update={"confirm_motion": word})
    if options.acquire.startswith(_FILES):  # views are numbered from 1 in each stage
        options = options.model_copy(update={"acquire": f"{options.acquire.rstrip('/')}/{folder.name}"})
        _make_ready(Path(options.acquire.removeprefix(_FILES)).expanduser())
    stands = None if work.hidden is None else work.hidden.mesh
    return executed(work.session, folder, options, stands=stands)


def _make_ready(folder: Path) -> None:
    """The folder that a stage's points come into; the one of all stages is a person's to make.

    Raises:
        FileError: if it cannot be made.
    """
    if folder.parent.is_dir():
        try:
            folder.mkdir(exist_ok=True)
        except OSError as error:
            reason = (error.strerror or str(error)).lower()
            raise FileError(f"{folder} cannot be made: {reason}; make it for the points of this stage") from error


@dataclass(frozen=True, slots=True, eq=False)
class _Expected:
    """What was open and a stage's views should have measured.

    Attributes:
        samples: N of the surface that it was planned on.
        sees: (N, views) by which of them.
        surface: all of it [m^2].
        on: which surface that was.
    """

    samples: SurfaceSamples
    sees: Bools
    surface: float
    on: SurfaceName


def _learned(known: Known, asked: _Expected, scans: Sequence[ExecutedScan], eye: Eye) -> Known:
    """What is known after a stage."""
    before, after, expected = known.space, known.space, asked.samples
    found = np.zeros(len(expected), dtype=np.bool_)
    for view, scan in enumerate(scans):
        T = scan.T_reported
        source, sensor = (T[:3, :3] @ place + T[:3, 3] for place in (eye.source, eye.sensor))
        after = after.with_points(scan.points, [source, sensor]).with_surface_between(
            eye.between(scan.points, T, before.gap)
        )
        after = after.with_votes(scan.points, source, sensor, eye.blank(scan.points, T), eye.near, eye.far)
        found |= asked.sees[:, view] & eye.answered(expected.points, scan.points[before.is_new(scan.points)], T)
    taken = (*known.scans, *scans)
    if asked.on == MEASURED:  # what lies between points is no news of what is believed
        return Known(after, known.record, taken)
    record = known.record
    if (before.state == OCCUPIED).any():  # the ring was planned for the cylinder, which is no guess at the part
        of = before.open_samples_at(expected.points, expected.normals)
        record = record.with_batch(of, expected.areas / record.weights(of) / asked.surface, found.astype(np.float64))
    return Known(
        after.with_tries(expected.points[after.is_still_open(expected.points, expected.normals)]), record, taken
    )


def require_plausible(space: VoxelSpace, folder: Path, views: Sequence[tuple[Floats, Floats]], eye: Eye) -> None:
    """Stop where a stage's points cannot be; later views may look at what was believed and is not there.

    Args:
        space: what is known without them.
        folder: of the stage.
        views: of each the points (N, 3) [m] and the pose (4, 4) of the scanner [m].
        eye: of the scanner.

    Raises:
        FileError: if nothing was hit yet, the part reaches out of its cylinder, or it moved.
    """
    points = np.concatenate([points for points, _ in views])
    if not len(points):
        if (space.state == OCCUPIED).any():
            return
        raise FileError(f"no ray of {folder} came back; look at --place, --cylinder and the scanner's range")
    if (out := float(space.outside(points).mean())) > _OUTSIDE:
        raise FileError(
            f"{100 * out:.1f} % of the points of {folder} lie outside the cylinder; nothing more is moved: explore "
            "anew with a larger --cylinder, or with the part in its middle; what it stands on must not be among the "
            "points"
        )
    moved = "the part was moved, or the poses are off; nothing more is moved: explore anew"
    if (gone := space.contradicted_share(points)) > _OUTSIDE:
        raise FileError(f"{100 * gone:.1f} % of the points of {folder} lie in space that was seen free; {moved}")
    passed = max(eye.passed(space.points, points, T, _MARGIN * space.edge) for points, T in views)
    if passed > _PASSED:
        raise FileError(f"{100 * passed:.1f} % of the known points that a view of {folder} looked at are gone; {moved}")


def _expected(folder: Path, before: VoxelSpace, on: SurfaceName) -> _Expected:
    """What of the rows of a stage's matrix its views should have measured."""
    run = open_finished(folder)
    M, views = run.measurability, run.plan.views
    sees = M.matrix()[:, [view.id for view in views]].toarray()
    rows = np.asarray(sees.any(axis=1))
    if on == BELIEVED:  # a batch may be asked for what was seen as well
        rows = rows & ~before.is_measured(M.samples.points, M.samples.normals)
    surface = float(run.mesh("reference.ply").areas.sum())
    return _Expected(pick_samples(M.samples, rows), sees[rows], surface, on)


def _stage_of(
    folder: Path, scans: Sequence[ExecutedScan], expected: _Expected, before: VoxelSpace, known: Known, eye: Eye
) -> ExploredStage:
    """What explore.json says of a stage."""
    run, mesh = open_finished(folder), known.believed
    taken = [(scan.points, scan.T_reported) for scan in scans]
    seen, new = known.space.measured_since(before, mesh.centres, mesh.normals)
    return ExploredStage(
        folder=f"{folder.parent.name}/{folder.name}",
        digest=run.digest,
        views=len(scans),
        planned_on=expected.on,
        points=sum(len(scan.points) for scan in scans),
        seconds=round(run.motion.duration, 6),
        expected_mm2=round(1e6 * float(expected.samples.areas.sum()), 3),
        too_near_mm2=round(1e6 * too_near(expected.samples, expected.sees, taken, before, eye), 3),
        surface_mm2=round(1e6 * float(mesh.areas.sum()), 3),
        new_mm2=round(1e6 * float(mesh.areas[new].sum()), 3),
        open_mm2=round(1e6 * float(mesh.areas[~seen].sum()), 3),
        never_entered_mm3=round(1e9 * known.space.unseen_volume, 3),
    )


def _finished(
    work: Exploring, file: ExploreFile, scans: tuple[ExecutedScan, ...], ended: str, still_open: tuple[OpenReason, ...]
) -> ExploreFile:
    """Write the model of all scans, the report and the finished explore.json."""
    if not file.stages:
        raise UnreachableError(f"nothing can be explored here: {ended}; move the part (--place), or change the scanner")
    with work.session.stage(LAST_STAGE):
        model = report.write_model(work.paths.root, scans)
    middle = None if model is None else report.middle_of(model, np.asarray(work.scene.placement.position_mm))
    missed = None
    if model is not None and specification.asked(work.scene):
        missed = specification.missed(work.scene, model, np.stack([scan.T_reported for scan in scans]))
        if missed > _MISSED:
            work.session.note(
                f"{100 * missed:.1f} % of what was measured is worse than the sigma or spacing asked for; plan on "
                f"{report.MODEL} with the same limits"
            )
    file = file.model_copy(
        update={
            "status": "finished", "ended": ended, "open": still_open,
            "model": "" if middle is None else report.MODEL, "model_middle_mm": middle, "misses_limits": missed,
        }
    )  # fmt: skip
    report.write(work.paths.root, file)
    work.paths.write(file)
    return file
