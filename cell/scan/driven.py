"""What `cell scan` drives and scans, and what it keeps of it, once it is known that it may."""

from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np
from pydantic import JsonValue

from cell.acquisition import SIMULATED, sources
from cell.acquisition.sources import Acquisition
from cell.errors import DriverFailureError
from cell.runs.cell import RunCell
from cell.runs.run import split_axes
from cell.scan import execute
from cell.scan.execution_folder import EXECUTING, MOTION, ExecutionFolder
from cell.scan.legs import Legs
from cell.scan.options import ScanOptions
from cell.session import ProgressReporter, Session
from cell.world.embree import EmbreeRayCaster
from drivers.clock import Clock
from drivers.contract import Driver
from drivers.errors import DriverError
from planner.geometry.mesh import TriangleMesh
from planner.timing.motion import Motion


def cell_with(stands: TriangleMesh | None, cell: RunCell) -> RunCell:
    """The cell, with another part than the plan's where one stands there."""
    if stands is None:
        return cell
    return replace(cell, reference=stands, part_caster=EmbreeRayCaster(stands.vertices, stands.faces))


def part_may_be_near(options: ScanOptions, cell: RunCell, nearest: float) -> str:
    """A sentence where the part may stand farther off its place than the motion keeps clear of it; else none.

    Args:
        options: how far off it may stand.
        cell: the part.
        nearest: smallest distance of the motion from anything [m].
    """
    if options.search is None:
        return ""
    vertices, centre = cell.reference.vertices, cell.scene.T_object_centre[:3, 3]
    radius = float(np.linalg.norm(vertices - centre, axis=1).max())
    moved = options.search[0] + 2 * float(np.sin(options.search[1] / 2)) * radius
    if not moved > nearest:  # of older runs it is not known
        return ""
    return (
        f"the part may stand up to {1000 * moved:.1f} mm off, and the motion comes as near as {1000 * nearest:.1f} mm: "
        "find it with cell locate first, or plan with more clearance"
    )


def drive(
    connected: ExitStack,
    session: Session[ExecutionFolder],
    legs: Legs,
    driver: Driver,
    clock: Clock,
    cell: RunCell,
    options: ScanOptions,
    speed: float,
) -> None:
    """Drive and scan the legs; what goes wrong from here on is kept in the execution's folder."""
    folder = session.folder
    connected.enter_context(folder.keep_on_failure())
    connected.enter_context(drivers_errors_as_ours())
    with session.stage(EXECUTING) as progress, driver:
        scale = driver.capabilities.time_scale
        folder.note(
            controller=driver.capabilities.controller, speed_fraction=round(speed, 6),
            **({} if scale == 1 else {"time_scale": scale}),
        )  # fmt: skip
        seed = folder.manifest.require_seed(folder.path)
        source = acquisition_of(folder.manifest.options, cell, seed, folder.path, session.reporter)
        folder.note(source=source.source)
        seconds = execute.run(legs, driver, cell, source, folder, speed=speed, clock=clock, progress=progress)
        folder.note(moving_s=round(seconds, 6), simulated_time=driver.capabilities.simulated_time)


def acquisition_of(
    kept: Mapping[str, JsonValue], cell: RunCell, seed: int, folder: Path, reporter: ProgressReporter
) -> Acquisition:
    """Where the points come from, by the options that the execution was begun with."""
    kind, argument = sources.load(str(kept.get("acquire", SIMULATED)))
    return kind(argument, sources.Context(cell, kept, seed, folder, reporter.note))


_LIMITS = ("lower", "upper", "velocity", "acceleration", "jerk")


def write_motion(folder: ExecutionFolder, motion: Motion) -> None:
    """What is driven where that is not the plan's motion, so that it can be replayed."""
    folder.write_arrays(
        MOTION,
        **{
            name: getattr(motion, name)
            for name in ("via_q", "segment", "view", "via_t", "t", "q", "qd", "qdd", "segment_of_sample")
        }
        | split_axes(via_q=motion.via_q, q=motion.q, qd=motion.qd, qdd=motion.qdd),
        pose=motion.pose,
        line=motion.line,
        **{f"limit_{name}": getattr(motion.limits, name) for name in _LIMITS},
    )


@contextmanager
def drivers_errors_as_ours() -> Iterator[None]:
    """A driver's error ends the command with its code."""
    try:
        yield
    except DriverError as error:
        raise DriverFailureError(str(error)) from error
