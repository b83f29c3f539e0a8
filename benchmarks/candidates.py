"""Generators of candidates in the cell, on every part: grown, optimal scanning zone and view sphere.

For each part with its default settings at the place of the README (SCAN_CELL_PLACE sets another): seconds for reach,
matrix and selection (no cache, best of two runs that alternate between the generators), views of the plan at full
coverage, coverable and planned coverage on 10^5 samples outside the matrix, and the views that the generator's plan
needs for the area of the optimal scanning zone's plan.

The meshes of `$SCAN_CELL_MESHES` are treated like the built-in parts (see benchmarks/parts.py).
"""

import os
import tempfile
from collections.abc import Iterator
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np
import trimesh

from benchmarks.parts import meshes
from cell.part import workpiece
from cell.part.builtin import NAMES
from cell.plan import candidates as generators
from cell.robot.arm import kinematics_of
from cell.scanners.laser_area import LaserArea
from cell.scene.file import load_scene
from cell.scene.settle import settle
from cell.world.collision import MujocoCollisionChecker
from cell.world.embree import EmbreeRayCaster
from cell.world.measurability import surface_samples
from cell.world.model import compile_world
from cell.world.occluders import fixed_occluders
from planner import cover
from planner.cover import Cover
from planner.geometry.decimation import decimate
from planner.geometry.sampling import draw_samples
from planner.kinematics import reach
from planner.kinematics.reach import Reach, join_reach
from planner.measurability import coverage
from planner.measurability.matrix import Measurability
from planner.measurability.visibility import apply_occluders, fill_matrix, find_measured
from planner.viewpoints import growth
from planner.viewpoints.growth import ViewEvaluator
from planner.viewpoints.viewpoints import Viewpoints

GENERATORS = ("optimal-scanning-zone", "view-sphere", "grown")
_RUNS = 2
_COLOURS = {"optimal-scanning-zone": "#2a6f97", "view-sphere": "#7a9e3a", "grown": "#c4622d"}


def run() -> list[dict[str, Any]]:
    """Return three rows per part."""
    rows: list[dict[str, Any]] = []
    with tempfile.TemporaryDirectory() as scratch:
        for name, options in parts(Path(scratch)):
            rows += _part(name, options)
    return rows


