"""Step 3 and after step 4: candidates by the scene's generator; `grown` goes on where none that is reached measures.

`grown` begins with the optimal scanning zone. Once reach is known, `grow` appends viewpoints for what is open
(`planner.viewpoints.growth`): they depend on the placement and the cell, and all of them are reached. Nothing is random
but the scouts, which the plan's seed draws: equal inputs give equal candidates, so that the matrix's cache, which knows
a column by its pose, has them the next time.
"""

from collections.abc import Sequence

import numpy as np

from cell.part.workpiece import Workpiece
from cell.scene.model import Scene, with_rest
from cell.scene.regions import with_limits as with_limits
from cell.scene.settle import Settings
from cell.world.model import World
from planner.geometry.mesh import TriangleMesh
from planner.geometry.sampling import SurfaceSamples
from planner.kinematics import reach
from planner.measurability import coverage
from planner.ports import CollisionChecker, Kinematics, Progress, RayCaster, Scanner
from planner.values import Bools, Floats
from planner.viewpoints import growth
from planner.viewpoints.growth import ViewEvaluator
from planner.viewpoints.lines_of_sight import RayTargets
from planner.viewpoints.viewpoints import Viewpoints, optimal_scanning_zone, view_sphere, viewpoints_from_poses

GROWN = "grown"


def first(scene: Scene, settings: Settings, part: Workpiece, planning: TriangleMesh) -> Viewpoints:
    """The generator's candidates before reach is asked."""
    step_x, step_y = np.deg2rad(scene.plan.view_sphere_step_deg)
    if scene.plan.candidates == "view-sphere":
        return view_sphere(part.centre, settings.sphere_radius, step_x, step_y, settings.rolls)
    return optimal_scanning_zone(planning, settings.standoffs, settings.rolls)


def limited(scene: Scene, scanner: Scanner) -> Scanner:
    """The scanner's law with the scene's limits; who does not know its sigma is refused where M is made."""
    known = callable(getattr(scanner, "sigma", None))
    return with_limits(scanner, scene.plan.max_sigma_mm if known else None, with_rest(scene.region))


def arm_of(
    world: World,
    kinematics: Kinematics,
    checker: CollisionChecker,
    scanner: Scanner,
    casters: Sequence[RayCaster],
) -> ViewEvaluator:
    """Who measures and where it gets to.

    Args:
        world: the cell.
        kinematics: of the arm.
        checker: of the cell at the placement.
        scanner: the sensor's law, with its limit on sigma.
        casters: the part's and the occluders', object frame.
    """

    def takes_up(T_object_scanner: Floats) -> Bools:
        return reach.are_reachable(T_object_scanner, world.T_base_object, world.T_flange_scanner, kinematics, checker)

    T_view_scanner = getattr(scanner, "T_view_scanner", np.eye(4)[None])
    return ViewEvaluator(scanner, casters, takes_up, T_view_scanner)


def grow(
    candidates: Viewpoints,
    usable: Bools,
    scouts: SurfaceSamples,
    arm: ViewEvaluator,
    progress: Progress | None = None,
    schedule: Sequence[growth.SearchStage] = growth.SCHEDULE,
) -> Viewpoints:
    """Viewpoints for what no usable candidate measures.

    Args:
        candidates: viewpoints of one pose.
        usable: (V,) those that are reached.
        scouts: points of the surface of equal area, neither the rows of the matrix nor the held-out samples.
        arm: the scanner and where it gets to.
        progress: called with (stages done, stages).
        schedule: of the search.

    Returns:
        The new ones alone.
    """
    targets = RayTargets.of(scouts.points, scouts.normals, scouts.region)
    poses = candidates.T_object_scanner[usable] @ arm.T_view_scanner
    seen = coverage.visible_coverage(poses, scouts, arm.scanner, arm.casters).covered
    found = growth.grow(targets, seen, arm, schedule=schedule, progress=progress)
    return viewpoints_from_poses(found.T_object_scanner, scouts.points[found.row], scouts.planning_face[found.row])
