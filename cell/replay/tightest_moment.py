"""The tightest moment of a plan as replay shows it: the two nearest points, what they are on, when in the show.

Runs that do not have it, or whose motion is nowhere near anything, show nothing. Base frame, metres, seconds of the
show.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated

import numpy as np

from cell.replay import overlays
from cell.runs.schema import PlanFile
from cell.runs.timeline import Timeline
from cell.view import rays
from planner.values import Floats, Value

if TYPE_CHECKING:
    import mujoco

NEAR: overlays.Colour = (0.93, 0.25, 0.05, 1.0)
_SHOWN = 0.35  # s of the show before and after, in which the pair is drawn into a running show
_ROD, _BALL = 0.002, 0.005  # m
_NEAREST = 0.7  # m, of a camera that looks at the pair
_ELEVATIONS_DEG = (-15.0, -35.0, 5.0)
_SKIN = 0.012  # m; a shape that hides less than this of a point's own surroundings does not hide it


@dataclass(frozen=True, slots=True, eq=False)
class Closest(Value):
    """Two things that are nearest in all of the motion.

    Attributes:
        points: (2, 3) of the first and of the second [m], base frame.
        distance: between them [m].
        between: what they are, "housing with part".
        time: of the show [s].
    """

    points: Annotated[Floats, "2 3"]
    distance: float
    between: str
    time: float

    @property
    def sentence(self) -> str:
        """For captions and for the label beside the line."""
        return f"{1000 * self.distance:.1f} mm {self.between}"

    def shown_at(self, t: float) -> bool:
        """Whether the show is so near to the moment that the pair is drawn."""
        return abs(t - self.time) <= _SHOWN


def of_plan(plan: PlanFile, timeline: Timeline) -> Closest | None:
    """The tightest moment of a plan."""
    tightest = None if plan.clearance is None else plan.clearance.tightest
    if tightest is None:
        return None
    rests = sum(stop.end - stop.begin for stop in timeline.stops if stop.moved < tightest.time_s - 1e-6)
    return Closest(
        np.array(tightest.points_in_base_mm) / 1000.0,
        tightest.distance_mm / 1000.0,
        tightest.between,
        min(tightest.time_s + rests, timeline.duration),
    )


def add_closest(scene: mujoco.MjvScene, closest: Closest) -> None:
    """A rod between the two points, a ball at each, and the distance as a label."""
    start, end = closest.points
    overlays.add_segment(scene, start, end, _ROD, NEAR)
    radius = max(_ROD, min(_BALL, closest.distance / 4))
    overlays.add_ball(scene, start, radius, NEAR)
    overlays.add_ball(scene, end, radius, NEAR)
    overlays.add_label(scene, closest.points.mean(axis=0), "   " + closest.sentence)  # beside the line, not on it


def near_camera(model: mujoco.MjModel, data: mujoco.MjData, closest: Closest, size: tuple[int, int]) -> rays.Camera:
    """A camera near the two points, across the line between them, from where most of both is to be seen.

    Args:
        model: what is looked at.
        data: the state at the tightest moment.
        closest: the two points.
        size: (width, height) of the picture [pixels].
    """
    import mujoco

    middle, distance = closest.points.mean(axis=0), max(_NEAREST, 6.0 * closest.distance)
    way = closest.points[1] - closest.points[0]
    way = way / max(float(np.linalg.norm(way)), 1e-9)
    shown = np.array([1, 1, 1, 1, 0, 0], dtype=np.uint8)
    best, forward = -1.0, np.zeros(3)
    for elevation in _ELEVATIONS_DEG:
        for azimuth in np.arange(0.0, 360.0, 15.0):
            looks = rays.direction(azimuth, elevation)
            eye = middle - distance * looks
            seen = 0
            for point in (*closest.points, middle):
                ray = point - eye
                length = float(np.linalg.norm(ray))
                hit = mujoco.mj_ray(model, data, eye, ray / length, shown, True, -1, np.zeros(1, dtype=np.int32))
                seen += hit < 0 or hit > length - _SKIN
            score = seen + float(np.linalg.norm(np.cross(way, looks)))
            if score > best + 1e-9:
                best, forward = score, looks
    right = np.cross(forward, [0.0, 0.0, 1.0])
    half = np.tan(np.radians(model.vis.global_.fovy) / 2) * np.array([size[0] / size[1], 1.0])
    return rays.Camera(middle - distance * forward, forward, right / np.linalg.norm(right), half, size, False)
