"""The driver of an execution, and the clock by which its events are told."""

import dataclasses
from collections.abc import Callable, Mapping
from urllib.parse import parse_qsl, urlsplit

import numpy as np

from cell.errors import DriverFailureError, UsageError
from cell.runs.cell import RunCell
from cell.scan.options import ScanOptions
from drivers.clock import Clock, RealTimeClock, SimulatedClock
from drivers.contract import Driver
from drivers.controller import PlantFactory
from drivers.errors import DriverError
from drivers.limits import Limits
from drivers.registry import Context, open_driver
from drivers.setpoints import from_rad, to_deg
from drivers.sim import SimDriver
from planner.timing.motion import Motion

_DYNAMIC = ("velocity", "acceleration", "jerk")


def on_a_wire(url: str) -> bool:
    """Whether a driver's URL may lead to something real: all but the controller that is simulated in this process."""
    return not url.lower().startswith("sim:")


def prepare(
    options: ScanOptions,
    motion: Motion,
    cell: RunCell,
    plants: Mapping[str, PlantFactory] | None = None,
    say: Callable[[str], None] | None = None,
) -> tuple[Driver, Clock]:
    """The driver, not yet connected, and the clock that tells its time.

    The simulated controller gets the limits and accelerations of the plan, stands at its beginning, and jumps in time
    unless real time was asked for. By the same limits the arrivals of a real one are judged; but it does not know how
    far the plan stays below what the arm can do, so there the robot model's count where they are larger.

    Args:
        options: URL, and whether in real time.
        motion: of the plan, with the limits that it was timed with.
        cell: of the run, with its arm and the fraction of the axis speeds in these limits.
        plants: what a simulated controller can move, beside its own.
        say: told what is waited for, where nothing happens.

    Raises:
        UsageError: if real time is asked of a controller that is not simulated.
        DriverFailureError: if the URL names no driver, or has an option that its driver does not have.
    """
    try:
        parts = urlsplit(options.driver)
        query = dict(parse_qsl(parts.query, keep_blank_values=True))
    except ValueError as error:
        raise DriverFailureError(f"driver URL '{options.driver}' cannot be read: {error}") from error
    url, simulated = options.driver, parts.scheme == "sim"
    if options.realtime and not simulated:
        raise UsageError(f"--realtime is for sim://; {options.driver} takes the time that it takes")
    own_clock = not simulated or query.get("realtime", "0").lower() not in ("0", "false", "no", "off")
    if simulated and "start" not in query and "://" in url:
        start = ",".join(f"{angle:.4f}" for angle in to_deg(from_rad(motion.via_q[0])))
        url += ("&" if "?" in url else "?") + f"start={start}"
    arm = dataclasses.replace(motion.limits, velocity=motion.limits.velocity / cell.scene.speed_scaling)
    if not simulated:
        able = cell.kinematics.limits
        arm = dataclasses.replace(
            arm, **{name: np.maximum(getattr(arm, name), getattr(able, name)) for name in _DYNAMIC}
        )
    given: Clock | None = None if own_clock else RealTimeClock() if options.realtime else SimulatedClock()
    try:
        limits = Limits.from_rad(arm)
        limits = limits.with_endless_axis() if cell.scene.table_is_endless else limits
        driver = open_driver(url, Context(limits, given, plants or {}, say))
        # A simulated controller has one clock, with its time_scale; of another one only real time is known.
        return driver, driver.clock if isinstance(driver, SimDriver) else RealTimeClock()
    except DriverError as error:
        raise DriverFailureError(str(error)) from error
