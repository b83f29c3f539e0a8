"""Commands on plans: `cell plan`, `setups`, `edit`, `why` and `diff`."""

import shlex
import sys
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from cell.cli.options import (
    AsJson,
    NewRunFolder,
    NoCache,
    OptionValues,
    Part,
    RunFolder,
    SceneFile,
    SceneOptions,
    command,
    print_json,
)
from cell.errors import UsageError
from cell.plan.edit_options import Edit
from cell.plan.setup_options import SetupOptions
from cell.scene.file import scene_from_options
from cell.scene.model import Scene
from cell.scene.options import flag, option_specs

if TYPE_CHECKING:
    from cell.cli.terminal import Terminal
    from cell.report.diff import Difference
    from cell.runs.run import Run

_SceneOptionsOfSetups = Annotated[
    OptionValues, {name: spec for name, spec in option_specs(Scene).items() if name not in option_specs(SetupOptions)}
]


@command(
    "cell plan --place 1200,500,0",
    "cell plan part.stl --units mm --place 1200,500,0,90,0,0 --standoff 300 --faces 930 --coverage 0.95",
    "cell plan --scene my_cell.toml --seed 7 --json --out sim_runs/trial",
    "cell plan --max-views 8 --curve",
    "cell plan --overlap 20% --coverage 0.98",
    "cell plan --pose-sd 0.5mm,0.1deg --alpha 0.05 --coverage 0.98",
)
def plan(
    *,
    part: Part = None,
    scene: SceneFile = None,
    scene_options: SceneOptions,
    open_of: Annotated[list[Path] | None, typer.Option(hidden=True)] = None,
    out: NewRunFolder = None,
    as_json: AsJson = False,
    no_cache: NoCache = False,
) -> None:
    """Plan the views that measure a part: selection, reachability, order and motion."""
    from cell import api
    from cell.cli.terminal import Terminal
    from cell.report.plan_report import table
    from cell.runs.digest import SHORT_DIGEST
    from cell.runs.next_commands import after_plan

    terminal = Terminal(quiet_stdout=as_json)
    if open_of:
        raise UsageError(
            f"--open-of is replaced by the first set-up of cell setups: use cell setups --first {open_of[0]}"
        )
    run = api.plan(
        scene_from_options(scene, scene_options, part, flag), scene=scene, out=out, use_cache=not no_cache,
        progress=terminal, argv=sys.argv[1:],
    )  # fmt: skip
    rows = [*table(run.report), ("digest", run.digest[:SHORT_DIGEST]), ("run folder", str(run.folder))]
    following = after_plan(run, str(run.folder))
    terminal.print_result(
        run.as_json(), f"View plan of {run.report.part.name}", rows, ("cell", "view", run.folder), *following
    )
    raise typer.Exit(run.exit_code)


@command(
    "cell setups part.stl --units mm --place 1200,500,0",
    "cell setups mug --max-setups 2 --proposals 8 --coverage 0.95 --json",
    "cell setups mug --cost time --setup-seconds 300",
    "cell setups mug --table --proposals 6",
    "cell setups mug --proposals 4 --pin 0:168 --ban 0:1506",
    "cell setups --first sim_runs/trial",
    note="Each set-up is a run folder of its own in FOLDER/setups; cell scan FOLDER scans one after the other.",
)
def setups(
    *,
    part: Part = None,
    scene: SceneFile = None,
    scene_options: _SceneOptionsOfSetups,
    options: SetupOptions,
    out: NewRunFolder = None,
    as_json: AsJson = False,
    no_cache: NoCache = False,
) -> None:
    """Plan several set-ups of a part as one cover: fewest set-ups, then fewest views, each with a bound."""
    from cell import api
    from cell.cli.terminal import Terminal
    from cell.plan.setups import scene_after
    from cell.report.setups_report import rows

    terminal = Terminal(quiet_stdout=as_json)
    if options.first is not None and part is None and scene is None:
        checked = scene_after(api.open_run(options.first), scene_options, flag)
    else:
        checked = scene_from_options(scene, scene_options, part, flag)
    run = api.setups(
        checked, options, scene=scene, out=out, use_cache=not no_cache, progress=terminal, argv=sys.argv[1:]
    )
    terminal.print_result(
        run.as_json(), f"Set-ups of {run.file.part}", [*rows(run.file), ("folder", str(run.folder))],
        ("cell", "scan", run.folder, "--setup", 1), ("cell", "view", run.folder),
    )  # fmt: skip
    raise typer.Exit(run.exit_code)


