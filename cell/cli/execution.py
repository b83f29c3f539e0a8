"""Commands on the real or simulated cell: `cell scan`, `explore`, `locate`, `calibrate`, `controller`, `emulate`."""

import shlex
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, NoReturn

import typer

from cell.cli.options import AsJson, OptionValues, Part, RunFolder, SceneFile, SceneOptions, command, print_json
from cell.errors import UsageError
from cell.explore.options import SCAN_OPTIONS, ExploreOptions
from cell.files import unused_path
from cell.metrology.options import HandEyeOptions, LocateOptions
from cell.scan.emulator_options import EmulateOptions
from cell.scan.options import REAL_ROBOT, ScanOptions
from cell.scene.file import scene_from_options
from cell.scene.options import flag, option_specs, parse_options

if TYPE_CHECKING:
    from cell.cli.terminal import Terminal
    from cell.session import Confirm, Session

_NOT_DETERMINED = 2  # exit code
_MOVED_PLAN = "The plan there"  # panel of options
_OF_THE_PART = ("units", "place", "place_origin", "max_views")  # options of an exploration that its model does not have

calibrate_app = typer.Typer(
    no_args_is_help=True, rich_markup_mode="rich", help="Measure the cell itself for the scene file."
)


@command(
    "cell scan sim_runs/trial",
    "cell scan sim_runs/trial --pose-error 0.5mm,0.1deg --range-noise 0.02 --seed 4",
    "cell scan sim_runs/trial --view 3 --resolution 0.5 --realtime",
    "cell scan sim_runs/trial --report 0001",
    "cell scan sim_runs/trial --driver modbus://192.168.0.10:502 --speed 0.1",
    "cell scan sim_runs/trial --resume latest --reset",
    "cell scan sim_runs/both --setup 1 --setup-error 5mm,2deg --range-noise 0.03",
    note="A report of an execution without all views ends with code 6.",
)
def scan(
    *,
    run: Annotated[Path, typer.Argument(help="Run folder of a finished cell plan, or the folder of cell setups.")],
    options: ScanOptions,
    setup: Annotated[
        int | None, typer.Option(min=1, help="Set-up of a folder of cell setups. Default: all unscanned ones.")
    ] = None,
    resume: Annotated[
        str | None,
        typer.Option(
            metavar="ID",
            help="Resume this execution (or latest) at the first unconfirmed view; if the arm is elsewhere, on a new "
            "approach path.",
            rich_help_panel=REAL_ROBOT,
        ),
    ] = None,
    report: Annotated[
        str | None,
        typer.Option(
            metavar="ID",
            help="Scan nothing: write the report of this execution (or latest) again from its files.",
            rich_help_panel="Output",
        ),
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Execute a plan on a controller, scan at every view, merge the scans, reconstruct the surface and evaluate it."""
    from cell import api
    from cell.cli.terminal import Terminal
    from cell.report import scan_report
    from cell.scan import results
    from cell.scan import scan as scan_command
    from cell.scan.results import ScanOutcome

    options.require_compatible(resume, report)
    terminal = Terminal(quiet_stdout=as_json)
    if (run / "setups.json").is_file():
        _scan_setups(run, options, setup, resume, report, terminal)
    if setup is not None:
        raise UsageError(f"--setup needs a folder of cell setups, and {run} is a single run; omit --setup")
    if report is not None:
        outcome = results.make_report(_session(terminal), run, report)
    elif resume is not None:
        outcome = scan_command.resume(_session(terminal), run, resume, options)
    else:
        executed = api.scan(run, options, progress=terminal, argv=sys.argv[1:], ask=_confirm(terminal))
        outcome = ScanOutcome(executed.folder, executed.exit_code, executed.report)
    number = outcome.folder.name
    missing = [("cell", "scan", run, "--resume", number)] if outcome.report.missing_views else []
    terminal.print_result(
        outcome.report.as_json(), f"Scan of {outcome.report.part.name}",
        [*scan_report.table(outcome.report), ("execution", str(outcome.folder))],
        *missing, ("cell", "replay", run, "--execution", number),
    )  # fmt: skip
    raise typer.Exit(outcome.exit_code)


def _scan_setups(
    folder: Path, options: ScanOptions, setup: int | None, resume: str | None, report: str | None, terminal: "Terminal"
) -> NoReturn:
    """Scan the set-ups of a folder, or write the report of their combined scans."""
    from cell import api
    from cell.report.scan_report import combined_rows
    from cell.runs.setups import SetupsRun
    from cell.scan.setups import combine_setups as report_of

    for option, value in (("--resume", resume), ("--report", report)):
        if value not in (None, "latest"):
            raise UsageError(f"{option} of several set-ups takes the latest execution of each: {option} latest")
    if report is not None:
        outcome = report_of(_session(terminal), SetupsRun.opened(folder))
    else:
        outcome = api.scan_setups(
            folder, options, setup=setup, resume=resume is not None, progress=terminal, argv=sys.argv[1:],
            ask=_confirm(terminal),
        )  # fmt: skip
    result = outcome.report
    following = [("cell", "scan", folder, "--setup", result.missing_setups[0])] if result.missing_setups else []
    terminal.print_result(
        result.as_json(),
        f"Scan of {result.part}",
        [*combined_rows(result), ("folder", str(outcome.folder))],
        *following,
    )
    raise typer.Exit(outcome.exit_code)


def _session(terminal: "Terminal") -> "Session[None]":
    from cell.session import Origin, Session

    return Session(None, terminal, confirm=_confirm(terminal), origin=Origin(tuple(sys.argv[1:])))


def _confirm(terminal: "Terminal") -> "Confirm | None":
    """Return the function that asks the person at the terminal; None without a terminal."""
    return terminal.ask if sys.stdin.isatty() and sys.stderr.isatty() else None


@command(
    "cell explore mug --place 1200,500,0",
    "cell explore part.stl --units mm --place 1200,500,0 --policy two-stage --out sim_runs/first",
    "cell explore --cylinder 200,120 --place 1100,300,60 --acquire command:./take --points-frame scanner "
    "--points-units mm --driver modbus://192.168.0.10:502",
    note="The same command with the same --out resumes a stopped exploration.",
)
def explore(
    *,
    part: Part = None,
    scene: SceneFile = None,
    options: ExploreOptions,
    scanning: Annotated[OptionValues, option_specs(ScanOptions, *SCAN_OPTIONS)],
    scene_options: SceneOptions,
    out: Annotated[
        Path | None,
        typer.Option(help="Folder to make, or to resume. Default: sim_runs/explore-<UTC>.", rich_help_panel="Output"),
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Measure a part without a model: first views of its cylinder, then the uncovered surface, batch by batch.

    PART is in the simulated cell; the planning does not use it. --max-views is the budget of views.
    """
    from cell import api
    from cell.cli.terminal import Terminal
    from cell.study.study import plan_command

    terminal = Terminal(quiet_stdout=as_json)
    checked = scene_from_options(scene, scene_options, part, flag)
    scans = parse_options(ScanOptions, scanning, flag)
    exploration = api.explore(
        checked, options, scanning=scans, out=out, progress=terminal, argv=sys.argv[1:], ask=_confirm(terminal)
    )
    following = []
    if exploration.place_mm is not None:
        place = ",".join(f"{value:g}" for value in exploration.place_mm)
        in_cell = {name: value for name, value in scene_options.items() if name not in _OF_THE_PART}
        planned = {**in_cell, "units": "mm", "place": place}
        following = [plan_command(exploration.folder / exploration.file.model, scene, planned)]
    rows = [*exploration.file.rows(), ("folder", str(exploration.folder))]
    terminal.print_result(exploration.file.as_json(), f"Exploration of {exploration.file.part}", rows, *following)


@command(
    "cell locate sim_runs/trial --execution latest",
    "cell locate sim_runs/trial --points scans --points-frame scanner --points-units mm --view 1,4",
    "cell locate sim_runs/trial --pairs touched.csv --points-frame base --points-units mm --out sim_runs/there",
    "cell locate sim_runs/trial --three-two-one touched.csv --points-frame base --points-units mm --point-sd 0.05",
    note="The plan is not changed; --out makes another one, whose views have moved with the part. If the points do not "
    "determine the placement, the exit code is 2.",
)
def locate(
    *,
    run: RunFolder,
    options: LocateOptions,
    out: Annotated[
        Path | None,
        typer.Option(
            help="Run folder to make: the plan with its views at the found placement.", rich_help_panel=_MOVED_PLAN
        ),
    ] = None,
    repair: Annotated[
        bool,
        typer.Option(
            "--repair",
            help="Drop views that the arm cannot reach there, and add the fewest others that restore the coverage.",
            rich_help_panel=_MOVED_PLAN,
        ),
    ] = False,
    keep_planned: Annotated[
        bool,
        typer.Option(
            "--keep-planned",
            help="Use the planned placement along directions that the points do not determine.",
            rich_help_panel=_MOVED_PLAN,
        ),
    ] = False,
    as_json: AsJson = False,
) -> None:
    """Find the true placement of the part from points measured on it, and move the plan there."""
    from cell import api
    from cell.cli.terminal import Terminal
    from cell.report.plan_report import table
    from cell.runs.digest import SHORT_DIGEST

    if out is None and (repair or keep_planned):
        raise UsageError("--repair and --keep-planned belong to the plan that --out makes; give --out")
    terminal = Terminal(quiet_stdout=as_json)
    placement = api.locate(run, options, progress=terminal)
    if not as_json:
        terminal.print_pairs(f"Placement of the part of {run}", placement.rows())
    if out is None:
        if as_json:
            print_json(placement.as_json())
        else:
            again = [word for word in sys.argv[1:] if word != "--json"]
            keep = ["--keep-planned"] if placement.free_motions else []
            mend = (
                ["--repair"] if not placement.motion_check.keeps_clearance and api.open_run(run).is_repairable else []
            )
            terminal.suggest(("cell", *again, "--out", unused_path(Path("sim_runs/there")), *keep, *mend))
        return
    if not keep_planned:
        placement.require_determined()
    new_run = api.edit(
        run, repair=repair, T_base_object=placement.T_base_object, out=out, progress=terminal, argv=sys.argv[1:]
    )
    rows = [*table(new_run.report), ("digest", new_run.digest[:SHORT_DIGEST]), ("run folder", str(new_run.folder))]
    terminal.print_result(
        {**placement.as_json(), "made": new_run.as_json()}, "The plan there", rows,
        ("cell", "scan", new_run.folder), ("cell", "diff", run, new_run.folder),
    )  # fmt: skip
    raise typer.Exit(new_run.exit_code)


@calibrate_app.callback()
def _group() -> None:
    """Keep hand-eye a subcommand although the group has no other."""


@command(
    "cell calibrate hand-eye raw/0001.ply raw/0002.ply raw/0003.ply raw/0004.ply --points-units m --diameter 38.1",
    "cell calibrate hand-eye 1.ply 2.ply 3.ply 4.ply --target plane --points-units mm --poses flange.csv",
    note="The target is fixed. Rotate the flange about at least two axes, and see the target in the corners of the "
    "field of view, from near and far (docs/acquisition.md). If they do not determine the mount, the exit code is 2.",
    name="hand-eye",
    group=calibrate_app,
)
def hand_eye(
    *,
    files: Annotated[
        list[Path],
        typer.Argument(metavar="SCAN...", help="Scans of the target, scanner frame (files as for cell locate)."),
    ],
    options: HandEyeOptions,
    as_json: AsJson = False,
) -> None:
    """Find the mount (flange to scanner) from scans of a sphere or a plane from several poses."""
    from cell import api
    from cell.cli.terminal import Terminal

    terminal = Terminal(quiet_stdout=as_json)
    result = api.calibrate_hand_eye(files, options, progress=terminal)
    terminal.print_result(result.as_json(), f"Mount from {len(files)} scans of a {result.target}", result.rows())
    if result.free_motions:
        terminal.note(
            "these poses do not determine the mount; scan the target from poses that are rotated about other axes, "
            "with the target elsewhere in the field of view"
        )
        raise typer.Exit(_NOT_DETERMINED)
    if not as_json:
        terminal.print(result.lines)


@command(
    "cell controller kvp --out usb_stick",
    "cell controller rsi --out usb_stick --address 192.168.0.20",
    note="docs/drivers.md describes the set-up at the controller.",
)
def controller(
    *,
    protocol: Annotated[str, typer.Argument(metavar="kvp|rsi", help="Protocol of the driver.")],
    out: Annotated[Path, typer.Option(help="Folder for the files.", metavar="DIR")],
    run: Annotated[Path | None, typer.Option(help="Run folder with the arm. Default: the built-in arm.")] = None,
    address: Annotated[
        str, typer.Option(help="rsi: address of this computer in the network of the controller.")
    ] = "192.168.0.20",
    port: Annotated[int, typer.Option(min=1, max=65535, help="rsi: UDP port of this computer.")] = 49152,
    cycle_ms: Annotated[int, typer.Option(help="rsi: cycle of the controller, 4 or 12 ms.")] = 4,
    timer: Annotated[int, typer.Option(min=1, max=32, help="kvp: $TIMER that watches the client.")] = 10,
) -> None:
    """Write the files that a KUKA controller needs to be driven online (`kvp://`, `rsi://`)."""
    from cell.scan import emulator

    for path in emulator.write_controller_files(protocol, out, run, address, port, cycle_ms, timer):
        sys.stdout.write(f"{path}\n")


@command(
    "cell emulate serial --link /tmp/kr16 --state arm.json",
    "cell emulate modbus --port 5020 --time-scale 10",
    "cell emulate modbus --run sim_runs/trial --plant mujoco",
    "cell emulate ur --run sim_runs/ur5e",
    "cell emulate kvp --port 7000",
    "cell emulate rsi --cycle-ms 12",
    "cell emulate modbus-rtu --faults drop=0.01,delay=0.02:0.3,estop@12.5 --seed 4 --log moves.jsonl",
    note="The first line on stdout is the driver URL: cell scan sim_runs/trial --driver URL. Ctrl-C ends it.",
)
def emulate(
    *,
    protocol: Annotated[
        str, typer.Argument(metavar="serial|modbus|modbus-rtu|ur|kvp|rsi", help="Protocol of the controller.")
    ],
    options: EmulateOptions,
) -> None:
    """Put a simulated controller behind a pseudo-terminal or a loopback socket, to be used like hardware."""
    from cell.scan import emulator

    if protocol not in emulator.PROTOCOLS:
        raise UsageError(f"cell emulate {protocol}: unknown protocol; valid are: {', '.join(emulator.PROTOCOLS)}")
    if options.link is not None and protocol in emulator.ON_A_PORT:
        raise UsageError(f"--link is for pseudo-terminals; cell emulate {protocol} has --port")
    if options.port and protocol not in emulator.ON_A_PORT:
        raise UsageError(
            f"--port is for cell emulate {', '.join(emulator.ON_A_PORT)}; cell emulate {protocol} has --link"
        )
    arm = emulator.load_arm(options.run, options.plant)
    emulator.emulate(protocol, options, arm, lambda url: _announce(url, options.run, options.time_scale))


def _announce(url: str, run: Path | None, time_scale: float) -> None:
    sys.stdout.write(f"{url}\n")
    sys.stdout.flush()
    scaled = "" if time_scale == 1.0 else f" --accept-time-scale {time_scale:g}"
    plan = "RUN" if run is None else shlex.quote(str(run))
    sys.stderr.write(
        "cell: an emulated arm (not a real one) is available at this URL until Ctrl-C\n"
        f"next, in another terminal:\n  cell scan {plan} --driver {shlex.quote(url)}{scaled}\n"
    )
