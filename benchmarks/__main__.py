"""The registry of benchmarks: `python -m benchmarks [NAME ...]` runs them and prints time and accuracy in one row.

Every benchmark is a module of this folder with `run() -> list[dict]`; an optional `chart(rows, folder)` draws a
picture. Eight have subcommands and options (`python -m benchmarks speed --help`), six of them in `benchmarks/methods`.
Timings are valid for this machine and this run: compare rows of one run, not rows of different runs.
"""

import json
import os
import platform
import sys
from collections.abc import Mapping
from importlib import import_module
from importlib.metadata import version
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console
from rich.table import Table

from cell.cli.failures import report_errors

_HERE = ("golden", "link_shapes", "inspection", "nist_fits")  # studies in this folder

STUDIES = {
    "speed": "seconds against error of planning faces, samples on each, and rays of a scan",
    "stability": "success and error of each method over the number that breaks it, and what the program says there",
    "cover": "view selection at equal processor time beside HiGHS, CP-SAT, a textbook search; solve FILE solves a file",
    "paper": "the paper's tables, its method and ours side by side: views and coverage of 86 rows",
    "golden": "about 45 small runs beside a committed reference of their artefacts: equal, words changed, data changed",
    "link_shapes": "collision shapes of the KR 16 beside an outline FILE of its links: excess and volume ratio",
    "nist_fits": "fits of FOLDER's points beside reference pairs in the form of NIST: largest differences",
    "inspection": "predicted and observed uncertainty of 200 scans, as-built errors, error rates of verdicts",
    "mutation": "seeded small faults in given modules: the share that given tests detect",
    "pictures": "the pictures of docs/images drawn anew; by name also the charts, which take minutes to an hour",
}
"""Modules with their own `app`, in `benchmarks.methods` or here."""

REGISTRY = {
    **STUDIES,
    "built_in_parts": "built-in parts: seconds to build and to load; whether the shipped mesh equals the built one",
    "kinematics": "inverse kinematics: poses per second and round-trip error",
    "robots": "plans with arms from files (ROBOT_FILES): coverage, contacts of the true triangles, limits, seconds",
    "fidelity": "hulls and triangles: missed contacts, false refusals and time",
    "collision": "collision checks per second and disagreements with python-fcl",
    "fill": "measurability matrix: seconds to fill it and error of the predicted coverage",
    "candidates": "candidate generators: seconds, views and coverable area of the plan of every part",
    "free_poses": "attainable coverage of any pose of the arm, compared with that of the candidates",
    "pose_search": "views over the effort of the pose search: views, coverage and motion beside processor seconds",
    "coverage_over_views": "coverage over the number of views, with candidates only and with free poses",
    "default_job": "the default plan with other efforts, samples and directions: views and coverage over seconds",
    "direction_table": "error of the direction table over its size: measured shares beside exact rays, seconds, MB",
    "versions": "the main jobs beside another version on every part: views, bound, coverage, seconds, memory",
    "mug": "the paper's Mug at 300 mm: views and both coverages over the ray resolution",
    "rays": "hits and blocked lines of sight against float64 brute force; a matrix of 10,000 x 10,000; share of Embree",
    "coverage_requests": "curve, overlap and pose errors: processor seconds and remaining gap",
    "timing": "times of joint moves: pairs per second and error against ruckig",
    "singularities": "near singularities: joint speed for 100 mm/s at the tool",
    "edge_resolution": "fixed steps along a move compared with certification: time, misses, false refusals",
    "closest": "closest points and signed distances: seconds, error against every triangle, wrong signs",
    "paths": "paths around obstacles in seeded scenes: success, checks and time, compared with ompl",
    "motion_recheck": "final motions of seeded scenes, checked by triangles every millisecond and by differences",
    "gtsp": "generalised travelling salesman files: excess over the best known tour and the lower bound, time",
    "cycle_time": "cycle time of plans compared with an earlier version, RoboTSP's method and the lower bound",
    "online_soak": "moves over ur:// and rsi:// with faults, killed clients of ur://, kvp:// and rsi://",
    "kills": "client and controller killed at random moments, then resumed: lost and repeated moves",
    "edits": "random edits of plans and differences of runs: results and refusals, checked independently",
    "locate": "placements found from one scan of a displaced part: error and reported undetermined motions",
    "hand_eye": "mounts from 12 scans of a sphere or a plane: error and reported precision; degenerate sets",
    "plan": "cell plan as a process: stages, memory and prediction error on every part",
    "plant": "dynamic arm: tracking error and simulation speed; diverging time steps, integrators and gains",
    "scan": "cell scan as a process: seconds, memory, achieved and predicted coverage, registration",
    "explore": "next views without a model: coverage at 5, 10 and 15 views, compared with four published policies",
    "explored": "explorations with the arm: true coverage and views compared with plans of the known model, contacts",
    "density": "dense and visible coverage; spacing of points predicted by plans and measured in their scans",
    "reconstruction": "cloud to mesh: seconds and deviation; registration error before and after",
    "setups": "several set-ups of every part: common cover and sequential covers, bounds, attainable coverage, seconds",
    "table": "rotary table compared with the fixed plan of every part: views, coverage, views for equal coverage",
    "sigma": "model of a point's standard deviation and observed scatter; cost of its layer",
    "soak": "2,000 moves over each wire with 1 % of every fault, checked by the journal of the controller",
    "fuzz": "mangled frames and telegrams: crashes and false accepts of the codecs",
    "fuzz_inputs": "mangled mesh, TOML, JSON and npz files: read, refused, unexpected errors, slowest",
    "generated_files": "mesh files of every format in many forms: equal to the closed form, refused, wrong",
    "path_watch": "arms that leave their path, and false alarms with noise, lag and jitter",
    "wire": "round trip of a state and of a command on loopback, beyond wire time: median and p99",
}

