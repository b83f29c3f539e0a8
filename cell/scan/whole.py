"""The scans of several set-ups as one model: registered to each other, merged, measured, in `scanned/`.

Each set-up is a body: its scans are merged in the part's frame as in a report of its own, the part found where it stood
if it may have stood elsewhere. Then all bodies are moved together, by what they share and by the reference. What is
made here can be made again from the scans at any time, so the folder is replaced. Object frame, metres.
"""

import shutil
from collections.abc import Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path

import numpy as np

from cell.errors import FileError
from cell.metrology import point_files
from cell.metrology.reconstruct import reconstruct
from cell.runs.cell import RunCell, read_cell
from cell.runs.folder import RunFolder
from cell.runs.run import ExecutedScan, Run, open_finished, read_execution
from cell.runs.schema import OpenShares, PlanFile, ScannedSetup, ScannedSetups
from cell.scan import causes
from cell.scan.executed_scans import source_of, usable
from cell.scan.execution_summary import deviation_of, place_of, registration_of, surface_of
from cell.scan.merging import Merged, executed_poses, merged, sigma_of
from cell.scan.post_processing import options_of
from cell.scan.whole_page import page
from cell.session import Session, Stream, random_stream
from cell.setups.contact import touching
from cell.setups.planned_setups import PlannedSetups
from cell.setups.shared import apart, shared
from cell.world.prediction import held_out_samples
from planner.geometry.closest import ClosestPointQuery
from planner.geometry.sampling import SurfaceSamples
from planner.measurability import coverage
from planner.measurability.visibility import find_measured
from planner.registration.cloud import PointCloud
from planner.registration.localisation import SearchRange
from planner.registration.registration import Registration, register
from planner.registration.surface import measure_deviation
from planner.values import Bools, Floats

FOLDER = "scanned"
"""Below the folder of `cell setups`."""

_SAMPLES = 20_000  # points of all set-ups that are matched


@dataclass(frozen=True, slots=True, eq=False)
class _Body:
    """A set-up that is scanned.

    Attributes:
        number: from 1.
        execution: name.
        run: its plan's folder.
        cell: what was measured in, as the plan has it.
        plan: its views.
        scans: that can be used.
        merged: as one cloud.
        doubts: what the points contradict, a sentence each.
    """

    number: int
    execution: str
    run: Run
    cell: RunCell
    plan: PlanFile
    scans: Sequence[ExecutedScan]
    merged: Merged
    doubts: Sequence[str]

    def moved(self, T: Floats) -> "_Body":
        """The whole body after a rigid motion (4, 4)."""
        now = replace(
            self.merged,
            cloud=self.merged.cloud.transformed(T),
            poses=tuple(T @ pose for pose in self.merged.poses),
            fit=None if self.merged.fit is None else replace(self.merged.fit, T=T @ self.merged.fit.T),
        )
        return replace(self, merged=now)

    def seen(self, samples: SurfaceSamples) -> Bools:
        """(S,) samples that the executed views measure and that no support touches."""
        cell = self.cell if self.merged.fit is None else self.cell.about_part(self.merged.fit.T)
        return _seen(cell, executed_poses(self.scans, self.merged), samples) & ~touching(samples, self.cell.occluders)

    def told(self, seen: Bools, before: Bools) -> ScannedSetup:
        """What the report says of it, from the (S,) samples that it measures and those that set-ups before do."""
        return ScannedSetup(
            number=self.number,
            execution=self.execution,
            digest=self.run.digest,
            views=len(self.scans),
            points=len(self.merged.cloud),
            visible=float(seen.mean()),
            adds=float((seen & ~before).mean()),
            place=place_of(self.merged, self.scans),
        )


def finished_execution(folder: Path) -> str | None:
    """The latest execution of a set-up's run that is whole; None where there is none.

    Raises:
        FileError: if the set-up has no finished plan.
    """
    run = open_finished(folder)
    for name in reversed(run.execution_ids):
        manifest = read_execution(run, name).manifest
        whole = manifest.status == "finished" and manifest.options.get("view") is None
        if whole and manifest.digest == run.digest:
            return name
    return None


