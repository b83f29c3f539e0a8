"""What must hold before an arm of steel moves: a person's word, a slow start, no latched fault.

A controller that is simulated in the same process needs none of it. This replaces no emergency stop and no safety
controller; it keeps a mistyped command from moving 235 kg.
"""

from cell.errors import DriverFailureError, UsageError
from cell.scan.way import Released
from cell.session import Confirm
from drivers.contract import Driver, RobotState
from drivers.status import latched_fault

HARDWARE_SPEED = 0.1
"""Fraction of the axis speeds at which hardware moves unless the user asks for another."""

EVERY = "every motion"
"""What is given for a digest where a person released every motion of something larger, whatever way it takes."""


def speed_fraction(asked_percent: float | None, planned: float, *, hardware: bool) -> float:
    """Fraction of the axis speeds at which to drive.

    Args:
        asked_percent: `--speed`, percent of the speed that the plan was timed with; None was not asked for.
        planned: the plan's fraction of the axis speeds.
        hardware: whether steel moves.
    """
    if asked_percent is not None:
        return planned * asked_percent / 100
    return min(planned, HARDWARE_SPEED) if hardware else planned


def require_confirmed(
    driver: Driver, speed: float, released: Released, *, given: str | None, ask: Confirm | None
) -> None:
    """Steel moves only on a person's word for what is driven.

    Args:
        driver: connected.
        speed: at which it will be driven.
        released: what is to be driven.
        given: digest that was given as an option, or its first characters; or `EVERY`.
        ask: puts the question to a person; None where nobody is there to answer.

    Raises:
        UsageError: if nobody confirms, or something else than what is to be driven.
    """
    able = driver.capabilities
    if not able.hardware:
        return
    danger = (
        f"{able.controller} moves an arm at {100 * speed:g} % of its axis speeds along {released.what} {released.shown}"
    )
    if given == EVERY or (given is not None and released.digest.startswith(given)):
        return
    if given is not None and not (released.own and ask is not None):
        raise UsageError(
            f"--confirm-motion {given} is not the digest of {released.what}, which is {released.shown}; nothing was "
            "moved: make sure that this is what is to be driven, and give its digest"
        )
    if ask is None:
        raise UsageError(
            f"{danger}; give --confirm-motion {released.shown} once nobody stands within its reach and the emergency "
            "stop is at hand"
        )
    if ask(f"{danger}. Nobody within its reach, emergency stop at hand? Type yes to move: ").strip().lower() != "yes":
        raise UsageError("not confirmed; nothing was moved")


def require_time_scale(driver: Driver, accepted: float | None) -> None:
    """A controller on a wire whose clock is not real time is an emulator, and only a person can know that it is one.

    Args:
        driver: connected.
        accepted: how many times as fast somebody says that it may be; None: nobody said so.

    Raises:
        UsageError: if its clock is another one.
    """
    able = driver.capabilities
    if able.hardware and able.time_scale == 1.0 and accepted not in (None, 1.0):
        raise UsageError(
            f"{able.controller} says that its clock is real time, not {accepted:g} times as fast; nothing was moved: "
            "leave --accept-time-scale away"
        )
    if able.hardware and able.time_scale != (1.0 if accepted is None else accepted):
        raise UsageError(
            f"{able.controller} says that its clock is {able.time_scale:g} times as fast as real time, as only an "
            f"emulator's is; nothing was moved: if it is one, give --accept-time-scale {able.time_scale:g}"
        )


def ready(driver: Driver, *, reset: bool, stop_first: bool, time_scale: float | None = None) -> RobotState:
    """The state of a controller that will take a move, and takes it from us alone.

    Args:
        driver: connected.
        reset: whether a latched fault may be cleared.
        stop_first: whether an arm that still moves, as after a client that was killed, may be stopped.
        time_scale: of a controller whose clock is not real time, as a person accepts it.

    Raises:
        UsageError: if its clock is another one.
        DriverFailureError: if a fault is latched and may not be cleared, or the arm moves.
        DriverError: whatever the driver raises.
    """
    require_time_scale(driver, time_scale)
    state = driver.state()
    if state.is_busy:
        if not stop_first:
            raise DriverFailureError("the arm moves already: another client drives it; stop it first")
        state = driver.stop()
    driver.take()
    if fault := latched_fault(state):
        if not reset:
            raise DriverFailureError(
                f"the controller has latched a fault ({fault}); nothing was moved: find its cause, then give --reset "
                "to clear it"
            )
        driver.reset()
    return driver.require_ready()
