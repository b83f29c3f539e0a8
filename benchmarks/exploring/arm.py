"""The arm of the cell in the laboratory: reachable poses around the unseen cylinder, and duration of motions.

A pose is reachable if a joint solution keeps the clearance from the whole cylinder, from post, pedestal and the arm.
Moves are timed as straight joint moves to the nearest solution, starting at home. Obstacles *between* poses are not
checked: the seconds compare policies, and are less than those of `cell explore`, which goes home after each batch.
"""

import tempfile
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from cell.explore import belief
from cell.explore.prepare import ExplorationContext
from cell.robot.arm import kinematics_of
from cell.robot.model import home
from cell.scanners import baseline_mm
from cell.scene.settle import Settings
from cell.world.collision import MujocoCollisionChecker
from cell.world.model import World, compile_world
from planner.kinematics import reach
from planner.ports import CollisionChecker, Kinematics, Scanner
from planner.timing.move_time import move_time
from planner.values import Bools, Floats
from planner.viewpoints.viewpoints import viewpoints_from_poses


@dataclass(frozen=True, slots=True, eq=False)
class CellArm:
    """The arm in the cell; the whole cylinder of the part is an obstacle."""

    world: World
    checker: CollisionChecker
    kinematics: Kinematics
    _reachable: dict[bytes, bool] = field(default_factory=dict)

    @classmethod
    def of(cls, work: ExplorationContext, settings: Settings, scanner: Scanner) -> "CellArm":
        """Return the cell of the first stage of an exploration."""
        believed = belief.belief_part(belief.surface_about(work.unknown, work.unknown.belief_voxels()), work.name)
        with tempfile.TemporaryDirectory() as folder:
            unseen = Path(folder) / "unseen.ply"
            belief.write_unseen(work.unknown, unseen)
            scene = belief.batch_scene(work.scene, work.cylinder, believed, unseen)
            mesh = believed.reference
            baseline = baseline_mm(settings.scanner, scanner)
            world = compile_world(scene, mesh.vertices, part_faces=mesh.faces, baseline_mm=baseline)
        return cls(world, MujocoCollisionChecker(world), kinematics_of(world.model))

    def are_reachable(self, poses: Floats) -> Bools:
        """Return which of (n, 4, 4) poses [m] the arm reaches."""
        names = [T.tobytes() for T in poses]
        new = [row for row, name in enumerate(names) if name not in self._reachable]
        if new:
            T_base_object, mount = self.world.T_base_object, self.world.T_flange_scanner
            found = reach.are_reachable(poses[new][:, None], T_base_object, mount, self.kinematics, self.checker)
            self._reachable.update(zip([names[row] for row in new], found.tolist(), strict=True))
        return np.array([self._reachable[name] for name in names], dtype=np.bool_)

    def seconds(self, poses: Sequence[Floats]) -> Floats:
        """Return (n,) seconds of motion until each of the poses is reached."""
        views = viewpoints_from_poses(np.stack(poses), np.zeros((len(poses), 3)), np.full(len(poses), -1))
        world, found = self.world, []
        reached = reach.solve_reach(views, world.T_base_object, world.T_flange_scanner, self.kinematics, self.checker)
        q = home(world.model)
        for view in range(len(views)):
            times = move_time(q, reached.configurations_of(view), self.kinematics.limits)
            found.append(float(times.min()))
            q = reached.configurations_of(view)[int(np.argmin(times))]
        return np.cumsum(found)
