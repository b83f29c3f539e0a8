"""Commands with many trials: `cell place`, and one command for each study."""

import shlex
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Annotated

import typer

from cell.cli.options import (
    EXIT_CODES,
    AsJson,
    OptionValues,
    Part,
    PartOptions,
    SceneFile,
    add_moved,
    command,
    print_json,
)
from cell.errors import UsageError
from cell.scene.file import scene_from_options
from cell.scene.model import Scene
from cell.scene.options import flag, option_specs
from cell.study.options import PlaceRange, ScannerNumber, StudyRun, parse_pairs, parse_range

if TYPE_CHECKING:
    from cell.cli.terminal import Terminal
    from cell.study.study import Study, StudyResult

app = typer.Typer(
    no_args_is_help=True,
    rich_markup_mode="rich",
    help="Vary one number in many trials: curves, maps, and the best value.",
    epilog="Examples:\n\n"
    "cell study standoff mug --values 50:500:50\n\n"
    "cell study placement mug --processes 4 --out map\n\n"
    "cell study scanner --sensors all --cluster tcp://127.0.0.1:8786\n\n"
    "The result of each trial is kept: a stopped study resumes, and a repeated one takes a second.\n\n" + EXIT_CODES,
)

_MAX_ROWS = 24  # of a map: a screen; the folder has all
_NO_RESULT = 2  # exit code: every trial failed


def run_and_print(
    make: "Callable[[], Study]", run: StudyRun, as_json: bool, plan: Sequence[object] = ("cell", "plan")
) -> None:
    """Run a study and print its result; `plan` is the command that plans its scene."""
    from cell.cli.terminal import Terminal
    from cell.study.study import run_study
    from cell.study.trials import open_workers

    terminal = Terminal(quiet_stdout=as_json)
    with open_workers(run.count, run.cluster, run.cluster_security) as workers:
        result = run_study(make(), workers, out=run.out, reporter=terminal, plan=plan)
    _print_study(terminal, result, as_json)
    if not result.rows:
        raise typer.Exit(_NO_RESULT)


def _print_study(terminal: "Terminal", result: "StudyResult", as_json: bool) -> None:
    from cell.view.study_page import format_value

    if as_json:
        print_json(result.summary())
        return
    if result.rows:
        rows = [[format_value(row.get(column)) for column in result.columns] for row in result.rows]
        terminal.print_table(result.columns, rows, at_most=_MAX_ROWS)
        if len(rows) > _MAX_ROWS:
            terminal.print(f"all of them: {result.folder / 'rows.csv'}")
    for sentence in result.sentences:
        terminal.print(sentence.replace("**", "").replace("`", ""))  # they are Markdown
    computed = f"{result.computed} trials computed now" if result.rows else "every trial failed"
    failed = f", {len(result.failed)} failed (see report.md)" if result.failed else ""
    terminal.print(f"{computed}{failed}; study folder {result.folder}")
    best = "" if result.best is None else result.commands[result.best]
    terminal.suggest(("cell", "view", result.folder), *([shlex.split(best)] if best and "#" not in best else []))


_Robot = Annotated[
    bool, typer.Option("--robot", help="Use only views that the robot reaches at the scene's placement.")
]


@command("cell study placement mug --x 1000:1600:50 --y 300:900:50", group=app)
def placement(
    *,
    part: Part = None,
    x: Annotated[str, typer.Option(metavar="MM:MM:MM", help="First, last and step of x.")] = "1000:1600:50",
    y: Annotated[str, typer.Option(metavar="MM:MM:MM", help="First, last and step of y.")] = "300:900:50",
    z: Annotated[str, typer.Option(metavar="MM[:MM:MM]", help="Heights of the part's centre.")] = "0",
    yaw: Annotated[str, typer.Option(metavar="DEG[:DEG:DEG]", help="Rotations about the vertical (A).")] = "0",
    scene: SceneFile = None,
    scene_options: PartOptions,
    run: StudyRun,
    as_json: AsJson = False,
) -> None:
    """Map placements of the part: reach, coverage, views and cycle time over its position."""
    from cell.study.placement_study import placement_study
    from cell.study.study import plan_command, scene_maker

    grids = [parse_range(name, text) for name, text in (("--x", x), ("--y", y), ("--z", z), ("--yaw", yaw))]
    base = scene_maker(part, scene, scene_options, flag)({})
    run_and_print(lambda: placement_study(base, *grids), run, as_json, plan_command(part, scene, scene_options))


