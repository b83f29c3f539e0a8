"""Playback: the replay model, a timeline, and the marks at each moment. Viewer and pictures use it."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from cell.robot import model as robot
from cell.runs.timeline import Timeline
from cell.view import overlays
from cell.view.appearance import VISIBLE_GROUPS
from cell.view.replay_model import ReplayModel
from cell.view.tightest_moment import TightestMoment, add_tightest
from cell.world.table import TablePoses
from planner.ports import ARM_AXES
from planner.values import Floats, readonly

if TYPE_CHECKING:
    import mujoco

_PATH_RADIUS = 0.0022
_PATH_SAMPLES = 400


class Playback:
    """The state (MjData) of the replay model at a moment, with its marks.

    Attributes:
        replay_model: cell with visual meshes.
        timeline: joint angles over time.
        data: the state; set by `pose`.
        T_base_scanner: (n, 4, 4) pose of the scanner at each view [m].
        path: (M, 3) path of the scanner's source [m], base frame.
        T_base_candidate: (C, 4, 4) candidate viewpoints of a run without motion [m].
        reachable: (C,) whether each of them is reachable; None if unknown.
        tightest: the moment of the smallest distance; None if unknown.
    """

    def __init__(
        self,
        replay_model: ReplayModel,
        timeline: Timeline,
        T_base_candidate: Floats | None = None,
        reachable: np.ndarray[tuple[int], np.dtype[np.bool_]] | None = None,
        tightest: TightestMoment | None = None,
    ) -> None:
        """Compute the poses of the scanner; arguments as the attributes."""
        import mujoco

        self.replay_model, self.timeline = replay_model, timeline
        self.data = mujoco.MjData(replay_model.model)
        self._mimic_joints = robot.MimicJoints.from_model(replay_model.model)
        self._table_poses = TablePoses(self.data, replay_model.table)
        self._flange = replay_model.model.site(robot.FLANGE).id
        self.T_base_scanner = readonly(
            "T_base_scanner",
            np.array([self._scanner(timeline.at(stop.begin)) for stop in timeline.stops]).reshape(-1, 4, 4),
            (None, 4, 4),
        )
        rows = np.linspace(0, len(timeline.t) - 1, min(len(timeline.t), _PATH_SAMPLES)).astype(int)
        corners = np.searchsorted(timeline.t, [stop.begin for stop in timeline.stops])
        rows = np.union1d(rows, corners)
        self.path = readonly("path", [self._scanner(q)[:3, 3] for q in timeline.q[rows]], (None, 3))
        self.T_base_candidate = np.zeros((0, 4, 4)) if T_base_candidate is None else T_base_candidate
        self.reachable = reachable
        self.tightest = tightest
        self.pose(0.0)

    def pose(self, t: float) -> None:
        """Set the state at a playback time [s]."""
        import mujoco

        self._set(self.timeline.at(t))
        mujoco.mj_kinematics(self.replay_model.model, self.data)
        mujoco.mj_comPos(self.replay_model.model, self.data)
        mujoco.mj_camlight(self.replay_model.model, self.data)

    def violations(self) -> tuple[overlays.ClearanceViolation, ...]:
        """Return the clearance violations at the current pose."""
        return overlays.find_violations(self.replay_model, self.data)

    def add_static_marks(self, scene: mujoco.MjvScene) -> None:
        """Draw the marks that do not change: the path, or the candidates of a run without motion."""
        if len(self.path) > 1:
            overlays.add_path(scene, self.path, _PATH_RADIUS)
        for number, T in enumerate(self.T_base_candidate):
            colour = overlays.EARLIER
            if self.reachable is not None:
                colour = overlays.NEWEST if self.reachable[number] else overlays.UNREACHABLE
            overlays.add_segment(scene, T[:3, 3], T[:3, 3] + 0.05 * T[:3, 2], 0.002, colour)
            overlays.add_ball(scene, T[:3, 3], 0.006, colour)

    def add_moment_marks(
        self, scene: mujoco.MjvScene, t: float, violations: tuple[overlays.ClearanceViolation, ...] = ()
    ) -> None:
        """Draw the scanner's frustum, the points scanned until then, and clearance violations."""
        # Views may be missing: the row of a stop is not its number.
        stop = self.timeline.stop_at(t)
        row = None if stop is None else self.timeline.stops.index(stop)
        if self.replay_model.cloud_meshes:
            overlays.add_clouds(scene, self.replay_model, range(self.timeline.reached(t)), row, self.data)
        if row is not None:
            overlays.add_frustum(scene, self.replay_model, self.T_base_scanner[row])
        elif self.timeline.stops:
            overlays.add_glyph(scene, self.replay_model, self._scanner_now())
        for violation in violations:
            overlays.add_ball(scene, np.array(violation.position), 0.02, overlays.CONTACT)
        if self.tightest is not None and self.tightest.is_shown_at(t):
            add_tightest(scene, self.tightest)

    def caption(self, t: float, violations: tuple[overlays.ClearanceViolation, ...] = ()) -> str:
        """Return a line with the current view or goal, the motion time, and distances below the clearance."""
        stops = self.timeline.stops
        if not stops:
            return "home"
        stop, n_reached = self.timeline.stop_at(t), self.timeline.reached(t)
        if stop is not None:
            where = f"view {stop.number} of {self.timeline.n_views} (candidate {stop.candidate})"
        elif n_reached < len(stops):
            where = f"to view {stops[n_reached].number} of {self.timeline.n_views}"
        else:
            where = "home" if t >= self.timeline.duration else "to home"
        text = f"{where}   {self.timeline.moved(t):.1f} s"
        tight = (
            [f"tightest: {self.tightest.sentence}"]
            if self.tightest is not None and self.tightest.is_shown_at(t)
            else []
        )
        return "   ".join([text, *tight, *(violation.sentence for violation in violations)])

    def _scanner(self, q: Floats) -> Floats:
        """Return the (4, 4) pose of the scanner at joint angles [m]."""
        import mujoco

        self._set(q)
        mujoco.mj_kinematics(self.replay_model.model, self.data)
        return self._scanner_now()

    def _set(self, q: Floats) -> None:
        self.data.qpos[:] = self._mimic_joints.qpos(q[:ARM_AXES])
        self._table_poses.set_configuration(self.data, q)

    def _scanner_now(self) -> Floats:
        T_base_scanner: Floats = robot.frame_of(self.data.site(self._flange)) @ self.replay_model.T_flange_scanner
        return T_base_scanner


def set_visible_groups(option: mujoco.MjvOption) -> None:
    """Show surfaces and the robot; hide hulls, the collision boxes inside the robot, and sites."""
    option.geomgroup[:] = VISIBLE_GROUPS
    option.sitegroup[:] = 0
