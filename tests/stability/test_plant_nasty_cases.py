"""Diverging simulations, weak drives, jumping clocks: the plant reports the failure."""

from dataclasses import replace
from time import perf_counter

import numpy as np
import pytest

from cell.robot.plant import FOLLOWING_ERROR, MujocoPlant, PlantSettings
from cell.scan import plants
from drivers.clock import SimulatedClock
from drivers.contract import Fault, Mode
from drivers.errors import DriverError, FaultError
from drivers.profile import Reference, interpolate, resting
from drivers.registry import Context, open_driver
from drivers.setpoints import PER_DEGREE, from_rad
from drivers.sim import SimDriver
from drivers.simulated_controller import Controller, Plant
from tests.support.arms import HOME, KR16

LIMITS = replace(KR16, path_tolerance=90 * PER_DEGREE)
"""Limits with a path tolerance that leaves the faults to the controller."""

GOAL = from_rad(HOME[None] + np.array([0.6, 0.5, -0.4, 0.8, -0.6, 1.0]))
UNSTABLE = {
    "time step 20 ms": PlantSettings(time_step=0.02),
    "time step 10 ms, explicit": PlantSettings(time_step=0.01, integrator="Euler"),
    "time step 10 ms, gain x 4": PlantSettings(time_step=0.01, bandwidth=48.0),
    "gain x 20": PlantSettings(bandwidth=240.0),
}
WITHIN_THE_MARGIN = {
    "default": PlantSettings(),
    "time step x 5": PlantSettings(time_step=0.005),
    "time step / 5": PlantSettings(time_step=0.0002),
    "gain x 4": PlantSettings(bandwidth=48.0),
    "explicit, time step x 2": PlantSettings(time_step=0.002, integrator="Euler"),
    "masses 30 % wrong": PlantSettings(mass_error=-0.3),
    "masses 30 % too heavy": PlantSettings(mass_error=0.3),
    "no friction compensation": PlantSettings(friction_error=-1.0),
}


def context(settings: PlantSettings, instances: list[MujocoPlant] | None = None) -> Context:
    """Return the context of a plant with these settings; its plants are appended to `instances`."""

    def make(start: np.ndarray) -> Plant:
        plant = plants.built_in_plants(settings)["mujoco"](start)
        assert isinstance(plant, MujocoPlant)
        if instances is not None:
            instances.append(plant)
        return plant

    return Context(LIMITS, plants={"mujoco": make})


@pytest.mark.parametrize("case", UNSTABLE)
def test_a_diverging_simulation_is_a_latched_fault(case: str) -> None:
    """The move ends with the fault PLANT or NOT_SETTLED and a message; the state stays finite."""
    with open_driver("sim://?plant=mujoco", context(UNSTABLE[case])) as driver:
        with pytest.raises(FaultError) as raised:
            driver.move(GOAL, 1.0)
        state = driver.state()
        assert state.mode is Mode.FAULT
        assert state.fault_code in (Fault.PLANT, Fault.NOT_SETTLED)
        assert state.fault_message in str(raised.value)
        assert isinstance(driver, SimDriver)
        assert np.isfinite(driver.controller.plant.reported_axes).all()


@pytest.mark.parametrize("case", WITHIN_THE_MARGIN)
def test_the_default_settings_have_a_margin(case: str) -> None:
    """The same move settles and stays within 1.5 mm at 1.6 m, with each setting far from its default."""
    errors: list[float] = []

    def watch(reference: Reference, times: np.ndarray, axes: np.ndarray) -> None:
        errors.append(float(np.abs(axes - reference.sample(times)[0]).max()))

    limits = LIMITS
    move = interpolate(HOME, GOAL / 1e4 * np.pi / 180, limits.velocity, limits.acceleration, limits.jerk)
    plant = plants.built_in_plants(WITHIN_THE_MARGIN[case], watch)["mujoco"](HOME)
    plant.follow(move)
    plant.advance(move.duration)
    for _ in range(1200):
        if plant.settled:
            break
        plant.advance(0.004)
    assert plant.settled, plant.failure
    assert 0.0 < max(errors) < 1e-3


