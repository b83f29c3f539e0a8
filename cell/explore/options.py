"""What `cell explore` can be asked for beside the scene's options and those of an execution."""

import re
from typing import Annotated, Literal

from pydantic import Field, field_validator

from cell.runs.digest import SHORT_DIGEST
from cell.scene.fields import Positive, Table
from cell.scene.options import Option

_EXPLORE = "Exploration"
EVERY_BATCH = "explore"
"""The word that releases every batch of one exploration."""

VOXELS, SPACINGS = 150, 1.3
"""Where the size of a voxel is not given: so many along the longest side of the cylinder at most, and each so many
times as large as points lie apart at the standoff."""

OF_SCAN = (
    *("driver", "realtime", "resolution", "range_noise", "noise", "pose_error", "acquire", "points_frame"),
    *("points_units", "acquire_wait_s", "acquire_timeout_s", "reset", "accept_time_scale"),
)
"""Options of `cell scan` that hold for every batch."""


class ExploreOptions(Table):
    """How to explore; what None means, each option says."""

    policy: Annotated[
        Literal["stepwise", "two-stage"],
        Option(
            "How views are chosen after the first ring: stepwise, a batch at a time for what is open; or two-stage, "
            "all in one plan on the rough model, and a few more for what stays open.",
            _EXPLORE,
        ),
    ] = "stepwise"
    cylinder_mm: Annotated[
        tuple[Positive, Positive] | None,
        Field(strict=False),
        Option(
            "Diameter and height of an upright cylinder about --place that holds the part, which stands on its bottom. "
            "Default: that of the simulated part, a twentieth wider.",
            _EXPLORE,
            metavar="MM,MM",
            counts=(2,),
        ),
    ] = None
    voxel_mm: Annotated[
        Positive | None,
        Option(
            f"Edge of a voxel. Default: 1/{VOXELS} of the cylinder's longest side, or {SPACINGS:g} x the distance of "
            "points at the standoff where that is more.",
            _EXPLORE,
        ),
    ] = None
    ring: Annotated[
        int | None,
        Field(ge=1),
        Option(
            "Views of the first ring, which see the cylinder best. Default: 1 stepwise, 6 in two stages.",
            _EXPLORE,
        ),
    ] = None
    batch: Annotated[
        int, Field(ge=1), Option("Views that are planned and executed at a time (stepwise).", _EXPLORE)
    ] = 1
    min_gain: Annotated[
        Positive,
        Field(lt=1),
        Option(
            "Share of the surface measured so far that a batch must be expected to add for each of its views: twice as "
            "much where unseen space hides the surface, 0.6 of it where walls go on; two-stage asks from three "
            "times as much to that.",
            _EXPLORE,
            metavar="SHARE",
        ),
    ] = 0.001
    max_seconds: Annotated[
        Positive | None, Option("Begin no batch after so many seconds of motion. Default: no limit.", _EXPLORE)
    ] = None
    confirm_motion: Annotated[
        str | None,
        Option(
            "Your word that a real arm may move: explore, for every batch of this exploration, whose arm stays out of "
            "space that was not seen free; or the digest of the next motion. Else it is asked for.",
            "Real controllers",
            metavar="explore|DIGEST",
        ),
    ] = None

    @field_validator("confirm_motion")
    @classmethod
    def _a_word(cls, given: str | None) -> str | None:
        if given is not None and not re.fullmatch(f"{EVERY_BATCH}|[0-9a-f]{{{SHORT_DIGEST},64}}", given.lower()):
            raise ValueError(
                f"is {given!r}; it must be {EVERY_BATCH}, or a digest of {SHORT_DIGEST} characters or more"
            )
        return None if given is None else given.lower()
