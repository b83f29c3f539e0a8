"""Compare two plans or two executions, and write a page of the difference.

Views are matched in the object frame. A view is kept if the other run has one at the same pose, and moved if the other
run has one that measures mostly the same surface; pairs maximise the shared area in total (assignment problem).
Coverage of both runs is evaluated on the held-out samples of the first. Object frame, metres, radians.
"""

import shlex
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated

import numpy as np
from pydantic import Field, JsonValue
from scipy.optimize import linear_sum_assignment

from cell.errors import FileError, UsageError
from cell.runs.cell import RunCell, read_cell
from cell.runs.run import Execution, Run, execution_of, open_finished, read_execution, reading
from cell.runs.schema import JsonTable, optional
from cell.session import ProgressReporter
from cell.view.page import PageContents, PageScene, PageSurface, PageView, render_page
from cell.view.palette import BLUE, GREEN, GREY, MEASURED, VERMILION
from cell.view.pieces import CellGeometry, cell_of_run, with_ignored_faces
from cell.view.run_pages import execution_contents, named_layer, run_contents
from cell.view.surface import canvas_of, viewing_directions
from cell.view.view_command import write_page
from cell.world.prediction import held_out_samples
from planner.geometry.mesh import TriangleMesh
from planner.geometry.sampling import SurfaceSamples
from planner.measurability import coverage
from planner.measurability.visibility import find_measured
from planner.values import Bools, Floats, Ints, Value

SAME_MM, SAME_DEG = 0.01, 0.01
"""Tolerance for equal poses: the effect of rounded joint angles."""
MOSTLY = 0.5
"""Smallest shared area, relative to the union, of a moved view and its match."""

_NO_MATCH = 1e6  # cost of a forbidden pair; above the number of views


def format_value(value: object) -> str:
    """Return a value as text; a matrix only by a note."""
    match value:
        case None:
            return "-"
        case float():
            return f"{value:.6g}"
        case [[*_], *_]:
            return "(transform)"
        case list():
            return ", ".join(format_value(each) for each in value)
        case _:
            return str(value)


class SettingDifference(JsonTable):
    """A key with different values in two runs; null if it is missing in one."""

    key: str = Field(description="key of scene.resolved.json, or of the settings of an execution's report.json")
    a: JsonValue
    b: JsonValue


class SimilarView(JsonTable):
    """A view of B that measures most of the surface of a view of A from another pose."""

    a: int = Field(description="number in A's visiting order, from 1")
    b: int = Field(description="number in B's visiting order, from 1")
    distance_mm: float = Field(description="distance of the scanner positions, object frame")
    angle_deg: float = Field(description="angle between the orientations")
    intersection_over_union: float = Field(description="area measured by both / area measured by either")


class ViewDifference(JsonTable):
    """Views by their numbers in visiting order, from 1."""

    equal: tuple[tuple[int, int], ...] = Field(description="views at the same pose: (number in A, number in B)")
    similar: tuple[SimilarView, ...] = Field(description="views that measure mostly the same surface")
    only_a: tuple[int, ...] = Field(description="views only in A")
    only_b: tuple[int, ...] = Field(description="views only in B")


class SurfaceDifference(JsonTable):
    """Area measured by A and B on the same samples: visible for plans, sampled for executions."""

    samples: int = Field(description="number of held-out samples of A")
    area_mm2: float = Field(description="area of the surface")
    a_mm2: float = Field(description="measured by A")
    b_mm2: float = Field(description="measured by B")
    only_b_mm2: float = Field(description="measured by B only")
    only_a_mm2: float = Field(description="measured by A only")


class FigureDifference(JsonTable):
    """A figure of both reports; null if it is missing in one."""

    name: str = Field(description="name with unit")
    a: float | None
    b: float | None


class Difference(JsonTable):
    """The object that `cell diff --json` prints."""

    a: str = Field(description="its folder")
    b: str = Field(description="its folder")
    kind: str = Field(description="kind of both: 'plan' or 'execution'")
    settings: tuple[SettingDifference, ...] = Field(description="differences")
    views: ViewDifference
    surface: SurfaceDifference | None = optional("absent if the parts are different meshes")
    numbers: tuple[FigureDifference, ...] = Field(description="differences")

    @property
    def is_empty(self) -> bool:
        """Whether nothing differs."""
        views, surface = self.views, self.surface
        other = bool(self.settings or self.numbers or views.similar or views.only_a or views.only_b)
        renumbered = any(a != b for a, b in views.equal)
        same_surface = surface is not None and surface.only_b_mm2 == surface.only_a_mm2 == 0.0
        return same_surface and not other and not renumbered


