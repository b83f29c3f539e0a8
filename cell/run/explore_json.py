"""explore.json: how a part without a model was explored, stage by stage, and, in simulation, the truth beside it."""

from pathlib import Path
from typing import Literal

from pydantic import ConfigDict, Field, JsonValue

from cell.run.json_table import JsonTable, Triple, optional, parsed

NAME = "explore.json"

UNSEEN = "unseen"
"""The fixture of a stage that is the space not seen free: it collides, and hides nothing."""


SurfaceName = Literal["believed", "measured"]
BELIEVED: SurfaceName = "believed"
MEASURED: SurfaceName = "measured"


class ExploredCylinder(JsonTable):
    """The upright cylinder that holds the part; its middle is the origin of the explored frame."""

    diameter_mm: float = Field(description="of it")
    height_mm: float = Field(description="of it")
    middle_mm: Triple = Field(description="in the base frame")
    given: bool = Field(description="whether a person gave it; else it is that of the simulated part, a little wider")


class ExploredStage(JsonTable):
    """A batch that was planned and executed."""

    folder: str = Field(description="its run folder, below this one")
    digest: str = Field(description="of what was driven")
    views: int = Field(description="that were scanned")
    planned_on: SurfaceName = Field(description="surface about what was not seen free, or where all points lead")
    points: int = Field(description="that came back")
    seconds: float = Field(description="of the planned motion, from home to home")
    expected_mm2: float = Field(description="of the surface that it was planned on, what it was to measure first")
    too_near_mm2: float = Field(
        default=0.0, description="of that, what gave no point where the part may begin before the scanner's range"
    )
    new_mm2: float = Field(description="of the surface believed after it, what it measured and no batch before")
    surface_mm2: float = Field(description="of the surface that was believed after it")
    open_mm2: float = Field(description="of that, without a measured point beside it")
    never_entered_mm3: float = Field(description="of the cylinder, by any ray; the part's inside is of it")

    @property
    def measured_mm2(self) -> float:
        """Of the surface that was believed after it, with a measured point beside it."""
        return self.surface_mm2 - self.open_mm2


class OpenReason(JsonTable):
    """Believed surface that stays open for one reason."""

    reason: str = Field(description="at which the closest candidate view fails")
    area_mm2: float = Field(description="of the surface of all that the part may be")


class BoundAt(JsonTable):
    """A point of the curve that nothing exceeds."""

    views: int = Field(description="how many")
    found: float = Field(description="share of the surface that the best views found measure")
    at_most: float = Field(description="share that no so many of the candidates measure")


class Truth(JsonTable):
    """What a simulation knows of the true part; shares of its surface."""

    visible: float = Field(description="visible coverage of the executed views")
    by_views: tuple[float, ...] = Field(description="the same after the first, second, ... view in driving order")
    known_model_visible: float = Field(description="of the plan that knows the model (truth/)")
    known_model_views: int = Field(description="of that plan")
    coverable: float = Field(description="what its reachable candidates measure")
    fewest: int = Field(
        description="views that its candidates need at least for the coverage reached, or for all that they measure"
    )
    fewest_found: int = Field(description="of its candidates that measure as much: the best cover found")
    bound: tuple[BoundAt, ...] = Field(description="over the number of views, for the true model's candidates")
    nearest_mm: float = Field(description="smallest distance of arm or tool to anything, the true part in place")
    nearest: str = Field(description="between what")

    @property
    def fewest_words(self) -> str:
        """The fewest views for the coverage that was reached, in a line."""
        least = f"{self.fewest} at least" if self.fewest < self.fewest_found else f"{self.fewest}, proven,"
        return f"{least} for this coverage, for the true model's candidates and samples"


class ExploreFile(JsonTable):
    """The file."""

    model_config = ConfigDict(serialize_by_alias=True)

    schema_version: str = Field(alias="schema", description="of the folder's layout")
    units: str = "mm, mm2, s; the explored frame: middle of the cylinder, axes of the base frame"
    part: str = Field(description="what it is called")
    status: str = Field(description="running, or finished")
    ended: str = Field(description='why no further batch was begun, a sentence; "" while it runs')
    inputs: str = Field(description="sha256 of all that the exploration depends on")
    seed: int = Field(description="of every random choice")
    policy: str = Field(description="how batches are chosen")
    source: str = Field(description="where points come from")
    options: dict[str, JsonValue] = Field(description="of the exploration")
    cylinder: ExploredCylinder
    voxel_mm: float = Field(description="edge of a voxel")
    stages: tuple[ExploredStage, ...] = Field(description="in order")
    open: tuple[OpenReason, ...] = Field(default=(), description="what stays open, largest area first")
    model: str = Field(default="", description='the mesh of all scans, explored frame; "" where there is none yet')
    model_middle_mm: Triple | None = optional("middle of its bounding box, base frame: where cell plan places it")
    misses_limits: float | None = optional(
        "where sigma or spacing is limited: share of what was measured that does not keep it"
    )
    truth: Truth | None = optional()

    @property
    def views(self) -> int:
        """Views that were scanned."""
        return sum(stage.views for stage in self.stages)

    def rows(self) -> list[tuple[str, str]]:
        """What the command, the report and the page show of it, once a stage is finished."""
        last = self.stages[-1]
        rows = [
            ("views", f"{self.views} in {len(self.stages)} batches ({self.policy})"),
            ("motion", f"{sum(stage.seconds for stage in self.stages):.1f} s"),
            ("ended", self.ended),
            ("measured", f"{last.measured_mm2 / 100:.1f} cm2 of surface"),
            ("stays open", f"{sum(reason.area_mm2 for reason in self.open) / 100:.1f} cm2 of all that the part may be"),
        ]
        rows.append(("never entered", f"{last.never_entered_mm3 / 1000:.1f} cm3 of the cylinder, by any ray"))
        rows += [("", f"{reason.area_mm2:.0f} mm2: {reason.reason}") for reason in self.open[:4]]
        if self.misses_limits is not None:
            share = f"{100 * self.misses_limits:.2f} % of what was measured, worse than the sigma or spacing asked for"
            rows.append(("beyond limits", share))
        if (known := self.truth) is not None:
            rows += [
                (
                    "visible coverage",
                    f"{100 * known.visible:.2f} % of the true surface, of which reachable candidates of the true model "
                    f"measure {100 * known.coverable:.2f} %",
                ),
                (
                    "with the model",
                    f"{known.known_model_views} views would have measured {100 * known.known_model_visible:.2f} %",
                ),
                ("fewest views", known.fewest_words),
                ("nearest", f"{known.nearest_mm:.1f} mm ({known.nearest}), the true part in place"),
            ]
        return rows


def read(path: Path) -> ExploreFile:
    """An explore.json as the value that defines it.

    Raises:
        FileError: if it is damaged.
    """
    return parsed(ExploreFile, path.read_bytes(), path)
