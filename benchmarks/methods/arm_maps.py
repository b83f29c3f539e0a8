"""Limits of the methods of the arm: inverse kinematics, joint limits, reach, path search.

The truth is known from the construction: a pose comes from joint angles at a given distance from a singularity, a limit
or the edge of the envelope. Metres, radians.
"""

from functools import lru_cache

import mujoco
import numpy as np
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from benchmarks.methods.stability_map import Map, MapPoint
from cell.robot import model as robot
from cell.robot.arm import kr16_kinematics
from cell.scene.model import Scene
from cell.world.collision import MujocoCollisionChecker
from cell.world.model import World, compile_world
from planner.kinematics.closed_form import STRETCH_TOLERANCE, KukaKinematics
from planner.kinematics.reach import Verdict
from planner.kinematics.setpoints import STEPS_PER_DEGREE, setpoints
from planner.path.certified_edge import certify, quantise
from planner.path.path import connect
from planner.values import Floats

_HALF_STEP = np.radians(0.5 / STEPS_PER_DEGREE)
_INNER = 0.95  # share of the joint range: poses near singularities and edges are not near the limits
_SAME_POSE = 1e-9  # m and 1: two poses
_OURS = "closed form"
_NUMERIC_STARTS, _NUMERIC_GOOD = 4, 1e-7  # starts of the numeric inverse; its tolerance in m and rad


@lru_cache(maxsize=1)
def _kinematics() -> KukaKinematics:
    return kr16_kinematics()


def _forearm() -> tuple[float, float]:
    """Return the length of the forearm bar, and the A3 at which the arm is stretched."""
    arm = _kinematics().arm
    return float(np.hypot(arm.d4, arm.a3)), float(-np.arctan2(-arm.a3, arm.d4))


def _draw(count: int, seed: int = 0) -> Floats:
    """Return (count, 6) joint angles within the inner part of the range."""
    limits = _kinematics().limits
    rng = np.random.default_rng(seed)
    return np.asarray(rng.uniform(_INNER * limits.lower, _INNER * limits.upper, (count, 6)))


def singular(line: str, distance: float, count: int) -> MapPoint:
    """Test inverse kinematics near the singularities: share of poses with exact branches, and residual."""
    kinematics = _kinematics()
    forearm, stretched = _forearm()
    q = _draw(count)
    q[:, 4] = np.where(np.abs(q[:, 4]) < 0.2, 0.2, q[:, 4])
    if line == "wrist straight":
        q[:, 4] = distance
    elif line == "arm stretched":
        q[:, 2] = stretched + distance
    else:  # r = a1 + a2 cos A2 + L cos(s + stretched) is the distance of the wrist centre from A1
        arm = kinematics.arm
        cosine = (distance - arm.a1 - arm.a2 * np.cos(q[:, 1])) / forearm
        q, cosine = q[np.abs(cosine) < 1], cosine[np.abs(cosine) < 1]
        q[:, 2] = np.arccos(cosine) - q[:, 1] + np.arctan2(arm.a3, arm.d4)
    T = kinematics.forward(q)
    branches = kinematics.inverse(T)
    off = np.abs((branches - q[:, None] + np.pi) % (2 * np.pi) - np.pi).max(axis=2)
    real = np.isfinite(branches).all(axis=2)
    back = kinematics.forward(branches[real])
    residual = np.abs(back - np.repeat(T, real.sum(axis=1), axis=0)).max(axis=(1, 2))
    found = real.sum(axis=1) > 0
    own = np.nanmin(np.where(real, off, np.inf), axis=1)
    good = np.zeros(len(q), dtype=np.bool_)
    good[np.repeat(np.arange(len(q)), real.sum(axis=1))[residual <= _SAME_POSE]] = True
    return MapPoint(
        float((found & good).mean()), float(residual.max()),
        more={"branches": float(real.sum(axis=1).mean()), "own joint angles off rad": float(np.median(own))},
    )  # fmt: skip


