"""manifest.json of a run and of an execution: how it was made and how far it came.

It is the one file that changes while the folder is written, and clock values stand in no other. It is read even where
it is cut off early or of a foreign folder: any key may be missing.
"""

from pathlib import Path
from typing import Self

from pydantic import ConfigDict, Field, JsonValue

from cell.errors import FileError
from cell.run.json_table import JsonTable, optional


class Resumed(JsonTable):
    """Once that a stopped execution was taken up again."""

    at: str = Field(description="time (UTC)")
    argv: tuple[str, ...] = Field(description="the command line")
    driver: str = Field(description="URL of the controller")
    after: str = Field(description="status that it had")
    way: str | None = optional("digest of the way that was planned to go on")
    way_deg: tuple[tuple[float, ...], ...] | None = optional("its set-points of all axes, from where the arm stood")


class NamedFile(JsonTable):
    """A file of the user's that a plan was made of."""

    what: str = Field(description="scene, part, or fixture:NAME")
    path: str = Field(description="where it was")
    sha256: str = Field(description="of its bytes")


class Manifest(JsonTable):
    """The file; a key that is not set is not written."""

    model_config = ConfigDict(serialize_by_alias=True)

    schema_version: str | None = Field(default=None, alias="schema", description="of the folder's layout")
    status: str | None = Field(
        default=None,
        description="running, finished, failed, interrupted, or incomplete: reported without having ended",
    )
    stage: str | None = Field(default=None, description="that was begun last")
    started: str | None = Field(default=None, description="time (UTC)")
    argv: tuple[str, ...] = Field(default=(), description="the command line")
    seed: int | None = Field(default=None, ge=0, description="of every random choice")
    inputs: dict[str, str] = Field(default_factory=dict, description="sha256 of what the plan depends on")
    files: tuple[NamedFile, ...] = Field(default=(), description="that the user named; none of a built-in cell")
    options: dict[str, JsonValue] = Field(default_factory=dict, description="of an execution: what was asked for")
    source: str | None = Field(default=None, description="of an execution: where its points come from")
    plan: str | None = Field(default=None, description="of an execution: sha256 of the plan.json that was executed")
    digest: str | None = Field(
        default=None, description="of all that drives; of an execution: of the plan that was executed"
    )
    way: str | None = Field(
        default=None, description="of an execution: digest of what was driven, where that is not the plan's motion"
    )
    versions: dict[str, str] = Field(default_factory=dict, description="of what results depend on")
    seconds: dict[str, float] = Field(default_factory=dict, description="of each stage")
    pid: int | None = Field(default=None, description="of an execution, while it runs: its process")
    pid_began: int | None = Field(default=None, description="when that began, in ticks of its machine")
    machine: str | None = Field(default=None, description="where it runs")
    controller: str | None = Field(default=None, description="of an execution: who drove")
    speed_fraction: float | None = Field(default=None, description="of the axis speeds")
    moving_s: float | None = Field(default=None, description="time that the controller took for the moves")
    simulated_time: bool | None = Field(default=None, description="whether its clock was a simulated one")
    time_scale: float | None = Field(default=None, description="of an emulator whose clock is not real time")
    resumed: tuple[Resumed, ...] = Field(default=(), description="each time that it was taken up again")
    reason: str = Field(default="", description="why it failed, a sentence")
    exit_code: int | None = Field(default=None, description="of the command; null where it was killed")
    artefacts: dict[str, str] = Field(default_factory=dict, description="sha256 of every file")

    def as_json(self) -> dict[str, JsonValue]:
        """The object as JSON types, of what is set."""
        return self.model_dump(mode="json", exclude_unset=True)

    def but(self, **entries: object) -> Self:
        """A copy with other entries."""
        return self.model_copy(update=entries)

    def without(self, *names: str) -> Self:
        """A copy without some entries."""
        return type(self).model_validate(self.model_dump(exclude_unset=True, exclude=set(names)))

    def require_seed(self, folder: Path) -> int:
        """The seed.

        Args:
            folder: for the sentence.

        Raises:
            FileError: if there is none.
        """
        if self.seed is None:
            raise FileError(f"{folder / 'manifest.json'} is damaged: it has no seed; plan or scan again")
        return self.seed
