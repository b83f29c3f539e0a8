"""`cell replay`: a run folder as a moving arm, in the viewer, as frames or as one picture.

A run with a motion shows the arm on it. A failed run (`.part`) that has only the checked cell shows the arm at home and
the candidate viewpoints, coloured by reachability.
"""

import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from cell.errors import FileError, UsageError
from cell.runs import timeline as replay_timeline
from cell.runs.run import RecordedExecution, Run, open_run, read_execution
from cell.runs.timeline import Timeline
from cell.session import ProgressReporter
from cell.view.cell_picture import tour_camera
from cell.view.pieces import cell_of_run
from cell.view.playback import Playback
from cell.view.replay_model import build_replay_model
from cell.view.replay_options import ReplayOptions
from cell.view.replay_pictures import PictureInputs, require_empty, write_frames, write_picture
from cell.view.tightest_moment import tightest_moment
from cell.view.viewer import Player, play, require_display
from planner.values import Floats


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
        The files that were drawn, in a sentence; "" after the viewer.

    Raises:
        UsageError: if the view or moment does not exist, or the viewer cannot open a window.
        FileError: if the run folder cannot be read.
    """
    is_drawn = options.frames is not None or options.picture is not None
    if options.frames is not None:  # checked before loading, which takes seconds
        require_empty(options.frames)
    if not is_drawn and not options.web:
        require_display()
    with reporter.stage("set up the replay"):
        run = open_run(folder)
        recorded = None if options.execution is None else read_execution(run, options.execution)
        playback = load_playback(run, recorded, reporter)
        cell, part = cell_of_run(run, run.scene), run.mesh("reference.ply")
        inputs = PictureInputs(playback, cell, part, _clouds(recorded))
    start = _tightest(playback) if options.tightest else _start(playback.timeline, options.view)
    results: list[str] = []
    if options.picture is not None:
        with reporter.stage("draw the picture"):
            moment = start if options.view is not None or options.tightest else None
            write_picture(inputs, options.picture, options, moment)
        results.append(f"picture in {options.picture}")
    if options.frames is not None:
        with reporter.stage("draw the frames") as progress:
            count = write_frames(inputs, options.frames, options, start, progress)
        results.append(f"{count} frames in {options.frames}")
    if not is_drawn:
        half = float(np.tan(np.radians(playback.replay_model.model.vis.global_.fovy) / 2))
        poses = [playback.timeline.at(t) for t in (0.0, *(stop.begin for stop in playback.timeline.stops))]
        camera = tour_camera(inputs.cell, inputs.part, poses, playback.path, (4, 3), half)
        tightest = None if playback.tightest is None else playback.tightest.time
        player = Player(playback.timeline, options.rate, start, tightest)
        if options.web:
            from cell.view.loopback import open_browser
            from cell.view.web_replay import play_web

            def show(address: str) -> None:
                reporter.note(f"the replay is at {address} until Ctrl-C")
                open_browser(address)

            play_web(playback, player, camera, show, clock=clock, wait=wait, once=options.once)
        else:
            play(playback, player, camera, clock=clock, wait=wait, once=options.once)
    return "; ".join(results)


def load_playback(run: Run, recorded: RecordedExecution | None, reporter: ProgressReporter) -> Playback:
    """Load the model and the timeline of a run.

    Args:
        run: the opened run.
        recorded: execution to show; None for the plan.
        reporter: reports missing files.

    Raises:
        FileError: if the run has no checked cell, or a file is damaged.
    """
    if not run.has("cell.xml"):
        raise FileError(
            f"{run.folder} has no cell.xml, so there is no cell to show: the run {run.ending}; correct that and plan "
            "again"
        )
    if not run.is_finished:
        reporter.note(f"this run {run.ending}; the replay shows its finished stages")
    scene = run.scene
    if recorded is not None and not recorded.scans:
        reporter.note(f"{recorded.folder} holds no readable scan")
    replay_model = build_replay_model(run, scene, run.mesh("reference.ply"), _clouds(recorded))
    planned = run.motion if run.has("motion.npz") else None
    if recorded is not None:
        timeline = replay_timeline.execution_timeline(recorded, planned, replay_model.home)
    elif planned is not None:
        timeline = replay_timeline.plan_timeline(planned)
    else:
        timeline = replay_timeline.home_timeline(replay_model.home)
    for note in timeline.notes:
        reporter.note(note)
    if timeline.stops or planned is not None or not run.has("viewpoints.npz"):
        tightest = None
        if recorded is None and planned is not None and run.has("plan.json"):
            tightest = tightest_moment(run.plan, timeline)
        return Playback(replay_model, timeline, tightest=tightest)
    candidates = run.candidates
    reachable = run.reach.reachable if run.has("reach.npz") else None
    reporter.note(
        f"the run has no motion: the arm is at home, with {len(candidates)} candidate viewpoints"
        + ("" if reachable is None else f", {int(np.count_nonzero(reachable))} of them reachable (green)")
    )
    return Playback(replay_model, timeline, replay_model.T_base_object @ candidates.T_object_scanner[:, 0], reachable)


def _clouds(recorded: RecordedExecution | None) -> list[Floats]:
    """Return the (P, 3) points of each scan of an execution, object frame [m]; none for a plan."""
    return [] if recorded is None else [scan.points for scan in recorded.scans]


def _start(timeline: Timeline, view: int | None) -> float:
    if view is None:
        return 0.0
    numbers = [stop.number for stop in timeline.stops]
    if view not in numbers:
        number_list = ", ".join(str(number) for number in numbers)
        is_complete = numbers == list(range(1, len(numbers) + 1))
        valid = f"1 to {len(numbers)}, in visiting order" if is_complete else f"{number_list}, as scanned"
        raise UsageError(f"--view {view} is not a view of this run; valid are {valid if numbers else 'none'}")
    return timeline.stops[numbers.index(view)].begin


def _tightest(playback: Playback) -> float:
    if playback.tightest is None:
        raise UsageError(
            "--tightest needs the moment of the smallest distance, which this replay does not have: it is unknown for "
            "an execution, a run of an older version, and a motion far from everything; omit --tightest"
        )
    return playback.tightest.time
