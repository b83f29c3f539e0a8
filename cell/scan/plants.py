"""The dynamic plants that `cell` injects into a simulated controller, by the name in `sim://?plant=`.

MuJoCo is imported, and the arm compiled, only when a driver makes the plant.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

from cell.runs.cell import table_of
from cell.runs.run import Run
from drivers.errors import DriverError
from drivers.simulated_controller import Plant, PlantFactory
from planner.values import Floats

if TYPE_CHECKING:
    from cell.robot.plant import Observer, PlantSettings


def plants_of_run(run: Run, observer: Observer | None = None) -> Mapping[str, PlantFactory]:
    """Return the plants of an execution: the arm carries the tool of the plan.

    Args:
        run: a run folder with a `cell.xml`.
        observer: receives every step.
    """

    def mujoco(start: Floats) -> Plant:
        from cell.robot import dynamics
        from cell.robot import model as robot
        from cell.robot.plant import MujocoPlant

        scene, model = run.scene, run.cell_model()
        mounted, table = scene.robot, table_of(scene)
        if mounted is not None and mounted.model != robot.KR16:
            raise DriverError(
                f"the plant 'mujoco' models the built-in arm, and this plan is for {mounted.name}; use plant=ideal"
            )
        load = None
        if table is not None and not table.upright:
            raise DriverError(
                "the plant 'mujoco' models rotary tables with an upright axis only, and this one is tilted; use "
                "plant=ideal"
            )
        if table is not None and scene.table is not None:
            load = dynamics.table_load_of(model, table, scene.table.diameter_mm / 1000.0)
        return MujocoPlant(start, dynamics.tool_of(model), observer=observer, spec=robot.spec(), table=load)

    return {"mujoco": mujoco}


def built_in_plants(
    settings: PlantSettings | None = None, observer: Observer | None = None
) -> Mapping[str, PlantFactory]:
    """Return the plants without a run: the arm carries housing and bracket of the built-in scene.

    Args:
        settings: of simulation and servo; None: the default.
        observer: receives every step.
    """

    def mujoco(start: Floats) -> Plant:
        from cell.robot import dynamics
        from cell.robot import model as robot
        from cell.robot.plant import MujocoPlant
        from cell.scene.file import load_scene
        from cell.scene.settle import with_device
        from cell.world import shapes

        scene, spec = with_device(load_scene(None), "mseke", 0.0), robot.spec()
        baseline_mm = scene.scanner.baseline_mm or 0.0
        T_flange_housing = scene.mount.T @ scene.housing.T_scanner_housing(baseline_mm)
        shapes.add_tool(spec, spec.copy().compile(), scene, T_flange_housing)
        return MujocoPlant(start, dynamics.tool_of(spec.compile()), settings, observer)

    return {"mujoco": mujoco}
