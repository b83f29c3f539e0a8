"""Estimate the gain of a second set-up or of another placement (`cell why --advise`).

Both use the pose search of `planner.viewpoints.attainable`, not candidates: they estimate the coverage by any reachable
pose. A second set-up is evaluated on seeded uncovered samples of the plan, another placement on seeded samples of the
whole surface, because the plan would change.
"""

import shlex
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from pydantic import JsonValue

from cell.plan.candidates import Cell, view_evaluator
from cell.plan.stable_poses import MARGIN, Underside, needs_fixture
from cell.runs.cell import read_cell, world_of
from cell.runs.run import Run
from cell.session import ProgressReporter, Stream, default_effort, random_stream
from cell.why.changes import ROTATIONS, format_placement, moved_world, rotated_worlds
from cell.world.model import World
from cell.world.occluders import fixed_occluders, make_caster
from cell.world.prediction import held_out_samples
from planner.geometry.sampling import SurfaceSamples
from planner.measurability.visibility import find_measured
from planner.values import Floats, Ints
from planner.viewpoints.attainable import probe_attainable
from planner.viewpoints.growth import ViewEvaluator
from planner.viewpoints.lines_of_sight import RayTargets

_ASIDE = ((0, 0), (200, 0), (-200, 0), (0, 200), (0, -200))  # mm, displacements in x and y
_ABOVE = (0, 200, 400)  # mm
N_PLACEMENTS = 4
"""Number of recommended other placements."""


@dataclass(frozen=True, slots=True)
class Advice:
    """A recommended set-up or placement.

    Attributes:
        what: description.
        share: coverage with it: of the plan and the second set-up, or at the other placement.
        standard_error: standard error of the share.
        command: command to run.
    """

    what: str
    share: float
    standard_error: float
    command: str

    def as_json(self) -> dict[str, JsonValue]:
        """Return the value as JSON types."""
        return {
            "description": self.what,
            "share": self.share,
            "standard_error": self.standard_error,
            "command": self.command,
        }


def advise(run: Run, reporter: ProgressReporter) -> tuple[float, list[Advice]]:
    """Return the coverage of the plan and the recommendations: second set-ups, then the best other placements."""
    with reporter.stage("read the run"):
        cell, plan = read_cell(run), run.plan
        world = world_of(run, cell.reference)
        samples = held_out_samples(cell.reference, cell.planning, run.seed)
        views = run.candidates.T_object_scanner[[view.id for view in plan.views]]
        seen = find_measured(views, samples, cell.scanner, cell.casters)
    rng = random_stream(run.seed, Stream.ADVICE_SAMPLES)
    visible = float(seen.mean())

    def arm(there: World | None) -> ViewEvaluator | None:
        if there is None or not (moved := Cell.of(there)).checker.free(there.home[None])[0]:
            return None
        return view_evaluator(moved, cell.scanner, (cell.part_caster, make_caster(fixed_occluders(there))))

    advice: list[Advice] = []
    left = np.sort(rng.permutation(np.flatnonzero(~seen))[: default_effort().searched_samples])
    with reporter.stage("second set-ups") as progress:
        for n_done, (turn, _, T_base_centre, there) in enumerate(rotated_worlds(world)):
            progress(n_done, len(ROTATIONS))
            share, error = _share(samples, left, arm(there))
            what, command = f"{turn}, in addition to this plan{_support(there)}", setup_command(run, T_base_centre)
            advice.append(Advice(what, visible + (1.0 - visible) * share, (1.0 - visible) * error, command))
    placements: list[Advice] = []
    rows = np.sort(rng.permutation(len(samples))[: default_effort().searched_samples])
    displaced = list(_displaced_placements(world))
    with reporter.stage("other placements") as progress:
        for n_done, (what, T_base_centre) in enumerate(displaced):
            progress(n_done, len(displaced))
            share, error = _share(samples, rows, arm(moved_world(world, T_base_centre)))
            placements.append(Advice(what, share, error, replan_command(run, T_base_centre)))
    placements.sort(key=lambda item: -item.share)
    return visible, [*advice, *placements[:N_PLACEMENTS]]


def _share(samples: SurfaceSamples, rows: Ints, arm: ViewEvaluator | None) -> tuple[float, float]:
    """Return the share of the rows measured by any pose, and its standard error; 0 if home is in collision."""
    if arm is None or not len(rows):
        return 0.0, 0.0
    targets = samples.pick(rows)
    share = float(probe_attainable(RayTargets.of(targets.points, targets.normals, targets.region), arm).measured.mean())
    return share, float(np.sqrt(share * (1 - share) / len(rows)))


def _support(world: World) -> str:
    """Return the note that the part does not rest on its post; "" if it does, or has none."""
    post, R = world.scene.post, world.T_base_object[:3, :3]
    margin = Underside(world.part_mesh, R, world.T_object_centre[:3, 3]).margin(post)
    return needs_fixture(post) if post.enabled and margin < MARGIN else ""


def _displaced_placements(world: World) -> Iterator[tuple[str, Floats]]:
    """Yield placements displaced to the side and upwards."""
    for up in _ABOVE:
        for x, y in _ASIDE:
            if (x, y, up) != (0, 0, 0):
                T = np.array(world.T_base_object @ world.T_object_centre)
                T[:3, 3] += np.array([x, y, up]) / 1000
                yield f"another placement, displaced by {x:g}, {y:g}, {up:g} mm", T


def setup_command(run: Run, T_base_centre: Floats) -> str:
    """Return the command that plans a further set-up with the run as the fixed first one."""
    first = ("--first", str(run.folder), "--proposals", "1")
    return shlex.join(["cell", "setups", *first, "--place", format_placement(T_base_centre)])


def replan_command(run: Run, T_base_centre: Floats) -> str:
    """Return the command of the run with another placement; only the option if `cell edit` or Python made it."""
    place, words = format_placement(T_base_centre), run.manifest.argv
    if words[:1] not in (("plan",), ("setups",)):
        return f"--place {place}"
    return shlex.join(["cell", *without_options(words, "--place", "--place-origin", "--out"), "--place", place])


def without_options(words: Sequence[str], *options: str) -> list[str]:
    """Return the words of a command without some options and their values, in both forms: `--out=X` and `--out X`."""
    kept = [word for word in words if word.partition("=")[0] not in options or word in options]
    for option in options:
        while option in kept:
            at = kept.index(option)
            del kept[at : at + 2]
    return kept
