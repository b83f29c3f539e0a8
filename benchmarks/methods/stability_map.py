"""One stability map: what breaks a method, what is asked of it there, and how the answer is judged."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any


@dataclass(frozen=True, slots=True)
class MapPoint:
    """What came of one value.

    Attributes:
        success: share of what was asked that came out right, 0 to 1.
        error: in the unit of the map; None where nothing came out that could have one.
        says: what the program tells its user there, in its own words; "" where it says nothing.
        more: what else is worth a column.
    """

    success: float
    error: float | None
    says: str = ""
    more: Mapping[str, Any] = field(default_factory=dict)


Look = Callable[[str, float, int], MapPoint]
"""Line of the map, value of what breaks the method, how much to ask."""


@dataclass(frozen=True, slots=True)
class Map:
    """What breaks one method, and how that is seen.

    Attributes:
        title: the question, for people.
        parameter: what is varied, with its unit.
        success: what counts as success.
        error: what the error is, with its unit.
        enough: share that has to succeed.
        tolerated: largest error that is good.
        values: of the parameter.
        quick: those of the reduced study.
        look: asks the method.
        sizes: how much is asked at each value: in full, and in the reduced study.
        lines: variants that are drawn beside each other.
        quick_lines: how many of them the reduced study has.
        compared: lines that are no method of the program's, for comparison.
        borders: (lowest, highest) value that is safe, where the program compares with a number; None for an end that it
            finds out by trying.
        judged_by_error: whether the program compares the error itself with `tolerated`; what lies below it is safe.
        scale: of the axis: "log", "linear" or "symlog".
        linear_below: of a "symlog" axis.
        towards_small: whether the method breaks towards small values; the axis then runs to the right towards them.
    """

    title: str
    parameter: str
    success: str
    error: str
    tolerated: float
    values: tuple[float, ...]
    quick: tuple[float, ...]
    look: Look
    sizes: tuple[int, int]
    lines: tuple[str, ...] = ("",)
    quick_lines: int = 9
    compared: tuple[str, ...] = ()
    borders: tuple[float | None, float | None] = (None, None)
    judged_by_error: bool = False
    scale: str = "log"
    linear_below: float = 1.0
    towards_small: bool = False
    enough: float = 0.99
