"""The dynamic arm against independent mechanics: point masses, Lagrange, a pendulum, a spring.

The chain of this file is separate: dimensions and masses are read from the XML's text, rotations are written out, and
the oracle does not use MuJoCo.
"""

from itertools import pairwise
from xml.etree import ElementTree

import mujoco
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import expm
from scipy.special import ellipk

from cell.files import model_file
from cell.robot import dynamics
from cell.robot.dynamics import Tool, ToolBody
from cell.robot.model import LINKS
from cell.robot.plant import FeedForward, MujocoPlant, PlantSettings
from drivers.profile import resting
from planner.values import Floats
from tests.support.arms import HOME

POSES = {
    "home": HOME,
    "stretched level": np.zeros(6),
    "generic": np.radians([12.0, -75, 110, 35, -60, 140]),
    "folded": np.radians([-100.0, -120, 150, -200, 100, 300]),
}
TOOL = Tool(
    (ToolBody("housing", 1.7, np.array([0.004, 0.006, 0.007]), np.array([0.04, 0.01, 0.09]), np.eye(4)[0], 0.1),)
)
GRAVITY = 9.81


class Chain:
    """Masses on KUKA's axes, base frame."""

    def __init__(self, tool: Tool) -> None:
        bodies = {body.get("name"): body for body in ElementTree.parse(model_file("kr16.xml")).iter("body")}
        self.offset = [_numbers(bodies[name].get("pos", "0 0 0")) for name in LINKS[1:]]
        axes = [bodies[name].find("joint") for name in LINKS[1:]]
        self.axis = [_numbers(axis.get("axis")) for axis in axes if axis is not None]
        self.mass, self.com, self.inertia = [], [], []
        for name in LINKS[1:]:
            inertial = bodies[name].find("inertial")
            assert inertial is not None
            self.mass.append(float(inertial.get("mass", "nan")))
            self.com.append(_numbers(inertial.get("pos")))
            diagonal, full = inertial.get("diaginertia"), inertial.get("fullinertia")
            if full is not None:
                xx, yy, zz, xy, xz, yz = _numbers(full)
                self.inertia.append(np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]))
            else:
                self.inertia.append(np.diag(_numbers(diagonal)))
        # The flange: 158 mm out, z along x of link 6, x along -z.
        self.flange = np.array([[0.0, 0, 1], [0, 1, 0], [-1, 0, 0]])
        self.tool_bodies = tool.bodies
        numeric = {
            n.get("name"): _numbers(n.get("data")) for n in ElementTree.parse(model_file("kr16.xml")).iter("numeric")
        }
        self.rotor = numeric["axis_rotor_inertia_kg_m2"]
        self.viscous = numeric["axis_viscous_friction_Nm_s_rad"]

    def bodies(self, q: Floats) -> list[tuple[int, float, Floats, Floats]]:
        """Return joint, mass, centre of mass and inertia about it in base axes, for each body."""
        found, R, p = [], np.eye(3), np.zeros(3)
        self.anchors, self.axes = [], []
        for i in range(6):
            p = p + R @ self.offset[i]
            self.anchors.append(p)
            self.axes.append(R @ self.axis[i])
            R = R @ _turn(self.axis[i], q[i])
            found.append((i, self.mass[i], p + R @ self.com[i], R @ self.inertia[i] @ R.T))
        for piece in self.tool_bodies:
            F = R @ self.flange
            at = p + R @ np.array([0.158, 0, 0]) + F @ piece.position
            found.append((5, piece.mass, at, F @ np.diag(piece.inertia) @ F.T))
        return found

    def potential(self, q: Floats) -> float:
        """Return the potential energy [J]."""
        return sum(mass * GRAVITY * com[2] for _, mass, com, _ in self.bodies(q))

    def gravity(self, q: Floats) -> Floats:
        """Return holding torques (6,) [Nm]: lever times weight of every body beyond the axis."""
        bodies, torque = self.bodies(q), np.zeros(6)
        for joint, mass, com, _ in bodies:
            for i in range(joint + 1):
                torque[i] += mass * GRAVITY * (_cross(self.axes[i]) @ (com - self.anchors[i]))[2]
        return torque

    def mass_matrix(self, q: Floats) -> Floats:
        """Return the mass matrix (6, 6) from the bodies' Jacobians, rotors included."""
        M = np.diag(self.rotor)
        for joint, mass, com, inertia in self.bodies(q):
            linear, angular = np.zeros((3, 6)), np.zeros((3, 6))
            for i in range(joint + 1):
                linear[:, i], angular[:, i] = _cross(self.axes[i]) @ (com - self.anchors[i]), self.axes[i]
            M = M + mass * linear.T @ linear + angular.T @ inertia @ angular
        return M

    def inverse(self, q: Floats, qd: Floats, qdd: Floats) -> Floats:
        """Return torques (6,) by Lagrange's equations, with central differences of the mass matrix."""
        step, gradient = 1e-5, np.zeros((6, 6, 6))
        for k in range(6):
            e = step * np.eye(6)[k]
            gradient[k] = (self.mass_matrix(q + e) - self.mass_matrix(q - e)) / (2 * step)
        rate = np.einsum("kij,k->ij", gradient, qd)
        torque: Floats = (
            self.mass_matrix(q) @ qdd
            + rate @ qd
            - 0.5 * np.einsum("kij,i,j->k", gradient, qd, qd)
            + self.gravity(q)
            + self.viscous * qd
        )
        return torque


