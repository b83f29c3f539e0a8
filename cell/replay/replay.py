"""`cell replay`: a run folder as a moving arm, in the viewer, as frames or as one picture.

Any run is shown as far as it got: with a motion, the arm follows it; a failed run (`.part`) that has only the checked
cell shows the arm at home and the candidate viewpoints, coloured by what was found out about them.
"""

import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from cell.errors import FileError, UsageError
from cell.replay.model import dress
from cell.replay.options import ReplayOptions
from cell.replay.show import Show
from cell.replay.still import Still, require_empty, write_frames, write_picture
from cell.replay.tightest_moment import of_plan
from cell.runs import timeline as replay_timeline
from cell.runs.run import Run, open_run, read_execution
from cell.runs.timeline import Timeline
from cell.session import ProgressReporter
from cell.view.cell_picture import tour_camera
from cell.view.pieces import cell_of_run


def replay(
    folder: Path,
    options: ReplayOptions,
    reporter: ProgressReporter,
    *,
    clock: Callable[[], float] = time.monotonic,
    wait: Callable[[float], None] = time.sleep,
) -> str:
    """Show a run.

    Returns:
        One sentence about what was made; "" after the viewer.

    Raises:
        UsageError: if there is no such view or moment, or nothing can be drawn on.
        FileError: if the run folder cannot be read.
    """
    drawing = options.frames is not None or options.picture is not None
    if options.frames is not None:  # asked before the work, which takes seconds
        require_empty(options.frames)
    if not drawing:
        from cell.replay.viewer import play, require_display

        require_display()
    with reporter.stage("set up the replay"):
        run = open_run(folder)
        show = load_show(run, options.execution, reporter)
        still = _still(run, show, options.execution)
    start = _tightest(show) if options.tightest else _start(show.timeline, options.view)
    made, chosen = [], options.view is not None or options.tightest
    if options.picture is not None:
        with reporter.stage("draw the picture"):
            moment = start if chosen else None
            write_picture(still, options.picture, options.size, moment, options.camera_deg, options.hide)
        made.append(f"picture in {options.picture}")
    if options.frames is not None:
        with reporter.stage("draw the frames") as progress:
            count = write_frames(
                still, options.frames, options.size, start=start, fps=options.fps, speed=options.speed,
                progress=progress,
            )  # fmt: skip
        made.append(f"{count} frames in {options.frames}")
    if not drawing:
        half = float(np.tan(np.radians(show.theatre.model.vis.global_.fovy) / 2))
        poses = [show.timeline.at(t) for t in (0.0, *(stop.begin for stop in show.timeline.stops))]
        camera = tour_camera(still.cell, still.part, poses, show.path, (4, 3), half)
        play(show, camera, clock=clock, wait=wait, speed=options.speed, start=start, once=options.once)
    return "; ".join(made)


def load_show(run: Run, execution: str | None, reporter: ProgressReporter) -> Show:
    """What there is to show of a run.

    Args:
        run: the opened run.
        execution: id of an execution, or "latest"; None for the plan.
        reporter: is told what is missing.

    Raises:
        FileError: if the run has no checked cell, or something in it is damaged.
    """
    if not run.has("cell.xml"):
        raise FileError(
            f"{run.folder} has no cell.xml, so there is no cell to show: the run {run.ending}; mend that and plan again"
        )
    if not run.is_finished:
        reporter.note(f"this run {run.ending}; it is shown as far as it got")
    scene = run.scene
    recorded = read_execution(run, execution) if execution is not None else None
    if recorded is not None and not recorded.scans:
        reporter.note(f"{recorded.folder} holds no scan that can be read")
    clouds = [scan.points for scan in recorded.scans] if recorded is not None else []
    theatre = dress(run, scene, run.mesh("reference.ply"), clouds)
    planned = run.motion if run.has("motion.npz") else None
    if recorded is not None:
        timeline = replay_timeline.execution_timeline(recorded, planned, theatre.home)
    elif planned is not None:
        timeline = replay_timeline.plan_timeline(planned)
    else:
        timeline = replay_timeline.home_timeline(theatre.home)
    for note in timeline.notes:
        reporter.note(note)
    if timeline.stops or planned is not None or not run.has("viewpoints.npz"):
        closest = None
        if recorded is None and planned is not None and run.has("plan.json"):
            closest = of_plan(run.plan, timeline)
        return Show(theatre, timeline, closest=closest)
    candidates = run.candidates
    reachable = run.reach.reachable if run.has("reach.npz") else None
    reporter.note(
        f"it has no motion: the arm stands at home beside {len(candidates)} candidate viewpoints"
        + ("" if reachable is None else f", {int(np.count_nonzero(reachable))} of them reachable (green)")
    )
    return Show(theatre, timeline, theatre.T_base_object @ candidates.T_object_scanner[:, 0], reachable)


def _still(run: Run, show: Show, execution: str | None) -> Still:
    """What a still is drawn of."""
    scans = () if execution is None else read_execution(run, execution).scans
    cell, part = cell_of_run(run, run.scene), run.mesh("reference.ply")
    return Still(show, cell, part, [scan.points for scan in scans])


def _start(timeline: Timeline, view: int | None) -> float:
    if view is None:
        return 0.0
    numbers = [stop.number for stop in timeline.stops]
    if view not in numbers:
        listed = ", ".join(str(number) for number in numbers)
        in_a_row = numbers == list(range(1, len(numbers) + 1))
        valid = f"1 to {len(numbers)}, in visiting order" if in_a_row else f"{listed}, as scanned"
        if not numbers:
            valid = "none, it has no views to show"
        raise UsageError(f"--view {view} is no view of this run; valid are {valid}")
    return timeline.stops[numbers.index(view)].begin


def _tightest(show: Show) -> float:
    if show.closest is None:
        raise UsageError(
            "--tightest asks for the tightest moment, and this replay knows none: an execution, a run of an older "
            "version, or a motion that is far from everything; leave it out"
        )
    return show.closest.time
