"""What must hold before a plan is driven or exported, found out from its run folder alone.

The person who confirms a digest confirms *what* is driven; this finds out whether it may be. In this order, the first
that does not hold being told in one sentence:

1. every file that drives is there, is what the manifest has the sha256 of, and is under the plan's digest;
2. the cell that scene.resolved.json describes, compiled again with this version's robot model, is that of `cell.xml`;
3. plan.json and motion.npz have the same views in the same order, at poses that follow from the angles;
4. the sweeps of a line sensor can be proven again; speeds, times and samples follow from the via points and from the
   limits of the model (those of the file must be equal to them);
5. the certificate of freedom of every segment (`planner.path.certified_edge`) is made again in that cell.

A way that is planned on the spot passes 5, and the limits, before its first move: `Proven.require_way`.
"""

from dataclasses import dataclass, replace
from pathlib import Path

from cell.errors import FileError
from cell.proof import cell_again, motion_again, views_again
from cell.proof.artefacts import refuse, whole
from cell.runs.run import Run, open_finished, reading
from cell.runs.schema import PlanFile, ResolvedScene
from cell.world.collision import MujocoCollisionChecker
from cell.world.model import World
from planner.errors import PlannerError
from planner.kinematics.setpoints import to_steps
from planner.timing.limits import scale_limits
from planner.timing.motion import Motion
from planner.values import Floats


@dataclass(frozen=True, slots=True, eq=False)
class Proven:
    """A plan that may be driven.

    Attributes:
        run: its folder.
        digest: of all that drives.
        scene: scene.resolved.json.
        plan: plan.json.
        motion: motion.npz.
        world: the cell, compiled again.
        checker: of collision in it.
    """

    run: Run
    digest: str
    scene: ResolvedScene
    plan: PlanFile
    motion: Motion
    world: World
    checker: MujocoCollisionChecker

    def require_way(self, via: Floats) -> None:
        """A way of its own keeps the limits and is free of collision.

        Args:
            via: (N, 6) via points from where the arm stands [rad], as they are sent.

        Raises:
            FileError: if it does not.
        """
        try:
            wrong = motion_again.require_free(via, self.checker, self.motion.limits)
        except PlannerError as error:
            wrong = f"leaves the joint range: {error}"
        if wrong:
            raise FileError(f"the way {wrong}; nothing was moved")


def prove(folder: Path) -> Proven:
    """Find out whether the plan of a run folder may be driven.

    Raises:
        FileError: in one sentence, if it may not.
    """
    run = open_finished(folder)
    digest = whole(run)
    resolved, plan, motion = run.scene, run.plan, run.motion
    stored, candidates = run.arrays("motion.npz"), run.candidates
    _require_manifest(run, resolved)
    if not len(plan.views) or len(motion.via_q) < 2:
        refuse(run.folder / "motion.npz", "holds no motion: it visits no view")
    for name in ("pose", "line", "limit_jerk"):  # what runs of earlier versions lack is read as if it were there
        if name not in stored:
            refuse(run.folder / "motion.npz", f"has no {name}")
    world = cell_again.compiled(run, resolved)
    if resolved.plan.collision != world.collision:
        refuse(run.folder / "scene.resolved.json", "contradicts itself at plan.collision")
    kinematics, checker = world.kinematics, MujocoCollisionChecker(world)
    with reading(run.folder / "motion.npz"):
        views_again.require_same_views(run, plan, motion, candidates, world, kinematics)
        views_again.require_same_clearance(run, plan, motion, stored, world.collision)
        full = motion_again.limits_of(resolved, world)
        limits = scale_limits(full, resolved.speed_scaling, resolved.acceleration_scaling)
        sweeps = views_again.sweeps_again(run, plan, motion, candidates, world, kinematics, checker, limits, full)
        motion_again.require_timed(run, motion, limits, sweeps, world.T_flange_scanner, kinematics)
        if (to_steps(motion.via_q[[0, -1]]) != to_steps(world.home)).any():
            refuse(run.folder / "motion.npz", "does not begin and end at home_deg of scene.resolved.json")
        if wrong := motion_again.require_free(motion.via_q, checker, limits):
            refuse(run.folder / "motion.npz", wrong)
    motion = replace(
        motion, limits=replace(motion.limits, table_turn_q=limits.table_turn_q)
    )  # which the file does not say
    return Proven(run, digest, resolved, plan, motion, world, checker)


def _require_manifest(run: Run, resolved: ResolvedScene) -> None:
    """What the manifest and the settings say twice."""
    said = run.manifest.inputs.get("part"), run.manifest.seed
    if said != (resolved.part.sha256, resolved.plan.seed):
        refuse(run.folder / "manifest.json", "has another part or seed than scene.resolved.json")