def _numbers(text: str | None) -> Floats:
    assert text is not None
    return np.array([float(word) for word in text.split()])


def _turn(axis: Floats, angle: float) -> Floats:
    """Return the rotation by Rodrigues' formula."""
    K = _cross(axis)
    return np.eye(3) + np.sin(angle) * K + (1.0 - np.cos(angle)) * K @ K


def _cross(a: Floats) -> Floats:
    return np.array([[0, -a[2], a[1]], [a[2], 0, -a[0]], [-a[1], a[0], 0]])


@pytest.fixture(scope="module")
def chain() -> Chain:
    """Return the oracle's arm."""
    return Chain(TOOL)


@pytest.mark.parametrize("pose", POSES)
def test_gravity_is_lever_times_weight(pose: str, chain: Chain) -> None:
    """The holding torque is that of the point masses, and the gradient of their potential energy."""
    q = POSES[pose]
    model = dynamics.compile_dynamic_arm(TOOL)
    data = mujoco.MjData(model)
    data.qpos[:] = q
    mujoco.mj_forward(model, data)
    np.testing.assert_allclose(data.qfrc_bias, chain.gravity(q), atol=1e-9)
    slope = [(chain.potential(q + e) - chain.potential(q - e)) / 2e-5 for e in 1e-5 * np.eye(6)]
    np.testing.assert_allclose(data.qfrc_bias, slope, atol=1e-5)


def test_the_mass_matrix_equals_that_of_the_jacobians(chain: Chain) -> None:
    """The mass matrices agree in every named pose, with a tool off the axis."""
    model = dynamics.compile_dynamic_arm(TOOL)
    for q in POSES.values():
        np.testing.assert_allclose(dynamics.mass_matrix(model, q), chain.mass_matrix(q), atol=1e-9)


def test_the_feed_forward_equals_lagrange(chain: Chain) -> None:
    """A servo with exact masses and no Coulomb friction gives Lagrange's torques."""
    rng = np.random.default_rng(0)
    right = FeedForward(TOOL, PlantSettings(mass_error=0.0, friction_error=-1.0))
    q, qd, qdd = rng.uniform(-2, 2, (3, 3, 6)) * np.array([1.0, 1.5, 3.0])[:, None, None]
    expected = [chain.inverse(*motion) for motion in zip(q, qd, qdd, strict=True)]
    np.testing.assert_allclose(right.torque(q, qd, qdd), expected, rtol=1e-6, atol=1e-4)


def test_the_free_fall_of_one_link_is_a_pendulum(chain: Chain) -> None:
    """With every other axis too heavy to move, the forearm about A3 swings with a pendulum's period at any amplitude.

    T = 4 sqrt(I / (m g d)) K(sin^2(amplitude / 2)); I, m d and the hanging angle are the oracle's.
    """
    model = dynamics.compile_dynamic_arm(TOOL, friction_scale=0.0, time_step=1e-4)
    model.dof_damping[:] = 0.0
    model.dof_armature[[0, 1, 3, 4, 5]] = 1e12
    q = np.zeros(6)
    angles = np.radians(np.arange(0, 360, 5.0))
    pull = np.array([chain.gravity(np.array([0, 0, a, 0, 0, 0]))[2] for a in angles])
    # g(a) = -m g d cos(a - b): fit exactly by its two harmonics.
    c, s = 2 * np.mean(pull * np.cos(angles)), 2 * np.mean(pull * np.sin(angles))
    hanging = np.arctan2(s, c) + np.pi / 2 + np.pi
    if chain.potential(np.array([0, 0, hanging, 0, 0, 0])) > chain.potential(
        np.array([0, 0, hanging + np.pi, 0, 0, 0])
    ):
        hanging += np.pi
    amplitude, inertia = np.radians(70.0), chain.mass_matrix(q)[2, 2]
    period = 4 * np.sqrt(inertia / np.hypot(c, s)) * ellipk(np.sin(amplitude / 2) ** 2)
    data = mujoco.MjData(model)
    data.qpos[2] = hanging - amplitude
    previous, crossings, time = data.qpos[2] - hanging, [], 0.0
    while len(crossings) < 3:
        mujoco.mj_step(model, data)
        time += 1e-4
        now = data.qpos[2] - hanging
        if previous < 0 <= now or now <= 0 < previous:
            crossings.append(time - 1e-4 * now / (now - previous))
        previous = now
    assert crossings[0] == pytest.approx(period / 4, rel=1e-3)
    assert [b - a for a, b in pairwise(crossings)] == pytest.approx([period / 2] * 2, rel=1e-3)