app = typer.Typer(add_completion=False)


@app.command()
def main(
    names: Annotated[list[str] | None, typer.Argument(help="which benchmarks; all when absent")] = None,
    save: Annotated[Path | None, typer.Option(help="write the rows as JSON")] = None,
    charts: Annotated[Path | None, typer.Option(help="draw the charts into this folder")] = None,
) -> None:
    """Run benchmarks and print one table each."""
    selection = names or list(REGISTRY)
    unknown = sorted(set(selection) - set(REGISTRY))
    if unknown:
        raise typer.BadParameter(f"no benchmark named {', '.join(unknown)}; there are {', '.join(REGISTRY)}")
    console = Console() if sys.stdout.isatty() else Console(width=200)
    console.print(
        f"Python {platform.python_version()}, {os.cpu_count()} cores, {platform.machine()}; "
        + ", ".join(f"{name} {version(name)}" for name in ("numpy", "scipy", "mujoco", "embreex"))
    )
    results: dict[str, list[dict[str, Any]]] = {}
    for name in selection:
        if name in STUDIES:
            run_study(name, [])
            continue
        module = import_module(f"benchmarks.{name}")
        results[name] = rows = module.run()
        _print(console, name, rows)
        if charts is not None and hasattr(module, "chart"):
            charts.mkdir(parents=True, exist_ok=True)
            module.chart(rows, charts)
    if save is not None:
        save.write_text(json.dumps(results, indent=2) + "\n", encoding="utf-8")


def _print(console: Console, name: str, rows: list[dict[str, Any]]) -> None:
    table = Table(title=f"{name}: {REGISTRY[name]}", title_justify="left")
    columns = list(dict.fromkeys(key for row in rows for key in row if not isinstance(row[key], list)))
    for column in columns:
        table.add_column(column)
    for row in rows:
        table.add_row(*(_cell(row, column) for column in columns))
    console.print(table)


def _cell(row: Mapping[str, Any], column: str) -> str:
    value = row.get(column, "")
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def run_study(name: str, words: list[str]) -> int:
    """Run a study with its own options; return the exit code."""
    study = import_module(f"benchmarks.{name}" if name in _HERE else f"benchmarks.methods.{name}").app
    program = f"python -m benchmarks {name}"
    return report_errors(lambda: study(words, prog_name=program, standalone_mode=False), as_json="--json" in words)


if __name__ == "__main__":
    if sys.argv[1:2] and sys.argv[1] in STUDIES:
        sys.exit(run_study(sys.argv[1], sys.argv[2:]))
    app()
