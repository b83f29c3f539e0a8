"""The front door for Python; the command line goes through it.

    from cell.api import open_run, plan, scan

    run = plan("part.stl", units="mm", place=(1200, 500, 0), coverage=0.99)
    run.T_base_scanner, run.q, run.coverage.visible, run.bound, run.folder
    execution = scan(run)
    execution.mesh, execution.deviation
    run = open_run("sim_runs/20261121T030106Z-1f0c2a9b")
    other = run.edited(drop=[4], turn={7: 90}, repair=True)

What the command line offers as `--max-views 8` is the keyword `max_views=8` here. Arrays are in metres and radians;
a name that ends in a unit (`_mm`, `_deg`) is in that unit. Nothing is printed: notes are logged under `cell.session`.
Errors are `cell.errors.CellError`, one sentence each. Importing this module imports nothing heavy; that is why the
functions import what they need themselves.
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
"""Told `(stage, done, total)` while work goes on; what it raises ends the work. A stage begins with (0, 0)."""

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
    **wishes: object,
) -> "EditableRun":
    """Plan the views that measure a part, and write a run folder.

    Args:
        part: mesh file or built-in part by name; a mesh in memory (`units` says in what its numbers are); or a whole
            checked scene. None takes the scene's part.
        scene: scene file (TOML); None is the built-in scene.
        out: run folder to make; None makes one below sim_runs/.
        use_cache: whether measurability matrices are taken from and left in the user's cache.
        progress: told how far the work is; None works in silence.
        argv: kept in the manifest beside the options.
        **wishes: options of `cell plan` by name, as Python values: `place=(1200, 500, 0)`, `standoff=300`,
            `coverage=0.99`, `max_views=8`, `pin=[3, 17]`.

    Returns:
        The finished plan. `exit_code` is 3 where it stays below a coverage that was asked for.

    Raises:
        CellError: in one sentence; the run folder keeps what was finished.
    """
    from cell.plan import pipeline
    from cell.plan.edit import EditableRun

    session = _session(progress, out=out, scene=scene, use_cache=use_cache, argv=argv)
    return EditableRun.opened(pipeline.plan(session, *pipeline.read_request(part, scene, wishes)))


def plan_setups(
    part: "str | Path | trimesh.Trimesh | Scene | None" = None,
    options: "SetupOptions | None" = None,
    *,
    scene: "str | Path | None" = None,
    out: "str | Path | None" = None,
    use_cache: bool = True,
    progress: "Progress | ProgressReporter | None" = None,
    argv: Sequence[str] = (),
    **wishes: object,
) -> "SetupsRun":
    """Plan several set-ups of a part as one cover: fewest set-ups, then fewest views (docs/setups.md).

    Args:
        part: as for `plan`.
        options: how many set-ups, and which, as one value; None makes it of the wishes.
        scene: scene file (TOML); None is the built-in scene. Its placement is the first pose that is offered.
        out: folder to make; None makes one below sim_runs/.
        use_cache: as for `plan`.
        progress: told how far the work is; None works in silence.
        argv: kept in the manifests.
        **wishes: options of `cell setups` by name: `place=(1200, 500, 0)`, `max_setups=2`, `proposals=8`.

    Raises:
        CellError: in one sentence; the folder keeps what was finished.
    """
    from cell.plan.pipeline import read_request
    from cell.plan.setup_options import SetupOptions
    from cell.plan.setups import plan_setups as planned
    from cell.plan.setups import scene_after
    from cell.runs.setups import SetupsRun
    from cell.scene.options import option_specs, parse_options

    own = {name: wishes.pop(name) for name in option_specs(SetupOptions) if name in wishes}
    wanted = parse_options(SetupOptions, own) if options is None else options
    if wanted.first is not None and part is None and scene is None:
        part, wishes = scene_after(open_run(wanted.first), wishes), {}
    checked, workpiece = read_request(part, scene, wishes)
    session = _session(progress, out=out, scene=scene, use_cache=use_cache, argv=argv)
    return SetupsRun.opened(planned(session, checked, options=wanted, part=workpiece))


def scan(
    run: "Run | str | Path",
    options: "ScanOptions | None" = None,
    *,
    progress: "Progress | ProgressReporter | None" = None,
    argv: Sequence[str] = (),
    ask: "Confirm | None" = None,
    confirm: str | None = None,
    **wishes: object,
) -> "Execution":
    """Execute a plan on a controller, scan at every view, merge, make the surface and measure its deviation.

    Args:
        run: a finished plan, or its folder.
        options: as one value; None makes it of the wishes.
        progress: told how far the work is; None works in silence.
        argv: kept in the manifest beside the options.
        ask: puts a question to a person, for real controllers; None where nobody is there.
        confirm: the word that an arm may move along what has this digest: `run.digest`. Without it, or somebody's yes,
            nothing moves on a wire; `sim://` needs none.
        **wishes: options of `cell scan` by name: `driver="modbus://192.168.1.10"`, `resolution=0.5`, `seed=7`.

    Returns:
        The execution. `exit_code` is 3 where it stays below the coverage that the plan requires.

    Raises:
        CellError: in one sentence; the execution's folder keeps the scans that were taken.
    """
    from cell.runs.run import Execution
    from cell.scan import scan as execution
    from cell.scan.options import ScanOptions
    from cell.scene.options import parse_options

    if confirm is not None:
        wishes = {**wishes, "confirm_motion": confirm}
    wanted = parse_options(ScanOptions, wishes) if options is None else options
    outcome = execution.scan(_session(progress, argv=argv, confirm=ask), _folder(run), wanted)
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
    **wishes: object,
) -> "SetupsOutcome":
    """Scan the set-ups of a folder, register them to each other, and make one model of all that are scanned.

    Args:
        folder: what `plan_setups` returned, or its folder.
        options: as for `scan`.
        setup: the number of one of them; None: each that is not scanned yet, in order, halting after one where points
            are not simulated.
        resume: whether an execution that was stopped is gone on with.
        progress: as for `scan`.
        argv: kept in the manifests.
        ask: as for `scan`.
        confirm: as for `scan`: the digest of the set-up's plan.
        **wishes: options of `cell scan` by name: `setup_error="5mm,2deg"`, `range_noise=0.03`.

    Returns:
        `report` (scanned/report.json), `folder`, `exit_code`.

    Raises:
        CellError: in one sentence; what was scanned is kept.
    """
    from cell.scan.options import ScanOptions
    from cell.scan.setups import scan_setups as scanned
    from cell.scene.options import parse_options

    if confirm is not None:
        wishes = {**wishes, "confirm_motion": confirm}
    wanted = parse_options(ScanOptions, wishes) if options is None else options
    where = Path(folder) if isinstance(folder, str | Path) else folder.folder
    return scanned(_session(progress, argv=argv, confirm=ask), where, wanted, setup=setup, resumed=resume)


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
    **wishes: object,
) -> "Exploration":
    """Measure a part that nobody has a model of, a batch of views at a time (docs/explore.md).

    Args:
        part: what stands in the cell: mesh file, built-in part by name, or a whole checked scene. In simulation it is
            hidden from the planning; elsewhere its mesh is not read. None takes the scene's part.
        options: of the exploration, as one value; None makes it of the wishes.
        scanning: of each batch's execution, as one value; None makes it of the wishes.
        scene: scene file (TOML); None is the built-in scene.
        out: folder to make, or to go on in where an exploration of the same options was stopped; None makes one below
            sim_runs/.
        progress: told how far the work is; None works in silence.
        argv: kept in the manifests beside the options.
        ask: puts a question to a person, for real controllers; None where nobody is there.
        **wishes: options of `cell explore` by name: `place=(1200, 500, 0)`, `policy="two-stage"`, `max_views=12`.

    Raises:
        CellError: in one sentence; what was finished stays in the folder.
    """
    from datetime import UTC, datetime

    from cell.explore.exploration import Exploration
    from cell.explore.explore import explore as run
    from cell.explore.options import SCAN_OPTIONS, ExploreOptions
    from cell.plan.pipeline import read_request
    from cell.scan.options import ScanOptions
    from cell.scene.options import option_specs, parse_options

    own, of_scan = (
        {name: wishes.pop(name) for name in names if name in wishes}
        for names in (option_specs(ExploreOptions), SCAN_OPTIONS)
    )
    checked, _ = read_request(part, scene, wishes)
    wanted = parse_options(ExploreOptions, own) if options is None else options
    scans = parse_options(ScanOptions, of_scan) if scanning is None else scanning
    folder = Path("sim_runs") / f"explore-{datetime.now(UTC):%Y%m%dT%H%M%SZ}" if out is None else Path(out)
    file = run(_session(progress, out=folder, argv=argv, confirm=ask), checked, wanted, scans)
    return Exploration(folder, file)


def locate(
    run: "Run | str | Path",
    wanted: "LocateOptions | None" = None,
    *,
    progress: "Progress | ProgressReporter | None" = None,
    **wishes: object,
) -> "LocateResult":
    """Find where the part of a plan really stands; `run.edited(T_base_object=found.T_base_object)` plans it there.

    Args:
        run: a finished plan, or its folder; nothing in it changes.
        wanted: as one value; None makes it of the wishes.
        progress: told how far the work is; None works in silence.
        **wishes: options of `cell locate` by name: `points="scan.ply"`, `points_frame="scanner"`, `points_units="mm"`.

    Returns:
        The placement with its precision, what is not determined, and whether the plan's motion keeps its clearance.

    Raises:
        CellError: in one sentence.
    """
    from cell.metrology.locate import locate as found
    from cell.metrology.options import LocateOptions
    from cell.runs.run import open_finished as opened
    from cell.scene.options import parse_options

    planned = opened(Path(run)) if isinstance(run, str | Path) else run
    return found(planned, parse_options(LocateOptions, wishes) if wanted is None else wanted, _reporter(progress))


def hand_eye(
    files: "Sequence[str | Path]",
    wanted: "HandEyeOptions | None" = None,
    *,
    progress: "Progress | ProgressReporter | None" = None,
    **wishes: object,
) -> "HandEyeResult":
    """Find the mount (flange to scanner) from scans of a sphere or a plane from several poses of the flange.

    Args:
        files: the scans, scanner frame.
        wanted: as one value; None makes it of the wishes.
        progress: told how far the work is; None works in silence.
        **wishes: options of `cell calibrate hand-eye` by name: `points_units="mm"`, `diameter=38.1`.

    Raises:
        CellError: in one sentence.
    """
    from cell.metrology.hand_eye import calibrate_hand_eye as found
    from cell.metrology.options import HandEyeOptions
    from cell.scene.options import parse_options

    return found(
        [Path(file) for file in files],
        parse_options(HandEyeOptions, wishes) if wanted is None else wanted,
        _reporter(progress),
    )


def open_run(folder: "str | Path") -> "EditableRun":
    """A run folder of `cell plan`, as `plan` returned it.

    Raises:
        FileError: if it is missing, damaged, not a run folder, or its plan did not finish.
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
