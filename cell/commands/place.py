"""`cell place` as the command line gives it: a part and a range in, the best place and how sure it is out."""

import json
import os
import sys
from typing import Annotated

import typer

from cell.commands.options import Preset
from cell.commands.study import AsJson, Cluster, Out, Part, Processes, SceneFile, Units, scene_maker, tell

EPILOG = (
    "Examples:\n\n"
    "cell place mug\n\n"
    "cell place part.stl --units mm --x 900:1500 --y=-600:600 --z 0 --yaw 0\n\n"
    "Give the answer to cell plan --place. Exit codes: 0 done, 2 usage, 4 nothing reachable, 6 files, 70 bug, "
    "130 Ctrl-C."
)


def place(
    part: Part = None,
    x: Annotated[str, typer.Option(metavar="MM:MM", help="From and to, or one value.")] = "700:1600",
    y: Annotated[str, typer.Option(metavar="MM:MM", help="From and to, or one value.")] = "0:900",
    z: Annotated[str, typer.Option(metavar="MM:MM", help="Of the part's centre.")] = "-200:400",
    yaw: Annotated[str, typer.Option(metavar="DEG:DEG", help="Turn about the vertical (A).")] = "-180:180",
    seed: Annotated[int | None, typer.Option(help="Seed of the places that are looked at.")] = None,
    units: Units = None,
    scene: SceneFile = None,
    preset: Preset = None,
    processes: Processes = None,
    cluster: Cluster = None,
    out: Out = None,
    as_json: AsJson = False,
) -> None:
    """Search where the part should stand: most coverage, then fewest views, then the shortest cycle."""
    from cell.commands.terminal import Terminal
    from cell.study.place import Range, pictures, search, sentences
    from cell.study.ranges import span
    from cell.study.study import StudyResult, study_folder, write_folder
    from cell.study.workers import open_workers

    (x0, x1), (y0, y1), (z0, z1), (a0, a1) = (
        span(name, text) for name, text in (("--x", x), ("--y", y), ("--z", z), ("--yaw", yaw))
    )
    where = Range((x0, y0, z0, a0), (x1, y1, z1, a1))
    checked = scene_maker(part, units, scene, preset)({} if seed is None else {"plan": {"seed": seed}})
    folder = study_folder("place", out)
    terminal = Terminal(quiet_stdout=as_json)
    with (
        open_workers(os.cpu_count() or 1 if processes is None else processes, cluster) as workers,
        terminal.rounds() as progress,
    ):
        found = search(checked, where, workers, progress=progress)
    result = StudyResult(folder, found.ten, sentences(found), [], sum(found.places.values()), list(found.ten[0]))
    seconds = [{"round": name, "places": count} for name, count in found.places.items()]
    write_folder("place", "Where the part should stand", result, pictures(found), seconds)
    if as_json:
        sys.stdout.write(json.dumps(result.summary(), indent=2, allow_nan=False) + "\n")
    else:
        tell(terminal, result)
