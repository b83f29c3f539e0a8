"""Commands `cell check`, `init`, `part`, `robot`, `sensors`, `view`, `live`, `replay`, `points` and `export`."""

import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import typer

from cell.cli.options import AsJson, OptionValues, command, print_json
from cell.errors import UsageError
from cell.export.options import ExportOptions
from cell.scene.file import scene_from_options
from cell.scene.model import PART, Scene
from cell.scene.options import flag, option_specs
from cell.view.replay_options import ReplayOptions


@command("cell check my_cell.toml", "cell check my_cell.toml --part part.stl --units mm --place 1200,500,0")
def check(
    *,
    scene: Annotated[
        Path | None, typer.Argument(help="Scene file (TOML). Default: the built-in scene.", show_default=False)
    ] = None,
    part: Annotated[
        str | None, typer.Option(help="As in cell plan: mesh file or built-in part.", rich_help_panel=PART)
    ] = None,
    scene_options: Annotated[OptionValues, option_specs(Scene, "units", "place", "collision")],
    as_json: AsJson = False,
) -> None:
    """Compile a scene, list contacts at home and the data of the cell, and report its errors."""
    from cell import api
    from cell.cli.terminal import Terminal

    result = api.check(scene_from_options(scene, scene_options, part, flag))
    if as_json:
        print_json(result.summary())
    else:
        terminal = Terminal()
        terminal.print_pairs("Scene", result.rows())
        for problem in result.problems:
            terminal.print_error(f"wrong: {problem}")
        words = [f"{flag(name)}={text}" for name, text in scene_options.items()]
        at = [] if scene is None else [scene]
        if result.problems:
            terminal.suggest(("cell", "check", *at, *(["--part", part] if part else []), *words))
        else:
            terminal.suggest(("cell", "plan", *([part] if part else []), *(["--scene", *at] if at else []), *words))
    raise typer.Exit(result.exit_code)


@command("cell init my_cell.toml", "cell init my_cell.toml --part bracket.stl --units mm")
def init(
    *,
    file: Annotated[Path, typer.Argument(metavar="FILE", help="Scene file to write.", show_default=False)],
    part: Annotated[
        str | None, typer.Option(help="Mesh file or built-in part of the scene.", rich_help_panel=PART)
    ] = None,
    scene_options: Annotated[OptionValues, option_specs(Scene, "units")],
) -> None:
    """Write a scene file with every key, its unit, its default and its purpose."""
    from cell import api
    from cell.cli.terminal import Terminal

    units = scene_options.get("units")
    api.init(file, part, None if units is None else str(units))
    terminal = Terminal()
    terminal.print(f"{file} has every key with its default; change the values, and remove what you do not need")
    terminal.suggest(("cell", "check", file), ("cell", "plan", "--scene", file))


@command(
    "cell part bracket.stp",
    "cell part bracket.stp --json --out looked",
    "cell part casting.stl --units mm",
    note="[[region]] of a scene file takes these face numbers (docs/step_and_regions.md). STEP files need cascadio: "
    "pip install 'scan-cell[step]'.",
)
def part(
    *,
    file: Annotated[
        str, typer.Argument(metavar="FILE", help="STEP or mesh file, or a built-in part.", show_default=False)
    ],
    scene_options: Annotated[OptionValues, option_specs(Scene, "units")],
    out: Annotated[
        Path | None, typer.Option(metavar="FOLDER", help="Folder of view.html and faces.png. Default: a temporary one.")
    ] = None,
    as_json: AsJson = False,
) -> None:
    """List the faces of a CAD part with their numbers, kinds and sizes, draw them, and check the part."""
    from cell.cli.terminal import Terminal
    from cell.part import description, workpiece
    from cell.view.part_page import faces_picture, part_page
    from cell.view.view_command import write_page

    terminal = Terminal(quiet_stdout=as_json)
    units = scene_options.get("units")
    loaded = workpiece.load(file, None if units is None else str(units))
    folder = Path(tempfile.mkdtemp(prefix="cell-part-")) if out is None else out
    words = ["cell", "plan", file, *([f"--units={units}"] if units else [])]
    rows = description.rows(loaded)
    with terminal.stage("draw the part"):
        page = write_page(part_page(loaded, rows, " ".join(words)), folder / "view.html")
        if loaded.cad is not None:
            faces_picture(folder / "faces.png", loaded, loaded.cad)
            rows.append(("picture", str(folder / "faces.png")))
    if loaded.cad is not None and not as_json:
        heading, faces = description.face_table(loaded, loaded.cad)
        terminal.print_table(heading, faces, at_most=len(faces))
    terminal.print_result(description.summary(loaded), f"Part {loaded.name}", [*rows, ("page", str(page))], words)


