"""Presets: what `--preset fast|balanced|accurate` settles where neither scene file nor option says anything.

A preset is data: keys of the scene that it fills in, and a factor for the part's default number of planning faces.
`balanced` fills in nothing: it *is* the defaults. The values come from the fronts of docs/speed_accuracy.md: each is at
the knee of its front, or one step beyond; what is measured to cost next to nothing (triangles in collisions, certified
moves) no preset gives up.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field

from cell.scene import sensors

DEFAULT = "balanced"


@dataclass(frozen=True, slots=True)
class Preset:
    """One trade of speed for accuracy.

    Attributes:
        plan: keys of the scene's `[plan]`.
        scanner: keys of `[scanner]`, for a scanner with a ray grid.
        faces_factor: of the part's default number of planning faces.
        price: measured, against `balanced` in the same run; a clause for people.
    """

    plan: Mapping[str, int] = field(default_factory=dict)
    scanner: Mapping[str, list[float]] = field(default_factory=dict)
    faces_factor: float = 1.0
    price: str = ""


PRESETS: dict[str, Preset] = {
    "fast": Preset(
        plan={"samples_per_face": 2},
        scanner={"resolution_deg": [0.5, 0.5]},
        faces_factor=0.5,
        price="a scan takes 0.7 times as long; a plan as long as the default, with as much surface",
    ),
    "balanced": Preset(price="the defaults"),
    "accurate": Preset(
        plan={"samples_per_face": 8},
        scanner={"resolution_deg": [0.125, 0.125]},
        faces_factor=2.0,
        price="a scan takes 2.9 times as long, points half as far apart; a plan up to 1.8 times, with no more surface",
    ),
}

RAY_GRID = "laser-area"  # the type of scanner whose resolution is the angle between the rays of a grid


def beneath(content: Mapping[str, object]) -> dict[str, object]:
    """The tables of a scene with what its preset fills in; every key that is there stays.

    Args:
        content: tables as they stand in the scene file, the command line's options in them. An unknown preset, or a
            table that is none, is left to the scene's own checks.
    """
    plan, scanner = content.get("plan", {}), content.get("scanner", {})
    if not isinstance(plan, dict) or not isinstance(scanner, dict):
        return dict(content)
    name = plan.get("preset")
    preset = PRESETS[name if isinstance(name, str) and name in PRESETS else DEFAULT]
    filled = dict(content)
    if preset.plan:
        filled["plan"] = {**preset.plan, **plan}
    if preset.scanner and _has_a_ray_grid(scanner):
        filled["scanner"] = {**preset.scanner, **scanner}
    return filled


def _has_a_ray_grid(scanner: Mapping[str, object]) -> bool:
    """Whether the scanner of a table that is not yet checked is of the type that the presets know."""
    name = scanner.get("sensor")
    if isinstance(name, str) and name in sensors.names():
        return sensors.load(name).type == RAY_GRID
    return name is None and scanner.get("type", RAY_GRID) == RAY_GRID


def line() -> str:
    """All presets with their prices in one line, for `--help`."""
    return "; ".join(f"{name}: {preset.price}" for name, preset in PRESETS.items())
