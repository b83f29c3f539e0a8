"""What `cell setups` can be asked for beside the scene's options."""

from collections.abc import Sequence
from typing import Annotated

from pydantic import Field

from cell.errors import UsageError
from cell.scene.fields import Positive, Table
from cell.scene.model import Scene
from cell.scene.options import Option

_PANEL = "Set-ups"


def _each(texts: Sequence[str]) -> list[str]:
    pieces = [piece.strip() for text in texts for piece in text.split(",")]
    for piece in pieces:
        _candidate(piece)  # ValueError where it is none
    return pieces


_PIN, _BAN = (
    Option(
        help_,
        _PANEL,
        name,
        metavar="SETUP:ID[,...]",
        form="candidates, each by the number of the set-up offered (setups.json) and its own",
        examples=("0:12,5:40",),
        made=_each,
    )
    for name, help_ in (("pin", "Candidates that must be taken."), ("ban", "Candidates that must not be taken."))
)
_Candidates = Annotated[tuple[str, ...], Field(strict=False)]


class SetupOptions(Table):
    """How many set-ups, and which; what None means, each option says."""

    most: Annotated[
        int | None, Field(ge=1), Option("Set-ups that may be used. Default: as many as it takes.", _PANEL)
    ] = None
    offer: Annotated[
        int | None,
        Field(ge=0),
        Option(
            "Poses that are proposed: as placed and stable ones, at four turns. Default: 24, or none beside those that "
            "the scene gives in [[setup]].",
            _PANEL,
        ),
    ] = None
    pinned: Annotated[_Candidates, _PIN] = ()
    banned: Annotated[_Candidates, _BAN] = ()
    setup_s: Annotated[
        Positive | None,
        Option(
            "With --cost time: seconds that a set-up costs beside its views, whose sum is made small. Default: fewest "
            "set-ups come first.",
            _PANEL,
            name="setup_seconds",
            metavar="S",
        ),
    ] = None

    @property
    def pins(self) -> list[tuple[int, int]]:
        """The pinned candidates: set-up offered, and number in it."""
        return sorted({_candidate(text) for text in self.pinned})

    @property
    def bans(self) -> list[tuple[int, int]]:
        """The banned candidates."""
        return sorted({_candidate(text) for text in self.banned})

    def check(self, scene: Scene) -> None:
        """Refuse what several set-ups do not answer.

        Raises:
            UsageError: naming the wish.
        """
        plan = scene.plan
        if plan.pinned or plan.banned:
            raise UsageError(
                "plan.pinned and plan.banned name candidates of one set-up; of several give --pin and --ban with the "
                "number of the set-up offered before each, for instance --pin 2:17"
            )
        if both := sorted(set(self.pins) & set(self.bans)):
            raise UsageError(f"candidate {named(both[0])} is pinned and banned; take it out of one of them")
        if plan.max_views is not None and len(self.pins) > plan.max_views:
            raise UsageError(f"{len(self.pins)} views are pinned and at most {plan.max_views} are allowed; pin fewer")
        if self.most is not None and len({setup for setup, _ in self.pins}) > self.most:
            raise UsageError(f"views of more than the {self.most} set-ups that may be used are pinned; allow more")
        if self.setup_s is not None and plan.cost != "time":
            raise UsageError("a set-up costs seconds only where views do; give --cost time as well")
        if self.setup_s is not None and self.most is not None:
            raise UsageError("--most and --setup-seconds both say how few set-ups there are to be; give one of them")


def named(candidate: tuple[int, int]) -> str:
    """A candidate as a user names it."""
    return f"{candidate[0]}:{candidate[1]}"


def _candidate(text: str) -> tuple[int, int]:
    setup, _, number = text.partition(":")
    if not (setup.isdecimal() and number.isdecimal()):
        raise ValueError(text)
    return int(setup), int(number)
