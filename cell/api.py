"""Plan and execute scans from Python: arguments in mm and deg, arrays and meshes in metres and radians.

    from cell.api import edit, open_run, plan, scan

    run = plan("part.stl", units="mm", place=(1200, 500, 0), coverage=0.99)
    run.views, run.T_base_scanner, run.q, run.coverage.visible, run.bound, run.folder
    execution = scan(run)
    execution.mesh, execution.deviation
    run = open_run("sim_runs/20261121T030106Z-1f0c2a9b")
    other = edit(run, drop=[4], turn={7: 90}, repair=True)

A command is the function of the same name: `cell study placement` is `study_placement`. The option `--max-views 8` is
the keyword `max_views=8`; its type is in `cell.keywords`. A result whose name ends in a unit (`_mm`, `_deg`) is in that
unit. Nothing is printed: notes are logged under `cell.session`. Errors are `cell.errors.CellError` with one sentence
each. The functions import their modules when they are called, so that importing this module is fast.

Arguments of several functions:

- `run`: result or its folder.
- `options`: options as one value, with their names in `cell.*.options`. None takes them from the keywords.
- `scene`: scene file (TOML). None takes the built-in scene.
- `out`: folder or file to create. None creates a folder below sim_runs/.
- `use_cache`: whether to read and write planning meshes and measurability matrices in the user's cache.
- `progress`: callback or reporter of the progress. None reports nothing.
- `argv`: command line to record in the manifest.
- `ask`: callback that asks a person to confirm the motion of a real robot. None if nobody is present: then a real robot
  moves only with `confirm_motion=run.digest`. `sim://` needs neither.

Every function raises `cell.errors.CellError`. A folder that is not complete keeps the results of the finished stages.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Literal, TypeVar, Unpack

from cell.keywords import (
    EditKeywords,
    ExploreKeywords,
    ExportKeywords,
    FeaturesKeywords,
    HandEyeKeywords,
    InspectKeywords,
    LocateKeywords,
    PlaceKeywords,
    PlanKeywords,
    ReplayKeywords,
    ScanKeywords,
    SetupsKeywords,
    StudyKeywords,
)

if TYPE_CHECKING:
    import trimesh
    from pydantic import BaseModel

    from cell.explore.exploration import Exploration
    from cell.explore.options import ExploreOptions
    from cell.export.export import ExportOutcome
    from cell.export.options import ExportOptions
    from cell.inspect.features import InspectionPlan
    from cell.inspect.results import InspectionResult
    from cell.metrology.hand_eye import HandEyeResult
    from cell.metrology.locate import LocateResult
    from cell.metrology.options import HandEyeOptions, InspectOptions, LocateOptions
    from cell.part.workpiece import Workpiece
    from cell.plan.edit_options import Edit
    from cell.plan.setup_options import SetupOptions
    from cell.report.diff import Difference
    from cell.runs.run import ArtefactFolder, Execution, Run
    from cell.runs.setups import SetupsRun
    from cell.scan.options import ScanOptions
    from cell.scan.setups import SetupsOutcome
    from cell.scene.model import Scene
    from cell.session import Confirm, ProgressReporter, Session
    from cell.study.options import StudyRun
    from cell.study.scanner_study import Setting
    from cell.study.study import SceneWith, Study, StudyResult
    from cell.view.replay_options import ReplayOptions
    from cell.why.advise import Advice
    from cell.why.explain import WhyOutcome
    from cell.world.checks import CheckResult
    from planner.values import Floats

    Options = TypeVar("Options", bound=BaseModel)

Progress = Callable[[str, int, int], None]
"""Callback `(stage, done, total)`. Each stage starts with (0, 0). An exception that it raises ends the work."""

__all__ = [
    "Progress", "advise", "calibrate_hand_eye", "check", "diff", "edit", "explore", "export", "features", "init",
    "inspect", "locate", "open_run", "part", "place", "plan", "points", "replay", "scan", "scan_setups", "setups",
    "study_placement", "study_scanner", "study_standoff", "view", "why",
]  # fmt: skip


def plan(
    part: "str | Path | trimesh.Trimesh | Scene | None" = None,
    *,
    scene: str | Path | None = None,
    out: str | Path | None = None,
    use_cache: bool = True,
    progress: "Progress | ProgressReporter | None" = None,
    argv: Sequence[str] = (),
    **keywords: Unpack[PlanKeywords],
) -> "Run":
    """Plan the views that measure a part, and write a run folder.

    Args:
        part: mesh or STEP file, name of a built-in part, mesh in memory (with `units`), or a validated scene. None
            takes the part of the scene.
        scene: see the module; likewise the other arguments.
        out: run folder.
        use_cache: see the module.
        progress: see the module.
        argv: see the module.
        **keywords: options of `cell plan`.

    Returns:
        The finished plan. `exit_code` is 3 if the required coverage is not reached.
    """
    from cell.plan import pipeline

    session = _session(progress, out=out, scene=scene, use_cache=use_cache, argv=argv)
    return open_run(pipeline.plan(session, *pipeline.read_request(part, scene, keywords)))


def setups(
    part: "str | Path | trimesh.Trimesh | Scene | None" = None,
    options: "SetupOptions | None" = None,
    *,
    scene: str | Path | None = None,
    out: str | Path | None = None,
    use_cache: bool = True,
    progress: "Progress | ProgressReporter | None" = None,
    argv: Sequence[str] = (),
    **keywords: Unpack[SetupsKeywords],
) -> "SetupsRun":
    """Plan several set-ups of a part as one cover: fewest set-ups first, then fewest views (docs/setups.md).

    The placement of the scene is the first candidate. Arguments as for `plan`; keywords are options of `cell setups`.
    """
    from cell.plan.pipeline import read_request
    from cell.plan.setup_options import SetupOptions
    from cell.plan.setups import plan_setups, scene_after
    from cell.runs.setups import SetupsRun
    from cell.scene.options import option_specs

    setup_options, scene_options = _split(keywords, SetupsKeywords, option_specs(SetupOptions))
    options = _options(SetupOptions, options, setup_options)
    if options.first is not None and part is None and scene is None:
        part, scene_options = scene_after(open_run(options.first), scene_options), {}
    checked, workpiece = read_request(part, scene, scene_options)
    session = _session(progress, out=out, scene=scene, use_cache=use_cache, argv=argv)
    return SetupsRun.opened(plan_setups(session, checked, options=options, part=workpiece))


def edit(
    run: "Run | str | Path",
    options: "Edit | None" = None,
    *,
    T_base_object: "Floats | None" = None,
    out: str | Path | None = None,
    use_cache: bool = True,
    progress: "Progress | ProgressReporter | None" = None,
    argv: Sequence[str] = (),
    **keywords: Unpack[EditKeywords],
) -> "Run":
    """Plan a new run with views dropped, moved, turned, added or reordered, and check it completely.

    Args:
        run: finished plan. It is not changed.
        options: see the module; likewise the other arguments.
        T_base_object: (4, 4) measured placement of the part [m], as found by `locate`. None keeps the planned
            placement. The views move with the part, and `repair` omits views that are out of reach.
        out: run folder.
        use_cache: see the module.
        progress: see the module.
        argv: see the module.
        **keywords: options of `cell edit`: `drop=[4]`, `turn={7: 90}`, `move={7: (x, y, z, a, b, c)}`.
    """
    from cell.plan.edit import edit
    from cell.plan.edit_options import Edit

    session = _session(progress, out=out, use_cache=use_cache, argv=argv)
    return open_run(edit(session, _opened(run), _options(Edit, options, keywords), T_base_object=T_base_object))


def why(
    run: "Run | str | Path", *, samples: int | None = None, progress: "Progress | ProgressReporter | None" = None
) -> "WhyOutcome":
    """Explain the uncovered surface by cause and area (docs/why.md), and write the files to why/ in the run folder.

    Args:
        run: finished plan.
        samples: number of surface samples. None takes 100,000, as in coverage.
        progress: see the module.
    """
    from cell.why.explain import explain

    return explain(_folder(run), _reporter(progress), samples=samples)


def advise(
    run: "Run | str | Path", *, progress: "Progress | ProgressReporter | None" = None
) -> tuple[float, "list[Advice]"]:
    """Return the coverage of a plan, and second set-ups and other placements with theirs (`cell why --advise`)."""
    from cell.why.advise import advise

    return advise(_opened(run), _reporter(progress))


def diff(
    a: "ArtefactFolder | str | Path",
    b: "ArtefactFolder | str | Path",
    *,
    out: str | Path | None = None,
    progress: "Progress | ProgressReporter | None" = None,
) -> "Difference":
    """Compare two plans or two executions; `out` is a page (HTML) of gained and lost surface to write."""
    from cell.report.diff import compare_runs

    return compare_runs(_folder(a), _folder(b), _reporter(progress), None if out is None else Path(out))


def check(
    part: "str | Path | Scene | None" = None, *, scene: str | Path | None = None, **keywords: Unpack[PlanKeywords]
) -> "CheckResult":
    """Check the cell that `plan` would use: `problems`, `warnings`, contacts at home; arguments as for `plan`."""
    from cell.plan.pipeline import read_request
    from cell.world.checks import check_scene

    return check_scene(read_request(part, scene, keywords)[0])


def init(file: str | Path, part: str | Path | None = None, units: str | None = None) -> Path:
    """Write a scene file with every key, its unit, its default and its purpose; return its path.

    Args:
        file: the new scene file.
        part: mesh file or name of a built-in part. None takes that of the built-in scene.
        units: of the mesh file; None for a format that states it.
    """
    from cell.scene.template import write_scene

    write_scene(Path(file), None if part is None else str(part), units)
    return Path(file)


def part(source: str | Path, units: str | None = None) -> "Workpiece":
    """Load and check a part: `reference` [m], `cad` with the numbered faces of a STEP file, `findings`."""
    from cell.part.workpiece import load

    return load(source, units)


def view(
    source: "ArtefactFolder | Exploration | StudyResult | str | Path | None" = None,
    *,
    out: str | Path | None = None,
    progress: "Progress | ProgressReporter | None" = None,
) -> Path:
    """Return the page (HTML) of a scene file, plan, execution, exploration or study; make it if there is none.

    Args:
        source: result, its folder, or a scene file. None takes the built-in scene.
        out: file to write. None takes the page in the folder, or a temporary file.
        progress: see the module.
    """
    from cell.view.view_command import make_page

    folder = None if source is None else _folder(source)
    return make_page(folder, None if out is None else Path(out), _reporter(progress))


def replay(
    run: "Run | str | Path",
    options: "ReplayOptions | None" = None,
    *,
    progress: "Progress | ProgressReporter | None" = None,
    **keywords: Unpack[ReplayKeywords],
) -> str:
    """Show a run in a window, or draw `picture="tour.png"` or the `frames` of a film.

    Keywords are options of `cell replay`. Returns the drawn files in a sentence; "" after the window.
    """
    from cell.view.replay import replay
    from cell.view.replay_options import ReplayOptions

    return replay(_folder(run), _options(ReplayOptions, options, keywords), _reporter(progress))


def export(
    run: "Run | SetupsRun | str | Path",
    options: "ExportOptions | None" = None,
    *,
    progress: "Progress | ProgressReporter | None" = None,
    **keywords: Unpack[ExportKeywords],
) -> "ExportOutcome":
    """Write the motion of a plan, or of every set-up, as a robot program or a table (docs/export.md).

    Keywords are options of `cell export`. Returns the written `files`, and facts of the program.
    """
    from cell.export import export as exporting
    from cell.export.options import ExportOptions

    folder, options = _folder(run), _options(ExportOptions, options, keywords)
    write = exporting.export_setups if (folder / "setups.json").is_file() else exporting.export
    return write(folder, options, _reporter(progress))


def points(run: "Run | str | Path", out: str | Path, execution: str = "latest") -> int:
    """Write the points or the surface of an execution to a file; its suffix is the format (docs/execution.md).

    Returns:
        The number of points, or of vertices of the surface.
    """
    from cell.export.points import write_points

    return write_points(_folder(run), Path(out), execution)


def scan(
    run: "Run | str | Path",
    options: "ScanOptions | None" = None,
    *,
    resume: str | None = None,
    report: str | None = None,
    progress: "Progress | ProgressReporter | None" = None,
    argv: Sequence[str] = (),
    ask: "Confirm | None" = None,
    **keywords: Unpack[ScanKeywords],
) -> "Execution":
    """Execute a plan on a controller: scan at every view, merge the scans, reconstruct and compare the surface.

    Args:
        run: finished plan.
        options: see the module; likewise the other arguments.
        resume: execution to resume, by its id or "latest". None begins a new one.
        report: execution whose report is written again from its scans. None scans.
        progress: see the module.
        argv: see the module.
        ask: see the module.
        **keywords: options of `cell scan`: `driver="modbus://192.168.1.10"`, `resolution=0.5`, `seed=7`.

    Returns:
        The execution. `exit_code` is 3 if the coverage that the plan requires is not reached.
    """
    from cell.runs.run import Execution
    from cell.scan import results
    from cell.scan import scan as execution
    from cell.scan.options import ScanOptions

    options, folder = _options(ScanOptions, options, keywords), _folder(run)
    options.require_compatible(resume, report)
    session = _session(progress, argv=argv, confirm=ask)
    if report is not None:
        outcome = results.make_report(session, folder, report)
    elif resume is not None:
        outcome = execution.resume(session, folder, resume, options)
    else:
        outcome = execution.scan(session, folder, options)
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
    **keywords: Unpack[ScanKeywords],
) -> "SetupsOutcome":
    """Scan the set-ups of a folder, register them to each other and reconstruct one model.

    Args:
        folder: result of `setups` or its folder.
        options: see the module; likewise the other arguments.
        setup: number of the set-up to scan. None scans the remaining set-ups in order, and stops after one if the
            points are not simulated.
        resume: whether to continue an interrupted execution.
        progress: see the module.
        argv: see the module.
        ask: see the module.
        **keywords: options of `cell scan`: `setup_error="5mm,2deg"`, `range_noise=0.03`.

    Returns:
        `report` (scanned/report.json), `folder`, `exit_code`.
    """
    from cell.scan.options import ScanOptions
    from cell.scan.setups import scan_setups

    options = _options(ScanOptions, options, keywords)
    session = _session(progress, argv=argv, confirm=ask)
    return scan_setups(session, _folder(folder), options, setup=setup, resumed=resume)


def explore(
    part: "str | Path | Scene | None" = None,
    options: "ExploreOptions | None" = None,
    *,
    scanning: "ScanOptions | None" = None,
    scene: str | Path | None = None,
    out: str | Path | None = None,
    progress: "Progress | ProgressReporter | None" = None,
    argv: Sequence[str] = (),
    ask: "Confirm | None" = None,
    **keywords: Unpack[ExploreKeywords],
) -> "Exploration":
    """Measure a part without a model, one batch of views at a time (docs/explore.md).

    Args:
        part: part in the cell: mesh file, name of a built-in part, or a validated scene. In simulation its mesh is
            only scanned, not planned on. With a real scanner its mesh is not read. None takes the part of the scene.
        options: see the module; likewise the other arguments.
        scanning: options of the executions as one value. None takes them from the keywords.
        scene: see the module.
        out: folder, or that of an interrupted exploration with the same options to continue.
        progress: see the module.
        argv: see the module.
        ask: see the module.
        **keywords: options of `cell explore`: `place=(1200, 500, 0)`, `policy="two-stage"`, `max_views=12`.
    """
    from datetime import UTC, datetime

    from cell.explore.exploration import Exploration
    from cell.explore.explore import explore
    from cell.explore.options import SCAN_OPTIONS, ExploreOptions
    from cell.plan.pipeline import read_request
    from cell.scan.options import ScanOptions
    from cell.scene.options import option_specs

    explore_options, scan_options, scene_options = _split(
        keywords, ExploreKeywords, option_specs(ExploreOptions), SCAN_OPTIONS
    )
    checked, _ = read_request(part, scene, scene_options)
    options = _options(ExploreOptions, options, explore_options)
    scanning = _options(ScanOptions, scanning, scan_options)
    folder = Path("sim_runs") / f"explore-{datetime.now(UTC):%Y%m%dT%H%M%SZ}" if out is None else Path(out)
    file = explore(_session(progress, out=folder, argv=argv, confirm=ask), checked, options, scanning)
    return Exploration(folder, file)


def locate(
    run: "Run | str | Path",
    options: "LocateOptions | None" = None,
    *,
    progress: "Progress | ProgressReporter | None" = None,
    **keywords: Unpack[LocateKeywords],
) -> "LocateResult":
    """Measure the true placement of a planned part; `edit(run, T_base_object=result.T_base_object)` replans for it.

    Keywords are options of `cell locate`: `points="scan.ply"`, `points_frame="scanner"`, `points_units="mm"`.

    Returns:
        The placement with its precision, its undetermined directions, and whether the motion keeps its clearance.
    """
    from cell.metrology.locate import locate
    from cell.metrology.options import LocateOptions

    return locate(_opened(run), _options(LocateOptions, options, keywords), _reporter(progress))


def features(
    part: "str | Path | Scene | None" = None, *, scene: str | Path | None = None, **keywords: Unpack[FeaturesKeywords]
) -> "InspectionPlan":
    """Return the features and characteristics of a part: `features`, `characteristics`, `unsupported`, `notes`.

    They come from the `[[feature]]` tables of the scene and from `qif="part.qif"`. Arguments as for `plan`.
    """
    from cell.errors import UsageError
    from cell.inspect.inspection import plan_inspection
    from cell.part.workpiece import load
    from cell.plan.pipeline import read_request

    checked, _ = read_request(part, scene, keywords)
    inspection_plan = plan_inspection(checked, load(checked.part.source, checked.part.units))
    if inspection_plan is None:
        raise UsageError("the scene has no [[feature]]; add features, or give a QIF file (docs/inspection.md)")
    return inspection_plan


def inspect(
    source: "Execution | str | Path",
    part: "str | Path | Scene | None" = None,
    options: "InspectOptions | None" = None,
    *,
    scene: str | Path | None = None,
    out: str | Path | None = None,
    progress: "Progress | ProgressReporter | None" = None,
    **keywords: Unpack[InspectKeywords],
) -> "InspectionResult":
    """Compare measured points, a mesh or an execution with the tolerances of a part (docs/inspection.md).

    Args:
        source: file of points or a mesh, or an execution.
        part: as for `plan`. None with an execution takes the features of its run.
        options: see the module; likewise the other arguments.
        scene: scene file with features.
        out: folder of the results.
        progress: see the module.
        **keywords: options of `cell inspect`: `qif="part.qif"`, `points_units="mm"`.

    Returns:
        `characteristics` with values, uncertainties and verdicts; `features`; `to_dataframe()`.
    """
    from cell.metrology.inspect import inspect
    from cell.metrology.options import InspectOptions
    from cell.plan.pipeline import read_request
    from cell.scene.options import option_specs

    inspect_options, scene_options = _split(keywords, InspectKeywords, option_specs(InspectOptions))
    has_request = part is not None or scene is not None or scene_options
    checked = read_request(part, scene, scene_options)[0] if has_request else None
    options, folder = _options(InspectOptions, options, inspect_options), None if out is None else Path(out)
    return inspect(_folder(source), checked, options, _reporter(progress), folder)[1].result


def calibrate_hand_eye(
    files: Sequence[str | Path],
    options: "HandEyeOptions | None" = None,
    *,
    progress: "Progress | ProgressReporter | None" = None,
    **keywords: Unpack[HandEyeKeywords],
) -> "HandEyeResult":
    """Calibrate the pose of the scanner on the flange from scans of a sphere or a plane at several flange poses.

    Args:
        files: scans in the scanner frame.
        options: see the module.
        progress: see the module.
        **keywords: options of `cell calibrate hand-eye`: `points_units="mm"`, `diameter=38.1`.
    """
    from cell.metrology.hand_eye import calibrate_hand_eye
    from cell.metrology.options import HandEyeOptions

    options = _options(HandEyeOptions, options, keywords)
    return calibrate_hand_eye([Path(file) for file in files], options, _reporter(progress))


def place(
    part: str | Path | None = None, *, progress: Progress | None = None, **keywords: Unpack[PlaceKeywords]
) -> "StudyResult":
    """Search the best placement of a part (docs/studies.md); `rows` has the best ones, `commands` their plans.

    Keywords are options of `cell place`: ranges such as `x=(900, 1500)`, `z=0`, and `processes=4`.
    """
    from cell.scene.options import option_specs, parse_options
    from cell.study.options import PlaceRange
    from cell.study.place_search import place_study
    from cell.study.study import plan_command, scene_maker, study_folder
    from cell.study.trials import open_workers

    where, run_options = _split(keywords, PlaceKeywords, option_specs(PlaceRange))
    run, scene, scene_options = _study_options(run_options)
    checked, folder = scene_maker(part, scene, scene_options)({}), study_folder("place", run.out)
    with open_workers(run.count, run.cluster, run.cluster_security) as workers:
        words, quiet = plan_command(part, scene, scene_options), lambda *_: None
        return place_study(checked, parse_options(PlaceRange, where), workers, folder, progress or quiet, words)


def study_placement(
    part: str | Path | None = None,
    *,
    x: Sequence[float] = range(1000, 1601, 50),
    y: Sequence[float] = range(300, 901, 50),
    z: Sequence[float] = (0,),
    yaw: Sequence[float] = (0,),
    progress: "Progress | ProgressReporter | None" = None,
    **keywords: Unpack[StudyKeywords],
) -> "StudyResult":
    """Map reach, coverage, views and cycle time over positions of the part's centre [mm] and rotations A [deg]."""
    from cell.study.placement_study import placement_study

    return _study(lambda make: placement_study(make({}), x, y, z, yaw), part, progress, keywords)


