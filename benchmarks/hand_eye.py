"""`cell calibrate hand-eye` from 12 poses: error and reported uncertainty of the mount, and degenerate sets.

The target, a ball of 38.1 mm or a plane, lies in a corner of the field of view, 200 and 400 mm away, and the flange
views it from three tilts up to 60 deg with every roll; or it lies in the middle, with tilts of at most 40 deg. Points
have noise of 0.03 mm along the rays. The true flange pose differs from the reported one by 0.02 deg about each axis and
0.03 mm along each axis. The degenerate sets have no rotation, rotations about one axis only, and rotations about the
centre of the ball.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from time import process_time
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from planner.registration import hand_eye
from planner.registration.hand_eye import PoseError, TargetScans, solve_hand_eye
from planner.registration.observability import RigidFit
from planner.values import Floats

_RADIUS, _NOISE_M, _POSE_M, _POSE_RAD = 0.01905, 3e-5, 3e-5, float(np.radians(0.02))
_DRAWS, _POSES, _POINTS = 10, 12, 1500
_NORMAL = np.array([0.0, 0.0, 1.0])
_TARGET = np.array([1.1, 0.3, 0.0])


@dataclass(frozen=True)
class View:
    """Position of the target in the scanner frame, and rotation of the scanner in the base frame."""

    place: Floats
    turn: Floats


def run() -> list[dict[str, Any]]:
    """Return one row for each target and set of poses."""
    rows = []
    for name, target, radius, views in (
        ("ball, unknown diameter, corners", "ball", None, corners()),
        ("ball, known diameter, corners", "ball", _RADIUS, corners()),
        ("plane, corners", "plane", None, corners()),
        ("ball, unknown diameter, middle", "ball", None, middle()),
        ("plane, middle", "plane", None, middle()),
    ):
        begin = process_time()
        found = [mount_of(target, radius, list(views), draw) for draw in range(_DRAWS)]
        seconds = (process_time() - begin) / _DRAWS
        T = _mount()
        mm = [1000 * float(np.linalg.norm(fit.T[:3, 3] - T[:3, 3])) for fit in found]
        deg = [float(np.degrees(Rotation.from_matrix(fit.T[:3, :3].T @ T[:3, :3]).magnitude())) for fit in found]
        sds = [np.sqrt(np.diag(fit.covariance)) for fit in found if fit.covariance is not None]
        rows.append(
            {
                "target and poses": name,
                "median mm": float(np.median(mm)),
                "worst mm": max(mm),
                "stated mm": 1000 * float(np.median([np.linalg.norm(sd[:3]) for sd in sds])),
                "median deg": float(np.median(deg)),
                "worst deg": max(deg),
                "stated deg": float(np.degrees(np.median([np.linalg.norm(sd[3:]) for sd in sds]))),
                "cpu s": seconds,
            }
        )
    return [*rows, *_degenerate()]


def _degenerate() -> Iterator[dict[str, Any]]:
    """Yield a row for each set of poses that leaves motions of the mount undetermined."""
    down = Rotation.from_euler("x", 180, degrees=True).as_matrix()
    tilted = Rotation.from_euler("y", 20, degrees=True).as_matrix() @ down
    spots = [view.place for view in corners()]
    about = [Rotation.from_euler("z", 30 * k, degrees=True).as_matrix() @ down for k in range(_POSES)]
    for name, views in (
        ("not turned", [View(spot, tilted) for spot in spots]),
        ("turned about one axis", [View(spot, turn) for spot, turn in zip(spots, about, strict=True)]),
        ("turned about the target", [View(np.array([0.0, 0.0, 0.3]), view.turn) for view in corners()]),
    ):
        fit = mount_of("ball", None, views, 0)
        yield {
            "target and poses": f"ball, {name}",
            "undetermined": "; ".join(motion.sentence for motion in fit.undetermined_motions(5e-4)) or "nothing",
        }


def mount_of(target: str, radius: float | None, views: list[View], draw: int) -> RigidFit:
    """Return the fitted mount from scans of a target."""
    rng = np.random.default_rng(draw)
    scans = [_ball(view, rng) if target == "ball" else _plane(view, rng) for view in views]
    poses = [_flange(view, rng) for view in views]
    if target == "ball":
        points = np.stack([each.points for each in hand_eye.fit_spheres(scans, radius, rng)])
    else:
        points = np.stack([each.points for each in hand_eye.fit_planes(scans, rng)])
    return solve_hand_eye(TargetScans(np.stack(poses), points, target == "plane"), PoseError(_POSE_M, _POSE_RAD), rng)


def corners() -> list[View]:
    """Return views of the target in the corners of the field of view, near and far, tilted by 0, 30 and 60 deg."""
    across = np.tan(np.radians(25.0))
    signs = ((1, 1), (-1, 1), (1, -1), (-1, -1))
    places = [
        (0.2, 0.4)[k % 2] * np.array([across * signs[k % 4][0], across * signs[k % 4][1], 1.0]) for k in range(_POSES)
    ]
    return [View(spot, _turn(150 * k, 30 * (k % 3), 210 * k)) for k, spot in enumerate(places)]


def middle() -> list[View]:
    """Return views of the target within 40 mm of the viewing axis, 250 to 350 mm away, tilted by at most 40 deg."""
    rng = np.random.default_rng(1)
    return [
        View(
            np.array([*rng.uniform(-0.04, 0.04, 2), rng.uniform(0.25, 0.35)]),
            _turn(*rng.uniform((0, 0, 0), (360, 40, 360))),
        )
        for _ in range(_POSES)
    ]


def _turn(azimuth: float, tilt: float, roll: float) -> Floats:
    """Return the (3, 3) rotation of a scanner that looks down, tilted and rolled [deg]."""
    down = Rotation.from_euler("x", 180, degrees=True)
    turned = Rotation.from_euler("zyz", [azimuth, tilt, roll - azimuth], degrees=True) * down
    return np.asarray(turned.as_matrix())


def _mount() -> Floats:
    T = np.eye(4)
    T[:3, :3] = Rotation.from_euler("zyx", [30, 10, -15], degrees=True).as_matrix()
    T[:3, 3] = 0.03, -0.02, 0.12
    return T


def _flange(view: View, rng: np.random.Generator) -> Floats:
    """Return T_base_flange as the controller reports it: the true pose with the errors of the arm."""
    T, off = np.eye(4), np.eye(4)
    T[:3, :3], T[:3, 3] = view.turn, _TARGET - view.turn @ view.place
    off[:3, :3] = Rotation.from_rotvec(rng.normal(0.0, _POSE_RAD, 3)).as_matrix()
    off[:3, 3] = rng.normal(0.0, _POSE_M, 3)
    return np.asarray(T @ np.linalg.inv(_mount()) @ off)


def _ball(view: View, rng: np.random.Generator) -> Floats:
    """Return points within 60 deg of the point of the ball that faces the source."""
    facing = -view.place / np.linalg.norm(view.place)
    on = rng.standard_normal((6 * _POINTS, 3))
    on /= np.linalg.norm(on, axis=1, keepdims=True)
    return _noisy(view.place + _RADIUS * on[on @ facing > 0.5][:_POINTS], rng)


def _plane(view: View, rng: np.random.Generator) -> Floats:
    """Return points within 25 deg of the viewing axis, on the plane through the target."""
    across = np.tan(np.radians(rng.uniform(-25, 25, (_POINTS, 2))))
    rays = np.column_stack([across, np.ones(_POINTS)])
    normal = view.turn.T @ _NORMAL
    far = (view.place @ normal) / (rays @ normal)
    return _noisy((rays * far[:, None])[(far > 0) & (far < 1.0)], rng)


def _noisy(points: Floats, rng: np.random.Generator) -> Floats:
    rays = points / np.linalg.norm(points, axis=1, keepdims=True)
    return points + rays * rng.normal(0.0, _NOISE_M, (len(points), 1))