@command(
    "cell robot ur5e.urdf --out ur5e.png",
    "cell robot kr10.urdf --package kuka_kr10_support=../kuka_experimental/kuka_kr10_support",
    note='A scene names the arm as [robot] model = "ur5e.urdf"; see docs/robots.md.',
)
def robot(
    *,
    file: Annotated[Path, typer.Argument(help="URDF or MJCF of the arm.", show_default=False)],
    base_link: Annotated[str | None, typer.Option(help="Link that is its base. Default: the root.")] = None,
    flange_link: Annotated[
        str | None, typer.Option(help="Link that is its flange. Default: tool0, flange, or another usual name.")
    ] = None,
    package: Annotated[
        list[str] | None, typer.Option(metavar="NAME=DIR", help="Folder of a ROS package that the file names.")
    ] = None,
    out: Annotated[Path | None, typer.Option(metavar="FILE.png", help="Draw the arm at home.")] = None,
    as_json: AsJson = False,
) -> None:
    """Report the arm in a robot's file: axes, lengths, limits, missing data, links in contact."""
    from cell.cli.terminal import Terminal
    from cell.world.robot_check import report

    packages = {}
    for text in package or []:
        name, is_given, folder = text.partition("=")
        if not is_given:
            raise UsageError(f"--package {text} has no =; give NAME=DIR")
        packages[name] = str(Path(folder).absolute())
    terminal = Terminal(quiet_stdout=as_json)
    with terminal.stage("read the arm"):
        robot_report, model = report(file, base_link, flange_link, packages)
    terminal.print_result(robot_report.summary(), f"Robot {file.name}", robot_report.rows())
    if out is not None:
        from cell.view.cell_picture import draw_robot
        from cell.view.rays import save_png

        save_png(draw_robot(model), out)
        terminal.print(str(out))


@command("cell sensors", "cell plan --sensor generic-area-medium", "cell plan --sensor gocator-2340 --baseline 100")
def sensors(*, as_json: AsJson = False) -> None:
    """List the scanners that a scene can name, their known data, and the data that the user must give."""
    from cell.cli.terminal import Terminal
    from cell.runs.folder import SCHEMA
    from cell.scene import sensors as library

    if as_json:
        print_json({"schema": SCHEMA, "sensors": [library.load(name).summary() for name in library.names()]})
        return
    terminal = Terminal()
    heading, *rows = library.table_rows()
    terminal.print_table(heading, rows)
    terminal.print(
        "mm, deg. distance: from the housing; line: its length at the near and the far end; range: from the laser "
        "source, of a line as depth from its fan's apex; x: times the standoff; you give: keys of scanner that no "
        "source states. cell sensors --json has all figures with their sources."
    )
    terminal.suggest(("cell", "plan", "--sensor", library.names()[0]))