def report(session: Session[None], planned: PlannedSetups) -> ScannedSetups:
    """Make `scanned/` of the latest whole execution of each set-up, of those that have one.

    Args:
        session: of the command.
        planned: the set-ups.

    Raises:
        FileError: if no set-up is scanned, a file is damaged, too few points lie near the part, or the folder cannot
            be written.
    """
    names = {number: finished_execution(folder) for number, folder in enumerate(planned.folders, start=1)}
    if not any(names.values()):
        raise FileError(f"no set-up of {planned.folder} is scanned; begin with cell scan {planned.folder} --setup 1")
    with session.stage("merge the set-ups"):
        bodies = [_body(number, planned.folders[number - 1], name, session) for number, name in names.items() if name]
        nearest = ClosestPointQuery(bodies[0].cell.reference)
        bodies, registration = _registered(bodies, nearest)
    target = planned.folder / FOLDER
    for path in (target, target.with_name(FOLDER + ".part")):
        _clear(path)
    folder = RunFolder.create(target, list(session.origin.argv), bodies[0].run.seed, {}, datetime.now(UTC))
    with folder.keep_on_failure():
        done = _written(folder, planned, bodies, registration, nearest, session)
        folder.finish(0)
    return done


def _body(number: int, folder: Path, name: str, session: Session[None]) -> _Body:
    """Read and merge one set-up."""
    run = open_finished(folder)
    recorded, plan = read_execution(run, name), run.plan
    options = options_of(recorded)
    cell = read_cell(run, options.resolution_deg)
    scans, left_out = usable(recorded, plan.views)
    for sentence in left_out:
        session.note(f"set-up {number}: {sentence}")
    nearest = ClosestPointQuery(cell.reference)
    search = None if options.search is None else SearchRange(*options.search)
    if search is None and any(scan.T_true is None for scan in scans):
        search = SearchRange()  # nobody sets a part down to a tenth of a millimetre
    rng = random_stream(recorded.manifest.require_seed(recorded.folder), Stream.REGISTRATION_STARTS)
    cloud = merged(scans, nearest, registered=options.registers, search=search, rng=rng)
    return _Body(number, name, run, cell, plan, scans, cloud, causes.doubts(scans, cell, nearest, options.points_units))


