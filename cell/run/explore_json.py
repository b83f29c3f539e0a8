"""explore.json: how a part without a model was explored, stage by stage, and, in simulation, the truth beside it."""

from pathlib import Path

from pydantic import ConfigDict, Field, JsonValue

from cell.run.json_table import JsonTable, Triple, optional, parsed

NAME = "explore.json"


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
    points: int = Field(description="that came back")
    seconds: float = Field(description="of the planned motion, from home to home")
    expected_mm2: float = Field(description="of the believed surface that was open, to be measured by the batch")
    surface_mm2: float = Field(description="of the surface that was believed after it")
    open_mm2: float = Field(description="of that, without a measured point beside it")
    never_entered_mm3: float = Field(description="of the cylinder, by any ray; the part's inside is of it")


class OpenReason(JsonTable):
    """Believed surface that stays open for one reason."""

    reason: str = Field(description="at which the closest candidate view fails")
    area_mm2: float = Field(description="of the believed surface")


class BoundAt(JsonTable):
    """A point of the curve that nothing exceeds."""

    views: int = Field(description="how many")
    found: float = Field(description="share of the surface that the best views found measure")
    at_most: float = Field(description="share that no so many of the candidates measure")


class Truth(JsonTable):
    """What a simulation knows: all of the true part, which the planning did not. Shares of its surface."""

    visible: float = Field(description="visible coverage of the executed views")
    by_views: tuple[float, ...] = Field(description="the same after the first, second, ... view in driving order")
    known_model_visible: float = Field(description="of the plan that knows the model (truth/)")
    known_model_views: int = Field(description="of that plan")
    coverable: float = Field(description="what its reachable candidates measure")
    fewest: int = Field(
        description="views that the candidates of the true model need at least for the coverage that was reached (for "
        "all that they measure, where more was reached); over these candidates and samples"
    )
    bound: tuple[BoundAt, ...] = Field(description="over the number of views, for the true model's candidates")
    nearest_mm: float = Field(description="smallest distance of arm or tool to anything, the true part in place")
    nearest: str = Field(description="between what")


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
        "where sigma or spacing is limited: share of what was measured that no view measures within the limits"
    )
    truth: Truth | None = optional()

    @property
    def views(self) -> int:
        """Views that were scanned."""
        return sum(stage.views for stage in self.stages)


def read(path: Path) -> ExploreFile:
    """An explore.json as the value that defines it.

    Raises:
        FileError: if it is damaged.
    """
    return parsed(ExploreFile, path.read_bytes(), path)