@command(
    "cell view sim_runs/trial",
    "cell view sim_runs/trial/executions/0001 --out scan.html --no-open",
    "cell view my_cell.toml --watch",
    "cell view sim_runs/study-place",
    "cell view sim_runs/explore-20261122T101500Z",
    note="A run is never changed: if its folder has no page, or with --out, the page is written elsewhere. The file "
    "needs no server and no network.",
)
def view(
    *,
    what: Annotated[
        Path | None,
        typer.Argument(
            metavar="[SCENE | RUN | EXECUTION | EXPLORATION | STUDY]",
            help="Scene file, run folder, executions/<id> of one, or folder of an exploration, of a study or of "
            "cell setups. Default: the built-in scene.",
            show_default=False,
        ),
    ] = None,
    out: Annotated[
        Path | None, typer.Option(metavar="FILE.html", help="File of the page. Default: a temporary file.")
    ] = None,
    no_open: Annotated[bool, typer.Option("--no-open", help="Open no browser, print the path.")] = False,
    watch: Annotated[
        bool, typer.Option("--watch", help="Draw a scene again whenever its file is saved; ends with Ctrl-C.")
    ] = False,
) -> None:
    """Show a scene, plan, execution, exploration or study in the browser: a file with robot, views and motion."""
    from cell.cli.terminal import Terminal
    from cell.view import loopback, view_command

    terminal = Terminal()

    def open_page(path: Path) -> None:
        if not no_open and not loopback.open_browser(path.absolute().as_uri()):
            terminal.note("no browser could be started; open the file in a browser")
        terminal.print(str(path))

    if watch:
        if what is None or what.is_dir():
            raise UsageError("--watch needs a scene file; give one: cell view my_cell.toml --watch")
        view_command.watch(what, out, terminal, open_page, time.sleep)
    elif what is not None and (what / "setups.json").is_file():
        from cell.runs.next_commands import after_plan
        from cell.runs.run import open_run
        from cell.runs.setups import SetupsRun

        if out is not None:
            raise UsageError(f"{what} holds several set-ups with a page each; omit --out")
        for folder in SetupsRun.opened(what).folders:
            open_page(view_command.make_page(folder, None, terminal))
        exported = after_plan(open_run(folder), str(what))[-1]
        Terminal(quiet_stdout=True).suggest(*_after_setups(what, exported))
    else:
        open_page(view_command.make_page(what, out, terminal))
        if following := _after_view(what):
            Terminal(quiet_stdout=True).suggest(*following)


@command(
    "cell live",
    "cell live my_cell.toml",
    "cell live sim_runs/trial --no-plan",
    note="The page is served on 127.0.0.1 only, under an address with a token. A real controller is never moved from "
    "it. Ends with Ctrl-C.",
)
def live(
    *,
    what: Annotated[
        Path | None,
        typer.Argument(
            metavar="[SCENE | RUN]",
            help="Scene file, or run folder of a finished cell plan. Default: the built-in scene.",
            show_default=False,
        ),
    ] = None,
    part: Annotated[
        str | None, typer.Option(help="As in cell plan: mesh file or built-in part.", rich_help_panel=PART)
    ] = None,
    scene_options: Annotated[OptionValues, option_specs(Scene, "units", "place", "table")],
    out: Annotated[
        Path | None, typer.Option(help="Folder of scene files and plans. Default: sim_runs/live-<UTC>.")
    ] = None,
    no_plan: Annotated[bool, typer.Option("--no-plan", help="Plan only on request.")] = False,
    no_open: Annotated[bool, typer.Option("--no-open", help="Open no browser, print the address.")] = False,
) -> None:
    """Move part, fixtures, table and robot on a local page: reach while dragging, the plan after release."""
    from cell.cli.terminal import Terminal
    from cell.live.command import serve
    from cell.view.loopback import open_browser

    is_run = what is not None and what.is_dir()
    if is_run and (part is not None or scene_options):
        raise UsageError("the part and the placement are those of the run; move the part on the page, or give a scene")
    scene = None if is_run else scene_from_options(what, scene_options, part, flag)
    terminal = Terminal()

    def open_page(url: str) -> None:
        if not no_open and not open_browser(url):
            terminal.note("no browser could be started; open the address in a browser of this machine")
        terminal.print(url)

    serve(scene, what if is_run else None, out, terminal, open_page, is_planning=not no_plan)


def _after_setups(folder: Path, otherwise: tuple[object, ...]) -> list[tuple[object, ...]]:
    """Return the command that scans the set-ups that are not scanned yet, or another if all are."""
    from cell.runs.setups import SetupsRun
    from cell.scan.setups import complete_execution

    is_scanned = all(complete_execution(run) is not None for run in SetupsRun.opened(folder).folders)
    return [otherwise if is_scanned else ("cell", "scan", folder)]


