"""`python -m benchmarks speed`: seconds and error of the numbers that trade speed for accuracy.

A row has the seconds of its trial on the machine of the trial: compare rows of one run on one machine, not rows of
different runs. Errors and views are the same on all machines.
"""

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any

import typer

from benchmarks.methods.knobs import KNOBS, Knob, Value, turn
from benchmarks.methods.speed_charts import by_knob, label, pictures
from cell.cli.options import SceneFile, from_fields
from cell.cli.study import run_and_print
from cell.errors import UsageError
from cell.scene.model import Scene
from cell.study.options import StudyRun
from cell.study.prepared_part import scene_settings
from cell.study.study import Row, Study, scene_maker
from cell.study.trials import Outcome, Trial

ELSEWHERE = {
    "rays": "fill",
    "solver": "cover",
    "collision": "fidelity",
    "edges": "edge_resolution",
    "ordering": "gtsp",
    "grid": "reconstruction",
    "plant": "plant",
}
"""What else trades speed for accuracy, and the benchmark that measures it."""

_COLUMNS = ("knob", "part", "value", "seconds", "processor s", "error", "unit", "views")

app = typer.Typer(add_completion=False)


@app.command()
@from_fields
def speed(
    *,
    run: StudyRun,
    names: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="[KNOB ...]",
            help=f"{', '.join(KNOBS)}. Default: all.",
            show_default=False,
        ),
    ] = None,
    part: Annotated[str | None, typer.Option(help="Built-in part or mesh file. Default: the scene's.")] = None,
    scene: SceneFile = None,
    values: Annotated[str | None, typer.Option(metavar="V,V,...", help="In place of a single knob's range.")] = None,
    repeats: Annotated[int, typer.Option(min=1, help="Runs of each work, of which the best counts.")] = 3,
) -> None:
    """Chart speed against accuracy: seconds and error of each knob."""
    knobs = select_knobs(names or [])
    if values is not None and len(knobs) != 1:
        raise UsageError("--values are those of one knob; name it, for instance samples --values 1,4")
    settings = None if values is None else KNOBS[knobs[0]].parsed(values)
    base = scene_maker(part, scene, {})({})
    study = speed_study([(name, base) for name in knobs], values=settings, repeats=repeats)
    alone = run.model_copy(update={"processes": run.processes or 1})  # several processes would disturb the timing
    run_and_print(lambda: study, alone, as_json=False)


def select_knobs(names: Sequence[str]) -> list[str]:
    """Return the requested knobs; without names all of them.

    Raises:
        UsageError: if a name is not a knob; the message names the benchmark that measures it.
    """
    known = [*KNOBS]
    for name in names:
        if name in ELSEWHERE:
            raise UsageError(f"{name} is no knob here; python -m benchmarks {ELSEWHERE[name]} measures it")
        if name not in known:
            raise UsageError(f"there is no knob {name}; there are {', '.join(known)}")
    return list(dict.fromkeys(names)) or known


def speed_study(
    turns: Sequence[tuple[str, Scene]], *, values: Sequence[Value] | None = None, repeats: int = 3
) -> Study:
    """Return the study of the requested knobs.

    Args:
        turns: name and scene of each knob.
        values: values in place of the range of a knob, if there is only one knob.
        repeats: runs of each work, the best of which counts.
    """
    turned = [
        (name, scene, value, Trial.of(turn, {**own, "knob": name, "value": value, "repeats": repeats}))
        for name, scene, own in ((name, scene, scene_settings(scene)) for name, scene in turns)
        for value in (values or KNOBS[name].values)
    ]

    def rows(outcomes: Sequence[Outcome]) -> list[Row]:
        found = {outcome.trial: outcome for outcome in outcomes}
        return [_row(name, scene, value, found[trial]) for name, scene, value, trial in turned if trial in found]

    trials = [trial for *_, trial in turned]
    return Study("speed", "Speed against accuracy", trials, rows, pictures, sentences, _COLUMNS)


def _part(scene: Scene) -> str:
    return scene.part.name if scene.part.path is None else Path(scene.part.path).stem


def _row(name: str, scene: Scene, value: Value, outcome: Outcome) -> Row:
    return {
        "knob": name,
        "part": _part(scene),
        "value": value,
        "seconds": outcome.seconds["work"],
        "processor s": outcome.seconds["processor"],
        "error": outcome.values["error"],
        "unit": KNOBS[name].error_unit,
        **outcome.values["more"],
    }


def sentences(rows: Sequence[Row]) -> list[str]:
    """Return for each knob the cost and the benefit of a step from the default to either side."""
    return [
        _sentence(name, KNOBS[name], line)
        for name, line in by_knob(rows).items()
        if any(row["value"] == KNOBS[name].default for row in line)
    ]


def _sentence(name: str, knob: Knob, line: Sequence[Row]) -> str:
    usual = next(row for row in line if row["value"] == knob.default)
    at = line.index(usual)
    steps = []
    for row in [*line[max(0, at - 1) : at], *line[at + 1 : at + 2]]:
        ratio = row["processor s"] / usual["processor s"] if usual["processor s"] else math.nan
        steps.append(f"at {label(knob, row)} {ratio:.2f} times the time and {_error(row)}")
    return (
        f"**{name}** ({knob.title}; {knob.measure}): {_error(usual)} at the default of {label(knob, usual)}; "
        f"{'; '.join(steps)}."
    )


def _error(row: Mapping[str, Any]) -> str:
    return f"{row['error']:.3g} {row['unit']}"
