"""Registration: small corrections of the reported poses, from the scans' overlap and the reference model, jointly.

Gauss-Newton on six unknowns a scan (translation and rotation about its middle). A point near the model pulls along the
model's normal (Chen and Medioni, Image Vision Comput. 10(3), 1992, doi:10.1016/0262-8856(92)90066-C), a point near
another scan along that scan's normal and moves both. Weights are Tukey's with the scale taken from the median, so that
outliers and surface that the model lacks do not count. What the measurements cannot see (a plane slides, a sphere
turns) is said and not
corrected: the step is restricted to the directions that each scan sees. Object frame, metres, radians.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum
from typing import Annotated

import numpy as np

from cell.reconstruction.cloud import PointCloud, ScanCloud
from cell.reconstruction.freedom import FreeMotion, name, shape_of, split
from cell.reconstruction.matching import FEWEST, JointProblem, Matches, MovingScan
from planner.errors import PlannerError
from planner.geometry.closest import ClosestPointQuery
from planner.geometry.mesh import TriangleMesh
from planner.values import Floats, Value

SAMPLES = 2000
"""Points of a scan that are matched: a correction of six unknowns needs no more."""

TOLERANCE = 2e-6
"""Finished when no point of any scan moves by more than this in a step [m]; a tenth of a good scanner's noise."""

_STILL = 10 * TOLERANCE  # a scan whose matches change to and fro moves within the noise, and has converged [m]
_ITERATIONS = 40
_REACH = 0.03  # of the diagonal: matches farther apart are no matches


class RegistrationStatus(Enum):
    """How it went for one scan; the value is a sentence."""

    CONVERGED = "registered in all six directions"
    PARTLY_FREE = "registered, except for motions that its surface does not show: those were not corrected"
    NOT_CONVERGED = "still moving after the last iteration: the reported pose was kept"
    TOO_FAR = "the correction went farther than matches reach: the reported pose was kept"
    REJECTED = "the correction made the match worse: the reported pose was kept"
    NO_OVERLAP = "too little of it lies near the model or another scan: the reported pose was kept"
    TOO_FEW_POINTS = f"fewer than {FEWEST} points: the reported pose was kept"
    EMPTY = "the scan is empty"


_MOVED = (RegistrationStatus.CONVERGED, RegistrationStatus.PARTLY_FREE)


@dataclass(frozen=True, slots=True, eq=False)
class ScanRegistration(Value):
    """The correction of one scan.

    Attributes:
        status: how it went.
        T_correction: (4, 4) to be applied to the scan's points in the object frame; the identity where nothing was
            done.
        rms_before: root mean square distance along the normals of the points that take part [m], at the reported pose;
            NaN when none does.
        rms_after: the same points after the correction [m].
        used: share of the matched points that take part in these numbers; the rest are outliers or lie on nothing.
        rank: how many of the six directions the measurements see.
        free: the other directions, by name.
    """

    status: RegistrationStatus
    T_correction: Annotated[Floats, "4 4"]
    rms_before: float
    rms_after: float
    used: float
    rank: int
    free: tuple[FreeMotion, ...]

    @property
    def is_corrected(self) -> bool:
        """Whether the pose was corrected; otherwise it is the reported one."""
        return self.status in _MOVED

    @property
    def sentence(self) -> str:
        """What a report says about this scan."""
        if not self.free:
            return self.status.value
        shape = shape_of(self.free)
        motions = "; ".join(motion.sentence for motion in self.free)
        return f"{self.status.value} ({shape + ': ' if shape else ''}{motions})"


@dataclass(frozen=True, slots=True, eq=False)
class Registration:
    """The corrections of all scans.

    Attributes:
        scans: one result per scan, in the order given.
        rms_before: over all points that take part [m]; NaN when none does.
        rms_after: the same after the corrections [m].
        iterations: steps taken.
        overlaps: pairs of scans that were matched to each other.
    """

    scans: tuple[ScanRegistration, ...]
    rms_before: float
    rms_after: float
    iterations: int
    overlaps: tuple[tuple[int, int], ...]