def _after_view(what: Path | None) -> Sequence[tuple[object, ...]]:
    """Return commands for a scene, a run or an execution; pages of other folders have their own."""
    from cell.runs.next_commands import after_plan, drop_command
    from cell.runs.run import EXECUTIONS, open_run

    if what is None or not what.is_dir():
        return [("cell", "plan", *(["--scene", what] if what else []))]
    if (folder := what.absolute()).parent.name == EXECUTIONS:
        return [("cell", "replay", folder.parent.parent, "--execution", folder.name)]
    if not all((what / name).is_file() for name in ("plan.json", "report.json")):  # a study, or an unfinished run
        return []
    run = open_run(what)
    drop = drop_command(run.report, 1, str(what))
    return [*after_plan(run, str(what)), *([drop] if drop else [])]


@command(
    "cell replay sim_runs/trial",
    "cell replay sim_runs/trial --execution latest --view 3 --rate 0.5",
    "cell replay sim_runs/trial --tightest --picture tight.png",
    "cell replay sim_runs/trial --picture tour.png --size 1600x1200 --camera -60,20 --hide post",
    note="Keys: space pause, left and right step from view to view, up and down speed, home start, end tightest "
    "moment. Without a display for the viewer the exit code is 2.",
)
def replay(
    *,
    run: Annotated[Path, typer.Argument(help="Run folder of cell plan; a failed one (.part) too.")],
    options: ReplayOptions,
) -> None:
    """Show a run: the arm on its motion, the scanner's frustum at each stop, the points of an execution."""
    from cell import api
    from cell.cli.terminal import Terminal

    if text := api.replay(run, options, progress=Terminal()):
        sys.stdout.write(f"{text}\n")
    Terminal(quiet_stdout=True).suggest(("cell", "scan" if options.execution is None else "why", run))


@command(
    "cell points sim_runs/trial trial.e57",
    "cell points sim_runs/trial surface.glb --execution 0001",
    note="e57, ptx, las, laz, pcd, csv: points; ply, stl, obj, glb: surface (docs/execution.md). E57, LAS and LAZ need "
    "pip install 'scan-cell[points]'.",
)
def points(
    *,
    run: Annotated[Path, typer.Argument(help="Run folder of a finished cell plan.")],
    out: Annotated[Path, typer.Argument(metavar="FILE", help="File to write; its suffix is the format.")],
    execution: Annotated[str, typer.Option(help="Execution, by its id.")] = "latest",
) -> None:
    """Write the points or the surface of an execution for other programs, with their deviation from the part."""
    from cell import api

    count = api.points(run, out, execution)
    sys.stdout.write(f"{out}: {count:,} points\n")


@command(
    "cell export sim_runs/trial",
    "cell export sim_runs/trial --name PART_07 --speed 0.1 --trigger-output 5 --done-input 6 --out program",
    "cell export sim_runs/trial --format csv",
    "cell export sim_runs/both",
    note="Read docs/export.md before a program runs on a robot.",
)
def export(
    *,
    run: Annotated[Path, typer.Argument(help="Run folder of a finished cell plan, or the folder of cell setups.")],
    options: ExportOptions,
    as_json: AsJson = False,
) -> None:
    """Write the motion of a plan as a robot program (KRL, RAPID, URScript, LS) or as a table (CSV, JSON)."""
    from cell import api
    from cell.cli.terminal import Terminal

    terminal = Terminal(quiet_stdout=as_json)
    has_setups = (run / "setups.json").is_file()
    outcome = api.export(run, options, progress=terminal)
    if outcome.format not in ("csv", "json", "ros"):
        terminal.note(
            "before this program runs on a robot, check axes, tool, signals and cell (docs/export.md), and run it at "
            "reduced speed"
        )
    if as_json:
        print_json(outcome.as_json())
    else:
        sys.stdout.write("".join(f"{path}\n" for path in outcome.files))
        page_command = ("cell", "view", run)
        Terminal(quiet_stdout=True).suggest(
            *(_after_setups(run, page_command) if has_setups else [("cell", "replay", run)])
        )
