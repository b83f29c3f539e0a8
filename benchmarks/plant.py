"""The dynamic KR 16 (`sim://?plant=mujoco`): following error, simulation speed, and limits of stability.

Rows `default plan` drive the segments of the built-in Mseke's plan through the simulated controller, without scanning.
All errors are those of the scanner's origin (its laser source) at every simulation step, true position against
reference: `error` is the distance at equal time, with the time lag; `along` and `across` are its components in the
direction of the reference's motion and perpendicular to it; `off the path` is the distance to the nearest point of the
reference path, without the time lag; `lag` is the error along divided by the speed, above 0.1 m/s. `at rest` is the
largest error when the controller reports the arm at rest, as the scanner sees it. `x real time` is the controller's
time over the processor time of one core, best of 3, without an observer.

Rows `stability` drive one move of three segments with every axis (full speed and acceleration, no jerk limit, so that
accelerations jump) for each time step, integrator and bandwidth of the servo. `outcome`: settled; `restless`, the arm
did not come to rest within the controller's limit; `failed`, the plant failed during the move. `warned`: whether the
program warns of such a time step. `off mm`, for the default servo only, is the distance of the flange from its position
with a step of 0.05 ms at the same time.
"""

from __future__ import annotations

import tempfile
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from time import process_time
from typing import Any

import numpy as np

from benchmarks.cell_process import run_cell
from benchmarks.hard_move import OneMove, Trace, one_move
from cell.robot.arm import kinematics_of
from cell.robot.model import load
from cell.robot.plant import MujocoPlant, PlantSettings
from cell.runs.cell import read_cell
from cell.runs.run import Run, open_run
from cell.scan import execution as scan_driver
from cell.scan import plants
from cell.scan.execution import plan_execution
from cell.scan.options import ScanOptions
from planner.kinematics.closed_form import KukaKinematics
from planner.values import Floats

URL = "sim://?plant=mujoco"
TIME_STEPS_MS = (0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0)
BANDWIDTHS_HZ = (3.0, 6.0, 12.0, 24.0, 48.0)
INTEGRATORS = ("Euler", "implicitfast")
AT_SPEED = 0.1

_FINE_STEP = 5e-5  # time step of the reference simulation of `off mm` [s]


def run() -> list[dict[str, Any]]:
    """Run the default plan, then the grid."""
    with tempfile.TemporaryDirectory() as scratch:
        plan = Path(scratch) / "default"
        run_cell(Path(scratch), "plan", "mseke", "--out", str(plan), cache=Path(scratch) / "cache")
        rows = [default_plan(open_run(plan), speed) for speed in (1.0, 0.3)]
    return rows + stability()


def default_plan(run_record: Run, speed: float) -> dict[str, Any]:
    """Return one row: the plan's segments at a speed fraction."""
    motion, T = run_record.motion, run_record.scene.T_flange_scanner
    kinematics = kinematics_of(load())
    seconds, stands, trace = np.inf, [], Trace()
    for attempt in range(4):
        recorded: list[MujocoPlant] = []

        def make(start: Floats, watched: bool = attempt == 0, recorder: list[MujocoPlant] = recorded) -> MujocoPlant:
            plant: Any = plants.plants_of_run(run_record, observer=trace if watched else None)["mujoco"](start)
            recorder.append(plant)
            return plant

        driver, clock = scan_driver.make_driver(
            ScanOptions(driver=URL), motion, read_cell(run_record), {"mujoco": make}
        )
        with driver:
            began, busy = clock.now(), process_time()
            for leg in plan_execution(motion).segments:
                state = driver.move(leg.set_points, speed)
                if attempt == 0:
                    stands.append((state.q, leg.via[-1]))
            simulated = clock.now() - began
            if attempt:
                seconds = min(seconds, process_time() - busy)
    errors = trace.errors(kinematics, T)
    error = errors["true"] - errors["reference"]
    pace = np.linalg.norm(errors["velocity"], axis=1)
    tangent = errors["velocity"] / np.maximum(pace, 1e-9)[:, None]
    along = np.where(pace > 1e-6, (error * tangent).sum(axis=1), 0.0)
    across = np.linalg.norm(error - along[:, None] * tangent, axis=1)
    fast = pace > AT_SPEED
    at_rest = [np.linalg.norm(_position(kinematics, T, a) - _position(kinematics, T, b)) for a, b in stands]
    planned = sum(reference.duration for reference in trace.references)
    return {
        "what": "default plan",
        "speed": speed,
        "steps": len(error),
        "error mm": 1e3 * np.linalg.norm(error, axis=1).max(),
        "along mm": 1e3 * np.abs(along).max(),
        "across mm": 1e3 * across.max(),
        "off the path mm": 1e3 * errors["off"].max(),
        "lag ms": 1e3 * float(np.median(-along[fast] / pace[fast])),
        "fastest m/s": pace.max(),
        "at rest mm": 1e3 * max(at_rest),
        "settling s": (simulated - planned) / len(stands),
        "x real time": simulated / seconds,
    }


def _position(kinematics: KukaKinematics, T_flange_scanner: Floats, q: Floats) -> Floats:
    return np.asarray((kinematics.forward(q[None]) @ T_flange_scanner)[0, :3, 3])


def stability() -> list[dict[str, Any]]:
    """Return one row for each time step, integrator and bandwidth."""
    return [
        _one_move(PlantSettings(time_step=step / 1e3, integrator=integrator, bandwidth=bandwidth))
        for integrator in INTEGRATORS
        for bandwidth in BANDWIDTHS_HZ
        for step in TIME_STEPS_MS
    ]


