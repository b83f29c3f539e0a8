"""The pictures of a plan and its page, sent to the process that draws them (`cell.plan.picture_process`)."""

import numpy as np

from cell.part.workpiece import Workpiece
from cell.plan.connected_plan import ConnectedPlan
from cell.plan.problem import Problem
from cell.robot.arm import wrist_positions
from cell.runs.folder import RunFolder
from cell.runs.schema import PlanFile, Report
from cell.scene.model import Picture
from cell.session import PlotQueue
from cell.world.model import World
from planner.timing.motion import Motion
from planner.values import Floats

_GRID = np.radians(2.0)  # of the axes in the outline of what the wrist reaches
_STEPS = 12  # of the scanner's way between two via points


def draw_views(
    plots: PlotQueue,
    folder: RunFolder,
    part: Workpiece,
    problem: Problem,
    chosen: ConnectedPlan,
    picture: Picture,
) -> None:
    """What is known before the motion is timed: part, views and cell, the cover curve, the candidates by verdict."""
    cover, world = chosen.cover, problem.world
    plots.send(
        "part_and_views",
        folder.path / "views.png",
        T_object_poses=chosen.T_object_poses,
        T_object_scanner=chosen.T_object_scanner,
        seen=chosen.seen,
    )
    via, steps = chosen.tour.via, np.linspace(0, 1, _STEPS)[None, :, None]
    way_q = (via[:-1, None] + steps * np.diff(via, axis=0)[:, None]).reshape(-1, via.shape[1])
    plots.send(
        "cell_with_arm",
        folder.path / "cell.png",
        q=chosen.tour.q,
        T_base_scanner=chosen.T_base_scanner,
        way=(world.in_base(way_q, problem.kinematics.forward(way_q)) @ world.T_flange_scanner)[:, :3, 3],
        camera_deg=picture.camera_deg or (),
        hide=picture.hide,
    )
    plots.send(
        "cover_curve",
        folder.path / "cover.png",
        marginal_area=cover.marginal_area,
        coverable=cover.coverable_area,
        total=cover.total_area,
        lower_bound=cover.lower_bound,
    )
    corners = np.array(np.meshgrid(*part.bounds.T)).reshape(3, -1).T
    T = np.linalg.inv(world.scene.robot.T_base) @ world.T_base_object  # the picture is the robot's
    plots.send(
        "reach_map",
        folder.path / "reach.png",
        T_base_scanner=T @ problem.candidates.T_object_scanner[:, 0],
        verdict=problem.reached.verdict,
        part_corners=corners @ T[:3, :3].T + T[:3, 3],
        chosen=chosen.candidate,
        envelope=_envelope(world),
    )


def draw_motion(plots: PlotQueue, folder: RunFolder, motion: Motion) -> None:
    """Joint angles and speeds over time."""
    plots.send(
        "joint_motion",
        folder.path / "motion.png",
        t=motion.t,
        q=motion.q,
        qd=motion.qd,
        limit=motion.limits.velocity,
        stops=motion.via_t[motion.stops],
    )


def finish_drawing(
    plots: PlotQueue, folder: RunFolder, report: Report, plan: PlanFile, motion: Motion, T_base_object: Floats
) -> None:
    """Wait for all pictures, and add to the page what is known at the end: views, motion, numbers."""
    # What draws is kept out of the start-up.
    from cell.view.contents import HALF_PAGE, NAME, plan_play
    from cell.view.page import second_half

    rest = second_half(plan_play(report, plan.views, motion, T_base_object))
    for path in plots.finish():
        folder.adopt(path.name)
    half = folder.path / HALF_PAGE
    folder.write_text(NAME, half.read_text(encoding="utf-8") + rest)
    half.unlink()


def _envelope(world: World) -> Floats:
    """(E, 2) a grid of places that the wrist centre reaches in the plane of the arm: radius and height [m]."""
    return np.stack(wrist_positions(world.model, world.scene.robot.T_base, _GRID), axis=1)
