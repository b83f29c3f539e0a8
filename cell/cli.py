"""The command line: options in, one run folder and a table (or one JSON object) out.

Exit codes: 0 done, 2 usage or scene, 3 below the required coverage, 4 nothing reachable, 5 driver, 6 files or run
folder, 70 a bug, 130 Ctrl-C. Heavy modules are imported inside the commands, so that `--help` answers at once.
"""

import json
import os
import signal
import sys
from pathlib import Path
from types import FrameType
from typing import Annotated, Any

import typer

from cell.commands import options
from cell.commands.failures import INTERRUPTED, guarded
from cell.errors import UsageError

app = typer.Typer(
    add_completion=False,
    no_args_is_help=True,
    rich_markup_mode="rich",
    pretty_exceptions_enable=False,
    help="Plan, check and time the views that measure a part with a laser scanner on a KUKA KR 16.",
    epilog="Start with: [bold]cell plan --place 1200,500,0[/bold]",
)

_PART = "Part and place"
_VIEWS = "Views"
_ERRORS = "Errors of the execution"
_OUTPUT = "Output"


@app.command(
    epilog="Examples:\n\n"
    "cell plan --place 1200,500,0\n\n"
    "cell plan part.stl --units mm --place 1200,500,0,90,0,0 --standoff 300 --faces 930 --coverage 0.95\n\n"
    "cell plan --scene my_cell.toml --seed 7 --json --out sim_runs/trial\n\n"
    "Exit codes: 0 done, 2 usage or scene, 3 below the required coverage, 4 nothing reachable, 6 files, 70 bug, "
    "130 Ctrl-C."
)
def plan(
    part: Annotated[
        str | None,
        typer.Argument(
            help="Mesh file (STL, OBJ, PLY, OFF, GLB) or a built-in part: mseke, mug, robinet, petanque, humerus, "
            "st-jean. Default: the scene's, which is mseke.",
            show_default=False,
        ),
    ] = None,
    place: Annotated[
        str | None,
        typer.Option(
            metavar="X,Y,Z[,A,B,C]",
            help="Where the part's centre stands in the robot's base frame (mm) and how it is turned (deg, KUKA ABC).",
            rich_help_panel=_PART,
        ),
    ] = None,
    units: Annotated[
        str | None,
        typer.Option(help="Unit of the mesh file: mm, cm, m, um or in. Never guessed.", rich_help_panel=_PART),
    ] = None,
    scene: Annotated[
        Path | None,
        typer.Option(help="Scene file (TOML). Default: the built-in scene.", rich_help_panel=_PART),
    ] = None,
    faces: Annotated[
        int | None, typer.Option(help="Faces of the planning mesh (one candidate normal each).", rich_help_panel=_VIEWS)
    ] = None,
    percent: Annotated[
        float | None,
        typer.Option(help="In place of --faces: percentage of the faces that is KEPT.", rich_help_panel=_VIEWS),
    ] = None,
    sensor: Annotated[
        str | None,
        typer.Option(help="A real sensor by name, see cell sensors; in place of scanner.type.", rich_help_panel=_VIEWS),
    ] = None,
    baseline: Annotated[
        float | None,
        typer.Option(metavar="MM", help="From laser source to sensor.", rich_help_panel=_VIEWS),
    ] = None,
    candidates: Annotated[
        str | None,
        typer.Option(help="optimal-scanning-zone (one per face), view-sphere or targeted.", rich_help_panel=_VIEWS),
    ] = None,
    standoff: Annotated[
        str | None,
        typer.Option(metavar="MM[,MM...]", help="Distance from surface to laser source.", rich_help_panel=_VIEWS),
    ] = None,
    roll: Annotated[
        str | None,
        typer.Option(metavar="DEG[,DEG...]", help="Rolls about the viewing axis.", rich_help_panel=_VIEWS),
    ] = None,
    coverage: Annotated[
        float | None,
        typer.Option(help="Share of the coverable area that the plan must measure, 0 to 1.", rich_help_panel=_VIEWS),
    ] = None,
    require: Annotated[
        float | None,
        typer.Option(
            help="Exit with code 3 when the predicted visible coverage of the WHOLE surface is below this share.",
            rich_help_panel=_VIEWS,
        ),
    ] = None,
    fill: Annotated[
        str | None,
        typer.Option(help="How the measurability matrix is filled: aimed or rays.", rich_help_panel=_VIEWS),
    ] = None,
    samples: Annotated[
        int | None,
        typer.Option(help="Surface samples per planning face (aimed).", rich_help_panel=_VIEWS),
    ] = None,
    max_sigma: Annotated[
        float | None,
        typer.Option(
            metavar="MM",
            help="Count a point as measured only if its expected standard deviation is at most this.",
            rich_help_panel=_VIEWS,
        ),
    ] = None,
    solver: Annotated[
        str | None,
        typer.Option(help="auto, greedy, meta-raps, local-search or exact.", rich_help_panel=_VIEWS),
    ] = None,
    seed: Annotated[int | None, typer.Option(help="Seed of every random choice.", rich_help_panel=_VIEWS)] = None,
    out: Annotated[
        Path | None,
        typer.Option(help="Run folder to make. Default: sim_runs/<UTC>-<hash>.", rich_help_panel=_OUTPUT),
    ] = None,
    as_json: Annotated[
        bool,
        typer.Option("--json", help="Print one JSON object on stdout, the rest on stderr.", rich_help_panel=_OUTPUT),
    ] = False,
    no_cache: Annotated[
        bool,
        typer.Option("--no-cache", help="Neither read nor write cached matrices.", rich_help_panel=_OUTPUT),
    ] = False,
) -> None:
    """Plan the views that measure a part: which, whether the robot reaches them, in which order, along which motion."""
    from cell.commands.narrator import Narrator
    from cell.plan.pipeline import plan as run_plan
    from cell.scene.scene import load_scene

    tables: dict[str, dict[str, Any]] = {"part": {}, "placement": {}, "plan": {}}
    if part is not None:
        tables["part"] = options.part(part, units)
    elif units is not None:
        tables["part"]["units"] = units
    if place is not None:
        tables["placement"] = options.placement(place)
    if faces is not None and percent is not None:
        raise UsageError("--faces and --percent both set the size of the planning mesh; give one of them")
    given = {
        "faces": faces,
        "percent_kept": percent,
        "candidates": candidates,
        "standoffs_mm": options.numbers("--standoff", standoff),
        "rolls_deg": options.numbers("--roll", roll),
        "coverage": coverage,
        "required_visible": require,
        "fill": fill,
        "samples_per_face": samples,
        "max_sigma_mm": max_sigma,
        "solver": solver,
        "seed": seed,
    }
    tables["plan"] = {key: value for key, value in given.items() if value is not None}
    tables["scanner"] = {k: v for k, v in {"sensor": sensor, "baseline_mm": baseline}.items() if v is not None}
    narrator = Narrator(quiet_stdout=as_json)
    with options.named_as_options(tables):
        checked = load_scene(scene, tables)
    outcome = run_plan(
        checked,
        scene_path=scene,
        out=out,
        argv=sys.argv[1:],
        use_cache=not no_cache,
        narrator=narrator,
    )
    if as_json:
        sys.stdout.write(json.dumps(outcome.as_json(), indent=2, allow_nan=False) + "\n")
    else:
        narrator.plan_table(outcome)
    raise typer.Exit(outcome.exit_code)


