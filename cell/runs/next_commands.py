"""Commands that follow a finished plan, as far as it supports them; printed by the command line and shown in pages."""

from typing import TYPE_CHECKING

from cell.robot.model import dimensions
from cell.runs.cell import world_of
from cell.runs.run import Run
from cell.runs.schema import Report

if TYPE_CHECKING:
    import mujoco


def after_plan(run: Run, name: str = "RUN") -> list[tuple[str, ...]]:
    """Return the commands that execute, explain and export a plan.

    Args:
        run: finished plan.
        name: of its folder in the commands.
    """
    own_model = None if run.scene.robot is None else world_of(run, run.reference).model
    return commands_of(run.report, own_model, name)


def commands_of(report: Report, model: "mujoco.MjModel | None", name: str = "RUN") -> list[tuple[str, ...]]:
    """Return the commands that execute, explain and export a plan.

    Args:
        report: of the plan.
        model: compiled cell of another robot; None: the built-in one.
        name: of the run folder in the commands.
    """
    # KRL is for KUKA's axes, and for sweeps along straight lines.
    has_krl = (model is None or dimensions(model) is not None) and not report.settings.own.get("sweep_deg")
    exported = ("cell", "export", name, *([] if has_krl else ["--format", "csv"]))
    return [("cell", "scan", name), ("cell", "why", name), exported]


def drop_command(report: Report, number: int, name: str = "RUN") -> tuple[str, ...] | None:
    """Return the command that drops a view, and restores the coverage if possible; None for the only view."""
    if report.n_views < 2:
        return None
    return "cell", "edit", name, "--drop", str(number), *(["--repair"] if report.is_repairable else [])