def test_a_falling_arm_keeps_its_energy_and_follows_lagrange(chain: Chain) -> None:
    """Without friction and torque the arm falls as an independent integrator predicts, without loss of energy."""
    model = dynamics.compile_dynamic_arm(TOOL, friction_scale=0.0, time_step=5e-5)
    model.dof_damping[:] = 0.0
    frictionless = Chain(TOOL)
    frictionless.viscous = np.zeros(6)
    data = mujoco.MjData(model)
    data.qpos[:] = HOME + 0.1
    before = frictionless.potential(data.qpos)

    def fall(_: float, state: Floats) -> Floats:
        q, qd = state[:6], state[6:]
        return np.concatenate([qd, -np.linalg.solve(chain.mass_matrix(q), frictionless.inverse(q, qd, np.zeros(6)))])

    expected = solve_ivp(fall, (0.0, 0.2), np.concatenate([HOME + 0.1, np.zeros(6)]), rtol=1e-5, atol=1e-6).y[:6, -1]
    mujoco.mj_step(model, data, nstep=4000)
    np.testing.assert_allclose(data.qpos, expected, atol=2e-4)
    kinetic = 0.5 * data.qvel @ chain.mass_matrix(data.qpos) @ data.qvel
    assert kinetic > 3.0
    assert frictionless.potential(data.qpos) + kinetic == pytest.approx(before, abs=2e-3 * kinetic)


@pytest.mark.parametrize("pose", ["home", "stretched level"])
def test_without_integral_the_arm_droops_like_a_spring(pose: str, chain: Chain) -> None:
    """At rest, kp (q_ref - q) is the gravity that the light model lacks: droop = 0.1 g(q) / kp."""
    plant = MujocoPlant(POSES[pose], TOOL)
    model, data = plant.model, plant.data
    kp = -model.actuator_biasprm[:, 1]
    model.dof_frictionloss[:] = 0.0  # friction would hold it anywhere near
    believed = FeedForward(TOOL, PlantSettings(friction_error=-1.0))
    rest = np.zeros((1, 6))
    data.ctrl[:] = kp * POSES[pose] + believed.torque(POSES[pose][None], rest, rest)[0]
    mujoco.mj_step(model, data, nstep=3000)
    droop = POSES[pose] - data.qpos
    assert np.abs(droop[1]) > 1e-6
    np.testing.assert_allclose(droop, 0.1 * chain.gravity(POSES[pose]) / kp, rtol=2e-3, atol=2e-8)


def test_a_small_error_decays_like_the_linear_servo() -> None:
    """A6 rotates about its own axis: its error obeys J e''' + kd e'' + kp e' + ki e = 0."""
    model = dynamics.compile_dynamic_arm(Tool())
    plant = MujocoPlant(HOME, Tool(), PlantSettings(time_step=1e-4, friction_error=-1.0))
    plant.model.dof_frictionloss[:] = 0.0
    plant.model.dof_damping[:] = 0.0
    offset = 1e-3 * np.eye(6)[5]
    plant.follow(resting(HOME + offset))
    kp, kd = -plant.model.actuator_biasprm[5, 1], -plant.model.actuator_biasprm[5, 2]
    believed = dynamics.mass_matrix(dynamics.compile_dynamic_arm(Tool(), mass_scale=0.9), HOME)[5, 5]
    ki = 0.3 * (2 * np.pi * 12.0) ** 3 * believed
    inertia = dynamics.mass_matrix(model, HOME)[5, 5]
    A = np.array([[0.0, 1, 0], [0, 0, 1], [-ki / inertia, -kp / inertia, -kd / inertia]])  # of integral, error, rate
    for _ in range(20):
        plant.advance(0.01)
    state = np.array([0.0, 1e-3, 0.0])
    for _ in range(20):
        state = expm(A * 0.01) @ state
    assert abs(state[1]) > 1e-8
    error = (HOME + offset - plant.reported_axes)[5]
    assert error == pytest.approx(state[1], abs=5e-6)