@dataclass(frozen=True, slots=True, eq=False)
class Side(Value):
    """One of the two compared runs.

    Attributes:
        folder: folder of the plan or of the execution.
        run: the plan, or the plan of the execution.
        execution: None for a plan.
        number: (n,) numbers of the views, from 1 in visiting order.
        poses: (n, K, 4, 4) T_object_scanner.
    """

    folder: Path
    run: Run
    execution: Execution | None
    number: Annotated[Ints, "n"]
    poses: Annotated[Floats, "n _ 4 4"]


def read_side(folder: Path) -> Side:
    """Read the folder of a plan or of an execution."""
    if (execution := execution_of(folder)) is None:
        run = open_finished(folder)
        poses = np.stack([view.T_object_poses for view in run.plan.views])
        return Side(folder, run, None, np.arange(1, len(poses) + 1), poses)
    run = open_finished(execution[0])
    recorded = read_execution(run, execution[1])
    if not recorded.scans:
        raise FileError(f"{folder} has no readable scan; give another execution")
    number = np.array([scan.stop for scan in recorded.scans])
    with reading(folder / "scans"):
        poses = np.stack([scan.T_reported_poses for scan in recorded.scans])
    order = np.argsort(number)
    return Side(recorded.folder, run, Execution.open(recorded.folder), number[order], poses[order])


def compare_runs(a: Path, b: Path, reporter: ProgressReporter, out: Path | None = None) -> Difference:
    """Compare two run folders, or two folders of executions (RUN/executions/0001).

    Args:
        a: the first folder.
        b: the second folder, of the same kind.
        reporter: receives the progress.
        out: page to write; None writes none.
    """
    with reporter.stage("read"):
        A, B = read_side(a), read_side(b)
        if (A.execution is None) != (B.execution is None):
            plan, execution = (a, b) if A.execution is None else (b, a)
            raise UsageError(
                f"{plan} is a plan and {execution} an execution; give two plans or two executions (the report.md of an "
                "execution compares it with its plan)"
            )
        cells = read_cell(A.run), read_cell(B.run)
        parts = {side.run.manifest.artefacts.get("reference.ply") for side in (A, B)}
    same_part = len(parts) == 1
    if out is not None and not same_part:
        raise UsageError(
            f"--out {out}: the parts of {a} and {b} are different meshes, so gained and lost surface cannot be drawn"
        )
    with reporter.stage("coverage of each view"):
        samples = held_out_samples(cells[0].reference, cells[0].planning, A.run.seed)
        by_view = [_measured(side, cell, samples) for side, cell in zip((A, B), cells, strict=True)]
        views = _views(A, B, by_view if same_part else None, samples.areas)
        radius = coverage.sampling_radius(cells[0].reference)
        covered = [_covered(side, measured, samples, radius) for side, measured in zip((A, B), by_view, strict=True)]
    difference = Difference(
        a=str(a), b=str(b), kind="plan" if A.execution is None else "execution", settings=tuple(_settings(A, B)),
        views=views, surface=_surface(samples, *covered) if same_part else None, numbers=tuple(_numbers(A, B)),
    )  # fmt: skip
    if out is not None:
        with reporter.stage("draw the page"):
            write_page(difference_page(difference, (A, B), cells[0].reference, samples, *covered), out)
    return difference


def _measured(side: Side, cell: RunCell, samples: SurfaceSamples) -> Bools:
    """Return (S, n) the samples measured by each view in its own cell."""
    return find_measured(side.poses, samples, cell.scanner, cell.casters, each=True)


def _covered(side: Side, by_view: Bools, samples: SurfaceSamples, radius: float) -> Bools:
    """Return (S,) the covered samples of a side: by lines of sight of a plan, by points of an execution.

    Args:
        side: of the comparison.
        by_view: (S, n) samples measured by each view.
        samples: of the part.
        radius: largest distance of a sample from a point [m].
    """
    if side.execution is None:
        return np.asarray(by_view.any(axis=1))
    return coverage.sampled_coverage(side.execution.points, samples, radius).covered


def _surface(samples: SurfaceSamples, a: Bools, b: Bools) -> SurfaceDifference:
    def area(of: Bools) -> float:
        return round(float(samples.areas[of].sum()) * 1e6, 3)

    everything = np.ones(len(samples), dtype=np.bool_)
    return SurfaceDifference(
        samples=len(samples), area_mm2=area(everything), a_mm2=area(a), b_mm2=area(b), only_b_mm2=area(b & ~a),
        only_a_mm2=area(a & ~b),
    )  # fmt: skip


