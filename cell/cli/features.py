"""Commands on features: `cell features` and `cell inspect`."""

import tempfile
from pathlib import Path
from typing import Annotated

import typer

from cell.cli.options import AsJson, OptionValues, Part, SceneFile, command
from cell.metrology.options import InspectOptions
from cell.scene.file import scene_from_options
from cell.scene.model import PART, Scene
from cell.scene.options import flag, option_specs

_PartOfCommand = Annotated[
    str | None, typer.Option(help="STEP file of the part. Default: the scene's.", rich_help_panel=PART)
]


@command(
    "cell features part.stp --qif part.qif",
    "cell features --scene my_cell.toml --out listed",
    note="The characteristics are those of [[feature]] in the scene and of the QIF file (docs/inspection.md).",
)
def features(
    *,
    part: Part = None,
    scene: SceneFile = None,
    scene_options: Annotated[OptionValues, option_specs(Scene, "units", "qif")],
    out: Annotated[
        Path | None, typer.Option(metavar="FOLDER", help="Folder of features.png. Default: a temporary one.")
    ] = None,
    as_json: AsJson = False,
) -> None:
    """List features and characteristics of a part with their tolerances and datums, and draw them."""
    from cell import api
    from cell.cli.terminal import Terminal
    from cell.inspect.pictures import features_picture
    from cell.part import workpiece

    terminal = Terminal(quiet_stdout=as_json)
    checked = scene_from_options(scene, scene_options, part, flag)
    with terminal.stage("read the features"):
        plan = api.features(checked)
    folder = Path(tempfile.mkdtemp(prefix="cell-features-")) if out is None else out
    with terminal.stage("draw the features"):
        folder.mkdir(parents=True, exist_ok=True)
        loaded = workpiece.load(checked.part.source, checked.part.units)
        features_picture(folder / "features.png", loaded.reference, plan, None)
    if not as_json:
        numbered = [
            [str(k), each.name, each.description, each.datum or "", ", ".join(map(str, each.faces))]
            for k, each in enumerate(plan.features, 1)
        ]
        terminal.print_table(["", "feature", "element", "datum", "faces"], numbered, at_most=len(numbered))
        rows = [
            [str(each.id), each.name, each.feature, each.kind, each.tolerance_text, each.note]
            for each in plan.characteristics
        ]
        heading = ["", "characteristic", "feature", "kind", "tolerance", "note"]
        terminal.print_table(heading, rows, at_most=len(rows))
    for sentence in plan.notes:
        terminal.note(sentence)
    for sentence in plan.unsupported:
        terminal.note(f"not supported: {sentence}")
    words = [
        *([part] if part else []), *(["--scene", scene] if scene else []),
        *(f"{flag(name)}={text}" for name, text in scene_options.items()),
    ]  # fmt: skip
    counts = [
        ("characteristics", f"{len(plan.characteristics)} supported, {len(plan.unsupported)} items not supported"),
        ("features", str(len(plan.features))),
        ("picture", str(folder / "features.png")),
    ]
    terminal.print_result(plan.as_json(), f"Features of {loaded.name}", counts, ("cell", "plan", *words))


@command(
    "cell inspect scan.ply --points-units mm --part part.stp --qif part.qif",
    "cell inspect part.stl --points-units mm --scene my_cell.toml --search 30mm,8deg --out checked",
    "cell inspect sim_runs/trial/executions/0001",
    note="Exit code 3 if a characteristic fails. Points are in the frame of the part, or near it with --search.",
)
def inspect(
    *,
    source: Annotated[
        Path,
        typer.Argument(
            metavar="CLOUD|MESH|EXECUTION",
            help="File of points or of a mesh, or executions/<id> of a run.",
            show_default=False,
        ),
    ],
    part: _PartOfCommand = None,
    scene: SceneFile = None,
    scene_options: Annotated[OptionValues, option_specs(Scene, "units", "qif")],
    options: InspectOptions,
    out: Annotated[
        Path | None,
        typer.Option(help="Folder of the results. Default: sim_runs/inspect-<UTC>.", rich_help_panel="Output"),
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Compare measured points with the tolerances of a part: values, uncertainties and verdicts."""
    from cell.cli.terminal import Terminal
    from cell.inspect.results import table_rows
    from cell.metrology.inspect import inspect

    terminal = Terminal(quiet_stdout=as_json)
    needs_scene = part is not None or scene is not None or scene_options or not source.is_dir()
    checked = scene_from_options(scene, scene_options, part, flag) if needs_scene else None
    folder, inspection = inspect(source, checked, options, terminal, out)
    result = inspection.result
    if not as_json:
        heading, rows = table_rows(result)
        terminal.print_table(heading, rows, at_most=len(rows))
    facts = [
        ("points", f"{'simulated, ' if result.is_simulated else ''}{result.source}"),
        ("result", result.summary),
        ("rule", result.rule),
        ("alignment", result.alignment),
        ("folder", str(folder)),
    ]
    terminal.print_result(result.as_json(), f"Inspection of {result.part}", facts)
    raise typer.Exit(3 if result.count("fail") else 0)
