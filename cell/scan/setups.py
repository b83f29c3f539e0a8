"""`cell scan SETUPS`: scan one set-up after the other and combine their scans in `scanned/`.

The execution stops where a person has to turn the part. The only record of the sequence are the executions of the
set-ups: they tell which set-up is next, so the sequence continues wherever it was stopped.

Combination: the scans of each set-up are merged in the part's frame as in its own report, with the part localised if it
may be displaced. Then all set-ups are registered together, each as one body, by their common surface and the reference.
The result can be made again from the scans at any time, so the folder is replaced. Object frame, metres.
"""

import shutil
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from cell.errors import FileError, UsageError
from cell.files import file_errors
from cell.formatting import comma_list
from cell.inspect.inspection import inspect_points, qif_of_run, read_plan
from cell.metrology import point_files
from cell.metrology.inspect import REGISTERED, execution_points, points_of_setups
from cell.metrology.reconstruct import reconstruct
from cell.plan.shared_surface import shared_surfaces, unconnected_setups
from cell.report import scan_report
from cell.runs.cell import RunCell, read_cell
from cell.runs.folder import RunFolder
from cell.runs.run import ExecutedScan, Run, open_finished, read_execution
from cell.runs.schema import ScannedSetup, ScannedSetups, UnmeasuredShares
from cell.runs.setups import SetupsRun
from cell.scan.options import ScanOptions
from cell.scan.point_checks import find_contradictions
from cell.scan.results import (
    MergedScans,
    deviation_values,
    executed_poses,
    localisation_values,
    merge_execution,
    options_of,
    point_sigma,
    registration_values,
    source_of,
    surface_values,
    usable_scans,
    write_mesh,
)
from cell.scan.scan import resume, scan
from cell.session import Session
from cell.world.prediction import held_out_samples
from cell.world.support_contact import in_contact
from planner.geometry.closest import ClosestPointQuery
from planner.geometry.sampling import SurfaceSamples
from planner.measurability import coverage
from planner.measurability.visibility import find_measured
from planner.registration.cloud import PointCloud
from planner.registration.localisation import SearchRange
from planner.registration.registration import Registration, placement_sd, register
from planner.values import Bools, Floats

COMBINED = "scanned"
"""Subfolder of a folder of `cell setups` with the combined scans."""

_SAMPLES = 20_000  # matched points of all set-ups


@dataclass(frozen=True, slots=True, eq=False)
class SetupsOutcome:
    """Outcome of `cell scan SETUPS`.

    Attributes:
        folder: of the combined scans.
        exit_code: 0; 3 if all set-ups together do not reach the coverage that the plan requires.
        report: its report.json.
    """

    folder: Path
    exit_code: int
    report: ScannedSetups


def scan_setups(
    session: Session[None], folder: Path, options: ScanOptions | None, *, setup: int | None, resumed: bool
) -> SetupsOutcome:
    """Scan the next set-up, or a given one, and combine all scanned set-ups.

    Simulated parts turn themselves, so all set-ups follow each other; likewise if a person confirms each motion. With
    points of other sources one set-up is scanned.

    Args:
        session: of the command.
        folder: of `cell setups`.
        options: of the executions; for a resumed one as in `cell.scan.scan.resume`. None for a new execution: those of
            the set-up before.
        setup: its number; None for each that is not scanned yet, in order.
        resumed: whether to resume a stopped execution, if there is one.

    Raises:
        UsageError: if there is no such set-up, all are scanned, or an option applies to one run only.
        FileError: if views have no points, or a set-up's folder belongs to another plan.
        CellError: from an execution; its scans are kept.
    """
    planned = SetupsRun.opened(folder)
    folders = planned.folders
    if setup is not None and not 1 <= setup <= len(folders):
        raise UsageError(f"there is no set-up {setup} of {folder}; there are 1 to {len(folders)}")
    if options is not None and options.view is not None:
        raise UsageError(
            "--view applies to one run: give its folder instead of that of all set-ups, such as "
            f"{folders[(setup or 1) - 1]}"
        )
    remaining = [number for number, run in enumerate(folders, start=1) if complete_execution(run) is None]
    if setup is None and not remaining:
        raise UsageError(
            f"all {len(folders)} set-ups of {folder} are scanned; --setup 1 scans one again, --report latest repeats "
            "the report"
        )
    for number in remaining if setup is None else [setup]:
        run, placement = folders[number - 1], _describe_placement(planned, number)
        session.note(placement)
        setup_session = _with_placement(session, placement)
        stopped = _stopped_execution(run) if resumed else None
        if stopped is not None:
            execution_options = _recorded_options(run, stopped, options)
            outcome = resume(setup_session, run, stopped, options)
        else:
            execution_options = _new_options(planned, number, options, resumed=resumed)
            outcome = scan(setup_session, run, execution_options)
        if missing := outcome.report.missing_views:
            raise FileError(
                f"view {missing[0]} of set-up {number} has no points ({len(missing)} such views); "
                f"cell scan {folder} --resume latest scans them"
            )
        if not execution_options.is_simulated or (execution_options.uses_wire and session.confirm is None):
            break
    return combine_setups(session, planned)


