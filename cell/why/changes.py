"""Build the single changes that `cell why` tries; docs/internals/conditions.md lists them.

Each is a `planner.why.what_if.PlanChange`: the candidates that are reachable under the change (inverse kinematics and
collision evaluated again), the scanner and the ray casters under it. Nothing is estimated. Object frame, metres.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from cell import scanners
from cell.errors import SceneError
from cell.plan.candidates import GROWN
from cell.runs.cell import RunCell
from cell.scene.regions import with_limits
from cell.world.collision import MujocoCollisionChecker
from cell.world.model import World
from cell.world.occluders import fixed_occluders, make_caster
from planner.kinematics import reach
from planner.kinematics.frames import kuka_abc_from_pose, pose_from_kuka_abc
from planner.measurability.quality import LimitedScanner
from planner.ports import Scanner
from planner.values import Floats, Ints
from planner.viewpoints.lines_of_sight import RayTargets
from planner.viewpoints.viewpoints import Viewpoints
from planner.why import what_if
from planner.why.what_if import ChangeKind, PlanChange

_ROLLS_DEG = (0.0, 45.0, 90.0, 135.0, 180.0, 225.0, 270.0, 315.0)
_STANDOFFS = (0.9, 1.1, 0.8, 1.2, 0.7, 1.3, 0.6, 1.4, 0.5, 1.5)  # of the present one, inside the range
_TILTS_DEG = (0.0, 20.0, 40.0, 60.0)  # of new views from the normal, below the grazing limit
_AZIMUTHS = 8
_FEW = 4  # rolls or standoffs that an option can list


@dataclass(frozen=True, slots=True, eq=False)
class Changes:
    """Generator of changes of cell and candidates.

    Attributes:
        world: the checked cell, compiled again.
        world_without: compiles it without one fixture.
        cell: the same cell for measurement.
        candidates: candidates of the plan, with executed poses for its views.
        usable: (n,) candidates that are reachable by a path.
    """

    world: World
    world_without: Callable[[str], World]
    cell: RunCell
    candidates: Viewpoints
    usable: Ints

    def ladders(self, aims: tuple[Floats, Floats]) -> Iterator[list[PlanChange]]:
        """Yield lists of changes of one kind, smallest first, except further views.

        `aims` are (n, 3) points [m] and (n, 3) normals at which new candidates are aimed.
        """
        yield self._rolls()
        yield self._standoffs()
        yield self._aimed(*aims)
        yield [self._turned(*turn) for turn in rotated_worlds(self.world)]
        for fixture in self.cell.scene.fixtures:
            if not fixture.built_in or fixture.name == "post":
                yield [self._without(fixture.name)]
        yield from ScannerChanges(self.cell, self.candidates.T_object_scanner[self.usable]).ladders()

    def views(self, targets: RayTargets, rows: Ints) -> list[PlanChange]:
        """Return one further candidate, and the few that measure nearly all rows that candidates can measure."""
        T = self.candidates.T_object_scanner[self.usable]
        pairs = what_if.measured_pairs(targets, rows, T, self.cell.scanner, self.cell.casters)
        selection = what_if.select_views(pairs, len(rows))
        changes = []
        for count in sorted({1, len(selection)} if selection else ()):
            names = ", ".join(str(int(self.usable[view])) for view in selection[:count])
            sentence = f"one view more: candidate {names}" if count == 1 else f"{count} views more: candidates {names}"
            setting = f"cell edit RUN --add-candidate {names.replace(' ', '')}"
            changes.append(self._seen_from(ChangeKind.VIEW, count, sentence, setting, T[np.array(selection[:count])]))
        return changes

    def _rolls(self) -> list[PlanChange]:
        """Return the changes to another roll: in addition to a few rolls, else of all candidates."""
        view = self.candidates
        rolls_deg = np.unique((np.degrees(view.roll) % 360).round(6))
        few = len(rolls_deg) <= _FEW
        is_first_roll = np.isclose(np.degrees(view.roll) % 360, rolls_deg[0])
        base = view.pick(np.flatnonzero(is_first_roll)) if few else view
        apart = {roll: min(abs((roll - have + 180) % 360 - 180) for have in rolls_deg) for roll in _ROLLS_DEG}
        present = ",".join(f"{roll:g}" for roll in rolls_deg)
        return [
            self._reached(
                ChangeKind.ROLL,
                apart[roll],
                f"a roll of {roll:g} deg",
                f"--roll {present},{roll:g}" if few else "",
                what_if.with_roll(base, np.radians(roll)),
            )
            for roll in sorted(_ROLLS_DEG, key=lambda roll: (apart[roll], roll))
            if apart[roll] > 1
        ]

    def _standoffs(self) -> list[PlanChange]:
        """Return the changes to another standoff within the range: in addition to a few, else of all candidates."""
        view, standoffs, now = self.candidates, self._standoffs_mm, self._standoff_mm
        few = len(standoffs) <= _FEW
        base = view.pick(np.flatnonzero(np.isclose(view.standoff * 1000, now))) if few else view
        present = ",".join(f"{standoff:g}" for standoff in standoffs)
        near, far = self.cell.scanner_keys.pair("range_mm") or (0.0, np.inf)
        return [
            self._reached(
                ChangeKind.STANDOFF,
                abs(factor - 1),
                f"standoff {other:g} mm in addition to {now:g}" if few else f"standoff {other:g} mm for all candidates",
                f"--standoff {present},{other:g}" if few else f"--standoff {other:g}",
                what_if.with_standoff(base, other / 1000),
            )
            for factor in _STANDOFFS
            if near < (other := round_mm(factor * now)) < far and other not in standoffs
        ]

    def _aimed(self, points: Floats, normals: Floats) -> list[PlanChange]:
        """Return the changes to new candidates aimed at points (n, 3) [m] with normals (n, 3), by their tilt."""
        limit, T = self.cell.scanner_keys.number("grazing_max_deg"), self.candidates.T_object_scanner
        limit = 90.0 if limit is None else limit
        sweep = np.linalg.inv(what_if.middle_poses(T[:1])) @ T[0]
        setting = "" if self.cell.scene.plan.candidates == GROWN else f"--candidates {GROWN}"
        rolls, standoff = np.radians((0.0, 90.0, 180.0, 270.0)).tolist(), self._standoff_mm / 1000
        return [
            self._reached(
                ChangeKind.AIMED,
                tilt,
                "new candidates aimed along the normal"
                if tilt == 0
                else f"new candidates aimed {tilt:g} deg from the normal",
                setting,
                what_if.tilted_viewpoints(points, normals, np.radians(tilt), _AZIMUTHS, standoff, rolls, sweep),
            )
            for tilt in _TILTS_DEG
            if tilt <= limit - 2 and len(points)
        ]

    @property
    def _standoffs_mm(self) -> Floats:
        """Different standoffs of the candidates, ascending [mm]."""
        return np.unique((self.candidates.standoff * 1000).round(6))

    @property
    def _standoff_mm(self) -> float:
        """Smallest of a few standoffs, else their median [mm]."""
        standoffs = self._standoffs_mm
        return float(standoffs[0]) if len(standoffs) <= _FEW else float(np.median(self.candidates.standoff)) * 1000

    def _turned(self, how: str, change: float, T_base_centre: Floats, there: World) -> PlanChange:
        """Return the change to a second set-up with the part rotated about its centre."""
        setting = f"cell setups --first RUN --proposals 1 --place {format_placement(T_base_centre)}"
        return self._in(there, ChangeKind.TURN, change, how, setting)

    def _without(self, name: str) -> PlanChange:
        what = "without the post (the part held in another way)" if name == "post" else f"without fixture {name}"
        return self._in(self.world_without(name), ChangeKind.FIXTURE, float(name == "post"), what, "")

    def _in(self, world: World, kind: ChangeKind, change: float, sentence: str, setting: str) -> PlanChange:
        """Return a change to another cell with the same candidates."""
        return PlanChange(
            kind, change, sentence, setting, self.candidates.T_object_scanner[_reachable(self.candidates, world)],
            self.cell.scanner, (self.cell.part_caster, make_caster(fixed_occluders(world))),
        )  # fmt: skip

    def _reached(
        self, kind: ChangeKind, change: float, sentence: str, setting: str, candidates: Viewpoints
    ) -> PlanChange:
        """Return a change to other candidates, as far as they are reachable."""
        poses = candidates.T_object_scanner[_reachable(candidates, self.world)]
        return self._seen_from(kind, change, sentence, setting, poses)

    def _seen_from(self, kind: ChangeKind, change: float, sentence: str, setting: str, poses: Floats) -> PlanChange:
        """Return a change to other poses (n, K, 4, 4) [m] of the scanner."""
        return PlanChange(kind, change, sentence, setting, poses, self.cell.scanner, self.cell.casters)


def ladder_masks(ladder: Sequence[PlanChange], targets: RayTargets, rows: Ints) -> list[np.ndarray[Any, Any]]:
    """Return (n,) the rows that each change of a ladder measures.

    Opening a limit never loses a point, so each step of such a ladder is evaluated only on rows that the last step
    measures and no smaller one does.
    """
    if not ladder or ladder[0].kind not in _LIMITS:
        return [step.measures(targets, rows) for step in ladder]
    final = ladder[-1].measures(targets, rows)
    is_gained = np.zeros(len(rows), dtype=np.bool_)
    masks = []
    for step in ladder[:-1]:
        ask = np.flatnonzero(final & ~is_gained)
        if len(ask):
            is_gained[ask[step.measures(targets, rows[ask])]] = True
        masks.append(is_gained.copy())
    return [*masks, final]


def _reachable(views: Viewpoints, world: World) -> Ints:
    """Return the reachable viewpoints, at any angle of a rotary table."""
    reached = reach.solve_reach(
        views, world.T_base_object, world.T_flange_scanner, world.kinematics, MujocoCollisionChecker(world)
    )
    return np.flatnonzero(reached.reachable)


_FARTHER = (1.1, 1.25, 1.5, 2.0)
_NEARER = (0.9, 0.75, 0.5, 0.25)
_FOV_DEG = (10.0, 20.0, 30.0, 40.0, 60.0, 90.0)  # added to both axes
_BASELINES = (0.75, 0.5, 0.25)
_SIGMAS = (1.1, 1.25, 1.5, 2.0, 3.0, 5.0)  # of the limit, on spacing too
_FINER = (0.75, 0.5, 0.25)  # of the angle between rays
_LAST_GRAZING_DEG = 89
_LIMITS = {ChangeKind.GRAZING, ChangeKind.RANGE, ChangeKind.SPACING}
_LIMITS |= {ChangeKind.SIGMA, ChangeKind.RESOLUTION, ChangeKind.FOV}
_Step = tuple[float, float | tuple[float, float], str]  # size, value, sentence


@dataclass(frozen=True, slots=True, eq=False)
class ScannerChanges:
    """Generator of changes of the scanner with the same reachable candidates.

    Attributes:
        cell: the cell for measurement.
        T_object_scanner: (n, K, 4, 4) candidates that are reachable by a path [m].
    """

    cell: RunCell
    T_object_scanner: Floats

    @property
    def max_sigma_mm(self) -> float | None:
        """Sigma limit of the plan [mm]; None without one."""
        return self.cell.scene.plan.max_sigma_mm

    def ladders(self) -> Iterator[list[PlanChange]]:
        """Yield lists of changes of one kind, smallest first."""
        keys = self.cell.scanner_keys
        for key, last, of in (
            ("grazing_max_deg", _LAST_GRAZING_DEG, "grazing limit"),
            ("sensor_grazing_max_deg", 90, "sensor's grazing limit"),
        ):
            if (now := keys.number(key)) is not None:
                wider = map(float, range(int(np.floor(now)) + 1, last + 1))
                less_strict = ((to - now, to, f"{of} {to:g} instead of {now:g} deg") for to in wider)
                yield self._laws(ChangeKind.GRAZING, key, less_strict)
        for key in ("range_mm", "depth_of_field_mm"):
            if (limits := keys.pair(key)) is not None:
                yield from self._ranges(key, *limits)
        for key, of in (("fov_deg", "field of view"), ("sensor_fov_deg", "sensor's field of view")):
            if (fov := keys.pair(key)) is not None:
                h, v = fov
                steps = [more for more in _FOV_DEG if max(fov) + more < 180]
                wider_fovs = ((d, (h + d, v + d), f"{of} {h + d:g} x {v + d:g} deg, not {h:g} x {v:g}") for d in steps)
                yield self._laws(ChangeKind.FOV, key, wider_fovs)
        if (now := keys.number("fan_deg")) is not None:
            steps = [more for more in _FOV_DEG if now + more < 180]
            wider_fans = ((d, now + d, f"fan of {now + d:g} deg instead of {now:g}") for d in steps)
            yield self._laws(ChangeKind.FOV, "fan_deg", wider_fans)
        if (limit := keys.number("max_spacing_mm")) is not None:
            sparser = ((f, f * limit, f"points up to {f * limit:.3g} instead of {limit:g} mm apart") for f in _SIGMAS)
            yield self._laws(ChangeKind.SPACING, "max_spacing_mm", sparser, "--max-spacing {:.3g}")
        grid = keys.pair("resolution_deg")
        if grid and (limit is not None or any(region.max_spacing_mm for region in self.cell.scene.regions or ())):
            finer = (
                (1 - f, (f * grid[0], f * grid[1]), f"{f * max(grid):.3g} instead of {max(grid):g} deg between rays")
                for f in _FINER  # closer views are among the standoffs
            )
            yield self._laws(ChangeKind.RESOLUTION, "resolution_deg", finer)
        if self.max_sigma_mm is not None:
            yield [self._sigma(factor, self.max_sigma_mm) for factor in _SIGMAS]
        if now := keys.number("baseline_mm"):
            shorter = ((1 - f, f * now, f"baseline {f * now:.3g} instead of {now:g} mm") for f in _BASELINES)
            yield self._laws(ChangeKind.BASELINE, "baseline_mm", shorter)

    def _ranges(self, key: str, near: float, far: float) -> Iterator[list[PlanChange]]:
        """Yield farther, then nearer limits of a range."""
        of = key.removesuffix("_mm").replace("_", " ")
        farther = (
            (_relative_change(to, far), (near, to), f"{of} to {to:g} instead of {far:g} mm")
            for factor in _FARTHER
            if (to := round_mm(far * factor)) != far
        )
        nearer = (
            (_relative_change(at, near), (at, far), f"{of} from {at:g} instead of {near:g} mm")
            for factor in _NEARER
            if (at := round_mm(near * factor)) != near
        )
        yield self._laws(ChangeKind.RANGE, key, farther)
        yield self._laws(ChangeKind.RANGE, key, nearer)

    def _laws(self, kind: ChangeKind, key: str, steps: Iterable[_Step], option: str = "") -> list[PlanChange]:
        """Return changes of one scanner key with the same candidates.

        Args:
            kind: of the changes.
            key: of the scanner.
            steps: size, value and sentence of each change.
            option: of `cell plan`, with a field for the value; "" if there is none.
        """
        keys, changes = self.cell.scanner_keys, []
        for change, value, sentence in steps:
            scanner: Scanner = scanners.load(keys.type)(**{**keys.own, key: value})
            scanner = with_limits(scanner, self.max_sigma_mm, self.cell.scene.regions or ())
            numbers = f"{value:g}" if isinstance(value, float) else f"[{value[0]:g}, {value[1]:g}]"
            setting = option.format(value) if option else f"scanner.{key} = {numbers}"
            changes.append(self._scanned_with(scanner, kind, change, sentence, setting))
        return changes

    def _sigma(self, factor: float, now: float) -> PlanChange:
        """Return the change that scales the limit of sigma `now` [mm] by `factor`."""
        assert isinstance(self.cell.scanner, LimitedScanner)
        scanner = replace(self.cell.scanner, max_sigma=factor * (now / 1000))
        sentence = f"sigma up to {factor * now:.3g} instead of {now:g} mm"
        return self._scanned_with(scanner, ChangeKind.SIGMA, factor, sentence, f"--max-sigma {factor * now:.3g}")

    def _scanned_with(
        self, scanner: Scanner, kind: ChangeKind, change: float, sentence: str, setting: str
    ) -> PlanChange:
        """Return a change to another scanner at the same poses."""
        return PlanChange(kind, change, sentence, setting, self.T_object_scanner, scanner, self.cell.casters)


def _relative_change(value: float, now: float) -> float:
    """Return the relative change of a limit, on a logarithmic scale."""
    return float(abs(np.log(max(value, 1e-3) / max(now, 1e-3))))


def round_mm(length: float) -> float:
    """Round a length [mm] to two digits, or to whole tens from 100 mm on."""
    return float(round(length, -1)) if length >= 100 else float(f"{length:.2g}")


ROTATIONS = ((2, 180.0), (2, 90.0), (2, -90.0), (0, 180.0))  # axis of the base frame, degrees


def rotated_worlds(world: World) -> Iterator[tuple[str, float, Floats, World]]:
    """Yield each rotation in words, its size [deg], the pose (4, 4) of the centre [m], the cell.

    Rotations that a rotary table makes itself, or cannot carry, are left out.
    """
    for axis, angle in ROTATIONS:
        turn = np.zeros(3)
        turn[2 - axis] = np.radians(angle)  # KUKA's angles are about z, y, x
        T = np.array(world.T_base_object @ world.T_object_centre)
        T[:3, :3] = pose_from_kuka_abc(np.zeros(3), turn)[:3, :3] @ T[:3, :3]
        how = "upside down" if axis != 2 else f"rotated by {angle:g} deg about the vertical"
        if axis == 2 and world.table is not None and world.table.upright:
            continue
        if (there := moved_world(world, T)) is not None:
            yield f"a second set-up with the part {how}", abs(angle) + 360 * (axis != 2), T, there


def moved_world(world: World, T_base_centre: Floats) -> World | None:
    """Return the cell with the part's centre at a pose (4, 4) [m]; None if a rotary table cannot carry it there."""
    try:
        return world.with_placement(T_base_centre)
    except SceneError:
        return None


def format_placement(T_base_centre: Floats) -> str:
    """Return the `--place` argument for a pose (4, 4) of the part's centre [m]."""
    position, abc = kuka_abc_from_pose(T_base_centre)
    return ",".join(f"{value + 0.0:g}" for value in [*(position * 1000).round(3), *(np.degrees(abc).round(3))])
