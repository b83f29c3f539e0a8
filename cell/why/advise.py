"""`cell why --advise`: what a second set-up with the part turned would add to a plan, and what other places would give.

Both are asked by the pointwise search (`planner.viewpoints.attainable`), not of candidates: they are what any pose
measures that the robot takes up there. A second set-up is asked for seeded samples that the plan leaves open; another
place for seeded samples of the whole surface, because there the plan would be another one.
"""

import shlex
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from pydantic import JsonValue

from cell.plan.candidates import arm_of
from cell.runs.cell import read_cell, world_of
from cell.runs.run import Run
from cell.session import ProgressReporter, Stream, default_effort, random_stream
from cell.why.turns import TURNS, carried, place_of, turned
from cell.world.collision import MujocoCollisionChecker
from cell.world.model import World
from cell.world.occluders import fixed_occluders, make_caster
from cell.world.prediction import held_out_samples
from planner.geometry.sampling import SurfaceSamples, pick_samples
from planner.measurability.visibility import find_measured
from planner.values import Floats, Ints
from planner.viewpoints.attainable import probe_attainable
from planner.viewpoints.growth import ViewEvaluator
from planner.viewpoints.lines_of_sight import RayTargets

_ASIDE = ((0, 0), (200, 0), (-200, 0), (0, 200), (0, -200))  # mm, x and y of other places
_ABOVE = (0, 200, 400)  # mm
TOLD = 4
"""Other places that are told, the best first."""


@dataclass(frozen=True, slots=True)
class Advice:
    """One thing to try.

    Attributes:
        what: in words.
        share: of the surface that is measured then: with a second set-up beside the plan, or at another place.
        standard_error: of the share.
        command: to paste.
    """

    what: str
    share: float
    standard_error: float
    command: str

    def as_json(self) -> dict[str, JsonValue]:
        """As JSON types."""
        return {
            "what": self.what, "share": self.share, "standard_error": self.standard_error, "command": self.command,
        }  # fmt: skip


def advise(run: Run, reporter: ProgressReporter) -> tuple[float, list[Advice]]:
    """What the plan measures of the surface, and what to try: second set-ups, then the best of other places."""
    with reporter.stage("read the run"):
        cell, plan = read_cell(run), run.plan
        world = world_of(run, cell.reference)
        samples = held_out_samples(cell.reference, cell.planning, run.seed)
        views = run.candidates.T_object_scanner[[view.id for view in plan.views]]
        seen = find_measured(views, samples, cell.scanner, (cell.part_caster, cell.occluder_caster))
    rng = random_stream(run.seed, Stream.ADVICE_SAMPLES)
    visible = float(seen.mean())

    def arm(there: World | None) -> ViewEvaluator | None:
        if there is None or not (checker := MujocoCollisionChecker(there)).free(there.home[None])[0]:
            return None
        casters = (cell.part_caster, make_caster(fixed_occluders(there)))
        return arm_of(there, there.kinematics, checker, cell.scanner, casters)

    found: list[Advice] = []
    left = np.sort(rng.permutation(np.flatnonzero(~seen))[: default_effort().searched_samples])
    with reporter.stage("second set-ups") as progress:
        for done, (turn, _, T_base_centre, there) in enumerate(turned(world)):
            progress(done, len(TURNS))
            share, error = _share(samples, left, arm(there))
            what, command = f"{turn}, beside this plan", open_of(run, T_base_centre)
            found.append(Advice(what, visible + (1.0 - visible) * share, (1.0 - visible) * error, command))
    places: list[Advice] = []
    some = np.sort(rng.permutation(len(samples))[: default_effort().searched_samples])
    asides = list(_elsewhere(world))
    with reporter.stage("other places") as progress:
        for done, (what, T_base_centre) in enumerate(asides):
            progress(done, len(asides))
            share, error = _share(samples, some, arm(carried(world, T_base_centre)))
            places.append(Advice(what, share, error, elsewhere(run, T_base_centre)))
    places.sort(key=lambda advice: -advice.share)
    return visible, [*found, *places[:TOLD]]


def _share(samples: SurfaceSamples, rows: Ints, arm: ViewEvaluator | None) -> tuple[float, float]:
    """Share of the rows that any pose measures, and its standard error; nothing where home itself is not free."""
    if arm is None or not len(rows):
        return 0.0, 0.0
    some = pick_samples(samples, rows)
    share = float(probe_attainable(RayTargets.of(some.points, some.normals, some.region), arm).measured.mean())
    return share, float(np.sqrt(share * (1 - share) / len(rows)))


def _elsewhere(world: World) -> Iterator[tuple[str, Floats]]:
    """The part moved aside and up."""
    for up in _ABOVE:
        for x, y in _ASIDE:
            if (x, y, up) != (0, 0, 0):
                T = np.array(world.T_base_object @ world.T_object_centre)
                T[:3, 3] += np.array([x, y, up]) / 1000
                yield f"another place, moved by {x:g}, {y:g}, {up:g} mm", T


def open_of(run: Run, T_base_centre: Floats) -> str:
    """The command that plans a further set-up for what a run leaves open, or all set-ups of a folder together."""
    runs = [run.folder]
    if run.is_in_setups_folder:
        numbers = sorted(int(path.name) for path in run.folder.parent.iterdir() if path.name.isdecimal())
        runs = [run.folder.parent / str(number) for number in numbers]
    named = [word for folder in runs for word in ("--open-of", str(folder))]
    return shlex.join(["cell", "plan", *named, "--place", place_of(T_base_centre)])


def elsewhere(run: Run, T_base_centre: Floats) -> str:
    """The run's own command line at another placement; the option alone where `cell edit` or Python began it."""
    place = place_of(T_base_centre)
    words = list(run.manifest.argv)
    if words[:1] not in (["plan"], ["setups"]):
        return f"--place {place}"
    for option in ("--place", "--out"):
        while option in words:
            at = words.index(option)
            del words[at : at + 2]
    return shlex.join(["cell", *words, "--place", place])
