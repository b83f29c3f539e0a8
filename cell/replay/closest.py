"""The tightest moment of a plan as replay shows it: the two nearest points, what they are on, when in the show.

Runs that do not have it, or whose motion is nowhere near anything, show nothing. Base frame, metres, seconds of the
show.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from cell.replay import marks
from cell.replay.timeline import Timeline
from cell.run.plan_json import Tightest

if TYPE_CHECKING:
    import mujoco

NEAR: marks.Colour = (0.93, 0.25, 0.05, 1.0)
_SHOWN = 0.35  # s of the show before and after, in which the pair is drawn into a running show
_ROD, _BALL = 0.002, 0.005  # m
_NEAREST = 0.7  # m, of a camera that looks at the pair
_ELEVATIONS_DEG = (-15.0, -35.0, 5.0)
_SKIN = 0.012  # m; a shape that hides less than this of a point's own surroundings does not hide it


def in_the_show(tightest: Tightest | None, timeline: Timeline) -> Tightest | None:
    """The tightest moment of a plan at its time of the show, whose rests the motion does not have."""
    if tightest is None:
        return None
    rests = sum(stop.end - stop.begin for stop in timeline.stops if stop.moved < tightest.time_s - 1e-6)
    return tightest.model_copy(update={"time_s": min(tightest.time_s + rests, timeline.duration)})


def shown_at(closest: Tightest, t: float) -> bool:
    """Whether the show is so near to the moment that the pair is drawn."""
    return abs(t - closest.time_s) <= _SHOWN


def add_closest(scene: mujoco.MjvScene, closest: Tightest) -> None:
    """A rod between the two points, a ball at each, and the distance as a label."""
    start, end = closest.points
    marks.add_segment(scene, start, end, _ROD, NEAR)
    radius = max(_ROD, min(_BALL, closest.distance_mm / 4000))
    marks.add_ball(scene, start, radius, NEAR)
    marks.add_ball(scene, end, radius, NEAR)
    marks.add_label(scene, closest.points.mean(axis=0), "   " + closest.sentence)  # beside the line, not on it


def close_camera(model: mujoco.MjModel, data: mujoco.MjData, closest: Tightest) -> mujoco.MjvCamera:
    """A camera near the two points, across the line between them, from where most of both is to be seen.

    Args:
        model: what is looked at.
        data: the state at the tightest moment.
        closest: the two points.
    """
    import mujoco

    camera = mujoco.MjvCamera()
    mujoco.mjv_defaultFreeCamera(model, camera)
    middle = closest.points.mean(axis=0)
    camera.lookat[:], camera.distance = middle, max(_NEAREST, 0.006 * closest.distance_mm)
    way = closest.points[1] - closest.points[0]
    way = way / max(float(np.linalg.norm(way)), 1e-9)
    shown = np.array([1, 1, 1, 1, 0, 0], dtype=np.uint8)
    best = -1.0
    for elevation in _ELEVATIONS_DEG:
        for azimuth in np.arange(0.0, 360.0, 15.0):
            a, e = np.radians([azimuth, elevation])
            forward = np.array([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)])
            eye = middle - camera.distance * forward
            seen = 0
            for point in (*closest.points, middle):
                ray = point - eye
                length = float(np.linalg.norm(ray))
                hit = mujoco.mj_ray(model, data, eye, ray / length, shown, True, -1, np.zeros(1, dtype=np.int32))
                seen += hit < 0 or hit > length - _SKIN
            score = seen + float(np.linalg.norm(np.cross(way, forward)))
            if score > best + 1e-9:
                best, camera.azimuth, camera.elevation = score, float(azimuth), elevation
    return camera
