"""Plan and execute scans from Python; the command line uses the same functions.

    from cell.api import open_run, plan, scan

    run = plan("part.stl", units="mm", place=(1200, 500, 0), coverage=0.99)
    run.T_base_scanner, run.q, run.coverage.visible, run.bound, run.folder
    execution = scan(run)
    execution.mesh, execution.deviation
    run = open_run("sim_runs/20261121T030106Z-1f0c2a9b")
    other = run.edited(drop=[4], turn={7: 90}, repair=True)

The option `--max-views 8` of the command line is the keyword `max_views=8` here. Arrays are in metres and radians;
a name that ends in a unit (`_mm`, `_deg`) is in that unit. Nothing is printed: notes are logged under `cell.session`.
Errors are `cell.errors.CellError` with one sentence each. The functions import their modules when they are called, so
that importing this module is fast.
"""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import trimesh

    from cell.explore.exploration import Exploration
    from cell.explore.options import ExploreOptions
    from cell.metrology.hand_eye import HandEyeResult
    from cell.metrology.locate import LocateResult
    from cell.metrology.options import HandEyeOptions, LocateOptions
    from cell.plan.edit import EditableRun
    from cell.plan.setup_options import SetupOptions
    from cell.runs.run import Execution, Run
    from cell.runs.setups import SetupsRun
    from cell.scan.options import ScanOptions
    from cell.scan.setups import SetupsOutcome
    from cell.scene.model import Scene
    from cell.session import Confirm, ProgressReporter, Session

Progress = Callable[[str, int, int], None]
"""Callback `(stage, done, total)`. Each stage starts with (0, 0). An exception that it raises ends the work."""

__all__ = [
    "Progress", "explore", "hand_eye", "locate", "open_run", "plan", "plan_setups", "scan", "scan_setups"
]  # fmt: skip


def plan(
    part: "str | Path | trimesh.Trimesh | Scene | None" = None,
    *,
    scene: "str | Path | None" = None,
    out: "str | Path | None" = None,
    use_cache: bool = True,
    progress: "Progress | ProgressReporter | None" = None,
    argv: Sequence[str] = (),
    **keywords: object,
) -> "EditableRun":
    """Plan the views that measure a part, and write a run folder.

    Args:
        part: mesh or STEP file, name of a built-in part, mesh in memory (with `units`), or a validated scene. None
            takes the part of the scene.
        scene: scene file (TOML). None takes the built-in scene.
        out: run folder to create. None creates one below sim_runs/.
        use_cache: whether to read and write measurability matrices in the user's cache.
        progress: callback or reporter of the progress. None reports nothing.
        argv: command line to record in the manifest.
        **keywords: options of `cell plan` by name, as Python values: `place=(1200, 500, 0)`, `standoff=300`,
            `coverage=0.99`, `max_views=8`, `pin=[3, 17]`.

    Returns:
        The finished plan. `exit_code` is 3 if the required coverage is not reached.

    Raises:
        CellError: with one sentence. The run folder keeps the completed files.
    """
    from cell.plan import pipeline
    from cell.plan.edit import EditableRun

    session = _session(progress, out=out, scene=scene, use_cache=use_cache, argv=argv)
    return EditableRun.opened(pipeline.plan(session, *pipeline.read_request(part, scene, keywords)))


def plan_setups(
    part: "str | Path | trimesh.Trimesh | Scene | None" = None,
    options: "SetupOptions | None" = None,
    *,
    scene: "str | Path | None" = None,
    out: "str | Path | None" = None,
    use_cache: bool = True,
    progress: "Progress | ProgressReporter | None" = None,
    argv: Sequence[str] = (),
    **keywords: object,
) -> "SetupsRun":
    """Plan several set-ups of a part as one cover: fewest set-ups first, then fewest views (docs/setups.md).

    Args:
        part: as for `plan`.
        options: options of the set-ups as one value. None takes them from the keywords.
        scene: scene file (TOML). None takes the built-in scene. Its placement is the first candidate.
        out: folder to create. None creates one below sim_runs/.
        use_cache: as for `plan`.
        progress: callback or reporter of the progress. None reports nothing.
        argv: command line to record in the manifests.
        **keywords: options of `cell setups` by name: `place=(1200, 500, 0)`, `max_setups=2`, `proposals=8`.

    Raises:
        CellError: with one sentence. The folder keeps the completed files.
    """
    from cell.plan.pipeline import read_request
    from cell.plan.setup_options import SetupOptions
    from cell.plan.setups import plan_setups as plan_all
    from cell.plan.setups import scene_after
    from cell.runs.setups import SetupsRun
    from cell.scene.options import option_specs, parse_options

    own = {name: keywords.pop(name) for name in option_specs(SetupOptions) if name in keywords}
    chosen = parse_options(SetupOptions, own) if options is None else options
    if chosen.first is not None and part is None and scene is None:
        part, keywords = scene_after(open_run(chosen.first), keywords), {}
    checked, workpiece = read_request(part, scene, keywords)
    session = _session(progress, out=out, scene=scene, use_cache=use_cache, argv=argv)
    return SetupsRun.opened(plan_all(session, checked, options=chosen, part=workpiece))


