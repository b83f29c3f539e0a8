"""Options of `cell setups` in addition to those of the scene."""

from collections.abc import Sequence
from typing import Annotated

from pydantic import Field

from cell.errors import UsageError
from cell.scene.fields import Positive, Table
from cell.scene.model import Scene
from cell.scene.options import Option

_PANEL = "Set-ups"


def _split(texts: Sequence[str]) -> list[str]:
    pieces = [piece.strip() for text in texts for piece in text.split(",")]
    for piece in pieces:
        parse_candidate(piece)  # ValueError if it is none
    return pieces


_PIN, _BAN = (
    Option(
        help_,
        _PANEL,
        name,
        metavar="SETUP:ID[,...]",
        form="candidates, each as SETUP:ID with the number of the set-up candidate (setups.json)",
        examples=("0:12,5:40",),
        convert=_split,
    )
    for name, help_ in (("pin", "Candidates that must be views."), ("ban", "Candidates that must not be views."))
)
_Candidates = Annotated[tuple[str, ...], Field(strict=False)]


class SetupOptions(Table):
    """Number and choice of the set-ups; each option states its default."""

    max_setups: Annotated[
        int | None, Field(ge=1), Option("Largest number of set-ups. Default: as many as are needed.", _PANEL)
    ] = None
    proposals: Annotated[
        int | None,
        Field(ge=0),
        Option(
            "Number of proposed poses: the part as placed and in stable poses, each at four turns. Default: 24, or "
            "none if the scene gives [[setup]] tables.",
            _PANEL,
        ),
    ] = None
    first: Annotated[
        str | None,
        Option(
            "Finished plan of the part that is the first set-up; its views stay as they are, and only further set-ups "
            "are planned. Its executions are copied.",
            _PANEL,
            metavar="RUN",
        ),
    ] = None
    pinned: Annotated[_Candidates, _PIN] = ()
    banned: Annotated[_Candidates, _BAN] = ()
    setup_s: Annotated[
        Positive | None,
        Option(
            "With --cost time: cost of a set-up in seconds beside its views; the sum is minimised. Default: fewest "
            "set-ups come first.",
            _PANEL,
            name="setup_seconds",
            metavar="S",
        ),
    ] = None

    @property
    def pins(self) -> list[tuple[int, int]]:
        """Pinned candidates: (set-up candidate, number in it)."""
        return sorted({parse_candidate(text) for text in self.pinned})

    @property
    def bans(self) -> list[tuple[int, int]]:
        """Banned candidates."""
        return sorted({parse_candidate(text) for text in self.banned})

    def check(self, scene: Scene) -> None:
        """Refuse options that contradict each other or the scene.

        Raises:
            UsageError: naming the option.
        """
        plan = scene.plan
        if plan.pinned or plan.banned:
            raise UsageError(
                "plan.pinned and plan.banned name candidates of one set-up; for several give --pin and --ban with the "
                "number of the set-up candidate, for instance --pin 2:17"
            )
        if both := sorted(set(self.pins) & set(self.bans)):
            raise UsageError(
                f"candidate {format_candidate(both[0])} is pinned and banned; remove it from one of the options"
            )
        if plan.max_views is not None and len(self.pins) > plan.max_views:
            raise UsageError(f"{len(self.pins)} views are pinned and at most {plan.max_views} are allowed; pin fewer")
        if self.max_setups is not None and len({setup for setup, _ in self.pins}) > self.max_setups:
            raise UsageError(f"views of more than the {self.max_setups} allowed set-ups are pinned; allow more")
        if self.setup_s is not None and plan.cost != "time":
            raise UsageError("--setup-seconds needs views with a cost in seconds; give --cost time as well")
        if self.setup_s is not None and self.max_setups is not None:
            raise UsageError("--max-setups and --setup-seconds both limit the number of set-ups; give one of them")


def format_candidate(candidate: tuple[int, int]) -> str:
    """Write a candidate as the options name it."""
    return f"{candidate[0]}:{candidate[1]}"


def parse_candidate(text: str) -> tuple[int, int]:
    """Read a candidate as the options name it."""
    setup, _, number = text.partition(":")
    if not (setup.isdecimal() and number.isdecimal()):
        raise ValueError(text)
    return int(setup), int(number)