def study_standoff(
    part: str | Path | None = None,
    *,
    values: Sequence[float] = range(50, 501, 50),
    robot: bool = False,
    progress: "Progress | ProgressReporter | None" = None,
    **keywords: Unpack[StudyKeywords],
) -> "StudyResult":
    """Chart views and coverage over the standoff distance [mm]; `robot` uses reachable views only."""
    from cell.study.scanner_study import scanner_study

    return _study(lambda make: scanner_study(make, "standoff", values, robot=robot), part, progress, keywords)


def study_scanner(
    part: str | Path | None = None,
    *,
    parameter: Literal["fov", "resolution", "baseline", "grazing", "range", "sensors"],
    values: "Sequence[Setting]",
    robot: bool = False,
    progress: "Progress | ProgressReporter | None" = None,
    **keywords: Unpack[StudyKeywords],
) -> "StudyResult":
    """Chart views and coverage over a parameter of the scanner [mm, deg], or over real sensors.

    Args:
        part: mesh file or built-in part. None takes that of the scene.
        parameter: option of `cell study scanner`.
        values: numbers; pairs of near and far limit for "range"; names for "sensors".
        robot: whether to use only views that the robot reaches at the scene's placement.
        progress: see the module.
        **keywords: scene, unit, workers and folder.
    """
    from cell.study.scanner_study import scanner_study

    return _study(lambda make: scanner_study(make, parameter, values, robot=robot), part, progress, keywords)


