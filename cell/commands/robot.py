"""`cell robot` as the command line gives it: an arm's file in, a table or one JSON object and a picture out."""

from pathlib import Path
from typing import Annotated

import typer

from cell.commands.options import AsJson, print_json
from cell.errors import UsageError

EPILOG = (
    "Examples:\n\n"
    "cell robot ur5e.urdf --out ur5e.png\n\n"
    "cell robot kr10.urdf --package kuka_kr10_support=../kuka_experimental/kuka_kr10_support\n\n"
    'A scene names the arm as [robot] model = "ur5e.urdf"; see docs/robots.md.\n\n'
    "Exit codes: 0 done, 2 usage or no arm that can be planned with, 6 files, 70 bug."
)


def robot(
    file: Annotated[Path, typer.Argument(help="URDF or MJCF of the arm.", show_default=False)],
    base_link: Annotated[str | None, typer.Option(help="Link that is its base. Default: the root.")] = None,
    flange_link: Annotated[
        str | None, typer.Option(help="Link that is its flange. Default: tool0, flange, or another usual name.")
    ] = None,
    package: Annotated[
        list[str] | None, typer.Option(metavar="NAME=DIR", help="Where a ROS package is that the file names.")
    ] = None,
    out: Annotated[Path | None, typer.Option(metavar="FILE.png", help="Draw the arm at home.")] = None,
    as_json: AsJson = False,
) -> None:
    """Say what is recognised of a robot's file: its axes, lengths, limits, what is missing, which links touch."""
    from cell.commands.terminal import Terminal
    from cell.world.robot_report import report

    packages = {}
    for text in package or []:
        name, is_given, folder = text.partition("=")
        if not is_given:
            raise UsageError(f"--package is NAME=DIR, and {text} has no =")
        packages[name] = str(Path(folder).absolute())
    terminal = Terminal(quiet_stdout=as_json)
    with terminal.stage("read the arm"):
        found, model = report(file, base_link, flange_link, packages)
    if as_json:
        print_json(found.summary())
    else:
        terminal.pairs(f"Robot {file.name}", found.rows())
    if out is not None:
        from cell.view.cell_picture import draw_robot
        from cell.view.rays import save

        save(draw_robot(model), out)
        terminal.say(str(out))
