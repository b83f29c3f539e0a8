"""Whether anything can be planned with the candidates that the arm reaches."""

from cell.errors import SceneError, UnreachableError
from cell.part.mesh_checks import Kind
from cell.part.workpiece import Workpiece
from cell.scene.model import PlanSettings
from planner.kinematics.reach import Reach, Verdict

_ONE_SIDED = (Kind.OPEN, Kind.FLAT)


def require_reachable(plan: PlanSettings, part: Workpiece, reached: Reach) -> None:
    """Refuse to go on with nothing reachable, or without what the plan names.

    Raises:
        UnreachableError: if the arm reaches no candidate.
        SceneError: if the plan names a candidate that there is not, or pins one that is not reached.
    """
    _require_named(plan, reached)
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


def _require_named(plan: PlanSettings, reached: Reach) -> None:
    """Refuse pinned and banned candidates that do not exist, and pinned ones that the arm does not reach.

    Raises:
        SceneError: with the candidate and its verdict.
    """
    for key in ("pinned", "banned"):
        for view in getattr(plan, key):
            if view >= len(reached):
                raise SceneError(f"plan.{key} names candidate {view}; there are candidates 0 to {len(reached) - 1}")
    for view in plan.pinned:
        if not reached.reachable[view]:
            verdict = Verdict(int(reached.verdict[view]))
            blocker = f" ({reached.blocker[view]})" if reached.blocker[view] else ""
            raise SceneError(
                f"plan.pinned names candidate {view}, which is {verdict.sentence}{blocker}; pin another one, or move "
                "the part"
            )