def open_run(folder: str | Path) -> "Run":
    """Open the run folder of a finished plan.

    Raises:
        FileError: if the folder is missing, damaged, not a run folder, or its plan did not finish.
    """
    from cell.runs.run import open_finished

    run = open_finished(Path(folder))
    run.plan, run.report  # noqa: B018  # damaged files are reported here
    return run


def _study(
    make: "Callable[[SceneWith], Study]",
    part: str | Path | None,
    progress: "Progress | ProgressReporter | None",
    keywords: Mapping[str, object],
) -> "StudyResult":
    from cell.study.study import plan_command, run_study, scene_maker
    from cell.study.trials import open_workers

    run, scene, scene_options = _study_options(*_split(keywords, StudyKeywords))
    study, words = make(scene_maker(part, scene, scene_options)), plan_command(part, scene, scene_options)
    with open_workers(run.count, run.cluster, run.cluster_security) as workers:
        return run_study(study, workers, out=run.out, reporter=_reporter(progress), plan=words)


def _study_options(keywords: dict[str, object]) -> "tuple[StudyRun, Path | None, dict[str, object]]":
    """Return the workers of a study, its scene file, and the options of its scene."""
    from cell.scene.options import option_specs, parse_options
    from cell.study.options import StudyRun

    run, scene_options = _split(keywords, PlaceKeywords, option_specs(StudyRun))
    scene = scene_options.pop("scene", None)
    return parse_options(StudyRun, run), None if scene is None else Path(str(scene)), scene_options


