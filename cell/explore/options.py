"""Options of `cell explore` in addition to those of the scene and of an execution."""

import re
from typing import Annotated, Literal

from pydantic import Field, field_validator

from cell.runs.digest import SHORT_DIGEST
from cell.scene.fields import Positive, Table
from cell.scene.options import Option

_EXPLORE = "Exploration"
ANY_BATCH = "explore"
"""Value of --confirm-motion that confirms every batch of one exploration."""

MAX_VOXELS, VOXEL_SPACINGS = 150, 1.3
"""Default size of a voxel: largest number along the longest side of the cylinder, and edge in point distances."""

SCAN_OPTIONS = (
    *("driver", "realtime", "resolution", "range_noise", "noise", "pose_error", "acquire", "points_frame"),
    *("points_units", "acquire_wait_s", "acquire_timeout_s", "reset", "accept_time_scale"),
)
"""Options of `cell scan` that hold for every batch."""


class ExploreOptions(Table):
    """Options of `cell explore`; each option states the meaning of None."""

    policy: Annotated[
        Literal["stepwise", "two-stage"],
        Option(
            "Selection of views after the first ones: stepwise, one batch at a time for the uncovered surface; or "
            "two-stage, one plan on the rough model and a few more views for the rest.",
            _EXPLORE,
        ),
    ] = "stepwise"
    cylinder_mm: Annotated[
        tuple[Positive, Positive] | None,
        Field(strict=False),
        Option(
            "Diameter and height of an upright cylinder about --place that contains the part; the part stands on its "
            "bottom. Default: 5 % wider than the simulated part.",
            _EXPLORE,
            metavar="MM,MM",
            counts=(2,),
        ),
    ] = None
    voxel_mm: Annotated[
        Positive | None,
        Option(
            f"Edge of a voxel. Default: 1/{MAX_VOXELS} of the longest side of the cylinder, or {VOXEL_SPACINGS:g} x "
            "the point distance at the standoff if that is more.",
            _EXPLORE,
        ),
    ] = None
    ring: Annotated[
        int | None,
        Field(ge=1),
        Option(
            "Number of first views, which cover most of the cylinder. Default: 1 for stepwise, 6 for two-stage.",
            _EXPLORE,
        ),
    ] = None
    batch: Annotated[int, Field(ge=1), Option("Views per batch (stepwise).", _EXPLORE)] = 1
    min_gain: Annotated[
        Positive,
        Field(lt=1),
        Option(
            "Smallest expected gain of a view, as a share of the measured surface. Multiplied by 2 on the boundary "
            "of unseen space, by 0.6 on the continued surface, and by 3 for the first plans of two-stage.",
            _EXPLORE,
            metavar="SHARE",
        ),
    ] = 0.001
    max_seconds: Annotated[
        Positive | None, Option("Start no batch after this duration of motion. Default: no limit.", _EXPLORE)
    ] = None
    confirm_motion: Annotated[
        str | None,
        Option(
            "Confirms that a real arm may move: explore, for every batch of this exploration, in which the arm stays "
            "out of unseen space; or the digest of the next motion. Default: ask.",
            "Real controllers",
            metavar="explore|DIGEST",
        ),
    ] = None

    @field_validator("confirm_motion")
    @classmethod
    def _check_confirmation(cls, digest: str | None) -> str | None:
        if digest is not None and not re.fullmatch(f"{ANY_BATCH}|[0-9a-f]{{{SHORT_DIGEST},64}}", digest.lower()):
            raise ValueError(f"is {digest!r}; it must be {ANY_BATCH}, or a digest of {SHORT_DIGEST} characters or more")
        return None if digest is None else digest.lower()