def _new_options(planned: SetupsRun, number: int, user_options: ScanOptions | None, *, resumed: bool) -> ScanOptions:
    """Return the options of a new execution: the given ones, or in a resumed sequence those of the set-up before."""
    if not resumed:
        return user_options or ScanOptions()
    for before in range(number - 1, 0, -1):
        name = complete_execution(planned.folders[before - 1])
        if name is not None:
            options = _recorded_options(planned.folders[before - 1], name, user_options)
            if options.acquire.startswith("files:"):
                raise UsageError(
                    f"{options.acquire} has the points of set-up {before}; run cell scan {planned.folder} "
                    f"--setup {number} with --acquire for the points of set-up {number}"
                )
            return options
    return user_options or ScanOptions()


def _recorded_options(folder: Path, execution: str, user_options: ScanOptions | None) -> ScanOptions:
    """Return the options of an execution, as a resume with the given options would use them."""
    manifest = open_finished(folder).execution_manifest(execution)
    return ScanOptions.from_manifest(manifest.options).resumed(user_options or ScanOptions())


def _stopped_execution(folder: Path) -> str | None:
    """Return the latest execution of all views of a run if it did not finish."""
    run = open_finished(folder)
    for name in reversed(run.execution_ids):
        manifest = run.execution_manifest(name)
        if manifest.options.get("view") is None:
            return None if manifest.status == "finished" else name
    return None


def complete_execution(folder: Path) -> str | None:
    """Return the latest finished execution of all views of a set-up's run; None if there is none."""
    run = open_finished(folder)
    for name in reversed(run.execution_ids):
        manifest = run.execution_manifest(name)
        is_complete = manifest.status == "finished" and manifest.options.get("view") is None
        if is_complete and manifest.digest == run.digest:
            return name
    return None


def _with_placement(session: Session[None], placement: str) -> Session[None]:
    """Return a session whose confirmations include the placement of the part."""
    confirm = session.confirm
    if confirm is None:
        return session
    return replace(session, confirm=lambda question: confirm(f"{placement}. {question}"))


def _describe_placement(planned: SetupsRun, number: int) -> str:
    """Describe the placement of the part; raise FileError if the folder has another plan than setups.json names."""
    setup, folder = planned.file.selected[number - 1], planned.folders[number - 1]
    run = open_finished(folder)
    if run.digest != setup.digest:
        raise FileError(
            f"{folder} is not the plan that setups.json names, so the placement of its part is not known; nothing was "
            "moved: plan the set-ups again"
        )
    candidate = planned.file.candidates[setup.candidate]
    xyz, abc = comma_list(candidate.placement_mm), comma_list(candidate.placement_abc_deg)
    table = "" if run.scene.table is None else ", the rotary table at 0"
    return (
        f"set-up {number} of {len(planned.folders)}: the part lies {candidate.name}, its centre at {xyz} mm, "
        f"A, B, C {abc} deg{table}"
    )


