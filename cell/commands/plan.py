"""`cell plan` as the command line gives it: options in, a table or one JSON object out."""

import json
import sys
from pathlib import Path
from typing import Annotated, Any

import typer

from cell.commands import options
from cell.errors import UsageError

_PART = "Part and place"
_VIEWS = "Views"
_WISHES = "Wishes beyond the fewest views (docs/coverage_requests.md)"
_OUTPUT = "Output"

EPILOG = (
    "Examples:\n\n"
    "cell plan --place 1200,500,0\n\n"
    "cell plan part.stl --units mm --place 1200,500,0,90,0,0 --standoff 300 --faces 930 --coverage 0.95\n\n"
    "cell plan --preset fast\n\n"
    "cell plan --scene my_cell.toml --seed 7 --json --out sim_runs/trial\n\n"
    "cell plan --max-views 8 --curve\n\n"
    "cell plan --overlap 20% --coverage 0.98\n\n"
    "cell plan --pose-sd 0.5mm,0.1deg --alpha 0.05 --coverage 0.98\n\n"
    "Exit codes: 0 done, 2 usage or scene, 3 below the required coverage, 4 nothing reachable, 6 files, 70 bug, "
    "130 Ctrl-C."
)


def plan(
    part: Annotated[
        str | None,
        typer.Argument(
            help="Mesh file (STL, OBJ, PLY, OFF, GLB) or a built-in part: mseke, mug, robinet, petanque, humerus, "
            "st-jean. Default: the scene's, which is mseke.",
            show_default=False,
        ),
    ] = None,
    place: Annotated[
        str | None,
        typer.Option(
            metavar="X,Y,Z[,A,B,C]",
            help="Where the part's centre stands in the robot's base frame (mm) and how it is turned (deg, KUKA ABC).",
            rich_help_panel=_PART,
        ),
    ] = None,
    units: Annotated[
        str | None,
        typer.Option(help="Unit of the mesh file: mm, cm, m, um or in. Never guessed.", rich_help_panel=_PART),
    ] = None,
    scene: Annotated[
        Path | None,
        typer.Option(help="Scene file (TOML). Default: the built-in scene.", rich_help_panel=_PART),
    ] = None,
    preset: options.Preset = None,
    faces: Annotated[
        int | None, typer.Option(help="Faces of the planning mesh (one candidate normal each).", rich_help_panel=_VIEWS)
    ] = None,
    percent: Annotated[
        float | None,
        typer.Option(help="In place of --faces: percentage of the faces that is KEPT.", rich_help_panel=_VIEWS),
    ] = None,
    sensor: Annotated[
        str | None,
        typer.Option(help="A real sensor by name, see cell sensors; in place of scanner.type.", rich_help_panel=_VIEWS),
    ] = None,
    baseline: Annotated[
        float | None,
        typer.Option(metavar="MM", help="From laser source to sensor.", rich_help_panel=_VIEWS),
    ] = None,
    candidates: Annotated[
        str | None,
        typer.Option(help="optimal-scanning-zone (one per face), view-sphere or targeted.", rich_help_panel=_VIEWS),
    ] = None,
    standoff: Annotated[
        str | None,
        typer.Option(metavar="MM[,MM...]", help="Distance from surface to laser source.", rich_help_panel=_VIEWS),
    ] = None,
    roll: Annotated[
        str | None,
        typer.Option(metavar="DEG[,DEG...]", help="Rolls about the viewing axis.", rich_help_panel=_VIEWS),
    ] = None,
    coverage: Annotated[
        float | None,
        typer.Option(help="Share of the coverable area that the plan must measure, 0 to 1.", rich_help_panel=_VIEWS),
    ] = None,
    require: Annotated[
        float | None,
        typer.Option(
            help="Exit with code 3 when the predicted visible coverage of the WHOLE surface is below this share.",
            rich_help_panel=_VIEWS,
        ),
    ] = None,
    fill: Annotated[
        str | None,
        typer.Option(help="How the measurability matrix is filled: aimed or rays.", rich_help_panel=_VIEWS),
    ] = None,
    samples: Annotated[
        int | None,
        typer.Option(help="Surface samples per planning face (aimed).", rich_help_panel=_VIEWS),
    ] = None,
    max_sigma: Annotated[
        float | None,
        typer.Option(
            metavar="MM",
            help="Count a point as measured only if its expected standard deviation is at most this.",
            rich_help_panel=_VIEWS,
        ),
    ] = None,
    solver: Annotated[
        str | None,
        typer.Option(help="auto, greedy, meta-raps, local-search or exact.", rich_help_panel=_VIEWS),
    ] = None,
    collision: Annotated[
        str | None,
        typer.Option(
            help="What the part is to arm and scanner: hull, decomposed (convex pieces) or exact (its triangles).",
            rich_help_panel=_VIEWS,
        ),
    ] = None,
    speed: Annotated[
        float | None,
        typer.Option(help="Override: share of the axis speeds, above 0 to 1.", rich_help_panel=_VIEWS),
    ] = None,
    seed: Annotated[int | None, typer.Option(help="Seed of every random choice.", rich_help_panel=_VIEWS)] = None,
    max_views: Annotated[
        int | None, typer.Option(metavar="K", help="The most coverage with at most K views.", rich_help_panel=_WISHES)
    ] = None,
    multiplicity: Annotated[
        int | None,
        typer.Option(
            "--multiplicity", "--k-fold", metavar="K", help="Measure each sample from K views.", rich_help_panel=_WISHES
        ),
    ] = None,
    pin: Annotated[
        list[str] | None,
        typer.Option(metavar="ID[,ID...]", help="Candidates that the plan must take.", rich_help_panel=_WISHES),
    ] = None,
    ban: Annotated[
        list[str] | None,
        typer.Option(metavar="ID[,ID...]", help="Candidates that it must not take.", rich_help_panel=_WISHES),
    ] = None,
    cost: Annotated[
        str | None,
        typer.Option(
            help="What a view costs: views (1 each) or time (scan, settling and an estimated move, in seconds).",
            rich_help_panel=_WISHES,
        ),
    ] = None,
    overlap: Annotated[
        str | None,
        typer.Option(
            metavar="SHARE%|AREAmm2",
            help="All scans hang together: views are joined where they share so much, e.g. 20% of the smaller one or "
            "500mm2.",
            rich_help_panel=_WISHES,
        ),
    ] = None,
    overlap_in_order: Annotated[
        bool | None,
        typer.Option("--overlap-in-order", help="Each view overlaps an earlier one.", rich_help_panel=_WISHES),
    ] = None,
    pose_sd: Annotated[
        str | None,
        typer.Option(
            metavar="MMmm,DEGdeg",
            help="Standard deviations of executed poses, e.g. 0.5mm,0.1deg: samples count only where the plan measures "
            "them with probability 1 - alpha.",
            rich_help_panel=_WISHES,
        ),
    ] = None,
    alpha: Annotated[
        float | None,
        typer.Option(help="Probability with which such a sample may be missed. Default 0.05.", rich_help_panel=_WISHES),
    ] = None,
    curve: Annotated[
        bool | None,
        typer.Option("--curve", help="Also coverage over the number of views, bounded.", rich_help_panel=_WISHES),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(help="Run folder to make. Default: sim_runs/<UTC>-<hash>.", rich_help_panel=_OUTPUT),
    ] = None,
    as_json: Annotated[
        bool,
        typer.Option("--json", help="Print one JSON object on stdout, the rest on stderr.", rich_help_panel=_OUTPUT),
    ] = False,
    no_cache: Annotated[
        bool,
        typer.Option("--no-cache", help="Neither read nor write cached matrices.", rich_help_panel=_OUTPUT),
    ] = False,
) -> None:
    """Plan the views that measure a part: which, whether the robot reaches them, in which order, along which motion."""
    from cell.commands.terminal import Terminal
    from cell.plan import report
    from cell.plan.pipeline import plan as run_plan
    from cell.scene.scene import load_scene

    tables: dict[str, dict[str, Any]] = {"part": {}, "placement": {}, "plan": {}}
    if part is not None:
        tables["part"] = options.part(part, units)
    elif units is not None:
        tables["part"]["units"] = units
    if place is not None:
        tables["placement"] = options.placement(place)
    if faces is not None and percent is not None:
        raise UsageError("--faces and --percent both set the size of the planning mesh; give one of them")
    given = {
        "faces": faces,
        "percent_kept": percent,
        "candidates": candidates,
        "standoffs_mm": options.numbers("--standoff", standoff),
        "rolls_deg": options.numbers("--roll", roll),
        "coverage": coverage,
        "required_visible": require,
        "fill": fill,
        "samples_per_face": samples,
        "max_sigma_mm": max_sigma,
        "solver": solver,
        "collision": collision,
        "seed": seed,
        "max_views": max_views,
        "multiplicity": multiplicity,
        "pinned": options.views("--pin", pin),
        "banned": options.views("--ban", ban),
        "cost": cost,
        "overlap_in_order": overlap_in_order,
        "alpha": alpha,
        "curve": curve,
        **options.preset(preset),
        **options.overlap(overlap),
        **options.pose_sd(pose_sd),
    }
    tables["plan"] = {key: value for key, value in given.items() if value is not None}
    if speed is not None:
        tables["robot"] = {"speed_scaling": speed}
    tables["scanner"] = {k: v for k, v in {"sensor": sensor, "baseline_mm": baseline}.items() if v is not None}
    terminal = Terminal(quiet_stdout=as_json)
    with options.named_as_options(tables):
        checked = load_scene(scene, tables)
    outcome = run_plan(
        checked,
        scene_path=scene,
        out=out,
        argv=sys.argv[1:],
        use_cache=not no_cache,
        narrator=terminal,
    )
    if as_json:
        sys.stdout.write(json.dumps(outcome.as_json(), indent=2, allow_nan=False) + "\n")
    else:
        rows = [*report.table(outcome.summary), ("run folder", str(outcome.folder))]
        terminal.pairs(f"View plan of {outcome.summary.part.name}", rows)
    raise typer.Exit(outcome.exit_code)