def _views(A: Side, B: Side, by_view: Sequence[Bools] | None, areas: Floats) -> ViewDifference:
    """Return kept, moved, lost and new views; without `by_view` (different parts) none counts as moved."""
    distance, angle = _pose_distances(A.poses, B.poses)
    near = (distance <= SAME_MM) & (angle <= SAME_DEG)
    equal = _pairs(np.where(near, distance / SAME_MM, _NO_MATCH))
    similar: list[tuple[int, int]] = []
    shared = np.zeros_like(distance)
    if by_view is not None:
        a, b = (each.astype(np.float64) for each in by_view)
        both = a.T @ (areas[:, None] * b)
        either = (areas @ a)[:, None] + (areas @ b)[None] - both
        shared = np.divide(both, either, out=shared, where=either > 0)
        cost = np.where(shared >= MOSTLY, 1 - shared, _NO_MATCH)
        cost[[i for i, _ in equal], :] = _NO_MATCH
        cost[:, [j for _, j in equal]] = _NO_MATCH
        similar = _pairs(cost)
    only_a = [i for i in range(len(A.number)) if i not in {i for i, _ in (*equal, *similar)}]
    only_b = [j for j in range(len(B.number)) if j not in {j for _, j in (*equal, *similar)}]
    return ViewDifference(
        equal=tuple((int(A.number[i]), int(B.number[j])) for i, j in equal),
        similar=tuple(
            SimilarView(
                a=int(A.number[i]), b=int(B.number[j]), distance_mm=round(float(distance[i, j]), 3),
                angle_deg=round(float(angle[i, j]), 3), intersection_over_union=round(float(shared[i, j]), 4),
            )
            for i, j in similar
        ),
        only_a=tuple(int(A.number[i]) for i in only_a),
        only_b=tuple(int(B.number[j]) for j in only_b),
    )  # fmt: skip


