"""`cell place` as the command line gives it: a part and a range in, the best place and how sure it is out."""

import shlex
from typing import Annotated

from cell.commands.options import AsJson, Part, SceneFile, Wishes, from_fields, print_json
from cell.commands.study import plan_words, tell
from cell.scene.file import scene_from_options
from cell.scene.model import Scene
from cell.scene.options import flag, option_specs
from cell.study.options import PlaceRange, StudyRun

EPILOG = (
    "Examples:\n\n"
    "cell place mug\n\n"
    "cell place part.stl --units mm --x 900:1500 --y=-600:600 --z 0 --yaw 0\n\n"
    "Give the answer to cell plan --place. Exit codes: 0 done, 2 usage, 4 nothing reachable, 6 files, 70 bug, "
    "130 Ctrl-C."
)


@from_fields
def place(
    *,
    part: Part = None,
    where: PlaceRange,
    scene: SceneFile = None,
    wishes: Annotated[Wishes, option_specs(Scene, "units", "seed", "table")],
    run: StudyRun,
    as_json: AsJson = False,
) -> None:
    """Search where the part should stand: most coverage, then fewest views, then the shortest cycle."""
    from cell.commands.terminal import Terminal
    from cell.study.place_search import pictures, search, sentences
    from cell.study.placement_map import place_option
    from cell.study.study import StudyResult, study_folder, write_folder
    from cell.study.workers import open_workers

    checked = scene_from_options(scene, wishes, part, flag)
    folder = study_folder("place", run.out)
    terminal = Terminal(quiet_stdout=as_json)
    with (
        open_workers(run.count, run.cluster) as workers,
        terminal.rounds() as progress,
    ):
        found = search(checked, where, workers, progress=progress)
    plan = shlex.join(map(str, plan_words(part, scene, wishes)))
    commands = [f"{plan} {place_option(row)}" for row in found.ten]
    result = StudyResult(
        folder, found.ten, sentences(found), [], sum(found.places.values()), list(found.ten[0]), commands, 0
    )
    seconds = [{"round": name, "places": count} for name, count in found.places.items()]
    write_folder("place", "Where the part should stand", result, pictures(found), seconds)
    if as_json:
        print_json(result.summary())
    else:
        tell(terminal, result)
