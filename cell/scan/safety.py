"""What must hold before an arm of steel moves: a person's word, a slow start, no latched fault.

A controller that is simulated in the same process needs none of it. This replaces no emergency stop and no safety
controller; it keeps a mistyped command from moving 235 kg.
"""

from collections.abc import Callable

from cell.errors import DriverFailureError, UsageError
from drivers.contract import Driver, Mode, RobotState

HARDWARE_SPEED = 0.1
"""Fraction of the axis speeds at which hardware moves unless the user asks for another."""

Ask = Callable[[str], str]
"""Puts a question to a person and returns the answer."""


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


def require_confirmed(driver: Driver, speed: float, *, confirmed: bool, ask: Ask | None) -> None:
    """Steel moves only on a person's word.

    Args:
        driver: connected.
        speed: at which it will be driven.
        confirmed: whether the word was given as an option.
        ask: puts the question to a person; None where nobody is there to answer.

    Raises:
        UsageError: if nobody confirms.
    """
    able = driver.capabilities
    if not able.hardware or confirmed:
        return
    danger = f"{able.controller} moves an arm at {100 * speed:g} % of its axis speeds"
    if ask is None:
        raise UsageError(
            f"{danger}; give --confirm-motion once nobody stands within its reach and the emergency stop is at hand"
        )
    if ask(f"{danger}. Nobody within its reach, emergency stop at hand? Type yes to move: ").strip().lower() != "yes":
        raise UsageError("not confirmed; nothing was moved")


def ready(driver: Driver, *, reset: bool, stop_first: bool) -> RobotState:
    """The state of a controller that will take a move.

    Args:
        driver: connected.
        reset: whether a latched fault may be cleared.
        stop_first: whether an arm that still moves, as after a client that was killed, may be stopped.

    Raises:
        DriverFailureError: if a fault is latched and may not be cleared, or the arm moves.
        DriverError: whatever the driver raises.
    """
    state = driver.state()
    if state.busy:
        if not stop_first:
            raise DriverFailureError("the arm moves already: another client drives it; stop it first")
        state = driver.stop()
    if state.mode in (Mode.FAULT, Mode.EMERGENCY_STOP):
        if not reset:
            raise DriverFailureError(
                f"the controller has latched a fault ({state.fault_sentence}); nothing was moved: find its cause, then "
                "give --reset to clear it"
            )
        state = driver.reset()
    return state
