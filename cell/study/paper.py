"""The paper's Tables 1 to 5 as printed (paper_tables.csv): 86 rows of parameter, viewpoints, views and coverage.

Table 5 gives the robot's position with respect to the object; docs/frames.md says how that is read. The paper's own
contradictions (docs/internals/paper_tables.md) are kept as they stand.
"""

import csv
from dataclasses import dataclass
from functools import cache
from importlib import resources


@dataclass(frozen=True, slots=True)
class PaperRow:
    """One row.

    Attributes:
        part: built-in part that stands for the paper's.
        parameter: what the table varies: faces kept [%], standoff [mm], FOV [deg], resolution [deg] or position [mm];
            None for the row of Table 5 without a robot.
        viewpoints: candidates, one per face of the planning mesh; in Table 5 those that the robot reaches.
        views: length of the view plan.
        coverage: of the surface [%].
    """

    part: str
    parameter: float | tuple[float, ...] | None
    viewpoints: int
    views: int
    coverage: float


@cache
def tables() -> dict[str, list[PaperRow]]:
    """The rows of each table, `table1` to `table5`, in the paper's order."""
    found: dict[str, list[PaperRow]] = {}
    content = (resources.files("cell.study") / "paper_tables.csv").read_text(encoding="utf-8")
    for row in csv.DictReader(content.splitlines()):
        # Whole numbers stay what they are: rows, and the names of trials, are told by them.
        numbers = tuple(float(word) if "." in word else int(word) for word in row["parameter"].split())
        parameter = numbers if len(numbers) > 1 else numbers[0] if numbers else None
        counts = int(row["viewpoints"]), int(row["views"])
        found.setdefault(row["table"], []).append(PaperRow(row["part"], parameter, *counts, float(row["coverage"])))
    return found
