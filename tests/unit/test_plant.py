"""The dynamic plant behind a controller: reports, rest, tool, table, refusals."""

from time import process_time

import mujoco
import numpy as np
import pytest
from numpy.typing import NDArray

from cell.errors import SceneError, UsageError
from cell.robot import dynamics
from cell.robot import model as robot
from cell.robot.arm import kinematics_of
from cell.robot.dynamics import FACEPLATE_THICKNESS, STEEL_DENSITY, Tool, ToolBody, table_load_of
from cell.robot.plant import SETTLE_TOLERANCE, MujocoPlant, PlantSettings
from cell.scan.plants import built_in_plants
from drivers.clock import SimulatedClock
from drivers.contract import Mode
from drivers.errors import DriverError
from drivers.profile import Reference, interpolate, resting
from drivers.registry import Context, open_driver
from drivers.setpoints import from_rad
from drivers.sim import SimDriver
from planner.kinematics.rotary_table import RotaryTable
from tests.support.arms import HOME, KR16

CONTEXT = Context(KR16, plants=built_in_plants())
URL = "sim://?plant=mujoco"
_RATES = KR16.velocity, KR16.acceleration


def test_a_move_ends_in_position_within_the_repeatability() -> None:
    """Every point of the tool is within 0.05 mm; the controller reports the plant's axes in counts."""
    kinematics = kinematics_of(robot.load())
    goal = np.array([[200_000, -850_000, 800_000, 300_000, 600_000, -400_000]], dtype=np.int32)
    with open_driver(URL, CONTEXT) as driver:
        assert isinstance(driver, SimDriver)
        state = driver.move(goal, 1.0)
        assert state.mode is Mode.IN_POSITION
        assert (from_rad(driver.controller.plant.reported_axes) == state.axes).all()
        reached = kinematics.forward(np.stack([state.q, np.radians(goal[0] / 1e4)]))
        for lever in (np.zeros(3), np.array([0.1, 0.05, 0.12])):  # the flange, a point of the housing
            points = reached[:, :3, 3] + reached[:, :3, :3] @ lever
            assert 0.0 < np.linalg.norm(points[0] - points[1]) < SETTLE_TOLERANCE + 3e-6  # a count is some micrometres


def test_a_move_takes_the_time_of_the_reference_and_then_settles() -> None:
    """A move takes less than half a second longer than with the ideal arm."""
    goal = from_rad(HOME[None] + 0.3)
    took = {}
    for name in ("ideal", "mujoco"):
        clock = SimulatedClock()
        with open_driver(f"sim://?plant={name}", Context(KR16, clock=clock, plants=built_in_plants())) as driver:
            driver.move(goal, 1.0)
            took[name] = clock.now()
    assert took["ideal"] < took["mujoco"] < took["ideal"] + 0.5


def test_once_at_rest_it_stays_within_the_repeatability() -> None:
    """The integral at the end of a move does not swing the arm out again, at any point of the tool."""
    plant, limits, rng, at = built_in_plants()["mujoco"](HOME), KR16, np.random.default_rng(5), HOME
    assert isinstance(plant, MujocoPlant)
    levers = dynamics.lever_arms(plant.model, Tool()) + 0.17  # the housing's farthest corner from the flange
    for jerk in (limits.jerk, None, limits.jerk, None):
        goal = HOME + rng.uniform(-0.5, 0.5, 6)
        move = interpolate(at, goal[None], limits.velocity, limits.acceleration, jerk)
        plant.follow(move)
        plant.advance(move.duration)
        while not plant.settled:
            plant.advance(0.004)
        for _ in range(100):
            assert levers @ np.abs(goal - plant.reported_axes) < 5e-5
            plant.advance(0.008)
        at = goal