def _one_move(settings: PlantSettings) -> dict[str, Any]:
    move = one_move(settings)
    usual = replace(PlantSettings(), time_step=settings.time_step) == settings
    return {
        "what": "stability",
        "integrator": settings.integrator,
        "bandwidth Hz": settings.bandwidth,
        "time step ms": 1e3 * settings.time_step,
        "outcome": move.outcome,
        "warned": "yes" if settings.warning else "",
        "error mm": 1e3 * move.tracking_error(),
        "off mm": 1e3 * _step_error(move) if usual and move.outcome == "settled" else "",
        "settling s": move.waited if move.outcome == "settled" else "",
        "x real time": move.duration / move.processor_s if move.outcome != "failed" else "",
    }


def _step_error(move: OneMove) -> float:
    """Return the largest distance of the flange's point from its position with a fine step at the same time [m]."""
    times, position = move.positions()
    fine_times, fine = _fine_move()
    truth = np.stack([np.interp(times, fine_times, fine[:, axis]) for axis in range(3)], axis=1)
    return float(np.linalg.norm(position - truth, axis=1).max())


@lru_cache(maxsize=1)
def _fine_move() -> tuple[Floats, Floats]:
    return one_move(PlantSettings(time_step=_FINE_STEP)).positions()


def chart(rows: list[dict[str, Any]], folder: Path) -> None:
    """Draw error over simulation speed, and the map of time step and bandwidth for each integrator."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt
    from matplotlib.colors import LogNorm

    grid = [row for row in rows if row["what"] == "stability"]
    default = PlantSettings()
    figure, axes = plt.subplots(1, 3, figsize=(15, 4.8), width_ratios=(1.15, 1, 1), layout="constrained")
    colours = {"Euler": "tab:orange", "implicitfast": "tab:blue"}
    for integrator in INTEGRATORS:
        line = [
            row for row in grid if row["integrator"] == integrator and row["bandwidth Hz"] == default.bandwidth
            and row["outcome"] == "settled"
        ]  # fmt: skip
        points = [(row["x real time"], row["error mm"], row["time step ms"]) for row in line]
        axes[0].plot([p[0] for p in points], [p[1] for p in points], "o-", color=colours[integrator], label=integrator)
        offset = (-4, -13) if integrator == "Euler" else (-4, 9)
        for x, y, step in points:
            axes[0].annotate(
                f"{step:g}", (x, y), textcoords="offset points", xytext=offset, fontsize=8, color=colours[integrator]
            )
            if integrator == default.integrator and step == 1e3 * default.time_step:
                axes[0].plot(x, y, "*", color="black", ms=14, label="default", zorder=5)
        divergent = [
            row["time step ms"] for row in grid if row["integrator"] == integrator
            and row["bandwidth Hz"] == default.bandwidth and row["outcome"] != "settled"
        ]  # fmt: skip
        if divergent:
            axes[0].plot([], [], " ", label=f"{integrator} diverges from {min(divergent):g} ms on")
    axes[0].axhline(1.0, color="red", lw=1, ls="--")
    axes[0].axvline(10.0, color="red", lw=1, ls="--", label="1 mm, 10 x real time")
    axes[0].set(
        xscale="log", yscale="log", ylim=(0.08, 2.0),
        xlabel="simulation speed [x real time]", ylabel="largest error at the scanner [mm]",
        title=f"time step in ms beside each point; bandwidth {default.bandwidth:g} Hz",
    )  # fmt: skip
    axes[0].grid(alpha=0.3, which="both")
    axes[0].legend(fontsize=8, loc="upper left", bbox_to_anchor=(0.13, 0.78))
    settled = [row["error mm"] for row in grid if row["outcome"] == "settled"]
    norm = LogNorm(min(settled), max(settled))
    for panel, integrator in zip(axes[1:], INTEGRATORS, strict=True):
        values = np.full((len(BANDWIDTHS_HZ), len(TIME_STEPS_MS)), np.nan)
        for row in grid:
            if row["integrator"] != integrator:
                continue
            i, j = BANDWIDTHS_HZ.index(row["bandwidth Hz"]), TIME_STEPS_MS.index(row["time step ms"])
            if row["outcome"] == "settled":
                values[i, j] = row["error mm"]
                panel.text(
                    j + 0.5, i + 0.5, f"{row['error mm']:.2g}", ha="center", va="center", fontsize=8, color="white"
                )
            else:
                panel.text(
                    j + 0.5, i + 0.5, row["outcome"], ha="center", va="center", fontsize=7, color="darkred", rotation=40
                )
        panel.pcolormesh(values, norm=norm, cmap="viridis", edgecolors="white", lw=0.5)
        panel.set(
            xticks=np.arange(len(TIME_STEPS_MS)) + 0.5, yticks=np.arange(len(BANDWIDTHS_HZ)) + 0.5,
            xticklabels=[f"{step:g}" for step in TIME_STEPS_MS], yticklabels=[f"{b:g}" for b in BANDWIDTHS_HZ],
            xlabel="time step [ms]", ylabel="bandwidth of the servo [Hz]", title=f"{integrator}: largest error [mm]",
        )  # fmt: skip
        if integrator == default.integrator:
            i, j = BANDWIDTHS_HZ.index(default.bandwidth), TIME_STEPS_MS.index(1e3 * default.time_step)
            panel.add_patch(plt.Rectangle((j, i), 1, 1, fill=False, ec="black", lw=2.5))
    figure.suptitle(
        "Dynamic KR 16: where the simulation of arm and servo is stable (red words: it is not); default framed"
    )
    figure.savefig(folder / "plant_stability.png", dpi=130)
    plt.close(figure)
