"""Which wishes of `[plan]` go together; each pair that does not is refused in one sentence."""

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from cell.scene.scene import Plan


def contradiction(plan: "Plan") -> str:
    """The first contradiction among the wishes as what a key is ("and plan.x ..."), with the key first; "" for none."""
    overlap = "overlap_mm2" if plan.overlap_mm2 is not None else "overlap_share"
    overlaps = plan.overlap_mm2 is not None or plan.overlap_share is not None
    errs = plan.pose_sd_mm > 0 or plan.pose_sd_deg > 0
    if plan.overlap_mm2 is not None and plan.overlap_share is not None:
        return "overlap_mm2 and plan.overlap_share both say what an overlap is; give one of them"
    if both := sorted(set(plan.pinned) & set(plan.banned)):
        return f"pinned and plan.banned both name candidate {both[0]}; take it out of one of them"
    special = {
        "max_views": plan.max_views is not None,
        "multiplicity": plan.multiplicity > 1,
        overlap: overlaps,
        "pose_sd_mm" if plan.pose_sd_mm > 0 else "pose_sd_deg": errs,
        "cost": plan.cost == "time",
    }
    asked = [key for key, is_asked in special.items() if is_asked]
    if len(asked) > 1 and asked != ["multiplicity", "cost"]:
        return f"{asked[0]} and plan.{asked[1]} are different questions to the selection; ask one of them"
    if plan.max_views is not None and plan.coverage < 1:
        return "max_views and plan.coverage both set how long the plan is; give one of them"
    if plan.max_views is not None and len(plan.pinned) > plan.max_views:
        return f"max_views is {plan.max_views} and {len(plan.pinned)} views are pinned; allow more or pin fewer"
    if asked and asked[0] not in ("multiplicity", "cost") and plan.solver != "auto":
        return f"solver is '{plan.solver}', and plan.{asked[0]} has a search of its own; leave the solver 'auto'"
    if plan.overlap_in_order and not overlaps:
        return "overlap_in_order needs an overlap; give plan.overlap_mm2 or plan.overlap_share"
    if errs and plan.fill == "rays":
        return "pose_sd_mm and pose_sd_deg need aimed samples; choose plan.fill = 'aimed'"
    return ""
