"""Colours of all pictures and pages, distinguishable with any colour vision (Okabe and Ito 2008; viridis).

Uncovered surface is vermilion everywhere; measured surface is blue, darker with more views.
"""

from typing import Literal

import numpy as np

from planner.values import Floats

BLACK, ORANGE, SKY, GREEN, YELLOW = "#000000", "#e69f00", "#56b4e9", "#009e73", "#f0e442"
BLUE, VERMILION, PURPLE, GREY = "#0072b2", "#d55e00", "#cc79a7", "#999999"

AXES = (BLUE, ORANGE, GREEN, VERMILION, PURPLE, BLACK)
"""A1 to A6."""

BETWEEN = "#f6d5c0"
"""Area between a curve and its bound."""

OPEN = VERMILION
SEEN = ("#d4e6f1", "#a9cce3", "#7fb3d5", "#5499c7", "#2471a3", "#1a5276", "#154360")
"""Measured by 1, 2, ... views; the last colour also for more views."""

MEASURED = "#d9dee3"
"""Measured surface in pictures whose colours are causes."""

REASONS = (
    VERMILION, BLUE, GREEN, PURPLE, ORANGE, SKY, YELLOW, "#5d3a9b", "#7f4f24", "#1b7837", "#e31a8c", "#4d4d4d",
)  # fmt: skip
VERDICTS = {
    "no tolerance": "#9aa5b1", "pass": "#3f8f5b", "fail": "#c0392b", "undecided": "#e0a030", "not measured": "#7b5ea7",
}  # fmt: skip
"""Conformity of characteristics."""

LENGTHS = ("#440154", "#46327e", "#365c8d", "#277f8e", "#1fa187", "#4ac16d", "#a0da39", "#fde725")
"""Small to large (viridis)."""

SIGNED = ("#053061", "#2166ac", "#4393c3", "#92c5de", "#f7f7f7", "#f4a582", "#d6604d", "#b2182b", "#67001f")
"""Blue for missing material, red for excess material (RdBu of ColorBrewer)."""

RAMPS = {
    "length": {
        "viridis": LENGTHS,
        "cividis": ("#00204d", "#31446b", "#666970", "#958f78", "#cbba69", "#ffea46"),
        "magma": ("#000004", "#3b0f70", "#8c2981", "#de4968", "#fe9f6d", "#fcfdbf"),
    },
    "signed": {
        "blue to red": SIGNED,
        "purple to orange": ("#2d004b", "#542788", "#8073ac", "#b2abd2", "#f7f7f7", "#fdb863", "#e08214", "#b35806",
                             "#7f3b08"),
        "teal to brown": ("#003c30", "#01665e", "#35978f", "#80cdc1", "#f5f5f5", "#dfc27d", "#bf812d", "#8c510a",
                          "#543005"),
    },
}  # fmt: skip
"""Colour scales of lengths and of signed lengths by name; the first of each is the default."""

Material = Literal["orange", "anthracite", "aluminium", "painted", "fixture", "surface", "floor"]
MATERIALS: dict[Material, tuple[float, float, float]] = {
    "orange": (0.95, 0.33, 0.02),
    "anthracite": (0.13, 0.13, 0.145),
    "aluminium": (0.66, 0.68, 0.71),
    "painted": (0.36, 0.39, 0.43),
    "fixture": (0.33, 0.47, 0.62),
    "surface": (0.84, 0.80, 0.72),
    "floor": (0.86, 0.87, 0.88),
}
"""Materials of the cell."""

_DARK = ("motor", "feet", "turntable", "flange", "collar", "front")  # black parts of the real robot
_MATERIAL_OF_SHAPE: dict[str, Material] = {
    "housing": "anthracite", "bracket": "aluminium", "pedestal": "painted", "post": "aluminium", "floor": "floor",
    "part": "surface",
}  # fmt: skip


def material_of(shape: str, *, is_robot: bool) -> Material:
    """Return the material of a shape of the cell by its name."""
    if is_robot:
        return "anthracite" if any(word in shape for word in _DARK) else "orange"
    return _MATERIAL_OF_SHAPE.get(shape, "fixture")


def rgb(colour: str) -> Floats:
    """Return (3,) red, green, blue from 0 to 1 of `#rrggbb`."""
    return np.array([int(colour[i : i + 2], 16) for i in (1, 3, 5)]) / 255.0