@app.command(
    epilog="Examples:\n\ncell check my_cell.toml\n\n"
    "cell check my_cell.toml --part part.stl --units mm --place 1200,500,0"
)
def check(
    scene: Annotated[
        Path | None, typer.Argument(help="Scene file (TOML). Default: the built-in scene.", show_default=False)
    ] = None,
    part: Annotated[str | None, typer.Option(help="As in cell plan: mesh file or built-in part.")] = None,
    units: Annotated[str | None, typer.Option(help="Unit of the mesh file.")] = None,
    place: Annotated[str | None, typer.Option(metavar="X,Y,Z[,A,B,C]", help="As in cell plan.")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object on stdout.")] = False,
) -> None:
    """Compile a scene, list contacts at home and the cell's numbers, and say what is wrong."""
    from cell.commands.narrator import Narrator
    from cell.scene.scene import load_scene
    from cell.world.check import check_scene

    tables: dict[str, dict[str, Any]] = {"part": {}, "placement": {}}
    if part is not None:
        tables["part"] = options.part(part, units)
    if place is not None:
        tables["placement"] = options.placement(place)
    with options.named_as_options(tables):
        checked = load_scene(scene, tables)
    result = check_scene(checked)
    if as_json:
        sys.stdout.write(json.dumps(result.summary(), indent=2, allow_nan=False) + "\n")
    else:
        Narrator().check_table(result)
    raise typer.Exit(result.exit_code)


@app.command(epilog="Examples:\n\ncell sensors\n\ncell plan --sensor gocator-2340 --baseline 100")
def sensors(
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object on stdout.")] = False,
) -> None:
    """List the real sensors that a scene may name, what is known of each, and what you have to give."""
    from cell.run.folder import SCHEMA
    from cell.scene import sensors as library

    if as_json:
        known = [library.load(name).summary() for name in library.names()]
        sys.stdout.write(json.dumps({"schema": SCHEMA, "sensors": known}, indent=2, allow_nan=False) + "\n")
    else:
        library.print_table()


@app.command(
    epilog="Examples:\n\n"
    "cell replay sim_runs/trial\n\n"
    "cell replay sim_runs/trial --execution latest --view 3 --speed 0.5\n\n"
    "cell replay sim_runs/trial --picture tour.png --size 1600x1200\n\n"
    "Keys: space pause, left and right step from view to view, up and down speed, home start.\n\n"
    "Exit codes: 0 done, 2 usage (also: no display and no EGL or OSMesa), 6 files or run folder, 70 bug, 130 Ctrl-C."
)
def replay(
    run: Annotated[Path, typer.Argument(help="Run folder of cell plan; a failed one (.part) too.")],
    execution: Annotated[
        str | None, typer.Option(metavar="ID", help="Replay an execution of it: an id, or latest. Default: the plan.")
    ] = None,
    view: Annotated[
        int | None, typer.Option(metavar="N", help="Begin at this view, counted from 1 in visiting order.")
    ] = None,
    speed: Annotated[float, typer.Option(help="Seconds of the motion for each second.")] = 1.0,
    once: Annotated[bool, typer.Option("--once", help="Close the viewer at the end.")] = False,
    frames: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Draw PNG frames into a folder; needs no display.")
    ] = None,
    fps: Annotated[float, typer.Option(help="Frames for each second of film.")] = 25.0,
    every: Annotated[int, typer.Option(metavar="N", help="Draw only each N-th frame.")] = 1,
    picture: Annotated[
        Path | None, typer.Option(metavar="FILE.png", help="Draw one still of the whole tour; needs no display.")
    ] = None,
    size: Annotated[str, typer.Option(metavar="WxH", help="Size of frames and picture in pixels.")] = "960x720",
) -> None:
    """Show a run: the arm on its motion, the scanner's frustum at each stop, the points of an execution."""
    from cell.commands.narrator import Narrator
    from cell.replay.replay import ReplayOptions
    from cell.replay.replay import replay as run_replay

    width, cross, height = size.lower().partition("x")
    if not (cross and width.isdecimal() and height.isdecimal()):
        raise UsageError(f"--size {size} must be width x height in pixels, for instance --size 960x720")
    wanted = ReplayOptions(execution, view, speed, frames, picture, fps, every, (int(width), int(height)), once)
    made = run_replay(run, wanted, Narrator())
    if made:
        sys.stdout.write(made + "\n")


