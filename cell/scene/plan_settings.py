"""The scene's `[plan]` table: how to plan, what is wished beyond the fewest views, and which wishes go together."""

from typing import Annotated, Literal, Self

from pydantic import Field, ValidationInfo, field_validator, model_validator

from cell.scene.fields import NotNegative, Positive, Share, Table


class PlanKeys(Table):
    """The keys of the table; None takes the part's default."""

    preset: Literal["fast", "balanced", "accurate"] = "balanced"
    candidates: Literal["optimal-scanning-zone", "view-sphere", "targeted"] = "optimal-scanning-zone"
    view_sphere_step_deg: Annotated[
        tuple[Annotated[float, Field(gt=0, le=180)], Annotated[float, Field(gt=0, le=180)]], Field(strict=False)
    ] = (15.0, 15.0)
    standoffs_mm: Annotated[tuple[Positive, ...], Field(strict=False, min_length=1)] | None = None
    rolls_deg: Annotated[tuple[float, ...], Field(strict=False, min_length=1)] = (0.0, 90.0)
    faces: Annotated[int, Field(ge=4)] | None = None
    percent_kept: Annotated[float, Field(gt=0, le=100)] | None = None
    samples_per_face: Annotated[int, Field(ge=1)] = 4
    fill: Literal["aimed", "rays"] = "aimed"
    solver: Literal["auto", "greedy", "meta-raps", "local-search", "exact"] = "auto"
    coverage: Share = 1.0
    required_visible: Annotated[float, Field(ge=0, le=1)] = 0.0
    max_sigma_mm: Positive | None = None
    collision: Literal["hull", "decomposed", "exact"] = "exact"
    seed: Annotated[int, Field(ge=0, le=2**63 - 1)] = 0
    max_views: Annotated[int, Field(ge=1)] | None = None
    multiplicity: Annotated[int, Field(ge=1)] = 1
    pinned: Annotated[tuple[Annotated[int, Field(ge=0)], ...], Field(strict=False)] = ()
    banned: Annotated[tuple[Annotated[int, Field(ge=0)], ...], Field(strict=False)] = ()
    cost: Literal["views", "time"] = "views"
    scan_s: NotNegative = 2.0
    settle_s: NotNegative = 0.5
    overlap_mm2: Positive | None = None
    overlap_share: Share | None = None
    overlap_in_order: bool = False
    pose_sd_mm: NotNegative = 0.0
    pose_sd_deg: NotNegative = 0.0
    alpha: Annotated[float, Field(gt=0, lt=1)] = 0.05
    ensemble: Annotated[int, Field(ge=1, le=10_000)] = 32
    curve: bool = False


class PlanSettings(PlanKeys):
    """How to plan: the keys, and that they go together."""

    @field_validator("fill")
    @classmethod
    def _aimed_at_samples(cls, fill: str, info: ValidationInfo) -> str:
        if fill == "rays" and info.data.get("candidates") == "targeted":
            raise ValueError("is 'rays', and candidates = 'targeted' aims at surface samples; choose fill = 'aimed'")
        return fill

    @field_validator("percent_kept")
    @classmethod
    def _one_size(cls, percent: float | None, info: ValidationInfo) -> float | None:
        if percent is not None and info.data.get("faces") is not None:
            raise ValueError("and plan.faces both set the size of the planning mesh; give one of them")
        return percent

    @model_validator(mode="after")
    def _one_question(self) -> Self:
        if problem := _contradiction(self):
            raise ValueError(f".{problem}")
        return self


def _contradiction(plan: PlanSettings) -> str:
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