@dataclass(frozen=True, slots=True, eq=False)
class _ScannedBody:
    """Merged scans of a set-up, which move as one body.

    Attributes:
        number: of the set-up, from 1.
        execution: its id.
        run: its plan.
        cell: at the planned placement.
        scans: usable scans.
        merged: their cloud.
        doubts: one sentence for each contradiction in the points.
    """

    number: int
    execution: str
    run: Run
    cell: RunCell
    scans: Sequence[ExecutedScan]
    merged: MergedScans
    doubts: Sequence[str]

    def transformed(self, T: Floats) -> "_ScannedBody":
        """Return the body after a rigid motion (4, 4)."""
        merged = replace(
            self.merged,
            cloud=self.merged.cloud.transformed(T),
            poses=tuple(T @ pose for pose in self.merged.poses),
            fit=None if self.merged.fit is None else replace(self.merged.fit, T=T @ self.merged.fit.T),
        )
        return replace(self, merged=merged)

    def measured(self, samples: SurfaceSamples) -> Bools:
        """Return (S,) samples that the executed views measure and no support touches."""
        cell = self.cell if self.merged.fit is None else self.cell.about_part(self.merged.fit.T)
        seen = _measured_by(cell, executed_poses(self.scans, self.merged), samples)
        return seen & ~in_contact(samples, self.cell.occluders)

    def values(self, measured: Bools, before: Bools) -> ScannedSetup:
        """Return its values for the report; `before` (S,) are the samples measured by set-ups before."""
        return ScannedSetup(
            number=self.number,
            execution=self.execution,
            digest=self.run.digest,
            views=len(self.scans),
            points=len(self.merged.cloud),
            visible=float(measured.mean()),
            marginal_coverage=float((measured & ~before).mean()),
            localisation=localisation_values(self.merged, self.scans),
        )


def combine_setups(session: Session[None], planned: SetupsRun) -> SetupsOutcome:
    """Make `scanned/` from the latest complete execution of each scanned set-up.

    Raises:
        FileError: if no set-up is scanned, a file is damaged, too few points lie near the part, or the folder cannot be
            written.
    """
    executions = {number: complete_execution(folder) for number, folder in enumerate(planned.folders, start=1)}
    if not any(executions.values()):
        raise FileError(f"no set-up of {planned.folder} is scanned; start with cell scan {planned.folder} --setup 1")
    with session.stage("merge the set-ups"):
        bodies = [
            _read_body(session, number, planned.folders[number - 1], name)
            for number, name in executions.items()
            if name
        ]
        nearest = ClosestPointQuery(bodies[0].cell.reference)
        bodies, registration = _register_bodies(bodies, nearest)
    target = planned.folder / COMBINED
    for path in (target, target.with_name(COMBINED + ".part")):
        _remove_folder(path)
    folder = RunFolder.create(target, list(session.origin.argv), bodies[0].run.seed, {}, datetime.now(UTC))
    with folder.keep_on_failure():
        report = _write_combined(session, folder, planned, bodies, registration, nearest)
        folder.finish(0)
    for doubt in report.contradictions:
        session.note(doubt)
    is_missed = not report.missing_setups and report.visible < planned.file.coverage.required
    return SetupsOutcome(target, 3 if is_missed else 0, report)


def _read_body(session: Session[None], number: int, folder: Path, name: str) -> _ScannedBody:
    """Read and merge the scans of one set-up."""
    run = open_finished(folder)
    recorded = read_execution(run, name)
    options = options_of(recorded)
    cell = read_cell(run, options.resolution_deg)
    scans, unusable = usable_scans(recorded, run.plan.views)
    for sentence in unusable:
        session.note(f"set-up {number}: {sentence}")
    nearest = ClosestPointQuery(cell.reference)
    # No part is placed to a tenth of a millimetre by hand.
    search = SearchRange() if any(scan.T_true is None for scan in scans) else None
    merged = merge_execution(run, recorded, scans, nearest, search)
    doubts = find_contradictions(scans, cell, nearest, options.points_units)
    return _ScannedBody(number, name, run, cell, scans, merged, doubts)


