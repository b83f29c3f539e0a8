"""Commands that follow a finished plan, as far as it supports them; printed by the command line and shown in pages."""

from cell.robot.makers import maker_language
from cell.robot.model import KR16, ROUNDED, dimensions
from cell.runs.cell import world_of
from cell.runs.run import Run
from cell.runs.schema import Report
from cell.world.model import World


def after_plan(run: Run, name: str = "RUN") -> list[tuple[str, ...]]:
    """Return the commands that execute, explain and export a plan.

    Args:
        run: finished plan.
        name: of its folder in the commands.
    """
    robot = run.scene.robot
    if robot is None:
        return commands_of(run.report, None, KR16, name)
    return commands_of(run.report, world_of(run, run.reference), robot.name, name)


def commands_of(report: Report, world: World | None, robot: str, name: str = "RUN") -> list[tuple[str, ...]]:
    """Return the commands that execute, explain and export a plan.

    Args:
        report: of the plan.
        world: compiled cell; None: that of the built-in robot.
        robot: name of the robot's file, or "kr16".
        name: of the run folder in the commands.
    """
    exported = ("cell", "export", name, *([] if _has_program(report, world, robot) else ["--format", "csv"]))
    return [("cell", "scan", name), ("cell", "why", name), exported]


def _has_program(report: Report, world: World | None, robot: str) -> bool:
    """Return whether `cell export` can write a plan in the language of the robot's maker."""
    if report.settings.own.get("sweep_deg"):
        return False
    match maker_language(robot):
        case "krl":
            return world is None or dimensions(world.model, ROUNDED) is not None
        case "urscript":
            return world is None or world.table is None
        case "rapid" | "ls":
            return True
        case _:
            return False


def drop_command(report: Report, number: int, name: str = "RUN") -> tuple[str, ...] | None:
    """Return the command that drops a view, and restores the coverage if possible; None for the only view."""
    if report.n_views < 2:
        return None
    return "cell", "edit", name, "--drop", str(number), *(["--repair"] if report.is_repairable else [])