def _registered(bodies: list[_Body], nearest: ClosestPointQuery) -> tuple[list[_Body], Registration | None]:
    """All bodies moved together, where one of them was looked for: onto the reference, and onto each other."""
    if len(bodies) < 2 or all(body.merged.fit is None for body in bodies):
        return bodies, None
    found = register([body.merged.cloud for body in bodies], nearest, samples=_SAMPLES // len(bodies))
    return [body.moved(scan.T_correction) for body, scan in zip(bodies, found.scans, strict=True)], found


def _written(
    folder: RunFolder, planned: PlannedSetups, bodies: list[_Body], registration: Registration | None,
    nearest: ClosestPointQuery, session: Session[None],
) -> ScannedSetups:  # fmt: skip
    """Cloud, surface, deviation, report, into the open folder."""
    from cell.report import deviation_picture  # matplotlib

    first, source = bodies[0], source_of([scan for body in bodies for scan in body.scans])
    cloud, numbers, sigma = _joined(bodies)
    folder.write_bytes("cloud.ply", point_files.cloud_ply(cloud, numbers, sigma, source))
    with session.stage("reconstruct"):
        model = reconstruct(cloud)
    off = None
    with session.stage("measure"):
        if model.mesh is not None:
            rng = random_stream(first.run.seed, Stream.DEVIATION_SAMPLES)
            off = measure_deviation(
                model.mesh, nearest, rng, closed=model.closed, count=session.effort.deviation_samples
            )
            folder.write_bytes("mesh.ply", point_files.mesh_ply(model.mesh, model.closed, off.at_vertices, source))
            deviation_picture.draw(folder.path / "deviation.png", model.mesh, off, source)
            folder.adopt("deviation.png")
        samples = held_out_samples(first.cell.reference, first.cell.planning, first.run.seed)
        seen = {body.number: body.seen(samples) for body in bodies}
        report = ScannedSetups(
            part=planned.file.part,
            source=source,
            setups=tuple(_told(bodies, seen)),
            missing=tuple(n for n in range(1, len(planned.folders) + 1) if n not in seen),
            visible=float(np.logical_or.reduce(list(seen.values())).mean()),
            planned=planned.file.coverage.visible,
            sampled=coverage.sampled_coverage(
                cloud.points, samples, coverage.sampling_radius(first.cell.reference)
            ).fraction,
            open=_open(planned, list(seen.values()), samples, list(seen)),
            shared=(pairs := shared(seen, samples)),
            registration=None if registration is None else registration_of(registration),
            doubts=(*_doubts(bodies), *_held_apart(apart(pairs, tuple(seen)))),
            surface=surface_of(first.cell.reference, model),
            deviation=None if off is None else deviation_of(off),
        )
    folder.write_json("report.json", report.as_json())
    folder.write_text("report.md", page(report))
    return report


def _told(bodies: Sequence[_Body], seen: dict[int, Bools]) -> list[ScannedSetup]:
    told, before = [], np.zeros_like(seen[bodies[0].number])
    for body in bodies:
        told.append(body.told(seen[body.number], before))
        before = before | seen[body.number]
    return told


def _joined(bodies: Sequence[_Body]) -> tuple[PointCloud, np.ndarray[tuple[int], np.dtype[np.int32]], Floats]:
    """All points as one cloud; their views' numbers, counted on through the set-ups; their expected deviation."""
    clouds = [body.merged.cloud for body in bodies]
    first = np.cumsum([0, *(len(body.scans) for body in bodies)])
    views = np.cumsum([0, *(len(body.plan.views) for body in bodies)])
    scan = np.concatenate([cloud.scan + np.int32(start) for cloud, start in zip(clouds, first[:-1], strict=True)])
    stop = np.concatenate([body.merged.stop + np.int32(start) for body, start in zip(bodies, views[:-1], strict=True)])
    sigma = np.concatenate([sigma_of(body.merged, body.scans, body.cell.scanner) for body in bodies])
    points = np.concatenate([cloud.points for cloud in clouds])
    normals = np.concatenate([cloud.normals for cloud in clouds])
    return PointCloud(points, normals, scan.astype(np.int32)), stop.astype(np.int32), sigma


def _open(planned: PlannedSetups, seen: Sequence[Bools], samples: SurfaceSamples, scanned: Sequence[int]) -> OpenShares:
    """Why what no scan measures is open; each sample counts once, by the first reason that holds."""
    left = ~np.logical_or.reduce(seen)
    to_come, lost, touched = np.zeros_like(left), np.zeros_like(left), np.ones_like(left)
    for number, folder in enumerate(planned.folders, start=1):
        run = open_finished(folder)
        cell, plan = read_cell(run), run.plan
        touches = touching(samples, cell.occluders)
        would = _seen(cell, [view.T_object_poses for view in plan.views], samples) & ~touches
        touched &= touches
        if number in scanned:
            lost |= would
        else:
            to_come |= would
    shares = []
    for reason in (to_come, lost, touched, left):
        shares.append(float((left & reason).mean()))
        left = left & ~reason
    return OpenShares(to_come=shares[0], lost=shares[1], in_contact=shares[2], not_planned=shares[3])


def _seen(cell: RunCell, T_object_poses: Sequence[Floats], samples: SurfaceSamples) -> Bools:
    if not len(T_object_poses):
        return np.zeros(len(samples), dtype=np.bool_)
    return find_measured(np.stack(T_object_poses), samples, cell.scanner, (cell.part_caster, cell.occluder_caster))


def _doubts(bodies: Sequence[_Body]) -> list[str]:
    told = [f"set-up {body.number}: {sentence}" for body in bodies for sentence in body.doubts]
    return told + [
        f"set-up {body.number}: {sentence}"
        for body in bodies
        if body.merged.fit is not None
        for sentence in body.merged.fit.doubts
    ]


def _held_apart(numbers: Sequence[int]) -> list[str]:
    """A sentence about each set-up that only the reference holds to the others."""
    return [
        f"what set-up {number} measures together with others leaves it free to move against them; the reference alone "
        "holds it in its place"
        for number in numbers
    ]


def _clear(path: Path) -> None:
    """Take away what can be made again."""
    try:
        if path.exists():
            shutil.rmtree(path)
    except OSError as error:
        raise FileError(f"{path} cannot be replaced: {error.strerror or error}; remove it") from error