def chart(rows: list[dict[str, Any]], folder: Path) -> None:
    """Draw `candidates.png`: one panel per part, visible coverage over the number of views, for each generator."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    part_names = list(dict.fromkeys(row["part"] for row in rows))
    across = 4 if len(part_names) > 6 else 3
    down = -(-len(part_names) // across)
    figure = Figure(figsize=(3.4 * across, 2.6 * down + 0.8), dpi=110, layout="constrained")
    panels = figure.subplots(down, across, squeeze=False).flat
    for axis, part in zip(panels, part_names, strict=False):
        for row in (row for row in rows if row["part"] == part):
            colour = _COLOURS[row["candidates"]]
            curve = row["curve"]
            axis.plot(range(1, len(curve) + 1), curve, color=colour, linewidth=1.5, label=row["candidates"])
            axis.plot(len(curve), curve[-1], "o", color=colour, markersize=4)
            axis.axhline(row["coverable %"], color=colour, linewidth=0.8, linestyle=(0, (4, 3)))
        text = "\n".join(f"{row['views']} views, {row['s']:.2f} s" for row in rows if row["part"] == part)
        axis.text(
            0.97, 0.05, text, transform=axis.transAxes, ha="right", va="bottom", fontsize=7.5, color="0.25",
            linespacing=1.3,
        )  # fmt: skip
        axis.set_title(part, fontsize=9.5, loc="left")
        axis.set_ylim(0, 102)
        axis.set_xlim(left=0)
        axis.grid(color="0.92", linewidth=0.6)
        axis.set_axisbelow(True)
        axis.tick_params(labelsize=8)
        for side in ("top", "right"):
            axis.spines[side].set_visible(False)
    for axis in list(figure.axes)[len(part_names) :]:
        axis.set_visible(False)
    handles, labels = figure.axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper center", ncols=3, frameon=False, fontsize=9.5)
    figure.supxlabel("views of the plan, the most useful first", fontsize=9.5)
    figure.supylabel("visible coverage [%]; dashed: coverable", fontsize=9.5)
    FigureCanvasAgg(figure)
    figure.savefig(folder / "candidates.png", format="png", metadata={"Software": "scan-cell"})


def parts(scratch: Path) -> Iterator[tuple[str, dict[str, Any]]]:
    """Return name and `[part]` table of each part, built-in ones first; meshes are written into the folder."""
    for name in NAMES:
        yield name, {"name": name}
    for name, (path, *_) in meshes(scratch):
        yield name, {"path": str(path), "units": "mm"}


class Bench:
    """A part in its cell."""

    def __init__(self, options: dict[str, Any], scanner: dict[str, float] | None = None) -> None:
        place = [float(value) for value in os.environ.get("SCAN_CELL_PLACE", "1200,500,0").split(",")]
        self.tables = {"part": options, "placement": {"position_mm": place}, "scanner": scanner or {}}
        scene = load_scene(None, self.tables)
        self.part = workpiece.load(scene.part.source, scene.part.units)
        self.settings = settle(scene, self.part).settings
        reference = self.part.reference
        self.planning = decimate(reference, self.settings.faces)
        self.samples = surface_samples(scene, reference, self.planning, np.random.default_rng([0, 0]))
        self.held_out = draw_samples(reference, self.planning, coverage.N_SAMPLES, np.random.default_rng([0, 1]))
        self.scanner = LaserArea(**self.settings.scanner)
        self.world = compile_world(
            scene, reference.vertices, part_faces=reference.faces, baseline_mm=self.settings.scanner["baseline_mm"]
        )
        self.checker = MujocoCollisionChecker(self.world)
        self.kinematics = kinematics_of(self.world.model)
        others = trimesh.util.concatenate(
            [trimesh.Trimesh(piece.vertices, piece.faces, process=False) for piece in fixed_occluders(self.world)]
        )
        self.casters = [EmbreeRayCaster(mesh.vertices, mesh.faces) for mesh in (reference, others)]

    def reach_of(self, views: Viewpoints) -> Reach:
        """Return verdicts and configurations."""
        world = self.world
        return reach.solve_reach(views, world.T_base_object, world.T_flange_scanner, self.kinematics, self.checker)

    def arm(self) -> ViewEvaluator:
        """Return the evaluator of views."""
        return generators.view_evaluator(
            generators.Cell(self.world, self.checker, self.world.kinematics), self.scanner, self.casters
        )

    def views(self, generator: str) -> Viewpoints:
        """Return the candidates of the generator, reachable or not."""
        scene = load_scene(None, {**self.tables, "plan": {"candidates": generator}})
        return generators.generate_viewpoints(scene, self.settings, self.part, self.planning)

    def measure_alone(self, views: Viewpoints) -> Measurability:
        """Return the measurability matrix without occluders."""
        return fill_matrix(views, self.samples, self.scanner, self.casters[0])

    def measure(self, views: Viewpoints) -> Measurability:
        """Return the measurability matrix in the cell."""
        return apply_occluders(self.measure_alone(views), views, self.scanner, self.casters[1])

    def plan(self, generator: str) -> tuple[Viewpoints, Reach, Measurability, Cover, float]:
        """Return candidates, reach, M, selection and their seconds."""
        start = perf_counter()
        views = self.views(generator)
        reached = self.reach_of(views)
        if generator == generators.GROWN:
            scouts = draw_samples(self.part.reference, self.planning, growth.N_SCOUTS, np.random.default_rng([0, 7]))
            added = generators.grow_viewpoints(views, reached.reachable, scouts, self.arm())
            views, reached = Viewpoints.join([views, added]), join_reach([reached, self.reach_of(added)])
        M = self.measure(views)
        plan = self.choose(M, reached, 1.0)
        return views, reached, M, plan, perf_counter() - start

    def choose(self, M: Measurability, reached: Reach, share: float) -> Cover:
        """Return the fewest views for a share of the coverable area."""
        areas = M.samples.areas
        return cover.solve(
            cover.CoverProblem(M.matrix(), areas, reached.reachable, coverage=share), rng=np.random.default_rng(0)
        )


def _part(name: str, options: dict[str, Any]) -> list[dict[str, Any]]:
    bench = Bench(options)
    seconds = {generator: np.inf for generator in GENERATORS}
    found = {}
    for _ in range(_RUNS):
        for generator in GENERATORS:
            found[generator] = bench.plan(generator)
            seconds[generator] = min(seconds[generator], found[generator][-1])
    zone_area = found["optimal-scanning-zone"][3].covered_area
    rows = []
    for generator, (views, reached, M, plan, _) in found.items():
        seen = find_measured(
            views.T_object_scanner[plan.views], bench.held_out, bench.scanner, bench.casters, each=True
        )
        curve = 100 * np.logical_or.accumulate(seen, axis=1).mean(axis=0)
        reachable = views.T_object_scanner[reached.reachable]
        coverable = coverage.visible_coverage(reachable, bench.held_out, bench.scanner, bench.casters).fraction
        same = bench.choose(M, reached, min(1.0, zone_area / plan.covered_area))
        rows.append(
            {
                "part": name,
                "candidates": generator,
                "number": len(views),
                "reachable": int(reached.reachable.sum()),
                "s": round(seconds[generator], 3),
                "views": len(plan.views),
                "bound": plan.lower_bound,
                "coverable %": round(100 * coverable, 2),
                "visible %": round(float(curve[-1]), 2),
                "views for the zone's area": len(same.views) if plan.covered_area >= zone_area * (1 - 1e-9) else None,
                "curve": [round(float(value), 2) for value in curve],
            }
        )
    return rows