def limit(line: str, inside_deg: float, count: int) -> MapPoint:
    """Test joint limits: set-points inside the range are kept, set-points outside are refused."""
    kinematics, limits = _kinematics(), _kinematics().limits
    axis = int(line.removeprefix("A")) - 1
    q = _draw(count)
    q[:, 4] = np.where(np.abs(q[:, 4]) < 0.2, 0.2, q[:, 4])
    q[:, axis] = limits.upper[axis] - np.radians(inside_deg)
    branches = kinematics.inverse(kinematics.forward(q))
    off = np.abs((branches - q[:, None] + np.pi) % (2 * np.pi) - np.pi).max(axis=2)
    own = branches[np.arange(len(q)), np.nanargmin(off, axis=1)][:, None]
    found = setpoints(own, limits)
    is_found = np.isin(np.arange(len(q)), found.pose)
    excess = np.maximum(found.q - limits.upper, limits.lower - found.q).max(initial=0.0)
    is_expected = inside_deg >= 0
    doubtful = abs(np.radians(inside_deg)) <= _HALF_STEP  # rounds onto the limit
    right = np.ones(len(q), dtype=np.bool_) if doubtful else is_found == is_expected
    return MapPoint(
        float(right.mean()), max(float(np.degrees(excess)), 0.0),
        "" if is_found.all() else Verdict.JOINT_LIMIT.sentence, {"kept %": 100 * float(is_found.mean())},
    )  # fmt: skip


def reached(line: str, inside_mm: float, count: int) -> MapPoint:
    """Test reach at the edge of the envelope: share of correct answers for poses surely inside or outside."""
    kinematics = _kinematics()
    arm, (forearm, stretched) = kinematics.arm, _forearm()
    q = _draw(4 * count if line == _OURS else count)
    q[:, 4] = np.where(np.abs(q[:, 4]) < 0.2, 0.2, q[:, 4])
    q = q[np.cos(q[:, 1]) > 0]  # the wrist centre in front of A1: overhead the other shoulder reaches farther
    inside = inside_mm / 1000
    rho = arm.a2 + forearm - max(inside, 0.0)
    cosine = (rho**2 - arm.a2**2 - forearm**2) / (2 * arm.a2 * forearm)
    q[:, 2] = stretched + np.arccos(min(cosine, 1.0))
    T = kinematics.forward(q)
    if inside < 0:  # along the stretched arm: from the shoulder through the elbow, which lies on the line
        direction = np.stack(
            [np.cos(q[:, 1]) * np.cos(q[:, 0]), -np.cos(q[:, 1]) * np.sin(q[:, 0]), -np.sin(q[:, 1])], axis=1
        )
        T[:, :3, 3] -= inside * direction
    if line == _OURS:
        found = setpoints(kinematics.inverse(T), kinematics.limits)
        is_found = np.isin(np.arange(len(q)), found.pose)
        reached_at = kinematics.forward(found.q)[:, :3, 3] - T[found.pose, :3, 3]
        error = float(np.linalg.norm(reached_at, axis=1).max()) if len(found.q) else None
        says = "" if found.real.all() else Verdict.OUT_OF_REACH.sentence
    else:
        residual = np.array([_numeric(pose, index) for index, pose in enumerate(T)])
        is_found = residual <= _NUMERIC_GOOD
        error, says = (float(residual[is_found].max()) if is_found.any() else None), ""
    right = (is_found == (inside > 0)) | (abs(inside) <= STRETCH_TOLERANCE)
    return MapPoint(
        float(right.mean()), None if error is None else 1e6 * error, says, {"found %": 100 * float(is_found.mean())}
    )


def _numeric(T: Floats, seed: int) -> float:
    """Return the smallest residual [m, rad] of least squares on MuJoCo's chain of bodies, from several starts."""
    model = _model()
    data = mujoco.MjData(model)
    limits = _kinematics().limits

    def residual(q: Floats) -> Floats:
        data.qpos[:] = q
        mujoco.mj_kinematics(model, data)
        site = data.site(robot.FLANGE)
        turn = Rotation.from_matrix(site.xmat.reshape(3, 3).T @ T[:3, :3]).as_rotvec()
        return np.concatenate([site.xpos - T[:3, 3], turn])

    best = np.inf
    for start in np.random.default_rng(seed).uniform(limits.lower, limits.upper, (_NUMERIC_STARTS, 6)):
        found = least_squares(residual, start, bounds=(limits.lower, limits.upper), xtol=1e-15, ftol=1e-15, gtol=1e-15)
        best = min(best, float(np.linalg.norm(found.fun)))
        if best <= _NUMERIC_GOOD:
            break
    return best


@lru_cache(maxsize=1)
def _model() -> mujoco.MjModel:
    return robot.load()


_BALL = 0.02 * np.array([[1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1.0]])  # a part far from the arm
_FORWARD = np.array([[0, 0, 1], [0, 1, 0], [-1, 0, 0.0]])  # the flange looks along the base's x
_FLANGE, _ASIDE = np.array([1.1, 0.0, 0.8]), np.array([-0.2, 0.35, 0.1])