def register(
    scans: Sequence[ScanCloud | PointCloud],
    model: TriangleMesh | ClosestPointQuery | None,
    *,
    reach: float | None = None,
    samples: int = SAMPLES,
    iterations: int = _ITERATIONS,
) -> Registration:
    """Correct the poses of scans.

    Args:
        scans: clouds in the object frame by their reported poses; merged scans move as one body.
        model: the reference, object frame; None matches the scans to each other only: the mean of their motions is then
            kept zero, because nothing says where they are all together.
        reach: farthest match [m]; None takes 3 % of the diagonal of model or scans. Larger pose errors need more.
        samples: points a scan to match, > 0.
        iterations: most steps, > 0.

    Raises:
        PlannerError: if an argument is not positive.
    """
    if samples < 1 or iterations < 1 or (reach is not None and not reach > 0):
        raise PlannerError(f"samples {samples}, iterations {iterations} and reach {reach} must be positive")
    nearest = ClosestPointQuery(model) if isinstance(model, TriangleMesh) else model
    clouds = [scan.points for scan in scans if len(scan)]
    extent = nearest.mesh.vertices if nearest else np.concatenate(clouds) if clouds else np.zeros((1, 3))
    diagonal = float(np.linalg.norm(np.ptp(extent, axis=0)))
    moving = [MovingScan(scan, samples) for scan in scans]
    reach = _REACH * diagonal if reach is None else reach
    problem = JointProblem(moving, nearest, reach, overlap=True)
    before = problem.match()
    steps, moved = 0, np.full(len(moving), np.inf)
    while steps < iterations and moved.max(initial=0.0) >= TOLERANCE:
        moved = problem.step()
        steps += 1
    after = problem.match()
    matrix, _, weight, used = problem.information(after)
    results, squares = [], []
    for i, scan in enumerate(moving):
        own = slice(6 * i, 6 * i + 6)
        _, free = split(matrix[own, own], weight[i] if used[i] >= FEWEST else 0.0, scan.length)
        pair = _residuals(i, before, after, nearest is not None)
        result = _judge(scan, pair, free, used[i] >= FEWEST, bool(moved[i] < _STILL), reach)
        results.append(result)
        squares.append(np.stack(pair[:2] if result.is_corrected else (pair[0], pair[0])) ** 2)
    pooled = np.concatenate(squares, axis=1) if squares else np.empty((2, 0))
    rms_before, rms_after = np.sqrt(pooled.mean(axis=1)) if pooled.shape[1] else (float("nan"), float("nan"))
    overlaps = tuple(sorted({(min(pair), max(pair)) for pair in problem.pairs}))
    return Registration(tuple(results), float(rms_before), float(rms_after), steps, overlaps)


def _residuals(
    i: int, before: Sequence[Matches], after: Sequence[Matches], has_model: bool
) -> tuple[Floats, Floats, float]:
    """Residuals of scan i [m] before and after, of the matches that count in the end, and which share these are.

    They are against the model where there is one, else against the other scans.
    """
    chosen = [(a, b) for a, b in zip(before, after, strict=True) if b.scan == i and (b.partner < 0) == has_model]
    if not chosen:
        return np.empty(0), np.empty(0), 0.0
    counts = np.concatenate([b.weight > 0 for _, b in chosen])
    first = np.concatenate([a.residual for a, _ in chosen])[counts]
    last = np.concatenate([b.residual for _, b in chosen])[counts]
    return first, last, float(counts.mean())


def _judge(
    scan: MovingScan,
    residuals: tuple[Floats, Floats, float],
    free: Floats,
    is_matched: bool,
    is_still: bool,
    reach: float,
) -> ScanRegistration:
    """The result of one scan.

    Small residuals alone prove nothing: a scan that slid along the part fits as well. A correction that moves a point
    farther than `reach` [m] left what it was matched to at first.
    """
    first, last, used = residuals
    rms_before, rms_after = (float(np.sqrt(np.mean(r**2))) if len(r) else float("nan") for r in (first, last))
    if len(scan) == 0:
        status = RegistrationStatus.EMPTY
    elif len(scan) < FEWEST:
        status = RegistrationStatus.TOO_FEW_POINTS
    elif not is_matched:
        status = RegistrationStatus.NO_OVERLAP
    elif rms_after > rms_before + TOLERANCE:
        status = RegistrationStatus.REJECTED
    elif not is_still:
        status = RegistrationStatus.NOT_CONVERGED
    elif _farthest_move(scan) > reach:
        status = RegistrationStatus.TOO_FAR
    else:
        status = RegistrationStatus.PARTLY_FREE if free.shape[1] else RegistrationStatus.CONVERGED
    T = scan.T if status in _MOVED else np.eye(4)
    rms_after = rms_after if status in _MOVED else rms_before
    motions = name(free, scan.centre, scan.length) if is_matched else ()
    return ScanRegistration(status, T, rms_before, rms_after, used, 6 - free.shape[1], motions)


def _farthest_move(scan: MovingScan) -> float:
    """How far the correction moves the sampled point that it moves farthest [m]."""
    back = (scan.points - scan.T[:3, 3]) @ scan.T[:3, :3]
    return float(np.linalg.norm(scan.points - back, axis=1).max(initial=0.0))
