"""Kinematics of various arms against their chains: product of exponentials, brute force, MuJoCo."""

import mujoco
import numpy as np
import pytest

from planner.errors import PlannerError
from planner.kinematics.fit import POLISH_ABOVE, ArmKinematics, Chain
from planner.ports import JointLimits

LIMITS = JointLimits(
    lower=-np.full(6, 2 * np.pi),
    upper=np.full(6, 2 * np.pi),
    velocity=np.ones(6),
    acceleration=np.ones(6),
    jerk=np.ones(6),
)

# Axes' directions and points at q = 0 [m], and the flange: an upright arm whose forearm is level, one with KUKA's signs
# stretched level, one whose wrist lies 50 mm beside the arm's plane, and one of three parallel axes.
UPRIGHT = (
    ((0, 0, 1), (0, 1, 0), (0, 1, 0), (1, 0, 0), (0, 1, 0), (1, 0, 0)),
    ((0, 0, 0), (0.1, 0, 0.6), (0.1, 0, 1.3), (0.5, 0, 1.43), (0.85, 0, 1.43), (0.9, 0, 1.43)),
    (0.94, 0, 1.43),
)
LEVEL = (
    ((0, 0, -1), (0, 1, 0), (0, 1, 0), (-1, 0, 0), (0, 1, 0), (-1, 0, 0)),
    ((0, 0, 0), (0.26, 0, 0.675), (0.94, 0, 0.675), (1.2, 0, 0.64), (1.61, 0, 0.64), (1.61, 0, 0.64)),
    (1.768, 0, 0.64),
)
SIDEWAYS = (
    ((0, 0, 1), (0, 1, 0), (0, -1, 0), (0, 0, 1), (0, 1, 0), (0, 0, 1)),
    ((0, 0, 0), (0.05, 0.1, 0.478), (0.05, 0.1, 0.903), (0.05, 0.05, 1.1), (0.05, 0.05, 1.328), (0.05, 0.05, 1.4)),
    (0.05, 0.05, 1.428),
)
PARALLEL = (
    ((0, 0, 1), (0, -1, 0), (0, -1, 0), (0, -1, 0), (0, 0, -1), (0, -1, 0)),
    (
        (0, 0, 0),
        (0, 0, 0.1625),
        (-0.425, 0, 0.1625),
        (-0.817, -0.1333, 0.1625),
        (-0.817, -0.1333, 0.1),
        (-0.817, -0.2, 0.0628),
    ),
    (-0.817, -0.2329, 0.0628),
)
ARMS = {"upright": UPRIGHT, "level": LEVEL, "sideways": SIDEWAYS, "parallel": PARALLEL}


def arm(name, rng, tilt=0.0):
    """Return a named chain with random signs, zeros, base and flange; every axis is tilted by `tilt` [rad]."""
    directions, points, flange = (np.array(values, dtype=float) for values in ARMS[name])
    directions += rng.normal(0.0, tilt, (6, 3)) if tilt else 0.0
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = rotation(rng), flange
    moved = Chain(directions, points, T)
    q = rng.uniform(-np.pi, np.pi, (6, 6))
    at_zero, signs = np.diag(q), rng.choice([-1.0, 1.0], 6)
    # The axes at the new zero of the chain, then a moved base.
    base = np.eye(4)
    base[:3, :3], base[:3, 3] = rotation(rng) if name != "sideways" else np.eye(3), rng.uniform(-1, 1, 3)
    placed = [base @ frame for frame in frames(moved, at_zero)]
    return Chain(
        [s * T[:3, :3] @ w for T, w, s in zip(placed, directions, signs, strict=True)],
        [T[:3, :3] @ p + T[:3, 3] for T, p in zip(placed, points, strict=True)],
        base @ moved.forward(at_zero[None])[0],
    )


def frames(chain, q):
    """Return the motion of each axis by the axes before it, at q (6,)."""
    T, found = np.eye(4), []
    for w, p, angle in zip(chain.directions, chain.points, q, strict=True):
        found.append(T.copy())
        T = T @ about(w, p, angle)
    return found


def about(w, p, angle):
    """Return the rotation (4, 4) about the line through p along w."""
    K = np.array([[0, -w[2], w[1]], [w[2], 0, -w[0]], [-w[1], w[0], 0]])
    T = np.eye(4)
    T[:3, :3] = np.eye(3) + np.sin(angle) * K + (1 - np.cos(angle)) * K @ K
    T[:3, 3] = p - T[:3, :3] @ p
    return T


def rotation(rng):
    """Return a random rotation."""
    turn, R = np.linalg.qr(rng.normal(size=(3, 3)))
    turn = turn * np.sign(np.diag(R))
    return turn if np.linalg.det(turn) > 0 else -turn