def _pose_distances(a: Floats, b: Floats) -> tuple[Floats, Floats]:
    """Return (n, m) distances [mm] and angles [deg] between the middle poses of views."""
    a, b = a[:, a.shape[1] // 2], b[:, b.shape[1] // 2]
    distance = 1000 * np.linalg.norm(a[:, None, :3, 3] - b[None, :, :3, 3], axis=-1)
    # From the Frobenius norm of the difference, which is accurate for small angles: |Ra - Rb|^2 = 8 sin^2(angle / 2).
    chord = np.linalg.norm(a[:, None, :3, :3] - b[None, :, :3, :3], axis=(-2, -1))
    angle: Floats = np.degrees(2 * np.arcsin(np.clip(chord / np.sqrt(8.0), 0.0, 1.0)))
    return distance, angle


def _pairs(cost: Floats) -> list[tuple[int, int]]:
    """Return the assignment of least total cost, without forbidden pairs."""
    rows, columns = linear_sum_assignment(cost)
    return [(int(i), int(j)) for i, j in zip(rows, columns, strict=True) if cost[i, j] < _NO_MATCH]


def _settings(A: Side, B: Side) -> list[SettingDifference]:
    """Return the keys of the resolved scenes, and of the executions' settings, that differ."""
    of_a, of_b = (dict(_flat("", side.run.scene.as_json())) for side in (A, B))
    if A.execution is not None and B.execution is not None:
        of_a |= dict(_flat("scan.", A.execution.report.settings.as_json()))
        of_b |= dict(_flat("scan.", B.execution.report.settings.as_json()))
    keys = [key for key in dict.fromkeys((*of_a, *of_b)) if of_a.get(key) != of_b.get(key)]
    return [SettingDifference(key=key, a=of_a.get(key), b=of_b.get(key)) for key in keys]


def _flat(prefix: str, table: dict[str, JsonValue]) -> list[tuple[str, JsonValue]]:
    """Return the entries of nested tables with dotted keys; entries of a list of tables by their names."""
    entries: list[tuple[str, JsonValue]] = []
    for key, value in table.items():
        if isinstance(value, list) and value and all(isinstance(each, dict) and "name" in each for each in value):
            value = {str(each["name"]): each for each in value if isinstance(each, dict)}
        entries += _flat(f"{prefix}{key}.", value) if isinstance(value, dict) else [(prefix + key, value)]
    return entries


def _numbers(A: Side, B: Side) -> list[FigureDifference]:
    """Return the figures of the reports that differ."""
    of_a, of_b = _figures(A), _figures(B)
    names = dict.fromkeys([*of_a, *of_b])
    return [
        FigureDifference(name=name, a=of_a.get(name), b=of_b.get(name))
        for name in names
        if of_a.get(name) != of_b.get(name)
    ]


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
    execution = side.execution.report
    return {
        "scans": execution.n_views,
        "points": execution.n_points,
        "visible %": 100 * execution.coverage.visible,
        "sampled %": 100 * execution.coverage.sampled,
        "deviation rms mm": None if execution.deviation is None else execution.deviation.rms_mm,
        "motion s": execution.motion.executed_s,
    }


_NAMES = (("measured by both", MEASURED), ("by neither", GREY), ("lost: by A only", VERMILION),
          ("gained: by B only", BLUE))  # fmt: skip


def difference_page(
    difference: Difference, sides_of: tuple[Side, Side], part: TriangleMesh, samples: SurfaceSamples, a: Bools, b: Bools
) -> str:
    """Return the page: the part coloured by gained and lost surface in B's cell, with B's motion.

    B's views show the matching view of A. Views of A alone keep their pose relative to the part.

    Args:
        difference: the comparison.
        sides_of: A and B.
        part: reference mesh, object frame [m].
        samples: samples of the part.
        a: (S,) samples measured by A.
        b: (S,) samples measured by B.
    """
    A, B = sides_of
    scene = B.run.scene
    cell, canvas = cell_of_run(B.run, scene), canvas_of(part, samples)
    which = np.where(a, np.where(b, 0, 2), np.where(b, 3, 1))
    layer = named_layer("Gained and lost", which, _NAMES, canvas)
    page_scene = PageScene(
        f"{scene.part.name}: {difference.b} (B) against {difference.a} (A)",
        with_ignored_faces(cell, canvas.mesh, canvas.ignored),
        [PageSurface("part", canvas.counted_mesh, [layer])],
        viewing_directions(canvas, a != b, 1)[0],
    )
    if B.execution is None:
        contents = run_contents(B.run)
    else:
        recorded = read_execution(B.run, B.folder.name)
        contents = execution_contents(B.run, recorded, B.execution, cell)
    views = [*_matched_views(contents.views, difference), *_lost_views(A, difference, cell)]
    figures = [(each.name, f"{format_value(each.a)} → {format_value(each.b)}") for each in difference.numbers]
    settings = [(each.key, f"{format_value(each.a)} → {format_value(each.b)}") for each in difference.settings]
    contents = replace(contents, views=views, rows=[*figures, *settings], folder_depth=None)
    return render_page(page_scene, _with_folder(contents, B))


def _matched_views(views: Sequence[PageView], difference: Difference) -> list[PageView]:
    """Return B's views, each with its matching view of A."""
    equal = {str(b): (f"view {a}, same pose", MEASURED) for a, b in difference.views.equal}
    similar = {
        str(each.b): (f"view {each.a}, moved by {each.distance_mm:.1f} mm and {each.angle_deg:.1f} deg", GREEN)
        for each in difference.views.similar
    }
    matches = {**equal, **similar}
    matched = []
    for view in views:
        match, colour = matches.get(view.number, ("new", BLUE))
        matched.append(replace(view, rows=[*view.rows, ("in A", match)], colour=GREY if colour == MEASURED else colour))
    return matched


def _lost_views(A: Side, difference: Difference, cell: CellGeometry) -> list[PageView]:
    """Return the views of A alone, relative to the part in B's cell."""
    middle = {int(n): poses[len(poses) // 2] for n, poses in zip(A.number, A.poses, strict=True)}
    return [
        PageView(f"A{n}", cell.T_base_object @ middle[n], None, [("view", f"{n} of A, not in B")], colour=VERMILION)
        for n in difference.views.only_a
    ]


def _with_folder(contents: PageContents, B: Side) -> PageContents:
    """Return the page with commands that name the run folder, since the page is outside of it."""
    folder = shlex.quote(str(B.run.folder))

    def with_folder(commands: Sequence[str]) -> list[str]:
        return [each.replace("EXECUTION", B.folder.name).replace("RUN", folder) for each in commands]

    views = [replace(view, commands=with_folder(view.commands)) for view in contents.views]
    return replace(contents, views=views, next_commands=with_folder(contents.next_commands))