@pytest.mark.parametrize("with_jerk", [True, False])
def test_the_scanner_follows_its_path_faster_than_real_time(with_jerk: bool) -> None:
    """At full speed of every axis the error is below 1 mm, at 10 times real time or faster on one core."""
    limits, kinematics = KR16, kinematics_of(robot.load())
    via = np.radians([[60, -60, 60, 40, 60, 100], [-40, -20, 20, -80, 30, -100], [0, -90, 90, 0, 90, 0]])
    move = interpolate(HOME, via, limits.velocity, limits.acceleration, limits.jerk if with_jerk else None)
    errors: list[float] = []

    def scanner(q: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.asarray(kinematics.forward(q)[:, :3] @ np.array([0.0, 0.0, 0.12, 1.0]))

    def watch(reference: Reference, times: NDArray[np.float64], axes: NDArray[np.float64]) -> None:
        error = np.linalg.norm(scanner(axes) - scanner(reference.sample(times)[0]), axis=1)
        errors.append(float(error.max()))

    watched, unwatched = (built_in_plants(observer=each)["mujoco"](HOME) for each in (watch, None))
    watched.follow(move)
    watched.advance(move.duration)
    assert 1e-5 < max(errors) < 3e-4
    unwatched.follow(move)
    began = process_time()
    unwatched.advance(move.duration)
    assert move.duration / (process_time() - began) > 10.0
    assert watched.reported_axes.tobytes() == unwatched.reported_axes.tobytes()


def test_a_stop_brakes_on_the_path_and_settles() -> None:
    """A braking reference is followed like any other."""
    limits = KR16
    move = interpolate(HOME, HOME[None] + 0.5, limits.velocity, limits.acceleration, limits.jerk)
    plant = MujocoPlant(HOME)
    plant.follow(move)
    plant.advance(0.3)
    braked = move.braking_from(0.3)
    plant.follow(braked)
    assert not plant.settled
    plant.advance(braked.duration + 0.5)
    assert plant.settled
    assert plant.failure == ""
    np.testing.assert_allclose(plant.reported_axes, braked.end, atol=1e-4)


def test_it_starts_at_rest_and_stays_there() -> None:
    """At the start the integral compensates the error of the light model, and the arm does not sag."""
    for start in (HOME, np.zeros(6), np.radians([30.0, -20, 40, 10, 50, 0])):
        plant = MujocoPlant(start, Tool())
        assert plant.settled
        plant.advance(1.0)
        assert plant.settled
        np.testing.assert_allclose(plant.reported_axes, start, atol=1e-8)


def test_a_move_of_no_length_is_settled_at_once() -> None:
    """A move of zero length is settled at once, with any remaining fraction of a step."""
    plant = MujocoPlant(HOME)
    for seconds in (0.0, 0.0004, 0.0123, 7.0):
        plant.advance(seconds)
        plant.follow(resting(HOME))
        assert plant.settled


def test_the_tool_has_the_masses_of_its_shapes() -> None:
    """The housing has the density of sensors and the bracket that of aluminium, at their places in the cell."""
    plant = built_in_plants()["mujoco"](HOME)
    assert isinstance(plant, MujocoPlant)
    masses = {plant.model.body(name).name: float(plant.model.body(name).mass[0]) for name in ("housing", "bracket")}
    assert masses["housing"] == pytest.approx(0.16 * 0.08 * 0.06 * 1300)
    assert masses["bracket"] == pytest.approx(np.pi * 0.039**2 * 0.06 * 2700)
    kilograms = sum(masses.values())
    assert plant.model.body_subtreemass[1] == pytest.approx(235.1 + kilograms, abs=0.1)
    # A box of 16 x 8 x 6 cm about its middle, m / 12 (b^2 + c^2), in the order of its axes.
    size = np.array([0.16, 0.08, 0.06])
    expected = masses["housing"] / 12 * (np.roll(size, 1) ** 2 + np.roll(size, 2) ** 2)
    np.testing.assert_allclose(plant.model.body("housing").inertia, expected)
    assert not (plant.model.geom_contype.size), "the dynamic model has no shapes"


def test_a_heavier_tool_needs_more_torque() -> None:
    """Eight kilograms more on the flange add their weight times lever to the torque on A2."""
    heavy = ToolBody("housing", 8.0, np.full(3, 0.02), np.array([0.0, 0.0, 0.1]), np.eye(4)[0], 0.1)
    torque = []
    for carried in (Tool(), Tool((heavy,))):
        model = dynamics.compile_dynamic_arm(carried)
        data = mujoco.MjData(model)
        mujoco.mj_forward(model, data)
        torque.append(float(data.qfrc_bias[1]))
    assert torque[1] - torque[0] == pytest.approx(-8.0 * 9.81 * (0.68 + 0.67 + 0.158 + 0.1), rel=1e-9)


def test_the_planning_model_has_no_dynamics() -> None:
    """The planner's model of the same file has no actuator, rotor inertia or friction."""
    model = robot.load()
    assert model.nu == 0
    for values in (model.dof_armature, model.dof_damping, model.dof_frictionloss):
        assert not values.any()
    dynamic = dynamics.compile_dynamic_arm(Tool())
    assert dynamic.nu == 6
    assert dynamic.ngeom == 0
    for q in (HOME, np.zeros(6)):
        poses = []
        for each in (model, dynamic):
            data = mujoco.MjData(each)
            data.qpos[:] = q
            mujoco.mj_kinematics(each, data)
            poses.append(np.concatenate([data.site(robot.FLANGE).xpos, data.site(robot.FLANGE).xmat]))
        assert poses[0].tobytes() == poses[1].tobytes()


def test_lever_arms_bound_the_motion_by_an_axis() -> None:
    """In no pose the tool's farthest point moves by more than lever times angle."""
    carried = Tool((ToolBody("housing", 1.0, np.full(3, 0.01), np.array([0.0, 0.0, 0.2]), np.eye(4)[0], 0.0),))
    levers = dynamics.lever_arms(dynamics.compile_dynamic_arm(carried), carried)
    kinematics, rng = kinematics_of(robot.load()), np.random.default_rng(0)
    q = rng.uniform(
        np.radians([-185, -155, -130, -350, -130, -350]), np.radians([185, 35, 154, 350, 130, 350]), (500, 6)
    )
    for axis in range(6):
        ends = [kinematics.forward(q + s * np.eye(6)[axis])[:, :3] @ np.array([0, 0, 0.2, 1]) for s in (-1e-4, 1e-4)]
        moved = np.linalg.norm(ends[1] - ends[0], axis=1) / 2e-4
        assert moved.max() <= levers[axis] * (1 + 1e-6)


def test_a_table_is_a_hinge_with_its_load() -> None:
    """The inertia of a load and the faceplate equals a manual sum, and the arm's mass matrix is unchanged."""
    spec = mujoco.MjSpec()
    part = spec.worldbody.add_body(
        name="object", mocap=True, pos=[1.5, 0.5, 0.4], quat=[np.cos(0.2), 0, 0, np.sin(0.2)]
    )
    part.add_geom(type=mujoco.mjtGeom.mjGEOM_BOX, size=[0.1, 0.05, 0.2], pos=[0.1, 0, 0])
    post = spec.worldbody.add_body(name="post", mocap=True, pos=[1.2, 0.5, 0.0])
    post.add_geom(type=mujoco.mjtGeom.mjGEOM_CYLINDER, size=[0.02, 0.15, 0])
    T = np.eye(4)
    T[:3, 3] = 1.2, 0.5, -0.3
    load = table_load_of(spec.compile(), RotaryTable(T, -3.0, 3.0, 2.0, 4.0, 40.0), 0.4)
    off = np.array([0.3 + 0.1 * np.cos(0.4), 0.1 * np.sin(0.4)])
    box = STEEL_DENSITY * 0.2 * 0.1 * 0.4 * ((0.2**2 + 0.1**2) / 12 + off @ off)
    rods = STEEL_DENSITY * np.pi / 2 * (0.3 * 0.02**4 + FACEPLATE_THICKNESS * 0.2**4)
    assert load.inertia == pytest.approx(box + rods, rel=1e-3)  # the post has 64 sides
    turned, alone = (dynamics.compile_dynamic_arm(Tool(), table=each) for each in (load, None))
    M, q = dynamics.mass_matrix(turned, np.append(HOME, 0.7)), np.append(HOME, 0.7)
    np.testing.assert_allclose(M[:6, :6], dynamics.mass_matrix(alone, HOME), atol=1e-9)
    np.testing.assert_allclose(M[6], [0, 0, 0, 0, 0, 0, load.inertia + load.rotor_inertia], atol=1e-9)
    data = mujoco.MjData(turned)
    data.qpos[:] = q
    mujoco.mj_forward(turned, data)
    assert data.qfrc_bias[6] == pytest.approx(0.0, abs=1e-9)
    assert dynamics.lever_arms(turned, Tool(), load)[6] == load.reach >= np.linalg.norm(off)
    plant = MujocoPlant(q, table=load)
    plant.follow(move := interpolate(q, q[None] + 0.5, *(np.append(each, 2.0) for each in _RATES)))
    plant.advance(move.duration + 0.5)
    assert plant.settled
    assert plant.failure == ""
    with pytest.raises(DriverError, match="it must be 7 finite joint angles"):
        MujocoPlant(HOME, table=load)


@pytest.mark.parametrize(
    "values",
    [{"time_step": 0.0}, {"time_step": np.nan}, {"bandwidth": -1.0}, {"mass_error": -1.0}, {"friction_error": -1.1}],
    ids=str,
)
def test_impossible_settings_are_refused(values: dict[str, float]) -> None:
    """The message names the setting."""
    with pytest.raises(UsageError, match=f"plant's {next(iter(values))}"):
        PlantSettings(**values)  # type: ignore[arg-type] # one float by name


def test_invalid_input_is_refused() -> None:
    """An invalid start, negative time, a cell without a housing."""
    with pytest.raises(DriverError, match="6 finite joint angles"):
        MujocoPlant([0.0, np.nan, 0, 0, 0, 0])
    with pytest.raises(DriverError, match="must be at least 0"):
        MujocoPlant(HOME).advance(-1e-9)
    with pytest.raises(DriverError, match="must be at least 0"):
        MujocoPlant(HOME).advance(float("nan"))
    with pytest.raises(SceneError, match="no shape named housing"):
        dynamics.tool_of(robot.load())
