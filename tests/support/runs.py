"""Executions without a plan: a cell with a ball, a driver that records its moves, a folder."""

from collections.abc import Callable
from datetime import UTC, datetime
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import trimesh

from cell.robot.arm import kinematics_of
from cell.robot.model import load
from cell.runs.cell import RunCell
from cell.runs.folder import SCHEMA
from cell.runs.run import Run
from cell.runs.schema import Manifest, ScannerKeys
from cell.scan.execution_folder import ExecutionFolder
from cell.world.embree import EmbreeRayCaster
from cell.world.travel import TravelBound
from drivers.contract import Capabilities, Mode, RobotState
from drivers.setpoints import from_rad
from planner.geometry.mesh import TriangleMesh
from planner.values import Floats
from tests.support.arms import HOME, KR16


def ball_cell(scanner: Any) -> RunCell:
    """Return a cell with a ball of 60 mm radius in the middle of the scanner's range at home and a distant occluder."""
    model = load()
    kinematics = kinematics_of(model)
    T_base_object = np.eye(4)
    T_base_object[:3, 3] = (kinematics.forward(HOME[None])[0] @ np.array([0, 0, 0.3, 1]))[:3]
    ball = trimesh.creation.icosphere(3, 0.06)
    mesh = TriangleMesh(ball.vertices, ball.faces)
    away = TriangleMesh(np.array([[9.0, 9, 9], [9.1, 9, 9], [9, 9.1, 9]]), np.array([[0, 1, 2]]))
    scene: Any = SimpleNamespace(
        T_base_object=T_base_object, T_flange_scanner=np.eye(4), arrival_mm=None, clearance_mm=10, speed_scaling=1,
        table_is_endless=False, path_tolerance_mm=None,
    )  # fmt: skip
    casters = (EmbreeRayCaster(each.vertices, each.faces) for each in (mesh, away))
    return RunCell(
        scene, mesh, mesh, next(casters), (), next(casters), scanner, ScannerKeys(**scanner.parameters()), kinematics,
        TravelBound(model),
    )  # fmt: skip


class RecordingDriver:
    """A driver that reaches each set-point at once, records its moves and can call a function before each."""

    def __init__(
        self, start: Floats = HOME, *, max_via: int | None = None, before: Callable[[int], None] = lambda move: None,
        off: int = 0,
    ) -> None:  # fmt: skip
        self.axes = from_rad(start)
        self.moves: list[tuple[np.ndarray, float]] = []
        self.before, self.off = before, off
        self.capabilities = Capabilities(
            "recorder", KR16.lower, KR16.upper, KR16.max_step, 1.0, max_via, False, True
        )  # fmt: skip

    def state(self) -> RobotState:
        return RobotState(Mode.IDLE, self.axes, True)

    require_ready = state

    def move(self, set_points: np.ndarray, speed: float) -> RobotState:
        self.before(len(self.moves))
        self.moves.append((set_points, speed))
        self.axes = set_points[-1] + np.int32(self.off)
        return RobotState(Mode.IN_POSITION, self.axes, True)


def new_execution(folder: Path) -> ExecutionFolder:
    """Return a new execution folder of an empty run."""
    run = Run(folder, Manifest(schema=SCHEMA))
    return ExecutionFolder.make(run, ["scan"], 5, {}, datetime(2024, 1, 2, tzinfo=UTC))