@command("cell study standoff mug --values 50:500:50", group=app)
def standoff(
    *,
    part: Part = None,
    values: Annotated[str, typer.Option(metavar="MM:MM:MM", help="First, last and step.")] = "50:500:50",
    robot: _Robot = False,
    scene: SceneFile = None,
    scene_options: PartOptions,
    run: StudyRun,
    as_json: AsJson = False,
) -> None:
    """Find the scanning zone: views and coverage over the standoff distance."""
    from cell.study.scanner_study import scanner_study
    from cell.study.study import plan_command, scene_maker

    standoffs = parse_range("--values", values)
    make = scene_maker(part, scene, scene_options, flag)
    words = plan_command(part, scene, scene_options)
    run_and_print(lambda: scanner_study(make, "standoff", standoffs, robot=robot), run, as_json, words)


@command(
    "cell study scanner mug --fov 10:90:10",
    "cell study scanner --range 50-150,100-300,200-600",
    "cell study scanner --sensors gocator-2340,gocator-2350 --baseline 100",
    group=app,
)
def scanner(
    *,
    part: Part = None,
    number: ScannerNumber,
    robot: _Robot = False,
    scene: SceneFile = None,
    scene_options: PartOptions,
    run: StudyRun,
    as_json: AsJson = False,
) -> None:
    """Find the scanner: views and coverage over one of its numbers, or over real sensors. Give one of the options."""
    from cell.study.scanner_study import Setting, scanner_study
    from cell.study.study import plan_command, scene_maker

    varied = number.model_dump(exclude_none=True)
    if varied.keys() == {"sensors", "baseline"}:  # no sensor of the library states its baseline
        scene_options = {**scene_options, "baseline": varied.pop("baseline")}
    if len(varied) != 1:
        raise UsageError(
            "give one of --fov, --resolution, --baseline, --grazing, --range and --sensors, for instance --fov 10:90:10"
        )
    ((name, text),) = varied.items()
    make = scene_maker(part, scene, scene_options, flag)
    values: Sequence[Setting]
    if name == "ranges":
        name, values = "range", parse_pairs("--range", text)
    elif name == "sensors":
        from cell.scene import sensors as library

        complete = [name for name in library.names() if not library.load(name).not_stated.keys() - {"baseline_mm"}]
        values = complete if text == "all" else text.split(",")
    else:
        values = parse_range(flag(name), text)
    run_and_print(
        lambda: scanner_study(make, name, values, robot=robot), run, as_json, plan_command(part, scene, scene_options)
    )


for _name in ("speed", "stability"):
    add_moved(app, _name, f"cell study {_name}", f"python -m benchmarks {_name}")
for _name in ("table1", "table2", "table3", "table4", "table5", "all"):
    add_moved(app, _name, f"cell study {_name}", f"python -m benchmarks paper {_name}")


@command(
    "cell place mug",
    "cell place part.stl --units mm --x 900:1500 --y=-600:600 --z 0 --yaw 0",
    note="Give the answer to cell plan --place.",
)
def place(
    *,
    part: Part = None,
    where: PlaceRange,
    scene: SceneFile = None,
    scene_options: Annotated[OptionValues, option_specs(Scene, "units", "seed", "table")],
    run: StudyRun,
    as_json: AsJson = False,
) -> None:
    """Search the best placement of the part: most coverage, then fewest views, then the shortest cycle."""
    from cell.cli.terminal import Terminal
    from cell.study.place_search import place_study
    from cell.study.study import plan_command, study_folder
    from cell.study.trials import open_workers

    checked = scene_from_options(scene, scene_options, part, flag)
    folder = study_folder("place", run.out)
    terminal = Terminal(quiet_stdout=as_json)
    with open_workers(run.count, run.cluster, run.cluster_security) as workers, terminal.rounds() as progress:
        result = place_study(checked, where, workers, folder, progress, plan_command(part, scene, scene_options))
    _print_study(terminal, result, as_json)
