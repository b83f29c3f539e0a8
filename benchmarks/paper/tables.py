"""The paper's Tables 1 to 5 as printed (tables.csv): 86 rows of parameter, viewpoints, views and coverage.

Table 5 gives the robot's position with respect to the object; docs/frames.md explains it. The contradictions of
the paper (docs/internals/paper_tables.md) are not corrected.
"""

import csv
from dataclasses import dataclass
from functools import cache
from pathlib import Path


@dataclass(frozen=True, slots=True)
class PaperRow:
    """A printed row.

    Attributes:
        part: built-in part in place of the paper's.
        parameter: varied parameter: kept faces [%], standoff [mm], FOV [deg], resolution [deg] or position [mm]; None
            for the row of Table 5 without a robot.
        viewpoints: number of candidates, one per face of the planning mesh; in Table 5 the reachable ones.
        views: number of views of the plan.
        coverage: coverage of the surface [%].
    """

    part: str
    parameter: float | tuple[float, ...] | None
    viewpoints: int
    views: int
    coverage: float


@cache
def tables() -> dict[str, list[PaperRow]]:
    """Return the rows of each table, `table1` to `table5`, in the paper's order."""
    found: dict[str, list[PaperRow]] = {}
    content = (Path(__file__).parent / "tables.csv").read_text(encoding="utf-8")
    for row in csv.DictReader(content.splitlines()):
        # Integers stay integers: they are part of the settings that identify a trial.
        numbers = tuple(float(word) if "." in word else int(word) for word in row["parameter"].split())
        parameter = numbers if len(numbers) > 1 else numbers[0] if numbers else None
        counts = int(row["viewpoints"]), int(row["views"])
        found.setdefault(row["table"], []).append(PaperRow(row["part"], parameter, *counts, float(row["coverage"])))
    return found