@app.command(
    epilog="Examples:\n\n"
    "cell scan sim_runs/trial\n\n"
    "cell scan sim_runs/trial --pose-error 0.5,0.1 --range-noise 0.02 --seed 4\n\n"
    "cell scan sim_runs/trial --view 3 --resolution 0.5 --realtime\n\n"
    "cell scan sim_runs/trial --report 0001\n\n"
    "Exit codes: 0 done, 2 usage, 3 below the plan's required coverage, 5 driver, 6 files or run folder (also: "
    "a report of an execution that lacks views), 70 bug, 130 Ctrl-C."
)
def scan(
    run: Annotated[Path, typer.Argument(help="Run folder of a finished cell plan.")],
    driver: Annotated[str, typer.Option(metavar="URL", help="Which controller drives.")] = "sim://",
    realtime: Annotated[
        bool, typer.Option("--realtime", help="Let the simulated arm take its time. Default: as fast as it goes.")
    ] = False,
    view: Annotated[
        int | None, typer.Option(metavar="N", help="Scan this view only, counted from 1 in visiting order.")
    ] = None,
    resolution: Annotated[
        float | None, typer.Option(metavar="DEG", help="Angle between rays. Default: the plan's.")
    ] = None,
    range_noise: Annotated[
        float, typer.Option(metavar="MM", help="Noise along each ray, one sigma.", rich_help_panel=_ERRORS)
    ] = 0.0,
    noise: Annotated[
        str,
        typer.Option(
            metavar="none|model",
            help="model: noise along each ray by the scanner's own law, from range, triangulation angle and incidence.",
            rich_help_panel=_ERRORS,
        ),
    ] = "none",
    pose_error: Annotated[
        str | None,
        typer.Option(
            metavar="MM,DEG",
            help="Error of the executed pose, one sigma along and about each axis: the scanner stands off what the "
            "controller reports.",
            rich_help_panel=_ERRORS,
        ),
    ] = None,
    register: Annotated[
        bool | None,
        typer.Option(
            "--register/--no-register",
            help="Correct the reported poses by matching the scans. Default: with a pose error.",
            rich_help_panel=_ERRORS,
        ),
    ] = None,
    seed: Annotated[
        int | None, typer.Option(help="Seed of noise and pose error. Default: the plan's.", rich_help_panel=_ERRORS)
    ] = None,
    close_holes: Annotated[
        bool, typer.Option("--close-holes", help="Close the holes of the surface; the faces are marked.")
    ] = False,
    report: Annotated[
        str | None,
        typer.Option(
            metavar="ID",
            help="Scan nothing: make the report of this execution (or latest) anew from what is there.",
            rich_help_panel=_OUTPUT,
        ),
    ] = None,
    as_json: Annotated[
        bool,
        typer.Option("--json", help="Print one JSON object on stdout, the rest on stderr.", rich_help_panel=_OUTPUT),
    ] = False,
) -> None:
    """Execute a plan on a controller, scan at every view, merge, make the surface and say how good it is."""
    from cell.commands.narrator import Narrator
    from cell.scan import scan as scan_command
    from cell.scan.options import ScanOptions

    errors = options.numbers("--pose-error", pose_error) or [0.0, 0.0]
    if len(errors) != 2:
        raise UsageError(
            f"--pose-error {pose_error} must be two numbers, mm and deg, for instance --pose-error 0.5,0.1"
        )
    wanted = ScanOptions(
        driver, realtime, view, resolution, range_noise, errors[0], errors[1], register, close_holes, seed, noise
    )
    narrator = Narrator(quiet_stdout=as_json)
    if report is None:
        outcome = scan_command.scan(run, wanted, argv=sys.argv[1:], narrator=narrator)
    elif wanted == ScanOptions():
        outcome = scan_command.report(run, report, narrator)
    else:
        raise UsageError("--report makes the report of what was scanned; leave the options of a new scan away")
    if as_json:
        sys.stdout.write(json.dumps(outcome.summary, indent=2, allow_nan=False) + "\n")
    else:
        narrator.scan_table(outcome)
    raise typer.Exit(outcome.exit_code)