def scan(
    run: "Run | str | Path",
    options: "ScanOptions | None" = None,
    *,
    progress: "Progress | ProgressReporter | None" = None,
    argv: Sequence[str] = (),
    ask: "Confirm | None" = None,
    confirm: str | None = None,
    **keywords: object,
) -> "Execution":
    """Execute a plan on a controller: scan at every view, merge the scans, reconstruct and compare the surface.

    Args:
        run: finished plan or its folder.
        options: options as one value. None takes them from the keywords.
        progress: callback or reporter of the progress. None reports nothing.
        argv: command line to record in the manifest.
        ask: callback that asks a person to confirm the motion of a real robot. None without a user.
        confirm: digest of the plan (`run.digest`) whose motion is confirmed. A real robot does not move without it or
            a confirmation by `ask`. `sim://` needs neither.
        **keywords: options of `cell scan` by name: `driver="modbus://192.168.1.10"`, `resolution=0.5`, `seed=7`.

    Returns:
        The execution. `exit_code` is 3 if the coverage that the plan requires is not reached.

    Raises:
        CellError: with one sentence. The execution folder keeps the completed scans.
    """
    from cell.runs.run import Execution
    from cell.scan import scan as execution
    from cell.scan.options import ScanOptions
    from cell.scene.options import parse_options

    if confirm is not None:
        keywords = {**keywords, "confirm_motion": confirm}
    chosen = parse_options(ScanOptions, keywords) if options is None else options
    outcome = execution.scan(_session(progress, argv=argv, confirm=ask), _folder(run), chosen)
    return Execution.open(outcome.folder)


def scan_setups(
    folder: "SetupsRun | str | Path",
    options: "ScanOptions | None" = None,
    *,
    setup: int | None = None,
    resume: bool = False,
    progress: "Progress | ProgressReporter | None" = None,
    argv: Sequence[str] = (),
    ask: "Confirm | None" = None,
    confirm: str | None = None,
    **keywords: object,
) -> "SetupsOutcome":
    """Scan the set-ups of a folder, register them to each other and reconstruct one model.

    Args:
        folder: result of `plan_setups` or its folder.
        options: as for `scan`.
        setup: number of the set-up to scan. None scans the remaining set-ups in order, and stops after one if the
            points are not simulated.
        resume: whether to continue an interrupted execution.
        progress: as for `scan`.
        argv: command line to record in the manifests.
        ask: as for `scan`.
        confirm: as for `scan`: the digest of the set-up's plan.
        **keywords: options of `cell scan` by name: `setup_error="5mm,2deg"`, `range_noise=0.03`.

    Returns:
        `report` (scanned/report.json), `folder`, `exit_code`.

    Raises:
        CellError: with one sentence. The folder keeps the completed scans.
    """
    from cell.scan.options import ScanOptions
    from cell.scan.setups import scan_setups as scan_all
    from cell.scene.options import parse_options

    if confirm is not None:
        keywords = {**keywords, "confirm_motion": confirm}
    chosen = parse_options(ScanOptions, keywords) if options is None else options
    where = Path(folder) if isinstance(folder, str | Path) else folder.folder
    return scan_all(_session(progress, argv=argv, confirm=ask), where, chosen, setup=setup, resumed=resume)