def test_a_drive_that_is_too_weak_trips_and_can_be_reset() -> None:
    """Beyond the following error the fault names the axis, the arm stops, and a reset clears it."""
    instances: list[MujocoPlant] = []
    with open_driver("sim://?plant=mujoco", context(PlantSettings(), instances)) as driver:
        full = instances[0].model.actuator_forcerange.copy()
        instances[0].model.actuator_forcerange[0] /= 10.0
        with pytest.raises(FaultError, match=r"A1 is 0\.5[0-9] deg from its reference"):
            driver.move(GOAL, 1.0)
        stands = driver.state().axes
        assert not (stands == from_rad(HOME)).all()
        instances[0].model.actuator_forcerange[:] = full
        driver.reset()
        state = driver.state()
        assert state.mode is Mode.IDLE
        assert np.abs(state.axes - stands).max() <= 1
        assert driver.move(GOAL, 1.0).mode is Mode.IN_POSITION


@pytest.mark.parametrize("poison", ["qpos", "qvel"])
def test_nan_is_never_reported_as_a_pose(poison: str) -> None:
    """NaN in any part of the state latches the fault; the previous axes stay reported."""
    instances: list[MujocoPlant] = []
    with open_driver("sim://?plant=mujoco", context(PlantSettings(), instances)) as driver:
        before = driver.state().axes
        getattr(instances[0].data, poison)[2] = np.nan
        with pytest.raises(DriverError, match="not a number"):
            driver.move(GOAL, 1.0)
        state = driver.state()
        assert state.fault_code is Fault.PLANT
        assert (state.axes == before).all()


def test_a_jump_of_the_reference_is_a_failure() -> None:
    """A reference that does not begin at the arm's position is not driven."""
    plant = MujocoPlant(HOME)
    plant.follow(resting(HOME + 0.02))
    plant.advance(0.1)
    assert "from its reference" in plant.failure
    assert not plant.settled
    np.testing.assert_allclose(plant.reported_axes, HOME, atol=1e-9)
    plant.follow(resting(HOME))
    assert plant.failure == ""
    plant.advance(1.0)
    assert plant.settled


def test_a_failure_stays_if_the_reset_is_elsewhere() -> None:
    """The drives continue only with a reference at rest at the arm's position."""
    plant = MujocoPlant(HOME)
    plant.follow(resting(HOME + 2 * FOLLOWING_ERROR))
    plant.advance(0.1)
    for elsewhere in (resting(HOME + 0.1), interpolate(HOME, HOME[None] + 0.1, LIMITS.velocity, LIMITS.acceleration)):
        plant.follow(elsewhere)
        assert plant.failure
        plant.advance(1.0)
    np.testing.assert_allclose(plant.reported_axes, HOME, atol=1e-9)


@pytest.mark.parametrize("seconds", [86_400.0, 3e7, 1e12])
def test_a_clock_that_jumps_ahead_costs_nothing(seconds: float) -> None:
    """With closed brakes a jump of a day or a year needs no computation, and the arm then moves normally."""
    clock = SimulatedClock()
    controller = Controller(MujocoPlant(HOME), LIMITS, clock)
    start = perf_counter()
    clock.wait(seconds)
    assert controller.state().mode is Mode.IDLE
    assert perf_counter() - start < 2.0
    plant = controller.plant
    limits = LIMITS
    plant.follow(interpolate(HOME, HOME[None] + 0.1, limits.velocity, limits.acceleration, limits.jerk))
    plant.advance(2.0)
    assert plant.settled
    np.testing.assert_allclose(plant.reported_axes, HOME + 0.1, atol=1e-4)


def test_a_thousand_moves_leave_no_drift() -> None:
    """Moves by one count at irregular times end exactly; the integral does not wind up."""
    plant = MujocoPlant(HOME)
    limits, at = LIMITS, HOME
    for k in range(1000):
        goal = HOME + 1e-5 * (k % 2)
        move = interpolate(at, goal[None], limits.velocity, limits.acceleration, limits.jerk)
        plant.follow(move)
        plant.advance(move.duration + 0.000_3)
        at = goal
    plant.follow(resting(at))
    plant.advance(1.0)
    assert plant.settled
    np.testing.assert_allclose(plant.reported_axes, at, atol=2e-5)