def apart(a, b):
    """Return the largest difference of two sets of angles modulo full turns."""
    return np.abs((a - b + np.pi) % (2 * np.pi) - np.pi).max(axis=-1)


@pytest.mark.parametrize("name", ARMS)
def test_forward_equals_mujoco(name):
    """The product of exponentials equals MuJoCo's flange for the same axes to 1e-12."""
    rng = np.random.default_rng(1)
    chain = arm(name, rng)
    spec = mujoco.MjSpec()
    body = spec.worldbody
    for axis, (w, p) in enumerate(zip(chain.directions, chain.points, strict=True)):
        body = body.add_body(name=f"link{axis}")
        body.add_joint(name=f"q{axis}", type=mujoco.mjtJoint.mjJNT_HINGE, axis=w, pos=p)
        body.add_geom(size=[0.01, 0, 0])
    model = spec.compile()
    data = mujoco.MjData(model)
    q = rng.uniform(-np.pi, np.pi, (20, 6))
    for angles, T in zip(q, chain.forward(q), strict=True):
        data.qpos[:] = angles
        mujoco.mj_kinematics(model, data)
        last = np.eye(4)
        last[:3, :3], last[:3, 3] = data.body("link5").xmat.reshape(3, 3), data.body("link5").xpos
        np.testing.assert_allclose(last @ chain.T_zero, T, rtol=0, atol=1e-12)


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("name", ARMS)
def test_every_pose_is_recovered(name, seed):
    """The angles are among the branches, and each branch gives the pose to 1e-9, for any signs, zeros and frames."""
    rng = np.random.default_rng(seed)
    chain = arm(name, rng)
    kinematics = ArmKinematics(chain, LIMITS)
    assert kinematics.fit.residual < 1e-12
    q = rng.uniform(-np.pi, np.pi, (2000, 6))
    T = chain.forward(q)
    found = kinematics.inverse(T)
    real = ~np.isnan(found[..., 0])
    assert (np.where(real, apart(found, q[:, None]), np.inf).min(axis=1) < 1e-6).all()
    pose, branch = np.nonzero(real)
    np.testing.assert_allclose(chain.forward(found[pose, branch]), T[pose], rtol=0, atol=1e-9)
    assert (np.abs(found[real]) <= np.pi).all()


@pytest.mark.parametrize("name", ARMS)
def test_no_branch_is_missed(name):
    """Newton's method on the chain from 300 random starts finds no other solution."""
    rng = np.random.default_rng(7)
    chain = arm(name, rng)
    kinematics = ArmKinematics(chain, LIMITS)
    poses = chain.forward(rng.uniform(-np.pi, np.pi, (4, 6)))
    for T, branches in zip(poses, kinematics.inverse(poses), strict=True):
        starts = rng.uniform(-np.pi, np.pi, (300, 6))
        pose = np.broadcast_to(T, (300, 4, 4))
        reached = kinematics._newton(pose, starts, steps=60)
        reached = reached[~np.isnan(reached[:, 0])]
        assert len(reached) > 20
        real = branches[~np.isnan(branches[:, 0])]
        assert (apart(reached[:, None], real[None]).min(axis=1) < 1e-5).all()
        assert (apart(real[:, None], reached[None]).min(axis=1) < 1e-5).all()


@pytest.mark.parametrize("name", ARMS)
def test_rounded_axes_are_refined(name):
    """With axes rounded to 1e-4 rad the residual is positive, but every branch gives the chain's pose to 1e-9."""
    rng = np.random.default_rng(11)
    chain = arm(name, rng, tilt=1e-4)
    kinematics = ArmKinematics(chain, LIMITS)
    assert POLISH_ABOVE < kinematics.fit.residual < 1e-3
    q = rng.uniform(-np.pi, np.pi, (500, 6))
    T = chain.forward(q)
    found = kinematics.inverse(T)
    pose, branch = np.nonzero(~np.isnan(found[..., 0]))
    np.testing.assert_allclose(chain.forward(found[pose, branch]), T[pose], rtol=0, atol=1e-9)
    assert (
        np.mean(np.nan_to_num(apart(found, q[:, None]), nan=np.inf).min(axis=1) < 1e-6) > 0.97
    )  # except at the border of the reach


def test_an_arm_of_neither_family_is_refused():
    """Six axes of which no two are parallel and no three meet; the message has the nearest family's distance."""
    rng = np.random.default_rng(3)
    directions = rng.normal(size=(6, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    with pytest.raises(PlannerError, match="neither family"):
        ArmKinematics(Chain(directions, rng.uniform(-1, 1, (6, 3)), np.eye(4)), LIMITS)
