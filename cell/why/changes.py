"""The single changes that `cell why` tries for what a plan leaves open; docs/internals/conditions.md lists them.

Each becomes a `planner.why.what_if.WhatIf`: candidates that the arm reaches under the change (inverse kinematics and
collision asked again), the scanner's law and the casters under it. Nothing is estimated. Object frame, metres.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from cell.plan.candidates import GROWN
from cell.runs.cell import RunCell
from cell.why.scanner_changes import ScannerChanges, round_mm
from cell.why.turns import place_of, turned
from cell.world.collision import MujocoCollisionChecker
from cell.world.model import World
from cell.world.occluders import fixed_occluders, make_caster
from planner.kinematics import reach
from planner.ports import RayCaster
from planner.values import Floats, Ints
from planner.viewpoints.lines_of_sight import RayTargets
from planner.viewpoints.viewpoints import Viewpoints, pick_viewpoints
from planner.why import what_if
from planner.why.what_if import Kind, WhatIf

_ROLLS_DEG = (0.0, 45.0, 90.0, 135.0, 180.0, 225.0, 270.0, 315.0)
_STANDOFFS = (0.9, 1.1, 0.8, 1.2, 0.7, 1.3, 0.6, 1.4, 0.5, 1.5)  # of the present one, inside the range
_TILTS_DEG = (0.0, 20.0, 40.0, 60.0)  # of new views from the normal, below the grazing limit
_AZIMUTHS = 8


@dataclass(frozen=True, slots=True, eq=False)
class Changes:
    """What the changes start from.

    Attributes:
        world: the cell that was checked, compiled anew.
        world_without: compiles it without one fixture.
        cell: the same cell as it is measured in.
        candidates: the plan's candidates; those of the plan's views at the poses that will be executed.
        usable: (n,) candidates that are reachable and to which a path leads.
    """

    world: World
    world_without: Callable[[str], World]
    cell: RunCell
    candidates: Viewpoints
    usable: Ints

    @property
    def casters(self) -> tuple[RayCaster, RayCaster]:
        """The part's and everything else's, as they were."""
        return self.cell.part_caster, self.cell.occluder_caster

    def ladders(self, aims: tuple[Floats, Floats]) -> Iterator[list[WhatIf]]:
        """Every change except further views, in ladders.

        Args:
            aims: (n, 3) points [m] and (n, 3) normals that new views are aimed at.

        Yields:
            changes of one kind, the smallest first.
        """
        yield from self._of_the_plan(aims)
        yield [self._turned(*turn) for turn in turned(self.world)]
        for fixture in self.cell.scene.fixtures:
            if not fixture.built_in or fixture.name == "post":
                yield [self._without(fixture.name)]
        yield from ScannerChanges(self.cell, self.candidates.T_object_scanner[self.usable]).ladders()

    def views(self, targets: RayTargets, rows: Ints) -> list[WhatIf]:
        """One candidate more, and the few that measure nearly all of the rows that candidates can measure."""
        T = self.candidates.T_object_scanner[self.usable]
        pairs = what_if.measured_pairs(targets, rows, T, self.cell.scanner, self.casters)
        chosen = what_if.few_views(pairs, len(rows))
        found = []
        for count in sorted({1, len(chosen)} if chosen else ()):
            names = ", ".join(str(int(self.usable[view])) for view in chosen[:count])
            sentence = f"one view more: candidate {names}" if count == 1 else f"{count} views more: candidates {names}"
            poses = T[np.array(chosen[:count])]
            found.append(WhatIf(Kind.VIEW, count, sentence, "", poses, self.cell.scanner, self.casters))
        return found

    def _of_the_plan(self, aims: tuple[Floats, Floats]) -> Iterator[list[WhatIf]]:
        view = self.candidates
        rolls_deg = _distinct(np.degrees(view.roll) % 360)
        few = len(rolls_deg) <= 4
        base = (
            pick_viewpoints(view, np.flatnonzero(np.isclose(np.degrees(view.roll) % 360, rolls_deg[0])))
            if few
            else view
        )
        apart = {roll: min(abs((roll - have + 180) % 360 - 180) for have in rolls_deg) for roll in _ROLLS_DEG}
        listed = ",".join(f"{roll:g}" for roll in rolls_deg)
        yield [
            self._reached(
                Kind.ROLL, apart[roll], f"a roll of {roll:g} deg", f"--roll {listed},{roll:g}" if few else "",
                what_if.rolled(base, np.radians(roll)),
            )
            for roll in sorted(_ROLLS_DEG, key=lambda roll: (apart[roll], roll)) if apart[roll] > 1
        ]  # fmt: skip

        standoffs = _distinct(view.standoff * 1000)
        few = len(standoffs) <= 4
        now = float(standoffs[0]) if few else float(np.median(view.standoff)) * 1000
        base = pick_viewpoints(view, np.flatnonzero(np.isclose(view.standoff * 1000, now))) if few else view
        listed = ",".join(f"{standoff:g}" for standoff in standoffs)
        near, far = self.cell.scanner_keys.pair("range_mm") or (0.0, np.inf)
        yield [
            self._reached(
                Kind.STANDOFF, abs(factor - 1), f"standoff {other:g} mm beside {now:g}" if few
                else f"standoff {other:g} mm for all candidates",
                f"--standoff {listed},{other:g}" if few else f"--standoff {other:g}",
                what_if.backed_off(base, other / 1000),
            )
            for factor in _STANDOFFS if near < (other := round_mm(factor * now)) < far and other not in standoffs
        ]  # fmt: skip

        limit = self.cell.scanner_keys.number("grazing_max_deg")
        limit = 90.0 if limit is None else limit
        sweep = np.linalg.inv(what_if.middle(view.T_object_scanner[:1])) @ view.T_object_scanner[0]
        setting = "" if self.cell.scene.plan.candidates == GROWN else f"--candidates {GROWN}"
        rolls = np.radians((0.0, 90.0, 180.0, 270.0)).tolist()
        yield [
            self._reached(
                Kind.AIMED, tilt,
                "new candidates aimed at it along the normal" if tilt == 0
                else f"new candidates aimed at it, tilted {tilt:g} deg from the normal",
                setting, what_if.tilted_at(*aims, np.radians(tilt), _AZIMUTHS, now / 1000, rolls, sweep),
            )
            for tilt in _TILTS_DEG if tilt <= limit - 2 and len(aims[0])
        ]  # fmt: skip

    def _turned(self, how: str, change: float, T_base_centre: Floats, there: World) -> WhatIf:
        """The part turned about its centre: a second set-up, in which everything is asked again."""
        return self._in(there, Kind.TURN, change, how, f"--place {place_of(T_base_centre)}")

    def _without(self, name: str) -> WhatIf:
        what = "without the post (the part held in another way)" if name == "post" else f"without fixture {name}"
        return self._in(self.world_without(name), Kind.FIXTURE, float(name == "post"), what, "")

    def _in(self, world: World, kind: Kind, change: float, sentence: str, setting: str) -> WhatIf:
        """The candidates in another cell."""
        return WhatIf(
            kind, change, sentence, setting, self.candidates.T_object_scanner[_reach(self.candidates, world)],
            self.cell.scanner, (self.cell.part_caster, make_caster(fixed_occluders(world))),
        )  # fmt: skip

    def _reached(self, kind: Kind, change: float, sentence: str, setting: str, made: Viewpoints) -> WhatIf:
        """Other candidates, of which those that the arm takes up count."""
        reached = _reach(made, self.world)
        return WhatIf(kind, change, sentence, setting, made.T_object_scanner[reached], self.cell.scanner, self.casters)


def ladder_masks(ladder: Sequence[WhatIf], targets: RayTargets, rows: Ints) -> list[np.ndarray[Any, Any]]:
    """(n,) which rows each change of a ladder measures.

    A limit that is opened farther never loses a point, so there each step is asked only about what the last step of all
    measures and no smaller one does.
    """
    if not ladder:
        return []
    nested = ladder[0].kind in (Kind.GRAZING, Kind.RANGE, Kind.SPACING, Kind.SIGMA, Kind.RESOLUTION, Kind.FOV)
    if not nested:
        return [step.measures(targets, rows) for step in ladder]
    final = ladder[-1].measures(targets, rows)
    found = np.zeros(len(rows), dtype=np.bool_)
    masks = []
    for step in ladder[:-1]:
        ask = np.flatnonzero(final & ~found)
        if len(ask):
            found[ask[step.measures(targets, rows[ask])]] = True
        masks.append(found.copy())
    return [*masks, final]


def _reach(views: Viewpoints, world: World) -> Ints:
    """Views that the arm takes up, at some angle of a table."""
    reached = reach.solve_reach(
        views, world.T_base_object, world.T_flange_scanner, world.kinematics, MujocoCollisionChecker(world)
    )
    return np.flatnonzero(reached.reachable)


def _distinct(values: Floats) -> Floats:
    found: Floats = np.unique(values.round(6))
    return found