@app.command(
    epilog="Examples:\n\n"
    "cell why sim_runs/trial\n\n"
    "cell why sim_runs/trial --samples 20000 --json\n\n"
    "Writes why.json, why.ply and why.png to why/ in the run folder; the plan stays as it is.\n\n"
    "Exit codes: 0 done, 2 usage, 6 files or run folder, 70 bug, 130 Ctrl-C."
)
def why(
    run: Annotated[Path, typer.Argument(help="Run folder of a finished cell plan.")],
    samples: Annotated[
        int | None,
        typer.Option(metavar="N", help="Surface samples to ask about. Default: 100,000, as coverage is defined."),
    ] = None,
    as_json: Annotated[
        bool,
        typer.Option("--json", help="Print one JSON object on stdout, the rest on stderr.", rich_help_panel=_OUTPUT),
    ] = False,
) -> None:
    """Say why parts of the surface stay open, by area, and the smallest single change that would measure them."""
    from cell.commands.narrator import Narrator
    from cell.why.explain import explain

    narrator = Narrator(quiet_stdout=as_json)
    outcome = explain(run, narrator, samples=samples)
    if as_json:
        sys.stdout.write(json.dumps(outcome.summary, indent=2, allow_nan=False) + "\n")
    else:
        narrator.why_table(outcome)


def main(argv: list[str] | None = None) -> int:
    """Entry point of the console script: runs a command and turns every failure into one sentence and its exit code."""
    signal.signal(signal.SIGTERM, _stop)
    words = sys.argv[1:] if argv is None else argv
    code = guarded(lambda: app(args=words, prog_name="cell", standalone_mode=False), as_json="--json" in words)
    if code == INTERRUPTED:
        # The interrupt may have come between a ray engine and its threads: leave without taking them down in order.
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(code)
    sys.exit(code)


def _stop(signum: int, frame: FrameType | None) -> None:
    """A polite kill ends a run as Ctrl-C does: the folder keeps its status."""
    raise KeyboardInterrupt


if __name__ == "__main__":
    main()