def _register_bodies(
    bodies: list[_ScannedBody], nearest: ClosestPointQuery
) -> tuple[list[_ScannedBody], Registration | None]:
    """Register all bodies to the reference and to each other if one of them was localised."""
    if len(bodies) < 2 or all(body.merged.fit is None for body in bodies):
        return bodies, None
    registration = register([body.merged.cloud for body in bodies], nearest, samples=_SAMPLES // len(bodies))
    return [
        body.transformed(scan.T_correction) for body, scan in zip(bodies, registration.scans, strict=True)
    ], registration


def _write_combined(
    session: Session[None],
    folder: RunFolder,
    planned: SetupsRun,
    bodies: list[_ScannedBody],
    registration: Registration | None,
    nearest: ClosestPointQuery,
) -> ScannedSetups:
    """Write cloud, surface, deviation and report into the open folder."""
    first, source = bodies[0], source_of([scan for body in bodies for scan in body.scans])
    reference = first.cell.reference
    cloud, numbers, sigma = _combined_cloud(bodies)
    folder.write_bytes("cloud.ply", point_files.cloud_ply(cloud, numbers, sigma, source))
    with session.stage("reconstruct"):
        surface = reconstruct(cloud)
    deviation = None
    with session.stage("measure"):
        if surface.mesh is not None:
            deviation = write_mesh(session, folder, surface.mesh, surface, nearest, first.run.seed, source)
            scan_report.draw_deviation(folder.path / "deviation.png", surface.mesh, deviation, source)
            folder.adopt("deviation.png")
        samples = held_out_samples(reference, first.cell.planning, first.run.seed)
        measured = {body.number: body.measured(samples) for body in bodies}
        pairs = shared_surfaces(measured, samples)
        radius = coverage.sampling_radius(reference)
        report = ScannedSetups(
            part=planned.file.part,
            source=source,
            setups=tuple(_setup_values(bodies, measured)),
            missing_setups=tuple(n for n in range(1, len(planned.folders) + 1) if n not in measured),
            visible=float(np.logical_or.reduce(list(measured.values())).mean()),
            planned=planned.file.coverage.visible,
            sampled=coverage.sampled_coverage(cloud.points, samples, radius).fraction,
            uncovered=_uncovered_by_cause(planned, measured, samples),
            common_surface=pairs,
            registration=None if registration is None else registration_values(registration),
            contradictions=(*_doubts(bodies), *_disconnected(unconnected_setups(pairs, tuple(measured)))),
            surface=surface_values(reference, surface),
            deviation=None if deviation is None else deviation_values(deviation),
        )
    folder.write_json("report.json", report.as_json())
    with session.stage("inspect"):
        section = _inspect(folder, bodies, nearest, is_registered=registration is not None)
    folder.write_text("report.md", "\n".join([scan_report.combined_markdown(report), *section]))
    return report


def _inspect(
    folder: RunFolder, bodies: Sequence[_ScannedBody], nearest: ClosestPointQuery, *, is_registered: bool
) -> list[str]:
    """Inspect the features of the part by the points of all set-ups; return the section of the report."""
    run = bodies[0].run
    if (plan := read_plan(run)) is None:
        return []
    parts, is_exact = [], True
    for body in bodies:
        recorded, merged = read_execution(body.run, body.execution), body.merged
        sigma, views = point_sigma(merged, body.scans, body.cell.scanner), merged.stop.astype(np.int64) - 1
        parts.append(execution_points(body.run, recorded, merged.cloud.points, merged.cloud.normals, sigma, views))
        is_exact &= not options_of(recorded).registers
    placements = [
        placement_sd(body.merged.cloud.points[:: 1 + len(body.merged.cloud) // _SAMPLES], nearest)
        if is_registered
        else (0.0, 0.0)
        for body in bodies
    ]
    words = [
        f"set-up {body.number}: {1000 * along:.4f} mm, {np.degrees(about):.4f} deg"
        for body, (along, about) in zip(bodies, placements, strict=True)
    ]
    is_simulated = all(scan.T_true is not None for body in bodies for scan in body.scans)
    inspection = inspect_points(
        plan,
        nearest.mesh,
        points_of_setups(parts, placements),
        part=run.scene.part.name,
        source=source_of([scan for body in bodies for scan in body.scans]),
        is_simulated=is_simulated,
        on_reference=is_simulated and not any(options_of(read_execution(b.run, b.execution)).actual for b in bodies),
        alignment="set-ups " + ("registered to each other and to the part" if is_registered else "at their placements"),
        notes=(
            *([f"U contains the registration of each set-up, with standard deviations of {'; '.join(words)}"]
              if is_registered else ()),
            *(() if is_exact else (REGISTERED,)),
        ),
    )  # fmt: skip
    inspection.write(lambda name, content: folder.write_bytes(name, [content]), qif_of_run(run))
    return inspection.section()


def _setup_values(bodies: Sequence[_ScannedBody], measured: Mapping[int, Bools]) -> list[ScannedSetup]:
    values, before = [], np.zeros_like(measured[bodies[0].number])
    for body in bodies:
        values.append(body.values(measured[body.number], before))
        before = before | measured[body.number]
    return values


def _combined_cloud(bodies: Sequence[_ScannedBody]) -> tuple[PointCloud, NDArray[np.int32], Floats]:
    """Return all points as one cloud, their view numbers, counted on through the set-ups, and their sigma [m]."""
    clouds = [body.merged.cloud for body in bodies]
    first_scan = np.cumsum([0, *(len(body.scans) for body in bodies)])[:-1]
    first_view = np.cumsum([0, *(len(body.run.plan.views) for body in bodies)])[:-1]
    scan = np.concatenate([cloud.scan + np.int32(start) for cloud, start in zip(clouds, first_scan, strict=True)])
    stop = np.concatenate([body.merged.stop + np.int32(start) for body, start in zip(bodies, first_view, strict=True)])
    sigma = np.concatenate([point_sigma(body.merged, body.scans, body.cell.scanner) for body in bodies])
    points = np.concatenate([cloud.points for cloud in clouds])
    normals = np.concatenate([cloud.normals for cloud in clouds])
    return PointCloud(points, normals, scan.astype(np.int32)), stop.astype(np.int32), sigma


def _uncovered_by_cause(planned: SetupsRun, measured: Mapping[int, Bools], samples: SurfaceSamples) -> UnmeasuredShares:
    """Return the uncovered surface by cause; each sample counts once, for the first cause that applies."""
    uncovered = ~np.logical_or.reduce(list(measured.values()))
    remaining, missed, touched = np.zeros_like(uncovered), np.zeros_like(uncovered), np.ones_like(uncovered)
    for number, folder in enumerate(planned.folders, start=1):
        run = open_finished(folder)
        cell = read_cell(run)
        touches = in_contact(samples, cell.occluders)
        expected = _measured_by(cell, [view.T_object_poses for view in run.plan.views], samples) & ~touches
        touched &= touches
        if number in measured:
            missed |= expected
        else:
            remaining |= expected
    shares = []
    for cause in (remaining, missed, touched, uncovered):
        shares.append(float((uncovered & cause).mean()))
        uncovered = uncovered & ~cause
    return UnmeasuredShares(not_scanned=shares[0], not_measured=shares[1], in_contact=shares[2], not_planned=shares[3])


def _measured_by(cell: RunCell, T_object_poses: Sequence[Floats], samples: SurfaceSamples) -> Bools:
    if not len(T_object_poses):
        return np.zeros(len(samples), dtype=np.bool_)
    return find_measured(np.stack(T_object_poses), samples, cell.scanner, cell.casters)


def _doubts(bodies: Sequence[_ScannedBody]) -> list[str]:
    of_points = [f"set-up {body.number}: {sentence}" for body in bodies for sentence in body.doubts]
    fits = [(body.number, body.merged.fit) for body in bodies if body.merged.fit is not None]
    return of_points + [f"set-up {number}: {sentence}" for number, fit in fits for sentence in fit.doubts]


def _disconnected(numbers: Sequence[int]) -> list[str]:
    """Return a sentence about each set-up that is connected to the others by the reference only."""
    return [
        f"the surface that set-up {number} shares with others does not determine its pose relative to them; only the "
        "reference does"
        for number in numbers
    ]


def _remove_folder(path: Path) -> None:
    with file_errors(f"{path} cannot be replaced", "remove it"):
        if path.exists():
            shutil.rmtree(path)
