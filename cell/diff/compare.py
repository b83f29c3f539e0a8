"""`cell diff`: two plans, or two executions, beside each other.

Views are matched in the part's own frame: a view is kept where the other run has one at the same pose, and moved where
the other has one that measures mostly the same surface; the pairs are those that share most in all (the assignment
problem). What is measured is asked of one set of samples for both runs, the held-out ones of the first. Object frame,
metres, radians.
"""

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from pydantic import JsonValue
from scipy.optimize import linear_sum_assignment

from cell.diff.difference import Difference, MovedView, Number, Setting, Surface, Views
from cell.diff.page import page
from cell.diff.side import Side, read_side
from cell.errors import UsageError
from cell.runs.cell import RunCell, read_cell
from cell.session import ProgressReporter
from cell.view.looking import write
from cell.world.prediction import held_out
from planner.geometry.sampling import SurfaceSamples
from planner.measurability import coverage
from planner.measurability.visibility import find_measured
from planner.values import Bools, Floats

SAME_MM, SAME_DEG = 0.01, 0.01
"""Poses within these are the same one: what the rounding of joint angles leaves."""
MOSTLY = 0.5
"""Views whose areas overlap by this share of their union do the same work."""

_NO_MATCH = 1e6  # cost of a pair that is none; any number above the number of views


def compare(a: Path, b: Path, reporter: ProgressReporter, out: Path | None = None) -> Difference:
    """What differs between two runs.

    Args:
        a: run folder, or folder of an execution (RUN/executions/0001).
        b: the same.
        reporter: is told what goes on.
        out: file for a page that shows it; None writes none.

    Raises:
        UsageError: if one is a plan and the other an execution, or a page is wanted of parts that are not the same.
        FileError: if an artefact is missing, changed or damaged.
    """
    with reporter.stage("read"):
        A, B = read_side(a), read_side(b)
        if (A.execution is None) != (B.execution is None):
            plan, execution = (a, b) if A.execution is None else (b, a)
            raise UsageError(
                f"{plan} is a plan and {execution} an execution; give two plans or two executions (what an execution "
                "missed of its own plan stands in its report.md)"
            )
        cells = read_cell(A.run), read_cell(B.run)
        parts = {side.run.manifest.artefacts.get("reference.ply") for side in (A, B)}
    same_part = len(parts) == 1
    if out is not None and not same_part:
        raise UsageError(f"--out {out}: the parts of {a} and {b} are not the same mesh, on which gains could be drawn")
    with reporter.stage("what each view measures"):
        samples = held_out(cells[0].reference, cells[0].planning, A.run.seed)
        by_view = [_measured(side, cell, samples) for side, cell in zip((A, B), cells, strict=True)]
        views = _views(A, B, by_view if same_part else None, samples.areas)
        covered = [*map(_covered_by(cells, samples), (A, B), by_view)]
    found = Difference(
        a=str(a), b=str(b), kind="plan" if A.execution is None else "execution", settings=tuple(_settings(A, B)),
        views=views, surface=_surface(samples, *covered) if same_part else None, numbers=tuple(_numbers(A, B)),
    )  # fmt: skip
    if out is not None:
        with reporter.stage("draw the page"):
            write(page(found, (A, B), cells[0].reference, samples, *covered), out)
    return found


def _measured(side: Side, cell: RunCell, samples: SurfaceSamples) -> Bools:
    """(S, n) which samples each view measures in its own cell."""
    return find_measured(side.poses, samples, cell.scanner, (cell.part_caster, cell.occluder_caster), each=True)


def _covered_by(cells: Sequence[RunCell], samples: SurfaceSamples) -> Callable[[Side, Bools], Bools]:
    """What a run measures: of a plan by its views' lines of sight, of an execution by its points."""
    radius = coverage.sampling_radius(cells[0].reference)

    def covered(side: Side, by_view: Bools) -> Bools:
        if side.execution is None:
            return np.asarray(by_view.any(axis=1))
        return coverage.sampled_coverage(side.execution.points, samples, radius).covered

    return covered


def _surface(samples: SurfaceSamples, a: Bools, b: Bools) -> Surface:
    def area(of: Bools) -> float:
        return round(float(samples.areas[of].sum()) * 1e6, 3)

    everything = np.ones(len(samples), dtype=np.bool_)
    return Surface(
        samples=len(samples), area_mm2=area(everything), a_mm2=area(a), b_mm2=area(b), gained_mm2=area(b & ~a),
        lost_mm2=area(a & ~b),
    )  # fmt: skip


