"""`cell study ...`: one command a study, all with the same options for where it runs and what it leaves."""

import shlex
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from cell.commands.options import AsJson, OfPart, Part, SceneFile, Wishes, add_moved, from_fields, print_json
from cell.errors import UsageError
from cell.scene.file import load_scene, option_names, option_tables
from cell.scene.model import Scene
from cell.scene.options import flag
from cell.study.options import ScannerNumber, StudyRun

if TYPE_CHECKING:
    from cell.commands.terminal import Terminal
    from cell.study.curves import SceneWith
    from cell.study.study import Study, StudyResult

EPILOG = (
    "Examples:\n\n"
    "cell study standoff mug --values 50:500:50\n\n"
    "cell study placement mug --processes 4 --out map\n\n"
    "cell study scanner --sensors all --cluster tcp://scheduler:8786\n\n"
    "Every trial is kept as soon as it is done: a study that was stopped goes on where it was, and one that is asked "
    "for again takes a second. Exit codes: 0 done, 2 usage, 6 files, 70 bug, 130 Ctrl-C."
)

app = typer.Typer(
    no_args_is_help=True,
    rich_markup_mode="rich",
    help="Vary one number in many trials: curves, maps, and the best value.",
    epilog=EPILOG,
)

_ROWS_SHOWN = 24  # of a map: a screen; the folder holds all
_NOTHING = 2  # every trial failed: what was asked for cannot be


def conducted(
    make: "Callable[[], Study]", run: StudyRun, as_json: bool, plan: Sequence[object] = ("cell", "plan")
) -> None:
    """Run a study and show what it says; `plan` is the command that plans its scene."""
    from cell.commands.terminal import Terminal
    from cell.study.study import conduct
    from cell.study.workers import open_workers

    terminal = Terminal(quiet_stdout=as_json)
    with open_workers(run.count, run.cluster) as workers:
        result = conduct(make(), workers, out=run.out, reporter=terminal, plan=plan)
    if as_json:
        print_json(result.summary())
    else:
        tell(terminal, result)
    if not result.rows:
        raise typer.Exit(_NOTHING)


def tell(terminal: "Terminal", result: "StudyResult") -> None:
    """What a study says; the rows are in its folder."""
    from cell.view.study_page import shown

    if result.rows:
        rows = [[shown(row.get(column)) for column in result.shown] for row in result.rows]
        terminal.grid(result.shown, rows, at_most=_ROWS_SHOWN)
        if len(rows) > _ROWS_SHOWN:
            terminal.say(f"all of them: {result.folder / 'rows.csv'}")
    for sentence in result.sentences:
        terminal.say(sentence.replace("**", "").replace("`", ""))  # they are Markdown
    kept = f"{result.computed} trials computed now" if result.rows else "nothing succeeded"
    failed = f", {len(result.failed)} failed (see report.md)" if result.failed else ""
    terminal.say(f"{kept}{failed}; study folder {result.folder}")
    best = "" if result.best is None else result.commands[result.best]
    terminal.then(("cell", "view", result.folder), *([shlex.split(best)] if best and "#" not in best else []))


def plan_words(part: str | None, scene: Path | None, wishes: Wishes) -> list[object]:
    """The command that plans the scene of a study's options."""
    given = [f"{flag(name)}={text}" for name, text in wishes.items()]
    return ["cell", "plan", *([part] if part else []), *(["--scene", scene] if scene else []), *given]


Robot = Annotated[bool, typer.Option("--robot", help="Use only views that the robot reaches at the scene's placement.")]


def scene_maker(part: str | None, scene: Path | None, wishes: Wishes) -> "SceneWith":
    """The scene of the options, with more keys changed by a study.

    Raises:
        UsageError: as `cell plan` does for its options.
    """
    own = option_tables(wishes, part, flag)

    def scene_with(more: Mapping[str, Mapping[str, object]]) -> Scene:
        asked = {table: {**own.get(table, {}), **more.get(table, {})} for table in {**own, **more}}
        return load_scene(scene, asked, option_names(own, flag))

    return scene_with