@command(
    "cell edit sim_runs/trial --drop 4 --repair",
    "cell edit sim_runs/trial --turn 7:90 --keep-order --out sim_runs/turned",
    "cell edit sim_runs/trial --move 7:812,430,655,90,0,180",
    "cell edit sim_runs/trial --add-candidate 533 --add-pose 812,430,655,90,0,180",
    note="Views are named by their numbers in visiting order (the column stop of report.md). The edited plan is not "
    "changed.",
)
def edit(*, run: RunFolder, options: Edit, out: NewRunFolder = None, as_json: AsJson = False) -> None:
    """Change a plan by hand: drop, move, turn, add or reorder views. The result is a new, checked run."""
    from cell import api
    from cell.cli.terminal import Terminal
    from cell.report.plan_report import table
    from cell.runs.digest import SHORT_DIGEST

    terminal = Terminal(quiet_stdout=as_json)
    planned = api.open_run(run)
    new_run = api.edit(planned, options, out=out, progress=terminal, argv=sys.argv[1:])
    difference = api.diff(run, new_run, progress=terminal)
    rows = [
        *table(new_run.report), (f"against {run}", summarise(difference)), ("digest", new_run.digest[:SHORT_DIGEST]),
        ("run folder", str(new_run.folder)),
    ]  # fmt: skip
    surface = difference.surface
    is_repairable = planned.is_repairable and not options.repair
    repair = is_repairable and surface is not None and surface.only_a_mm2 > surface.only_b_mm2
    terminal.print_result(
        new_run.as_json() | {"against": difference.as_json()}, f"Edited view plan of {new_run.report.part.name}", rows,
        ("cell", "scan", new_run.folder), *([("cell", "edit", new_run.folder, "--repair")] if repair else []),
        ("cell", "diff", run, new_run.folder),
    )  # fmt: skip
    raise typer.Exit(new_run.exit_code)


def summarise(difference: "Difference") -> str:
    """Return gain and cost of the second plan in one line."""
    if difference.is_empty:
        return "nothing differs"
    values = {number.name: (number.a, number.b) for number in difference.numbers}
    facts = []
    if difference.surface is not None:
        gain, loss = difference.surface.only_b_mm2, difference.surface.only_a_mm2
        facts.append(f"gains {gain:,.0f} mm2 and loses {loss:,.0f} mm2 of the surface")
    for name, text in (
        ("views", "{:.0f} views instead of {:.0f}"),
        ("visible %", "visible {:.2f} % instead of {:.2f} %"),
        ("motion s", "motion {:.2f} s instead of {:.2f} s"),
        ("smallest clearance mm", "nearest {:.1f} mm instead of {:.1f} mm"),
    ):
        a, b = values.get(name, (None, None))
        if a is not None and b is not None:
            facts.append(text.format(b, a))
    return "; ".join(facts)


@command(
    "cell why sim_runs/trial",
    "cell why sim_runs/trial --samples 20000 --json",
    "cell why sim_runs/trial --advise",
    note="Writes why.json, why.ply, why.png and view.html to why/ in the run folder; the plan is not changed.",
)
def why(
    *,
    run: RunFolder,
    samples: Annotated[
        int | None, typer.Option(metavar="N", help="Number of surface samples. Default: 100,000, as in coverage.")
    ] = None,
    advise: Annotated[
        bool, typer.Option("--advise", help="Instead of causes: gain of a second set-up or of another placement.")
    ] = False,
    as_json: AsJson = False,
) -> None:
    """Explain the uncovered surface by cause and area, with the smallest single change that would measure it."""
    from cell import api
    from cell.cli.terminal import Terminal
    from cell.runs.run import open_run
    from cell.why.explain import TABLE_COLUMNS, table_rows

    terminal = Terminal(quiet_stdout=as_json)
    if advise:
        _advise(run, terminal, as_json=as_json)
        return
    outcome = api.why(run, samples=samples, progress=terminal)
    summary = outcome.summary
    if as_json:
        print_json(summary.as_json())
        return
    if summary.groups:
        title = f"Uncovered surface of {summary.part}: {100 * summary.uncovered:.2f} %"
        terminal.print_table(TABLE_COLUMNS, table_rows(summary), title)
    else:
        terminal.print("the whole surface is covered")
    terminal.print(f"files: {outcome.folder}")
    settings = [change.setting for group in summary.groups for change in group.changes]
    better = [command for setting in settings if (command := _command_of(setting, open_run(run)))][:1]
    terminal.suggest(*better, ("cell", "scan", run))


def _command_of(setting: str, run: "Run") -> tuple[str, ...] | None:
    """Return the command that makes a change of `cell why`; None if no option does."""
    from cell.why.advise import without_options

    words = shlex.split(setting)
    if words[:1] == ["cell"]:
        return tuple(str(run.folder) if word == "RUN" else word for word in words)
    if not setting.startswith("--") or run.manifest.argv[:1] != ("plan",):
        return None
    planned = [word for word in run.manifest.argv if word != "--json"]
    return "cell", *without_options(planned, "--out", words[0]), *words