def _options(model: "type[Options]", options: "Options | None", keywords: Mapping[str, object]) -> "Options":
    """Return the options, or make them from the keywords."""
    from cell.errors import UsageError
    from cell.scene.options import parse_options

    if options is None:
        return parse_options(model, keywords)
    if keywords:
        raise UsageError(f"{', '.join(keywords)} given beside options as one value; give one of the two")
    return options


def _split(keywords: Mapping[str, object], known: type, *tables: Iterable[str]) -> tuple[dict[str, object], ...]:
    """Return the keywords of each table, and the rest; `known` has all names."""
    from cell.scene.options import require_known

    rest = dict(keywords)
    for name in rest:
        require_known(name, known.__annotations__)
    return *({name: rest.pop(name) for name in table if name in rest} for table in tables), rest


def _folder(result: "ArtefactFolder | SetupsRun | Exploration | StudyResult | str | Path") -> Path:
    return Path(result) if isinstance(result, str | Path) else result.folder


def _opened(run: "Run | str | Path") -> "Run":
    return open_run(run) if isinstance(run, str | Path) else run


def _reporter(progress: "Progress | ProgressReporter | None") -> "ProgressReporter":
    from cell.session import LoggedProgress, ProgressReporter

    return progress if isinstance(progress, ProgressReporter) else LoggedProgress(progress)


def _session(
    progress: "Progress | ProgressReporter | None",
    *,
    out: str | Path | None = None,
    scene: str | Path | None = None,
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