def _views(A: Side, B: Side, by_view: Sequence[Bools] | None, areas: Floats) -> Views:
    """Views that are kept, moved, lost and new; none is moved where the parts differ, whose views are not asked."""
    distance, angle = _apart(A.poses, B.poses)
    near = (distance <= SAME_MM) & (angle <= SAME_DEG)
    kept = _pairs(np.where(near, distance / SAME_MM, _NO_MATCH))
    moved: list[tuple[int, int]] = []
    shared = np.zeros_like(distance)
    if by_view is not None:
        a, b = (each.astype(np.float64) for each in by_view)
        both = a.T @ (areas[:, None] * b)
        either = (areas @ a)[:, None] + (areas @ b)[None] - both
        shared = np.divide(both, either, out=shared, where=either > 0)
        cost = np.where(shared >= MOSTLY, 1 - shared, _NO_MATCH)
        cost[[i for i, _ in kept], :] = _NO_MATCH
        cost[:, [j for _, j in kept]] = _NO_MATCH
        moved = _pairs(cost)
    gone = [i for i in range(len(A.number)) if i not in {i for i, _ in (*kept, *moved)}]
    added = [j for j in range(len(B.number)) if j not in {j for _, j in (*kept, *moved)}]
    return Views(
        kept=tuple((int(A.number[i]), int(B.number[j])) for i, j in kept),
        moved=tuple(
            MovedView(
                a=int(A.number[i]), b=int(B.number[j]), distance_mm=round(float(distance[i, j]), 3),
                angle_deg=round(float(angle[i, j]), 3), shared=round(float(shared[i, j]), 4),
            )
            for i, j in moved
        ),
        lost=tuple(int(A.number[i]) for i in gone),
        new=tuple(int(B.number[j]) for j in added),
    )  # fmt: skip


def _apart(a: Floats, b: Floats) -> tuple[Floats, Floats]:
    """(n, m) distances [mm] and angles [deg] between the middle poses of views."""
    a, b = a[:, a.shape[1] // 2], b[:, b.shape[1] // 2]
    distance = 1000 * np.linalg.norm(a[:, None, :3, 3] - b[None, :, :3, 3], axis=-1)
    # Of the Frobenius norm of the difference, which keeps its digits where the angle is small: |Ra - Rb|^2 = 8 sin^2.
    chord = np.linalg.norm(a[:, None, :3, :3] - b[None, :, :3, :3], axis=(-2, -1))
    angle: Floats = np.degrees(2 * np.arcsin(np.clip(chord / np.sqrt(8.0), 0.0, 1.0)))
    return distance, angle


def _pairs(cost: Floats) -> list[tuple[int, int]]:
    """The pairs of least cost in all, as many as there can be; each row and column in one at most."""
    rows, columns = linear_sum_assignment(cost)
    return [(int(i), int(j)) for i, j in zip(rows, columns, strict=True) if cost[i, j] < _NO_MATCH]


def _settings(A: Side, B: Side) -> list[Setting]:
    """Keys of the resolved scenes, and of the executions' settings, that differ."""
    of_a, of_b = (dict(_flat("", side.run.scene.as_json())) for side in (A, B))
    if A.execution is not None and B.execution is not None:
        of_a |= dict(_flat("scan.", A.execution.report.settings.as_json()))
        of_b |= dict(_flat("scan.", B.execution.report.settings.as_json()))
    keys = [key for key in dict.fromkeys((*of_a, *of_b)) if of_a.get(key) != of_b.get(key)]
    return [Setting(key=key, a=of_a.get(key), b=of_b.get(key)) for key in keys]


def _flat(prefix: str, table: dict[str, JsonValue]) -> list[tuple[str, JsonValue]]:
    """Keys of nested tables, joined by points; entries of a list of tables by their names."""
    found: list[tuple[str, JsonValue]] = []
    for key, value in table.items():
        if isinstance(value, list) and value and all(isinstance(each, dict) and "name" in each for each in value):
            value = {str(each["name"]): each for each in value if isinstance(each, dict)}
        found += _flat(f"{prefix}{key}.", value) if isinstance(value, dict) else [(prefix + key, value)]
    return found


def _numbers(A: Side, B: Side) -> list[Number]:
    """Figures of the reports that differ."""
    of_a, of_b = _figures(A), _figures(B)
    names = dict.fromkeys([*of_a, *of_b])
    return [Number(name=name, a=of_a.get(name), b=of_b.get(name)) for name in names if of_a.get(name) != of_b.get(name)]


def _figures(side: Side) -> dict[str, float | None]:
    if side.execution is None:
        report = side.run.report
        return {
            "views": report.n_views,
            "views at least": report.lower_bound,
            "visible %": 100 * report.coverage.visible,
            "coverable %": 100 * report.coverage.coverable,
            "motion s": report.motion.duration_s,
            "smallest clearance mm": report.motion.minimum_clearance_mm,
            **{f"region {each.name} visible %": 100 * each.visible for each in report.regions or ()},
        }
    done = side.execution.report
    return {
        "scans": done.n_views,
        "points": done.n_points,
        "visible %": 100 * done.coverage.visible,
        "sampled %": 100 * done.coverage.sampled,
        "deviation rms mm": None if done.deviation is None else done.deviation.rms_mm,
        "motion s": done.motion.executed_s,
    }
