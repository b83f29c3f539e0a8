"""The show: a dressed model, a timeline, and what is to be seen at each moment. Viewer and pictures both play it."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from cell.replay import overlays
from cell.replay.model import Theatre
from cell.replay.tightest_moment import Closest, add_closest
from cell.robot import model as robot
from cell.runs.timeline import Timeline
from cell.world.table import TablePoses
from planner.ports import ARM_AXES
from planner.values import Floats, readonly

if TYPE_CHECKING:
    import mujoco

_PATH_RADIUS = 0.0022
_PATH_SAMPLES = 400


class Show:
    """Holds the state (MjData) that is posed and drawn.

    Attributes:
        theatre: the dressed model.
        timeline: what happens when.
        data: the state; `pose` sets it.
        T_base_scanner: (n, 4, 4) pose of the scanner at each stop [m].
        path: (M, 3) the way of the scanner's source [m], base frame.
        candidates: (C, 3) sources of candidate viewpoints where there is no motion to show [m].
        reachable: (C,) whether each of them was found reachable; None where the run did not get so far.
        closest: the tightest moment of the motion; None where it is not known.
    """

    def __init__(
        self,
        theatre: Theatre,
        timeline: Timeline,
        T_base_candidate: Floats | None = None,
        reachable: np.ndarray[tuple[int], np.dtype[np.bool_]] | None = None,
        closest: Closest | None = None,
    ) -> None:
        """Work out the poses.

        Args:
            theatre: the dressed model.
            timeline: what happens when.
            T_base_candidate: (C, 4, 4) candidate viewpoints to be shown [m]; None for a run with a motion.
            reachable: (C,) what is known of them.
            closest: the tightest moment of the motion.
        """
        import mujoco

        self.theatre, self.timeline = theatre, timeline
        self.data = mujoco.MjData(theatre.model)
        self._followers = robot.MimicJoints.from_model(theatre.model)
        self._table_poses = TablePoses(self.data, theatre.table)
        self._flange = theatre.model.site(robot.FLANGE).id
        self.T_base_scanner = readonly(
            "T_base_scanner",
            np.array([self._scanner(timeline.at(stop.begin)) for stop in timeline.stops]).reshape(-1, 4, 4),
            (None, 4, 4),
        )
        shown = np.linspace(0, len(timeline.t) - 1, min(len(timeline.t), _PATH_SAMPLES)).astype(int)
        corners = np.searchsorted(timeline.t, [stop.begin for stop in timeline.stops])
        rows = np.union1d(shown, corners)
        self.path = readonly("path", [self._scanner(q)[:3, 3] for q in timeline.q[rows]], (None, 3))
        self.T_base_candidate = np.zeros((0, 4, 4)) if T_base_candidate is None else T_base_candidate
        self.reachable = reachable
        self.closest = closest
        self.pose(0.0)

    def pose(self, t: float) -> None:
        """Bring the arm to where it is at a time of the show [s]."""
        import mujoco

        self._set(self.timeline.at(t))
        mujoco.mj_kinematics(self.theatre.model, self.data)
        mujoco.mj_comPos(self.theatre.model, self.data)
        mujoco.mj_camlight(self.theatre.model, self.data)

    def touches(self) -> tuple[overlays.Touch, ...]:
        """What is nearer than the clearance at the present pose."""
        return overlays.touches(self.theatre, self.data)

    def draw_still(self, scene: mujoco.MjvScene) -> None:
        """What does not change while the show runs: path, or the candidates of a run without one."""
        if len(self.path) > 1:
            overlays.add_path(scene, self.path, _PATH_RADIUS)
        for number, T in enumerate(self.T_base_candidate):
            known = self.reachable is not None
            free = known and self.reachable is not None and bool(self.reachable[number])
            colour = overlays.FRESH if free else overlays.LOST if known else overlays.EARLIER
            overlays.add_segment(scene, T[:3, 3], T[:3, 3] + 0.05 * T[:3, 2], 0.002, colour)
            overlays.add_ball(scene, T[:3, 3], 0.006, colour)

    def draw_moment(self, scene: mujoco.MjvScene, t: float, touching: tuple[overlays.Touch, ...] = ()) -> None:
        """Frustum where the scanner is looking, points taken by then, contacts."""
        row = self._row_at(t)
        taken = self.timeline.reached(t)
        if self.theatre.cloud_mesh:
            overlays.add_clouds(scene, self.theatre, range(taken), row, self.data)
        if row is not None:
            overlays.add_frustum(scene, self.theatre, self.T_base_scanner[row])
        elif self.timeline.stops:
            overlays.add_glyph(scene, self.theatre, self._scanner_now())
        overlays.add_touches(scene, touching)
        if self.closest is not None and self.closest.shown_at(t):
            add_closest(scene, self.closest)

    def _row_at(self, t: float) -> int | None:
        """Row of the stop at which the show rests; its number may be another one where views are missing."""
        stop = self.timeline.stop_at(t)
        return None if stop is None else self.timeline.stops.index(stop)

    def caption(self, t: float, touching: tuple[overlays.Touch, ...] = ()) -> str:
        """Where the show is, in a line."""
        stops = self.timeline.stops
        if not stops:
            return "home"
        stop, taken = self.timeline.stop_at(t), self.timeline.reached(t)
        if stop is not None:
            where = f"view {stop.number} of {self.timeline.n_views} (candidate {stop.candidate})"
        elif taken < len(stops):
            where = f"to view {stops[taken].number} of {self.timeline.n_views}"
        else:
            where = "home" if t >= self.timeline.duration else "to home"
        text = f"{where}   {self.timeline.moved(t):.1f} s"
        tight = [f"tightest: {self.closest.sentence}"] if self.closest is not None and self.closest.shown_at(t) else []
        return "   ".join([text, *tight, *(touch.sentence for touch in touching)])

    def _scanner(self, q: Floats) -> Floats:
        """(4, 4) pose of the scanner at joint angles [m]."""
        import mujoco

        self._set(q)
        mujoco.mj_kinematics(self.theatre.model, self.data)
        return self._scanner_now()

    def _set(self, q: Floats) -> None:
        self.data.qpos[:] = self._followers.qpos(q[:ARM_AXES])
        self._table_poses.set_configuration(self.data, q)

    def _scanner_now(self) -> Floats:
        T = np.eye(4)
        T[:3, :3] = self.data.site_xmat[self._flange].reshape(3, 3)
        T[:3, 3] = self.data.site_xpos[self._flange]
        T_base_scanner: Floats = T @ self.theatre.T_flange_scanner
        return T_base_scanner


def show_what_is_seen(option: mujoco.MjvOption) -> None:
    """Surfaces and the robot are shown; hulls, the boxes inside the robot's look, and sites are not."""
    option.geomgroup[:] = [1, 1, 1, 1, 0, 0]
    option.sitegroup[:] = 0
