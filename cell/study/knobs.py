"""The knobs that trade speed for accuracy: one table of what is turned, over what range, and what an error means.

`cell study speed` turns them one at a time; docs/speed_accuracy.md shows the same table. The trial of a knob is timed,
so it should run alone on its machine.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from cell.errors import UsageError
from cell.plant.servo import Settings
from cell.scene.plan_settings import PlanSettings
from cell.scene.presets import DEFAULT, PRESETS
from cell.scene.scene import Scanner
from cell.study import turned, turned_engine
from cell.study.scenes import bench_of
from cell.study.turned import Turn
from planner.order.generalised_tsp import STEPS

Value = float | int | str
OfPreset = Callable[[str], Value]


@dataclass(frozen=True, slots=True)
class Knob:
    """One knob.

    Attributes:
        title: what is turned, for people.
        unit: of its values, as beside a number; "" for a count or a name.
        values: its range, the fastest first.
        of_preset: the value that a preset has.
        truth: what an error is measured against.
        measure: what the error is, with its unit.
        error_unit: unit of the error alone.
        turn: computes one value.
        part: the built-in part that it is turned on where none is asked for: one on which it matters.
    """

    title: str
    unit: str
    values: tuple[Value, ...]
    of_preset: OfPreset
    truth: str
    measure: str
    error_unit: str
    turn: Turn
    part: str = "mseke"

    @property
    def turned_by_presets(self) -> bool:
        """Whether presets differ in it."""
        return len({self.of_preset(name) for name in PRESETS}) > 1

    def parsed(self, text: str) -> list[Value]:
        """Values of an option, separated by commas, of the kind that the knob has.

        Raises:
            UsageError: if one is of another kind.
        """
        return [self._parsed(piece.strip()) for piece in text.split(",")]

    def _parsed(self, text: str) -> Value:
        words = [value for value in self.values if isinstance(value, str)]
        if text in words:
            return text
        numbers = [value for value in self.values if not isinstance(value, str)]
        try:
            value = type(numbers[0])(text) if numbers else math.nan
        except ValueError:
            value = math.nan
        if not (0 <= value < math.inf) or (value == 0 and 0 not in numbers):
            kind = [] if not numbers else ["whole numbers" if isinstance(numbers[0], int) else "positive numbers"]
            raise UsageError(f"--values: {text} is no value of this knob; valid are {' or '.join([*kind, *words])}")
        return value

    @property
    def default(self) -> Value:
        """The value of the default preset."""
        return self.of_preset(DEFAULT)


def _plan(key: str) -> OfPreset:
    def value(preset: str) -> Value:
        found: Value = PRESETS[preset].plan.get(key, PlanSettings.model_fields[key].default)
        return found

    return value


def _same(value: Value) -> OfPreset:
    return lambda preset: value


def _resolution(preset: str) -> float:
    given = PRESETS[preset].scanner.get("resolution_deg", Scanner.model_fields["resolution_deg"].default)
    return float(given[0])


KNOBS: Mapping[str, Knob] = {
    "decimation": Knob(
        "faces of the planning mesh", "x default", (0.125, 0.25, 0.5, 1.0, 2.0),
        lambda preset: PRESETS[preset].faces_factor,
        "what all candidates of a mesh of four times the default faces measure together",
        "surface that the plan misses of it [points]", "points", turned.decimation,
    ),
    "samples": Knob(
        "surface samples per face, aimed at", "", (1, 2, 4, 8, 16), _plan("samples_per_face"),
        "visible coverage on 100,000 samples that the matrix has not seen",
        "coverage that the matrix claims for its plan, off by [points]", "points", turned.samples,
    ),
    "rays": Knob(
        "angle between rays of the paper's fill", "deg", (4.0, 2.0, 1.0, 0.5),
        _same(Scanner.model_fields["planning_resolution_deg"].default),
        "visible coverage on 100,000 samples that the matrix has not seen",
        "coverage that the matrix claims for its plan, off by [points]", "points", turned.rays,
    ),
    "solver": Knob(
        "work of the selection (a field of view of 18 deg)", "x default", (0.0, 0.03, 0.1, 0.3, 1.0, 3.0), _same(1.0),
        "the lower bound that the default budget proves",
        "views above it [%]", "%", turned.solver,
    ),
    "collision": Knob(
        "what the part is in collisions", "", ("hull", "decomposed", "exact"), _plan("collision"),
        "the part's true triangles",
        "free configurations beside the part that are refused [%]", "%", turned_engine.collision, "robinet",
    ),
    "edges": Knob(
        "step between the checks of a move", "deg", (32.0, 16.0, 8.0, 4.0, 2.0, 1.0, 0.5, turned_engine.CERTIFIED),
        _same(turned_engine.CERTIFIED),
        "a look at every millimetre of travel",
        "clearance that a move uses up and passes as free, at most [mm]", "mm", turned_engine.edges,
    ),
    "ordering": Knob(
        "tours that the ordering looks at", "", (0, 100, 1000, 10_000, 100_000), _same(STEPS),
        "the lower bound that is proven for these views and joint solutions",
        "time of the moves above it [%]", "%", turned.ordering,
    ),
    "scan": Knob(
        "angle between the rays of a scan", "deg", (2.0, 1.0, 0.5, 0.25, 0.125), _resolution,
        "the part's own surface; 30 um of noise along the rays",
        "rms deviation of the surface made of the scans [um]", "um", turned_engine.scan,
    ),
    "grid": Knob(
        "grid of the reconstruction", "x spacing", (5.0, 3.0, 2.0, 1.25, 0.8), _same(1.25),
        "the part's own surface; 30 um of noise along the rays",
        "rms deviation of the surface made of the scans [um]", "um", turned_engine.grid,
    ),
    "plant": Knob(
        "time step of the dynamic arm", "ms", (10.0, 5.0, 2.0, 1.0, 0.5, 0.2), _same(1000 * Settings().time_step),
        "the same move at a step of 0.05 ms",
        "farthest off at the same time [mm]", "mm", turned_engine.plant,
    ),
}  # fmt: skip


def turn(settings: Mapping[str, Any]) -> dict[str, Any]:
    """One value of one knob: the trial.

    Args:
        settings: scene and files (`cell.study.scenes`), knob, value, and repeats, of which the best counts.

    Returns:
        The error, in the knob's unit, and what else is worth a column; under "seconds" what the work took.
    """
    found = KNOBS[settings["knob"]].turn(bench_of(settings), settings["value"], settings["repeats"])
    return {"error": found.error, "more": dict(found.more), "seconds": dict(found.seconds)}
