"""A controller that interpreters of robot programs drive, and a program with sweeps."""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from cell.export.program import Program

HOME = [0.0, -90.0, 90.0, 0.0, 90.0, 0.0]


@dataclass
class Robot:
    """A controller with a clock [s], signals and axes [deg]; `scanner` reacts as time passes."""

    axes: list[float]
    scanner: Callable[["Robot"], None]
    operator: Callable[["Robot"], None] | None = None
    now: float = 0.0
    inputs: dict[int, bool] = field(default_factory=dict)
    outputs: dict[int, bool] = field(default_factory=dict)
    timers: dict[int, float] = field(default_factory=dict)  # time at which the timer is 0
    moves: list[tuple[str, dict[str, float]]] = field(default_factory=list)
    events: list[tuple[str, float]] = field(default_factory=list)
    variables: dict[str, Any] = field(default_factory=dict)
    line: Callable[["Robot", dict[str, float]], list[float]] | None = None  # axes after a LIN

    def wait(self, seconds: float) -> None:
        """Let time pass."""
        self.now += seconds
        self.scanner(self)


def prompt_scanner(output: int = 1, answer: int = 1, delay: float = 0.3) -> Callable[[Robot], None]:
    """Return a scanner that answers after `delay` seconds and resets the answer when the trigger falls."""
    since: list[float] = []

    def scanner(robot: Robot) -> None:
        if not robot.outputs.get(output, False):
            since.clear()
            robot.inputs[answer] = False
        elif not since:
            since.append(robot.now)
        elif robot.now - since[0] >= delay:
            robot.inputs[answer] = True

    return scanner


def sweeping_program(
    reverse: bool = False, turn: float = 0.0, planned_speed: float = 1.0, seed: int | None = None
) -> tuple[Program, Any]:
    """Return a program of two sweeps, the second turned by `turn` [rad], with a view between them, and its motion.

    A seed draws the place and the lengths of the sweeps.
    """
    from cell.export.program import ProgramInfo, program_of_motion
    from cell.robot.arm import kr16_kinematics
    from planner.path.sweeps import TimedSweep, find_sweeps
    from planner.timing.motion import retime
    from planner.viewpoints.viewpoints import straight_sweep_poses, turned_sweep_poses

    kinematics, mount = kr16_kinematics(), np.eye(4)
    mount[:3, 3] = (0.02, -0.03, 0.12)
    middle, lengths = np.radians([12.0, -75, 110, 35, -60, 140]), np.array([0.15, 0.06])
    if seed is not None:
        rng = np.random.default_rng(seed)
        middle += np.radians(rng.uniform(-8, 8, 6))
        lengths *= rng.uniform(0.5, 1.2, 2)
    T = kinematics.forward(middle[None])[0] @ mount
    columns = (
        straight_sweep_poses(float(lengths[0]), 8),
        turned_sweep_poses(turn, 5) if turn else straight_sweep_poses(float(lengths[1]), 5, (0.2, 1.0, 0.1)),
    )
    paths = [find_sweeps(T @ column, mount, kinematics, kinematics.limits).paths[int(reverse)] for column in columns]
    home, between = np.radians([HOME]), paths[0].q[-1:] + np.radians(1.5)
    via = np.concatenate([home, paths[0].q, between, paths[1].q, home])
    pose = np.concatenate([[-1], paths[0].pose, [0], paths[1].pose, [-1]])
    number = np.concatenate([[0], *([k] * n for k, n in ((40, len(paths[0].q)), (41, 1), (42, len(paths[1].q)))), [0]])
    view = np.where(pose >= 0, number, -1)
    segment = np.maximum(np.concatenate([number[:-1], [43]]) - 40, 0)
    rows = {1: paths[0], len(paths[0].q) + 2: paths[1]}
    motion = retime(
        via, segment, view, kinematics.limits, pose=pose,
        lines={row: TimedSweep(path, mount, kinematics) for row, path in rows.items()},
    )  # fmt: skip
    program = program_of_motion(
        motion,
        kinematics,
        mount,
        np.eye(4),
        ProgramInfo("SWEEPS", "krl", "plate", "run", "0" * 64, planned_speed, 1.0, "kr16", float("nan"), ""),
    )
    return program, (motion, paths, kinematics, mount)