def explore(
    part: "str | Path | Scene | None" = None,
    options: "ExploreOptions | None" = None,
    *,
    scanning: "ScanOptions | None" = None,
    scene: "str | Path | None" = None,
    out: "str | Path | None" = None,
    progress: "Progress | ProgressReporter | None" = None,
    argv: Sequence[str] = (),
    ask: "Confirm | None" = None,
    **keywords: object,
) -> "Exploration":
    """Measure a part without a model, one batch of views at a time (docs/explore.md).

    Args:
        part: part in the cell: mesh file, name of a built-in part, or a validated scene. In simulation its mesh is
            only scanned, not planned on. With a real scanner its mesh is not read. None takes the part of the scene.
        options: options of the exploration as one value. None takes them from the keywords.
        scanning: options of the executions as one value. None takes them from the keywords.
        scene: scene file (TOML). None takes the built-in scene.
        out: folder to create, or folder of an interrupted exploration with the same options to continue. None creates
            one below sim_runs/.
        progress: callback or reporter of the progress. None reports nothing.
        argv: command line to record in the manifests.
        ask: callback that asks a person to confirm the motion of a real robot. None without a user.
        **keywords: options of `cell explore` by name: `place=(1200, 500, 0)`, `policy="two-stage"`, `max_views=12`.

    Raises:
        CellError: with one sentence. The folder keeps the completed stages.
    """
    from datetime import UTC, datetime

    from cell.explore.exploration import Exploration
    from cell.explore.explore import explore as run
    from cell.explore.options import SCAN_OPTIONS, ExploreOptions
    from cell.plan.pipeline import read_request
    from cell.scan.options import ScanOptions
    from cell.scene.options import option_specs, parse_options

    own, of_scan = (
        {name: keywords.pop(name) for name in names if name in keywords}
        for names in (option_specs(ExploreOptions), SCAN_OPTIONS)
    )
    checked, _ = read_request(part, scene, keywords)
    chosen = parse_options(ExploreOptions, own) if options is None else options
    scans = parse_options(ScanOptions, of_scan) if scanning is None else scanning
    folder = Path("sim_runs") / f"explore-{datetime.now(UTC):%Y%m%dT%H%M%SZ}" if out is None else Path(out)
    file = run(_session(progress, out=folder, argv=argv, confirm=ask), checked, chosen, scans)
    return Exploration(folder, file)


def locate(
    run: "Run | str | Path",
    options: "LocateOptions | None" = None,
    *,
    progress: "Progress | ProgressReporter | None" = None,
    **keywords: object,
) -> "LocateResult":
    """Measure the true placement of a planned part; `run.edited(T_base_object=result.T_base_object)` replans for it.

    Args:
        run: finished plan or its folder. It is not changed.
        options: options as one value. None takes them from the keywords.
        progress: callback or reporter of the progress. None reports nothing.
        **keywords: options of `cell locate` by name: `points="scan.ply"`, `points_frame="scanner"`,
            `points_units="mm"`.

    Returns:
        The placement with its precision, its undetermined directions, and whether the motion keeps its clearance.

    Raises:
        CellError: with one sentence.
    """
    from cell.metrology.locate import locate as locate_part
    from cell.metrology.options import LocateOptions
    from cell.runs.run import open_finished
    from cell.scene.options import parse_options

    planned = open_finished(Path(run)) if isinstance(run, str | Path) else run
    return locate_part(
        planned, parse_options(LocateOptions, keywords) if options is None else options, _reporter(progress)
    )


def hand_eye(
    files: "Sequence[str | Path]",
    options: "HandEyeOptions | None" = None,
    *,
    progress: "Progress | ProgressReporter | None" = None,
    **keywords: object,
) -> "HandEyeResult":
    """Calibrate the pose of the scanner on the flange from scans of a sphere or a plane at several flange poses.

    Args:
        files: scans in the scanner frame.
        options: options as one value. None takes them from the keywords.
        progress: callback or reporter of the progress. None reports nothing.
        **keywords: options of `cell calibrate hand-eye` by name: `points_units="mm"`, `diameter=38.1`.

    Raises:
        CellError: with one sentence.
    """
    from cell.metrology.hand_eye import calibrate_hand_eye
    from cell.metrology.options import HandEyeOptions
    from cell.scene.options import parse_options

    return calibrate_hand_eye(
        [Path(file) for file in files],
        parse_options(HandEyeOptions, keywords) if options is None else options,
        _reporter(progress),
    )


def open_run(folder: "str | Path") -> "EditableRun":
    """Open the run folder of a finished plan.

    Raises:
        FileError: if the folder is missing, damaged, not a run folder, or its plan did not finish.
    """
    from cell.plan.edit import EditableRun

    return EditableRun.opened(Path(folder))


def _folder(run: "Run | str | Path") -> Path:
    return Path(run) if isinstance(run, str | Path) else run.folder


def _reporter(progress: "Progress | ProgressReporter | None") -> "ProgressReporter":
    from cell.session import LoggedProgress, ProgressReporter

    return progress if isinstance(progress, ProgressReporter) else LoggedProgress(progress)


def _session(
    progress: "Progress | ProgressReporter | None",
    *,
    out: "str | Path | None" = None,
    scene: "str | Path | None" = None,
    use_cache: bool = True,
    argv: Sequence[str] = (),
    confirm: "Confirm | None" = None,
) -> "Session[None]":
    from cell.session import Origin, Session

    return Session(
        None,
        reporter=_reporter(progress),
        out=None if out is None else Path(out),
        confirm=confirm,
        use_cache=use_cache,
        origin=Origin(tuple(argv), None if scene is None else Path(scene)),
    )