@app.command(epilog="Example:\n\ncell study placement mug --x 1000:1600:50 --y 300:900:50")
@from_fields
def placement(
    *,
    part: Part = None,
    x: Annotated[str, typer.Option(metavar="MM:MM:MM", help="First, last and step of x.")] = "1000:1600:50",
    y: Annotated[str, typer.Option(metavar="MM:MM:MM", help="First, last and step of y.")] = "300:900:50",
    z: Annotated[str, typer.Option(metavar="MM[:MM:MM]", help="Heights of the part's centre.")] = "0",
    yaw: Annotated[str, typer.Option(metavar="DEG[:DEG:DEG]", help="Turns about the vertical (A).")] = "0",
    scene: SceneFile = None,
    wishes: OfPart,
    run: StudyRun,
    as_json: AsJson = False,
) -> None:
    """Map where the part can stand: reach, coverage, views and cycle time over its position."""
    from cell.study.placement_map import placement_study
    from cell.study.ranges import values

    grids = [values(name, text) for name, text in (("--x", x), ("--y", y), ("--z", z), ("--yaw", yaw))]
    base = scene_maker(part, scene, wishes)({})
    conducted(
        lambda: placement_study(base, grids[0], grids[1], grids[2], grids[3]),
        run,
        as_json,
        plan_words(part, scene, wishes),
    )


@app.command(epilog="Example:\n\ncell study standoff mug --values 50:500:50")
@from_fields
def standoff(
    *,
    part: Part = None,
    values: Annotated[str, typer.Option(metavar="MM:MM:MM", help="First, last and step.")] = "50:500:50",
    robot: Robot = False,
    scene: SceneFile = None,
    wishes: OfPart,
    run: StudyRun,
    as_json: AsJson = False,
) -> None:
    """Find the scanning zone: views and coverage over the standoff distance."""
    from cell.study.curves import knob_study
    from cell.study.ranges import values as range_of

    wanted = range_of("--values", values)
    make = scene_maker(part, scene, wishes)
    conducted(lambda: knob_study(make, "standoff", wanted, robot=robot), run, as_json, plan_words(part, scene, wishes))


@app.command(
    epilog="Examples:\n\ncell study scanner mug --fov 10:90:10\n\n"
    "cell study scanner --range 50-150,100-300,200-600\n\n"
    "cell study scanner --sensors gocator-2340,gocator-2350 --baseline 100"
)
@from_fields
def scanner(
    *,
    part: Part = None,
    number: ScannerNumber,
    robot: Robot = False,
    scene: SceneFile = None,
    wishes: OfPart,
    run: StudyRun,
    as_json: AsJson = False,
) -> None:
    """Find the scanner: views and coverage over one of its numbers, or over real sensors. Give one of the options."""
    from cell.study.curves import Setting, knob_study
    from cell.study.ranges import pairs
    from cell.study.ranges import values as range_of

    given = number.model_dump(exclude_none=True)
    if given.keys() == {"sensors", "baseline"}:  # no sensor of the library states its baseline
        wishes = {**wishes, "baseline": given.pop("baseline")}
    if len(given) != 1:
        raise UsageError(
            "give one of --fov, --resolution, --baseline, --grazing, --range and --sensors, for instance --fov 10:90:10"
        )
    ((name, text),) = given.items()
    make = scene_maker(part, scene, wishes)
    wanted: Sequence[Setting]
    if name == "ranges":
        name, wanted = "range", pairs("--range", text)
    elif name == "sensors":
        from cell.scene import sensors as library

        complete = [name for name in library.names() if not library.load(name).not_stated.keys() - {"baseline_mm"}]
        wanted = complete if text == "all" else text.split(",")
    else:
        wanted = range_of(flag(name), text)
    conducted(lambda: knob_study(make, name, wanted, robot=robot), run, as_json, plan_words(part, scene, wishes))


for _name in ("speed", "stability"):
    add_moved(app, _name, f"cell study {_name}", f"python -m benchmarks {_name}")
for _name in ("table1", "table2", "table3", "table4", "table5", "all"):
    add_moved(app, _name, f"cell study {_name}", f"python -m benchmarks paper {_name}")
