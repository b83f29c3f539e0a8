"""What `cell cover` can be asked for, checked."""

from typing import Annotated

from pydantic import Field

from cell.scene.fields import NotNegative, Table
from cell.scene.options import Option

_SEARCH = "Search"


class CoverOptions(Table):
    """How a set-cover file is read and solved; what cannot be, reader and solver say themselves."""

    form: Annotated[str | None, Option("rows, rail or steiner. Default: the one that fits.", name="format")] = None
    solver: Annotated[str, Option("auto, greedy, meta-raps, local-search or exact.", _SEARCH)] = "auto"
    budget_s: Annotated[
        NotNegative | None,
        Option(
            "Work to spend, counted and not timed: about so many seconds of one core, and the same answer on every "
            "machine. Default: 2, or with --time-limit no end but that.",
            _SEARCH, name="budget", metavar="SECONDS",
        ),
    ] = None  # fmt: skip
    time_limit_s: Annotated[
        float | None,
        Option(
            "Wall-clock guard; the answer says when it stopped the search.", _SEARCH, name="time_limit",
            metavar="SECONDS",
        ),
    ] = None  # fmt: skip
    coverage: Annotated[float, Option("Share of the coverable rows that must be covered.")] = 1.0
    multiplicity: Annotated[int, Option("How many columns must cover a row.", metavar="K")] = 1
    seed: Annotated[int, Field(ge=0), Option("Seed of the solver's random choices.", _SEARCH)] = 0
