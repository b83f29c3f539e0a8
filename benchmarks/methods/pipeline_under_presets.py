"""The whole pipeline as a process of its own: `cell plan` and `cell scan` under a preset, or by the paper's method.

Seconds are those of the process, start-up included, nothing taken from caches. What the plan misses is held against
what any view could measure that the robot reaches: candidates of a mesh of four times the default faces at four rolls.
"""

import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.cell_process import run_cell
from benchmarks.methods.preset_knobs import FINEST
from cell.rays.occluders import caster_of, occluder_triangles
from cell.robot.frames import pose_from_kuka_abc
from cell.scene.presets import PRESETS
from cell.study.bench import Bench
from cell.study.scenes import scene_of
from cell.study.trial import Outcome
from planner.measurability import coverage

WHOLE = "whole"
"""Its name among the knobs."""

PAPER = "paper's method"

METHODS: Mapping[str, tuple[str, ...]] = {
    **{name: ("--preset", name) for name in PRESETS},
    PAPER: ("--fill", "rays", "--solver", "meta-raps"),
}
"""Options of `cell plan` for each way to run it; all choose from their mesh's candidates at the scene's rolls."""

_ROLLS_DEG = (0.0, 45.0, 90.0, 135.0)


def whole(settings: Mapping[str, Any]) -> dict[str, Any]:
    """Plan and scan: the trial.

    Args:
        settings: options (of `cell plan`: part, scene, units), method (a name of `METHODS`), and files whose contents
            the trial depends on.

    Raises:
        CellError: with the command's own sentence where it fails.
    """
    with tempfile.TemporaryDirectory(prefix="cell-speed-") as scratch:
        folder, options = Path(scratch), (*settings["options"], *METHODS[settings["method"]])
        plan, planning = run_cell(folder, "plan", *options, "--no-cache", "--out", str(folder / "run"))
        scan, scanning = run_cell(folder, "scan", str(folder / "run"))
    surface = scan["deviation"]
    return {
        "views": plan["n_views"],
        "lower_bound": plan["lower_bound"],
        "visible": plan["coverage"]["visible"],
        "motion_s": plan["motion"]["duration_s"],
        "sampled": scan["coverage"]["sampled"],
        "rms_um": None if surface is None else 1000 * surface["rms_mm"],
        "seconds": {
            "work": planning["s"], "processor": planning["cpu s"],
            "scan work": scanning["s"], "scan processor": scanning["cpu s"],
        },
    }  # fmt: skip


def measurable(settings: Mapping[str, Any]) -> dict[str, Any]:
    """What any view could measure that the robot reaches: the trial that is the truth of the others.

    Args:
        settings: scene and files (`cell.study.scenes`).

    Returns:
        The share of the surface, on the held-out samples, with fixtures, post and floor in the way.
    """
    scene = scene_of(settings)
    usual = Bench(scene)
    plan = {"faces": FINEST * usual.settings.faces, "percent_kept": None, "rolls_deg": _ROLLS_DEG}
    bench = Bench(scene.model_copy(update={"plan": scene.plan.model_copy(update=plan)}))
    place = scene.placement
    centre = pose_from_kuka_abc(np.array(place.position_mm) / 1000, np.deg2rad(place.abc_deg))
    reached = bench.reach(bench.zone, centre).reachable
    casters = (bench.caster, caster_of(occluder_triangles(bench.world, bench.world.placed(centre))))
    poses = bench.zone.T_object_scanner[reached]
    found = coverage.visible(poses, bench.samples, bench.scanner, casters).fraction if len(poses) else 0.0
    return {"measurable": found, "candidates": len(bench.zone), "reachable": int(reached.sum())}


def row(part: str, method: str, outcome: Outcome, most: float) -> dict[str, Any]:
    """One tidy row.

    Args:
        part: its name.
        method: a name of `METHODS`.
        outcome: of the trial `whole`.
        most: share of the surface that can be measured.
    """
    values, seconds = outcome.values, outcome.seconds
    return {
        "knob": WHOLE,
        "part": part,
        "value": method,
        "seconds": seconds["work"],
        "processor s": seconds["processor"],
        "error": 100 * (most - values["visible"]),
        "unit": "points",
        "views": values["views"],
        "fewest views": values["lower_bound"],
        "visible %": 100 * values["visible"],
        "motion s": values["motion_s"],
        "scan s": seconds["scan work"],
        "scan processor s": seconds["scan processor"],
        "sampled %": 100 * values["sampled"],
        "surface rms um": values["rms_um"],
    }


def sentences(rows: Sequence[Mapping[str, Any]]) -> list[str]:
    """Each way against the default preset, over all parts: ratios of seconds, differences of error and views."""
    said = []
    usual = {row["part"]: row for row in rows if row["value"] == "balanced"}
    for method in METHODS:
        pairs = [(row, usual[row["part"]]) for row in rows if row["value"] == method and row["part"] in usual]
        if method == "balanced" or not pairs:
            continue
        time = float(np.mean([one["processor s"] / other["processor s"] for one, other in pairs]))
        scan = float(np.mean([one["scan processor s"] / other["scan processor s"] for one, other in pairs]))
        missed = float(np.mean([one["error"] - other["error"] for one, other in pairs]))
        views = float(np.mean([one["views"] / other["views"] for one, other in pairs]))
        said.append(
            f"**{method}** against balanced, mean of {len(pairs)} part{'s' * (len(pairs) != 1)}: the plan takes "
            f"{time:.2f} times as long, the scan {scan:.2f} times; {missed:+.2f} points of the surface missed; "
            f"{views:.2f} times as many views."
        )
    return said
