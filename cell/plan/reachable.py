"""Whether anything can be planned with the candidates that the arm reaches."""

from cell.errors import UnreachableError
from cell.part.mesh_checks import Kind
from cell.part.workpiece import Workpiece
from cell.plan.request import check_named
from cell.scene.plan_settings import PlanSettings
from planner.reach.reach import Reach

_ONE_SIDED = (Kind.OPEN, Kind.FLAT)


def require_reachable(plan: PlanSettings, part: Workpiece, reached: Reach) -> None:
    """Refuse to go on with nothing reachable, or without what the plan names.

    Raises:
        UnreachableError: if the arm reaches no candidate.
        SceneError: if the plan names a candidate that there is not, or pins one that is not reached.
    """
    check_named(plan, reached)
    if not reached.reachable.any():
        raise UnreachableError(_nothing_reachable(reached, part))


def _nothing_reachable(reached: Reach, part: Workpiece) -> str:
    counts = ", ".join(f"{count} {verdict.sentence}" for verdict, count in reached.counts().items() if count)
    worst = next(iter(reached.blockers()), "")
    return (
        f"none of the {len(reached)} candidate viewpoints is reachable: {counts}"
        + (f" (most often {worst})" if worst else "")
        + "; move the part (--place), change the standoff or allow more --roll values"
        + (", or turn its faces round if they face inwards" if any(f.kind in _ONE_SIDED for f in part.findings) else "")
    )
