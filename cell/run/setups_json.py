"""setups.json: several set-ups of one part that were planned as one cover; fractions of the surface."""

from pydantic import Field

from cell.run.json_table import JsonTable, Triple


class OfferedSetup(JsonTable):
    """A pose of the part that was looked at."""

    name: str = Field(description="in words")
    placement_mm: Triple = Field(description="of the part's centre in base")
    placement_abc_deg: Triple = Field(description="how it is turned, KUKA A B C")
    reachable: int = Field(description="candidates that the arm reaches")
    coverable: float = Field(description="what these measure")
    in_contact: float = Field(description="what a support touches: no view of this set-up measures it")
    left_out: str = Field(description='why it is not possible, a sentence; "" where it is')


class ChosenSetup(JsonTable):
    """A set-up of the cover."""

    folder: str = Field(description="its run folder, from this file's")
    digest: str = Field(description="of the plan in it")
    offered: int = Field(description="row of `offered`")
    views: int = Field(description="of its plan")
    visible: float = Field(description="what they measure")
    adds: float = Field(description="what they measure that the set-ups before do not")


class SetupsCoverage(JsonTable):
    """What all set-ups measure together, on the same held-out samples."""

    visible: float = Field(description="measured by a view of any of them")
    coverable: float = Field(description="measured by a reachable candidate of any set-up that was offered")
    visible_of_coverable: float = Field(description="the first as a fraction of the second")
    asked: float = Field(description="of that fraction")


class SetupsFile(JsonTable):
    """The file."""

    part: str = Field(description="of the built-in part or of the file")
    seed: int = Field(description="of every random choice")
    coverage: SetupsCoverage
    status: str = Field(description="what is proven of the number of set-ups, and of views, in words")
    setups_bound: int = Field(description="no fewer of the set-ups offered reach what was asked of these samples")
    views: int = Field(description="of all set-ups")
    views_bound: int = Field(description="no cover by so many of the set-ups offered has fewer views")
    chosen: tuple[ChosenSetup, ...] = Field(description="in the order in which they are numbered")
    offered: tuple[OfferedSetup, ...] = Field(description="all that were looked at")
