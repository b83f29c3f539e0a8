"""Numbers that trade speed for accuracy: planning faces, samples per face, rays of a scan; seconds and error of each.

Each function takes the bench, the value of the knob and the number of repeats, and returns an error against a truth and
the seconds of the work. The truths are computed once per process. No robot is used.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any

import numpy as np

from benchmarks.best_of import best_of
from benchmarks.claimed_coverage import claim
from benchmarks.eight_scans import eight_scans, noisy
from cell.errors import UsageError
from cell.metrology.reconstruct import Reconstruction, reconstruct
from cell.plan.candidates import generate_viewpoints
from cell.scene.model import PlanSettings, Scanner
from cell.study.prepared_part import Bench, shared_bench
from planner import cover
from planner.errors import PlannerError
from planner.geometry.closest import ClosestPointQuery
from planner.geometry.decimation import decimate
from planner.geometry.mesh import TriangleMesh
from planner.geometry.sampling import draw_samples
from planner.measurability import coverage
from planner.measurability.visibility import fill_matrix, find_measured
from planner.registration.cloud import ScanCloud, merge
from planner.registration.surface import measure_deviation
from planner.viewpoints.viewpoints import Viewpoints

FINEST = 4
"""Multiple of the default planning faces; its candidates represent all possible ones."""

_FEATURES, _SELECTION = 0, 2  # random streams, as in `cell plan`
_NOISE = 30e-6  # noise of the scans along the ray [m]

Value = float | int


@dataclass(frozen=True, slots=True)
class KnobResult:
    """Result of one value of a knob.

    Attributes:
        error: deviation from the truth, in the unit of the knob.
        seconds: "work" on the wall clock, "processor" over all cores.
        more: further columns.
    """

    error: float
    seconds: Mapping[str, float]
    more: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class Knob:
    """A number that trades speed for accuracy.

    Attributes:
        title: title of the knob.
        unit: unit of its values; "" for a count.
        values: its range, fastest first.
        default: default value of a plan and a scan.
        truth: reference of the error.
        measure: definition of the error with its unit.
        error_unit: unit of the error.
        turn: function of bench, value and repeats that computes one result.
    """

    title: str
    unit: str
    values: tuple[Value, ...]
    default: Value
    truth: str
    measure: str
    error_unit: str
    turn: Callable[[Bench, Any, int], KnobResult]

    def parsed(self, text: str) -> list[Value]:
        """Return the values of an option, separated by commas, as numbers of the kind of the knob.

        Raises:
            UsageError: if a value is of another kind.
        """
        return [self._parsed(piece) for piece in text.split(",")]

    def _parsed(self, text: str) -> Value:
        kind = type(self.values[0])
        try:
            value = kind(text)
        except ValueError:
            value = kind(0)
        if not 0 < value < float("inf"):
            valid = "whole numbers" if kind is int else "numbers"
            raise UsageError(f"--values: {text} is no value of this knob; valid are {valid} above 0")
        return value


def decimation(bench: Bench, share: float, repeats: int) -> KnobResult:
    """Measure the surface lost by a share of the default planning faces: fewer candidates and samples."""

    def work() -> tuple[Viewpoints, cover.Cover]:
        planning = _planning(bench, share)
        candidates = generate_viewpoints(bench.scene, bench.settings, bench.part, planning)
        rng = np.random.default_rng([bench.scene.plan.seed, _FEATURES])
        count = bench.scene.plan.samples_per_face * len(planning.faces)
        features = draw_samples(bench.part.reference, planning, count, rng)
        M = fill_matrix(candidates, features, bench.scanner, bench.caster)
        rng = np.random.default_rng([bench.scene.plan.seed, _SELECTION])
        return candidates, cover.solve(cover.CoverProblem(M.matrix(), features.areas), rng=rng)

    (candidates, plan), seconds = best_of(work, repeats)
    visible = bench.visible_coverage(candidates.T_object_scanner[plan.views])
    error = 100 * (_most(bench) - visible)
    return KnobResult(error, seconds, {"views": len(plan.views), "candidates": len(candidates)})


def samples(bench: Bench, per_face: int, repeats: int) -> KnobResult:
    """Measure the error of the predicted coverage for a number of aimed samples per face."""
    planning, candidates = bench.planning, bench.candidates
    rng = np.random.default_rng([bench.scene.plan.seed, _FEATURES])
    features = draw_samples(bench.part.reference, planning, per_face * len(planning.faces), rng)
    M, seconds = best_of(lambda: fill_matrix(candidates, features, bench.scanner, bench.caster), repeats)
    found = claim(M, candidates, bench.samples, bench.scanner, bench.caster)
    return KnobResult(abs(found.error_points), seconds, {"views": found.views, "visible %": 100 * found.visible})


def scan(bench: Bench, step_deg: float, repeats: int) -> KnobResult:
    """Measure the rms deviation of the surface from the part [um] for an angle between the rays of a scan."""
    points: list[ScanCloud] = []

    def work() -> Reconstruction:
        points[:] = noisy(eight_scans(bench.part, step_deg), _NOISE)
        return reconstruct(merge(points))

    result, seconds = best_of(work, repeats)
    if result.mesh is None:
        raise PlannerError(f"{result.status.value}; scan more finely")
    off = measure_deviation(result.mesh, _nearest(bench), np.random.default_rng(0))
    found = np.concatenate([each.points for each in points])
    sampled = coverage.sampled_coverage(found, bench.samples, coverage.sampling_radius(bench.part.reference)).fraction
    more = {"grid mm": 1000 * result.grid, "faces": len(result.mesh.faces), "points": len(found)}
    return KnobResult(1e6 * off.rms, seconds, {**more, "sampled %": 100 * sampled})


def _planning(bench: Bench, share: float) -> TriangleMesh:
    return decimate(bench.part.reference, max(4, round(share * bench.settings.faces)))


@lru_cache(maxsize=2)
def _most(bench: Bench) -> float:
    """Return the share of the surface that the finest candidates measure together, on the held-out samples."""
    candidates = generate_viewpoints(bench.scene, bench.settings, bench.part, _planning(bench, FINEST))
    found = find_measured(candidates.T_object_scanner, bench.samples, bench.scanner, (bench.caster,))
    return float(bench.samples.areas[found].sum() / bench.samples.areas.sum())


@lru_cache(maxsize=2)
def _nearest(bench: Bench) -> ClosestPointQuery:
    return ClosestPointQuery(bench.part.reference)


KNOBS: Mapping[str, Knob] = {
    "decimation": Knob(
        "faces of the planning mesh", "x default", (0.125, 0.25, 0.5, 1.0, 2.0), 1.0,
        "coverage of all candidates of a mesh with four times the default faces",
        "difference of the plan [points]", "points", decimation,
    ),
    "samples": Knob(
        "surface samples per face", "", (1, 2, 4, 8, 16),
        PlanSettings.model_fields["samples_per_face"].default,
        "visible coverage on 100,000 held-out samples",
        "error of the coverage on the matrix [points]", "points", samples,
    ),
    "scan": Knob(
        "angle between the rays of a scan", "deg", (2.0, 1.0, 0.5, 0.25, 0.125),
        Scanner.model_fields["resolution_deg"].default[0],
        "the part; 30 um noise along the rays",
        "rms deviation of the reconstructed surface [um]", "um", scan,
    ),
}  # fmt: skip


def turn(settings: Mapping[str, Any]) -> dict[str, Any]:
    """Compute one value of one knob: the trial.

    Args:
        settings: scene and files (`cell.study.prepared_part`), knob, value, and repeats, the best of which counts.

    Returns:
        The error in the unit of the knob, and further columns; under "seconds" the time of the work.
    """
    found = KNOBS[settings["knob"]].turn(shared_bench(settings), settings["value"], settings["repeats"])
    return {"error": found.error, "more": dict(found.more), "seconds": dict(found.seconds)}
