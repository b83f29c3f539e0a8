"""One stability map: the varied number, the requests at each value, and the evaluation of the results."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any


@dataclass(frozen=True, slots=True)
class MapPoint:
    """Result at one value.

    Attributes:
        success: share of correct results, 0 to 1.
        error: in the unit of the map; None if no result has an error.
        says: message of the program to its user at this value; "" if there is none.
        more: further columns.
    """

    success: float
    error: float | None
    says: str = ""
    more: Mapping[str, Any] = field(default_factory=dict)


Method = Callable[[str, float, int], MapPoint]
"""Line of the map, value of what breaks the method, how much to ask."""


@dataclass(frozen=True, slots=True)
class Map:
    """Number that limits one method, and the measure of its effect.

    Attributes:
        title: title of the chart.
        parameter: name of the varied number with its unit.
        success: definition of success.
        error: definition of the error with its unit.
        enough: required share of successes.
        tolerated: largest acceptable error.
        values: values of the parameter.
        quick: values of the reduced study.
        method: function that runs the method.
        sizes: number of requests at each value, in the full and in the reduced study.
        lines: variants that are drawn in one chart.
        quick_lines: number of variants in the reduced study.
        compared: lines of other methods, for comparison.
        borders: (lowest, highest) safe value, if the program compares with a number; None for an end that it determines
        by trial.
        judged_by_error: whether the program compares the error itself with `tolerated`; smaller errors are safe.
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
    method: Method
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
