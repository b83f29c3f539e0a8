"""Final motions of seeded scenes, checked again with true triangles and by differences of the samples.

Each scene is processed like `cell plan` except for the selection: its cell is compiled, candidates are tested for
reach, ten reachable ones are drawn, ordered, connected and timed. `benchmarks.triangle_cell` checks for contact at
every millisecond of the motion. Limits are compared with the samples and with their differences.

SCAN_CELL_SCENES (default 8) is the number of scenes; with SCAN_CELL_RECHECK=FILE finished scenes are stored as lines of
JSON, and an interrupted call continues after them. The full form has 100 scenes. SCAN_CELL_TABLE=synchronised (or
indexed, or tilted) puts each part on a rotary table. With an indexed one two more conditions are checked: arm and table
never move at once, and there is no contact at any degree of the table in every posture in which it may turn.
"""

import json
import os
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np

from benchmarks.seeded_scenes import SeededCell, usable
from benchmarks.triangle_cell import TriangleCell
from cell.world.clearance import motion_clearance
from planner.ports import ARM_AXES
from planner.timing.motion import Motion, jerk_free_duration, retime
from planner.tour.tour import plan_tour
from planner.tour.visits import Visits
from planner.values import Floats

_STEP = 1e-3  # s
_VIEWS = 10
_DISTANCES = 40  # samples of a motion for the column "nearest": distances of triangles are slow


def run() -> list[dict[str, Any]]:
    """Return one row over all scenes, and one for each with a finding."""
    count = int(os.environ.get("SCAN_CELL_SCENES", "8"))
    records_file = Path(os.environ["SCAN_CELL_RECHECK"]) if "SCAN_CELL_RECHECK" in os.environ else None
    records = (
        [json.loads(line) for line in records_file.read_text().splitlines()]
        if records_file and records_file.exists()
        else []
    )
    for number in range(count):
        if any(row["scene"] == number for row in records):
            continue
        records.append(check_scene(number, table=os.environ.get("SCAN_CELL_TABLE", "")))
        if records_file:
            with records_file.open("a") as file:
                file.write(json.dumps(records[-1]) + "\n")
    rows = [row for row in records if row["scene"] < count]
    found = [row for row in rows if row["contacts"] or row["over limits"] > 1e-9 or row["at once"]]
    planned = [row for row in rows if row["moves"]]
    summary = {
        "scene": f"{len(rows)} scenes, {len(planned)} with a motion",
        "part": "",
        "fixtures": sum(row["fixtures"] for row in rows),
        "views": sum(row["views"] for row in rows),
        "moves": sum(row["moves"] for row in rows),
        "detours": sum(row["detours"] for row in rows),
        "motion s": sum(row["motion s"] for row in rows),
        "over jerk-free": float(np.mean([row["over jerk-free"] for row in planned])),
        "checked": sum(row["checked"] for row in rows),
        "contacts": sum(row["contacts"] for row in rows),
        "at once": sum(row["at once"] for row in rows),
        "nearest mm": min((row["nearest mm"] for row in planned), default=float("nan")),
        "over limits": max(row["over limits"] for row in rows),
        "plan s": float(np.median([row["plan s"] for row in rows])),
        "judge s": float(np.median([row["judge s"] for row in rows])),
    }
    return [summary, *found]


def check_scene(number: int, n_views: int = _VIEWS, *, table: str = "") -> dict[str, Any]:
    """Plan and check one scene, with a rotary table of the given kind or without one."""
    begin = perf_counter()
    cell = usable(number, least=n_views, table=table)
    rng = np.random.default_rng(number)
    views = rng.choice(cell.reachable, n_views, replace=False)
    poses = cell.world.T_base_object @ cell.viewpoints.T_object_scanner[views, 0]
    visits = Visits([cell.reach.configurations_of(int(view)) for view in views], cell.world.home, poses)
    tour = plan_tour(visits, cell.checker, cell.world.limits, rng)
    motion = retime(tour.via, tour.segment, tour.view, cell.world.limits)
    clearances = motion_clearance(cell.checker, tour.via, tour.segment, len(tour.detour))
    planned = perf_counter()
    return _judge(cell, motion) | {
        "views": len(tour.order),
        "dropped": len(tour.dropped),
        "detours": int(tour.detour.sum()),
        "lower bound mm": 1000 * float(clearances.distance.min(initial=np.inf)),
        "plan s": planned - begin,
        "judge s": perf_counter() - planned,
    }


def _judge(cell: SeededCell, motion: Motion) -> dict[str, Any]:
    triangles = TriangleCell(cell.world, cell.part)
    dense = retime(motion.via_q, motion.segment, motion.view, motion.limits, _STEP)
    indexed = motion.limits.table_turn_q is not None
    waiting = _while_it_turns(dense) if indexed else dense.q[:0]
    contacts = triangles.contacts(np.concatenate([dense.q, waiting]))
    moving = dense.qd != 0
    return {
        "scene": cell.number,
        "part": cell.world.scene.part.name,
        "fixtures": len(cell.world.scene.fixtures),
        "moves": len(motion.via_q) - 1,
        "motion s": motion.duration,
        "over jerk-free": motion.duration / jerk_free_duration(motion) if motion.duration else 1.0,
        "checked": len(dense.q) + len(waiting),
        "at once": int((moving[:, :ARM_AXES].any(axis=1) & moving[:, ARM_AXES:].any(axis=1)).sum()) if indexed else 0,
        "contacts": sum(contacts.values()),
        "between": ", ".join(contacts),
        "nearest mm": 1000 * triangles.nearest(dense.q[:: max(1, len(dense.q) // _DISTANCES)]),
        "over limits": max(excess(motion), excess(dense)),
    }


def _while_it_turns(dense: Motion) -> Floats:
    """Return (n, 7) every posture in which the table moves, at every degree of the table's range [rad]."""
    postures = np.unique(dense.q[dense.qd[:, ARM_AXES] != 0][:, :ARM_AXES], axis=0)
    low, high = dense.limits.lower[ARM_AXES], dense.limits.upper[ARM_AXES]
    angles = np.linspace(low, high, 1 + int(np.ceil(np.degrees(high - low))))
    return np.concatenate([np.repeat(postures, len(angles), axis=0), np.tile(angles, len(postures))[:, None]], axis=1)


def excess(motion: Motion) -> float:
    """Return the largest relative excess of position, speed, acceleration and jerk over the limits; at most 0 if kept.

    Speeds and accelerations are the recorded ones and the differences of angles and of speeds; jerks are differences of
    the recorded accelerations. What rounding of the samples puts into a difference is subtracted.
    """
    limits, steps = motion.limits, np.diff(motion.t)[:, None]
    rounding = 4 * np.spacing(np.abs(motion.t).max()) / steps
    excess = [
        float((np.abs(motion.qd) / limits.velocity).max()) - 1,
        float((np.abs(motion.qdd) / limits.acceleration).max()) - 1,
        float((np.maximum(motion.q - limits.upper, limits.lower - motion.q)).max()),
    ]
    for values, limit in ((motion.q, limits.velocity), (motion.qd, limits.acceleration), (motion.qdd, limits.jerk)):
        change = np.abs(np.diff(values, axis=0))
        noise = 4 * np.spacing(np.abs(values).max(axis=0))
        excess.append(float(((change - noise) / steps / limit - rounding).max()) - 1)
    return max(excess)