@lru_cache(maxsize=4)
def _between_plates(beyond_mm: float) -> tuple[World, MujocoCollisionChecker]:
    """Return two plates whose gap is the housing width, both clearances, and `beyond_mm` on both sides."""
    middle = 40.0 + Scene().clearance_mm + beyond_mm + 10.0
    plates = [
        {"name": name, "shape": "box", "size_mm": [100, 20, 500], "position_mm": [1190, y, 800]}
        for name, y in (("left plate", middle), ("right plate", -middle))
    ]
    scene = Scene.model_validate(
        {"fixtures": plates, "placement": {"position_mm": [0, 1500, 0]}, "post": {"enabled": False}}
    )
    world = compile_world(scene, _BALL, baseline_mm=75.0)
    return world, MujocoCollisionChecker(world)


def _place(checker: MujocoCollisionChecker, position: Floats, turn: float) -> Floats:
    """Return the first free set-point between wide plates with the flange there, turned about its axis."""
    T = np.eye(4)
    T[:3, :3] = _FORWARD @ Rotation.from_rotvec([0, 0, turn]).as_matrix()
    T[:3, 3] = position
    limits = _kinematics().limits
    q = quantise(_kinematics().inverse(T[None])[0])
    q = q[np.isfinite(q).all(axis=1) & (q >= limits.lower).all(axis=1) & (q <= limits.upper).all(axis=1)]
    return np.asarray(q[checker.free(q)][0])


def path(line: str, beyond_mm: float, seeds: int) -> MapPoint:
    """Test path search into a gap slightly wider than the clearance requires: share of found paths."""
    world, checker = _between_plates(beyond_mm)
    _, wide = _between_plates(20.0)
    inside, outside = _place(wide, _FLANGE, 0.0), _place(wide, _FLANGE + _ASIDE, np.radians(60))
    if certify(outside, inside, checker)[0]:
        raise ValueError("the straight move into the gap is free; the map needs one that is not")
    found = [connect(outside, inside, checker, world.limits, np.random.default_rng(seed)) for seed in range(seeds)]
    failed = [result for result in found if result.via is None]
    times = [result.duration for result in found if result.via is not None]
    right = 1.0 if beyond_mm < 0 and len(failed) == seeds else len(times) / seeds
    return MapPoint(
        right, float(np.median(times)) if times else None, failed[0].status.sentence if failed else "",
        {"checks": int(np.median([result.checks for result in found]))},
    )  # fmt: skip


_TINY = tuple(10.0**k for k in range(-16, 1))

MAPS = {
    "ik": Map(
        "Inverse kinematics towards the singularities",
        "distance from the singularity [rad; m for the wrist centre over A1]",
        "poses whose joint angles are found again", "largest residual of any branch's pose [m]", _SAME_POSE,
        _TINY, (1e-12, 1e-3), singular, (2000, 200),
        lines=("wrist straight", "arm stretched", "wrist centre over A1"), towards_small=True,
    ),
    "limits": Map(
        "Joint limits", "inside the limit [deg]", "joint angles told right",
        "set-points beyond the limit [deg]", 1e-9,
        (1.0, 1e-2, 1e-3, 1e-4, 6e-5, 4e-5, 0.0, -4e-5, -6e-5, -1e-4, -1e-3, -1e-2, -1.0), (1.0, 6e-5, -6e-5),
        limit, (2000, 200), lines=("A2", "A3", "A5"), borders=(-0.5 / STEPS_PER_DEGREE, None), scale="symlog",
        linear_below=1e-5, towards_small=True,
    ),
    "reach": Map(
        "Reach at the envelope's edge", "inside the edge [mm]", "poses told right, in or out of reach",
        "set-point's place off the pose [um]", 10.0,
        (300.0, 100.0, 10.0, 1.0, 1e-1, 1e-3, 1e-5, -1e-5, -1e-3, -1e-1, -1.0, -10.0, -100.0), (100.0, 1e-3, -1e-3),
        reached, (30, 6), lines=(_OURS, "numeric, least squares"), quick_lines=1, compared=("numeric, least squares",),
        borders=(-1000 * STRETCH_TOLERANCE, None), scale="symlog", linear_below=1e-6, towards_small=True,
    ),
    "path": Map(
        "Path search into a gap", "room beyond the clearance, on each side [mm]", "searches that end right",
        "time of the path, median [s]", 6.0,
        (20.0, 10.0, 5.0, 3.0, 2.0, 1.0, 0.5, 0.2, -0.5, -2.0), (20.0, -0.5), path, (5, 1), scale="symlog",
        linear_below=0.1, towards_small=True,
    ),
}  # fmt: skip
"""Of the arm."""
