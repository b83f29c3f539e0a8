"""The moment of the smallest distance of a plan: the two nearest points, their bodies and the playback time.

It does not exist for runs of older versions and for a motion far from everything. Base frame, metres, seconds.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated

import numpy as np

from cell.runs.schema import PlanFile
from cell.runs.timeline import Timeline
from cell.view import overlays, rays
from cell.view.appearance import VISIBLE_GROUPS
from planner.values import Floats, Value

if TYPE_CHECKING:
    import mujoco

TIGHTEST: overlays.Colour = (0.93, 0.25, 0.05, 1.0)
_DISPLAY_TIME = 0.35  # s before and after the moment during which a running playback shows the pair
_ROD, _BALL = 0.002, 0.005  # m
_MIN_CAMERA_DISTANCE = 1.2  # m; shows the object around the pair
_ELEVATIONS_DEG = (-15.0, -35.0, 5.0)
_SKIN = 0.012  # m; a surface this close in front of a point belongs to the point's own body and does not hide it


@dataclass(frozen=True, slots=True, eq=False)
class TightestMoment(Value):
    """The pair with the smallest distance of the whole motion.

    Attributes:
        points: on the first and on the second body [m], base frame.
        distance: between them [m].
        between: names of both, such as "housing with part".
        time: playback time [s].
    """

    points: Annotated[Floats, "2 3"]
    distance: float
    between: str
    time: float

    @property
    def sentence(self) -> str:
        """Text for captions and for the label at the line."""
        return f"{1000 * self.distance:.1f} mm {self.between}"

    def is_shown_at(self, t: float) -> bool:
        """Return whether a playback at time `t` shows the pair."""
        return abs(t - self.time) <= _DISPLAY_TIME


def tightest_moment(plan: PlanFile, timeline: Timeline) -> TightestMoment | None:
    """Return the moment of the smallest distance of a plan, if it is known."""
    tightest = None if plan.clearance is None else plan.clearance.tightest
    if tightest is None:
        return None
    rests = sum(stop.end - stop.begin for stop in timeline.stops if stop.moved < tightest.time_s - 1e-6)
    return TightestMoment(
        np.array(tightest.points_in_base_mm) / 1000.0,
        tightest.distance_mm / 1000.0,
        tightest.between,
        min(tightest.time_s + rests, timeline.duration),
    )


def add_tightest(scene: mujoco.MjvScene, tightest: TightestMoment) -> None:
    """Draw a rod between the two points, a ball at each, and the distance as a label."""
    start, end = tightest.points
    overlays.add_segment(scene, start, end, _ROD, TIGHTEST)
    radius = max(_ROD, min(_BALL, tightest.distance / 4))
    overlays.add_ball(scene, start, radius, TIGHTEST)
    overlays.add_ball(scene, end, radius, TIGHTEST)
    overlays.add_label(scene, tightest.points.mean(axis=0), "   " + tightest.sentence)  # beside the line, not on it


def closeup_camera(
    model: mujoco.MjModel, data: mujoco.MjData, tightest: TightestMoment, size: tuple[int, int]
) -> rays.Camera:
    """Return a camera close to the two points that sees most of both, across the line between them.

    Args:
        model: of the replay.
        data: the state at the tightest moment.
        tightest: the two points.
        size: (width, height) of the picture [pixels].
    """
    import mujoco

    middle, distance = tightest.points.mean(axis=0), max(_MIN_CAMERA_DISTANCE, 6.0 * tightest.distance)
    line = tightest.points[1] - tightest.points[0]
    line = line / max(float(np.linalg.norm(line)), 1e-9)
    visible_groups = np.array(VISIBLE_GROUPS, dtype=np.uint8)
    best, forward = -1.0, np.zeros(3)
    for elevation in _ELEVATIONS_DEG:
        for azimuth in np.arange(0.0, 360.0, 15.0):
            toward = rays.direction(azimuth, elevation)
            eye = middle - distance * toward
            n_seen = 0
            for point in (*tightest.points, middle):
                ray = point - eye
                length = float(np.linalg.norm(ray))
                hit = mujoco.mj_ray(
                    model, data, eye, ray / length, visible_groups, True, -1, np.zeros(1, dtype=np.int32)
                )
                n_seen += hit < 0 or hit > length - _SKIN
            score = n_seen + float(np.linalg.norm(np.cross(line, toward)))
            if score > best + 1e-9:
                best, forward = score, toward
    right = np.cross(forward, [0.0, 0.0, 1.0])
    half = np.tan(np.radians(model.vis.global_.fovy) / 2) * np.array([size[0] / size[1], 1.0])
    return rays.Camera(middle - distance * forward, forward, right / np.linalg.norm(right), half, size, False)
