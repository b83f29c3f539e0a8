"""The value that `cell locate` finds and prints."""

import numpy as np
from pydantic import Field

from cell.errors import UsageError
from cell.runs.schema import JsonTable, Transform, Triple


class Precision(JsonTable):
    """Standard deviations, of what is determined, from the scatter of the points; correlated errors do not show."""

    centre_mm: Triple = Field(description="of the part's centre along x, y, z of base")
    turn_deg: Triple = Field(description="of its orientation about x, y, z of base")
    worst_point_mm: float = Field(description="of the point of the part that is known least")


class CheckedMotion(JsonTable):
    """Whether the plan's own motion may be driven with the part there."""

    keeps_clearance: bool = Field(description="every segment certified again")
    problem: str = Field(description='what is wrong with it; "" where nothing is')
    nearest_mm: float = Field(description="smallest distance measured along it; farther than 300 mm is 300")
    between: str = Field(description='what comes that near; "" where all is farther')


class Located(JsonTable):
    """What `cell locate --json` prints."""

    run: str = Field(description="run folder")
    method: str = Field(description="'best fit', 'pairs' or '3-2-1'")
    source: str = Field(description="where the measured points come from")
    views: tuple[int, ...] = Field(description="whose points were fitted, in visiting order from 1")
    T_base_object: Transform = Field(description="where the part is: its file in base")
    placement_mm: Triple = Field(description="of the part's centre in base, as --place takes it")
    placement_abc_deg: Triple = Field(description="how it is turned, KUKA A B C")
    moved_mm: float = Field(description="of the centre, from where it was planned")
    turned_deg: float = Field(description="from how it was planned")
    points: int = Field(description="that were fitted")
    used: float = Field(description="share of them that counts; the others are outliers")
    rms_mm: float = Field(description="of what is left over; for 3-2-1 along the planes, which it leaves open")
    precision: Precision | None = Field(description="null where nothing says how precise the points are")
    within_mm: float = Field(description="what a direction has to be known to")
    undetermined: tuple[str, ...] = Field(
        description="motions that the points do not determine: there the part is taken to stand as planned, or is not "
        "known to `within_mm`"
    )
    symmetric: tuple[str, ...] = Field(description="further such motions, which leave the part the same")
    doubts: tuple[str, ...] = Field(description="what speaks against the result")
    checked_motion: CheckedMotion

    @property
    def place(self) -> str:
        """The value of --place that puts the part there."""
        return ",".join(f"{number:.10g}" for number in (*self.placement_mm, *self.placement_abc_deg))

    def require_determined(self) -> None:
        """Refuse a placement that the points do not determine.

        Raises:
            UsageError: naming what is open.
        """
        if self.undetermined:
            raise UsageError(
                f"the points do not determine where the part stands ({'; '.join(self.undetermined)}); measure more of "
                "it, or give --keep-planned to take it to stand as planned where that is open"
            )

    def rows(self) -> list[tuple[str, str]]:
        """For a table of names and values."""
        check, precision = self.checked_motion, self.precision
        found = [
            ("by", f"{self.method} of {self.points} points, {self.source}"),
            ("part's centre", f"{_listed(self.placement_mm)} mm in base, A B C {_listed(self.placement_abc_deg)} deg"),
            ("against the plan", f"{self.moved_mm:.3f} mm and {self.turned_deg:.4f} deg away"),
            ("left over", f"{self.rms_mm:.4f} mm rms; {100 * self.used:.1f} % of the points count"),
            (
                "standard deviation",
                "not known: give --point-sd"
                if precision is None
                else f"centre {_listed(precision.centre_mm, 4)} mm, turn {_listed(precision.turn_deg, 5)} deg; "
                f"worst point of the part {precision.worst_point_mm:.4f} mm",
            ),
            ("not determined", "\n".join(self.undetermined) or f"nothing (to {self.within_mm:g} mm)"),
        ]
        if self.symmetric:
            found.append(("without meaning", "\n".join(self.symmetric) + ": the part is the same after it"))
        if self.doubts:
            found.append(("doubts", "\n".join(self.doubts)))
        kept = "keeps its clearance there" if check.keeps_clearance else check.problem
        near = f"; nearest {check.nearest_mm:.1f} mm ({check.between})" if check.between else ""
        return [*found, ("the plan's motion", kept + near)]


def _listed(numbers: Triple, digits: int = 3) -> str:
    return ", ".join(str(np.round(number, digits) + 0.0) for number in numbers)
