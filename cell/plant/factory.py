"""The plants that `cell` injects into a simulated controller, by the name that `sim://?plant=` takes.

MuJoCo is imported, and the arm compiled, when a driver asks for the plant.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

from cell.runs.cell import table_of
from cell.runs.run import Run
from drivers.controller import Plant, PlantFactory
from drivers.errors import DriverError
from planner.values import Floats

if TYPE_CHECKING:
    from cell.plant.mujoco_plant import Observer
    from cell.plant.servo import Settings


def of_run(run: Run, observer: Observer | None = None) -> Mapping[str, PlantFactory]:
    """The plants of an execution: the arm carries the tool that the plan was checked with.

    Args:
        run: a run folder with a `cell.xml`.
        observer: is told of every step.
    """

    def mujoco(start: Floats) -> Plant:
        from cell.plant import tool, turned
        from cell.plant.mujoco_plant import MujocoPlant
        from cell.robot import model as robot

        scene, model = run.scene, run.cell_model()
        mounted, table = scene.robot, table_of(scene)
        if mounted is not None and mounted.model != robot.KR16:
            raise DriverError(
                f"the plant 'mujoco' is the built-in arm's, and this plan is of {mounted.name}; use plant=ideal"
            )
        on_table = None
        if table is not None and not table.upright:
            raise DriverError(
                "the plant 'mujoco' knows rotary tables whose axis is upright, on which nothing weighs, and this one "
                "is tilted; use plant=ideal"
            )
        if table is not None and scene.table is not None:
            on_table = turned.of_model(model, table, scene.table.diameter_mm / 1000.0)
        return MujocoPlant(start, tool.of_model(model), observer=observer, spec=robot.spec(), turned=on_table)

    return {"mujoco": mujoco}


def built_in(settings: Settings | None = None, observer: Observer | None = None) -> Mapping[str, PlantFactory]:
    """The same without a run: the arm carries housing and bracket of the built-in scene.

    Args:
        settings: of simulation and servo; None: the default.
        observer: is told of every step.
    """

    def mujoco(start: Floats) -> Plant:
        from cell.plant import tool
        from cell.plant.mujoco_plant import MujocoPlant
        from cell.robot import model as robot
        from cell.scene.file import load_scene
        from cell.scene.settle import with_device
        from cell.world import shapes

        scene, spec = with_device(load_scene(None), "mseke", 0.0), robot.spec()
        baseline_mm = scene.scanner.baseline_mm or 0.0
        shapes.add_tool(spec, scene, scene.mount.T @ scene.housing.T_scanner_housing(baseline_mm))
        return MujocoPlant(start, tool.of_model(spec.compile()), settings, observer)

    return {"mujoco": mujoco}