def _advise(run: Path, terminal: "Terminal", *, as_json: bool) -> None:
    from cell import api

    visible, advice_list = api.advise(run, progress=terminal)
    if as_json:
        print_json({"visible": visible, "advice": [advice.as_json() for advice in advice_list]})
        return
    rows = [
        (str(number), advice.what, f"{100 * advice.share:.2f} % (+- {100 * advice.standard_error:.2f})")
        for number, advice in enumerate(advice_list, 1)
    ]
    title = f"This plan measures {100 * visible:.2f} % of the surface"
    terminal.print_table(("", "change", "coverage, at least (found by search)"), rows, title)
    for number, advice in enumerate(advice_list, 1):
        terminal.print(f"{number}: {advice.command}")


@command(
    "cell diff sim_runs/trial sim_runs/other",
    "cell diff sim_runs/trial sim_runs/other --out diff.html",
    "cell diff sim_runs/trial/executions/0001 sim_runs/trial/executions/0002 --json",
    "cell diff before.ply after.ply --points-units mm",
    note="A view is kept if the other run has one at the same pose relative to the part, and moved if the other run "
    "has one that measures mostly the same surface from another pose.",
)
def diff(
    *,
    a: Annotated[Path, typer.Argument(help="Run folder of a finished cell plan, of an execution, or file of points.")],
    b: Annotated[Path, typer.Argument(help="The other one, of the same kind.")],
    out: Annotated[
        Path | None,
        typer.Option(metavar="FILE.html", help="Page to write: the part coloured by gained and lost surface."),
    ] = None,
    points_units: Annotated[
        str | None, typer.Option("--points-units", metavar="UNIT", help="Unit of two files of points. Never guessed.")
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Compare two plans or two executions: settings, views, gained and lost surface, time and clearance."""
    from cell import api
    from cell.cli.terminal import Terminal

    terminal = Terminal(quiet_stdout=as_json)
    if a.is_file() and b.is_file():
        _diff_clouds(terminal, a, b, points_units, as_json=as_json)
        return
    difference = api.diff(a, b, out=out, progress=terminal)
    if as_json:
        print_json(difference.as_json())
    elif difference.is_empty:
        terminal.print("nothing differs")
    else:
        _print_difference(terminal, difference)
        if out is not None:
            terminal.print(f"page: {out}")
        page = [("cell", "diff", a, b, "--out", "diff.html")] if out is None and difference.surface is not None else []
        replay = "cell", "replay", b.parent.parent, "--execution", b.name
        terminal.suggest(*page, ("cell", "scan", b) if difference.kind == "plan" else replay)


def _diff_clouds(terminal: "Terminal", a: Path, b: Path, units: str | None, *, as_json: bool) -> None:
    """Print the difference of two files of points."""
    from cell.metrology.cloud_diff import compare_clouds
    from cell.part.workpiece import UNITS

    if units not in UNITS:
        raise UsageError(f"{a} and {b} do not state their unit; give --points-units with one of {', '.join(UNITS)}")
    result = compare_clouds(a, b, units)
    if as_json:
        print_json(result.as_json())
        return
    rows = [
        ("points", f"{result.points_a:,} in A, {result.points_b:,} in B, spacing of A {result.spacing_mm:.4g} mm"),
        ("distance of B from A", f"{result.rms_mm:.4f} mm rms, 95 % within {result.quantile_95_mm:.4f} mm, largest "
                                 f"{result.largest_mm:.4f} mm"),
        ("only in one", f"{result.only_a:.2%} of A, {result.only_b:.2%} of B"),
    ]  # fmt: skip
    terminal.print_table(("", ""), rows)


def _print_difference(terminal: "Terminal", difference: "Difference") -> None:
    from cell.report.diff import format_value

    for heading, values in (
        ("setting", [(each.key, each.a, each.b) for each in difference.settings]),
        ("figure", [(each.name, each.a, each.b) for each in difference.numbers]),
    ):
        if values:
            rows = [(name, format_value(a), format_value(b)) for name, a, b in values]
            terminal.print_table((heading, "A", "B"), rows)
    views = difference.views
    moved = [
        (f"{each.a} moved, now {each.b}", f"{each.distance_mm:.1f} mm, {each.angle_deg:.1f} deg, shared area "
         f"{100 * each.intersection_over_union:.0f} % of the union")
        for each in views.similar
    ]  # fmt: skip
    equal_views = _list(f"{a}" if a == b else f"{a} as {b}" for a, b in views.equal)
    single = [("only in A", _list(map(str, views.only_a))), ("only in B", _list(map(str, views.only_b)))]
    terminal.print_pairs("Views, by their numbers in visiting order", [("kept", equal_views), *moved, *single])
    surface = difference.surface
    if surface is None:
        terminal.print("the two parts are different meshes: gained and lost surface cannot be computed")
    else:
        percent = 100 / surface.area_mm2
        terminal.print(
            f"B measures {surface.only_b_mm2:.0f} mm2 ({percent * surface.only_b_mm2:.2f} %) that A does not, and "
            f"misses {surface.only_a_mm2:.0f} mm2 ({percent * surface.only_a_mm2:.2f} %) that A measures."
        )


def _list(numbers: Iterable[str]) -> str:
    return ", ".join(numbers) or "none"
