"""Check edited plans and refused edits: other kinematics, true triangles, other rays, another solver.

The arm is py-opw-kinematics with the lengths of the data sheet. Contacts and distances are those of
`benchmarks.triangle_cell`, limits of the motion those of `benchmarks.motion_recheck`, coverage that of
`benchmarks.checks`. HiGHS finds the smallest number of views that repair the coverage. Metres, radians.
"""

import re
from collections.abc import Iterator

import numpy as np
from py_opw_kinematics import KinematicModel, Robot
from scipy.optimize import Bounds, LinearConstraint, milp
from scipy.spatial.transform import RigidTransform

from benchmarks.checks import independent_visible
from benchmarks.motion_recheck import excess
from benchmarks.random_edits import RandomEdit
from benchmarks.triangle_cell import TriangleCell
from cell.errors import CellError
from cell.runs.cell import world_of
from cell.runs.run import Run
from cell.runs.verification import verify_plan
from planner.timing.motion import retime
from planner.values import Floats

POSE_M, CLEARANCE_M = 20e-6, 60e-6
"""What the rounding of joint angles to 1e-4 deg leaves of a pose, and of a distance."""
VISIBLE = 0.006
"""Of two counts of 100,000 samples each: 0.6 points are 3.5 standard deviations or more."""

_REFUSAL = re.compile(
    r"(view \d+|candidate \d+|added pose \d+) cannot be (used|part of a motion): (.*); (move it|give another)"
)
_TURNED = 1e-4  # tolerance of the entries of rotations
_STEP_S, _DISTANCES = 1e-3, 40
_ARM = Robot(
    KinematicModel(
        a1=0.26, a2=0.035, c1=0.675, c2=0.68, c3=0.67, c4=0.158, offsets=(0.0, -np.pi / 2, 0.0, 0.0, 0.0, 0.0),
        flip_axes=(True, False, False, True, False, True),
    ),
    degrees=False,
)  # fmt: skip


class EditJudge:
    """Check the results of edits of a plan.

    Args:
        run: the plan; every edit has its cell, limits and clearance.
    """

    def __init__(self, run: Run) -> None:
        self._scene = run.scene
        self._world = world_of(run, run.reference)
        self._triangles = TriangleCell(self._world, run.reference)
        self._limits = np.radians(self._scene.joint_limits_deg)
        self.visible_error = 0.0

    def accepted(self, run: Run, edit: RandomEdit, result: Run) -> list[str]:
        """Return the faults of an edited plan; empty if there are none."""
        return [
            *self._views(edit, result), *_unchanged(run, edit, result), *self._motion(result), *self._coverage(result),
            *(_repaired(run, edit, result) if edit.options.get("repair") else ()),
        ]  # fmt: skip

    def refused(self, edit: RandomEdit, error: CellError) -> list[str]:
        """Return the faults of a refusal; empty if its reason is true."""
        message = str(error)
        if edit.wrong:
            return [] if edit.wrong in message else [f"should say: {edit.wrong}"]
        found = _REFUSAL.match(message)
        if found is None or found[1] not in edit.poses:
            return ["names no view that the edit names anew"]
        T, reason = edit.poses[found[1]] @ np.linalg.inv(self._scene.T_flange_scanner), found[3]
        every, within = self._solutions(T)
        if "out of the arm's reach" in reason:
            return [] if not len(every) else [f"{len(every)} solutions"]
        if "joint limit" in reason and "collides" not in reason:
            return [] if len(every) and not len(within) else [f"{len(within)} of {len(every)} solutions within limits"]
        if "collides" in reason:
            return self._collides(within, reason)
        return self._no_path(within) if "path" in reason else [f"a reason that is not known here: {reason}"]

    def _solutions(self, T_base_flange: Floats) -> tuple[Floats, Floats]:
        """Return (n, 6) all branches of a flange pose, and (m, 6) their turns within the joint limits."""
        q = np.asarray(_ARM.reach(RigidTransform.from_matrix(T_base_flange[None])).joints).reshape(-1, 6)
        q = q[~np.isnan(q).any(axis=1)]
        turns = np.stack(np.meshgrid(*[2 * np.pi * np.arange(-2, 3)] * 3), axis=-1).reshape(-1, 3)
        full = np.zeros((len(turns), 6))
        full[:, [0, 3, 5]] = turns  # full turns of A2, A3 and A5 do not fit into the limits
        base = (q + np.pi) % (2 * np.pi) - np.pi
        all_turns = (base[:, None] + full).reshape(-1, 6)
        inside = (all_turns >= self._limits[:, 0] - 1e-6) & (all_turns <= self._limits[:, 1] + 1e-6)
        return q, all_turns[inside.all(axis=1)]

    def _collides(self, within: Floats, reason: str) -> list[str]:
        """Check that each solution violates the clearance, and that one of them does so at the named pair."""
        if not len(within):
            return ["no solution is within the joint limits"]
        near = [self._triangles.distances(q[None], self._world.clearance + CLEARANCE_M) for q in within]
        pair_match = re.search(r"\((.*)\)", reason)
        found = [f"{sum(not each for each in near)} of {len(near)} solutions are free"] if not all(near) else []
        pairs = {frozenset(pair.split(" with ")) for each in near for pair in each}
        if pair_match is not None and frozenset(pair_match[1].split(" with ")) not in pairs:
            found.append(f"none is near {pair_match[1]}")
        return found

    def _no_path(self, within: Floats) -> list[str]:
        """Check that no straight move from home to a solution is free.

        The absence of any path is not checked.
        """
        for q in within:
            share = np.linspace(0.0, 1.0, 400)[:, None]
            if not self._triangles.distances(self._world.home + share * (q - self._world.home), self._world.clearance):
                return ["the straight move from home is free"]
        return []

    def _views(self, edit: RandomEdit, result: Run) -> Iterator[str]:
        """Check that poses follow from the joint angles, within limits, and that requested poses are reached."""
        T = np.stack([_ARM.forward(q).as_matrix() for q in result.q]) @ self._scene.T_flange_scanner
        if (wrong := float(np.abs(T - result.T_base_scanner).max())) > 1e-9:
            yield f"poses are {1e6 * wrong:.3g} um off their joint angles"
        if ((result.q < self._limits[:, 0] - 1e-9) | (result.q > self._limits[:, 1] + 1e-9)).any():
            yield "a joint limit is exceeded"
        for name, pose in edit.poses.items():
            apart = np.linalg.norm(T[:, :3, 3] - pose[:3, 3], axis=1)
            turned = np.abs(T[:, :3, :3] - pose[:3, :3]).max(axis=(1, 2))
            if not ((apart <= POSE_M) & (turned <= _TURNED)).any():
                yield f"{name} is {1e6 * apart.min():.0f} um from the requested position, or turned"

    def _motion(self, result: Run) -> Iterator[str]:
        """Check contacts, limits, order, clearance and verification of the motion.

        No triangles touch at any millisecond, no limit is exceeded, and the reported clearance is kept.
        """
        motion = result.motion
        dense = retime(motion.via_q, motion.segment, motion.view, motion.limits, _STEP_S)
        if contacts := self._triangles.contacts(dense.q):
            yield f"contacts: {contacts}"
        if max(excess(motion), excess(dense)) > 1e-9:
            yield "a limit of the motion is exceeded"
        if motion.view[motion.view >= 0].tolist() != result.candidate.tolist():
            yield "the motion visits other views"
        reported_mm = result.report.motion.minimum_clearance_mm
        nearest = self._triangles.nearest(dense.q[:: max(1, len(dense.q) // _DISTANCES)], 0.3)
        if reported_mm is not None and 1000 * nearest < reported_mm - 1000 * CLEARANCE_M:
            yield f"{1000 * nearest:.2f} mm near, said to be {reported_mm:.2f}"
        try:
            verify_plan(result.folder)
        except CellError as error:
            yield f"would not be driven: {error}"

    def _coverage(self, result: Run) -> Iterator[str]:
        self.visible_error = result.coverage.visible - independent_visible(result.folder, seed=12345)
        if abs(self.visible_error) > VISIBLE:
            yield f"visible coverage is {100 * self.visible_error:+.2f} points off"


def _unchanged(run: Run, edit: RandomEdit, result: Run) -> Iterator[str]:
    """Check that candidates keep their rows, dropped views are absent, and the order is the requested one."""
    before, after = run.candidates, result.candidates
    if after.T_object_scanner[: len(before)].tobytes() != before.T_object_scanner.tobytes():
        yield "candidates changed"
    if (result.reach.verdict[: len(before)] != run.reach.verdict).any():
        yield "verdicts changed"
    was, now = run.candidate.tolist(), result.candidate.tolist()
    if remaining := [number for number in edit.options.get("drop", ()) if was[number - 1] in now]:
        yield f"view {remaining[0]} is still there"
    changed = {*edit.options.get("drop", ()), *edit.options.get("move", ()), *edit.options.get("turn", ())}
    untouched = [view for number, view in enumerate(was, start=1) if number not in changed]
    if missing := [view for view in untouched if view not in now]:
        yield f"candidate {missing[0]} is lost"
    expected = was if edit.options.get("keep_order") else []
    if "order" in edit.options:
        expected = [was[number - 1] for number in edit.options["order"] if number <= len(was)]
    expected = [view for view in expected if view in untouched]
    if expected and [view for view in now if view in expected] != expected:
        yield "the order is another"
    if result.bound > len(result.q):
        yield "the bound is above the number of views"


def _repaired(run: Run, edit: RandomEdit, result: Run) -> Iterator[str]:
    """Check that a repaired plan reaches its coverage target with the fewest added views.

    HiGHS finds the fewest added views.
    """
    M, reached = result.measurability, result.reach
    matrix, areas = M.matrix().astype(np.float64), M.samples.areas
    banned = {int(run.candidate[number - 1]) for number in edit.options.get("drop", ())} - {*result.candidate.tolist()}
    open_to_all = matrix @ reached.reachable > 0
    target = (result.plan.coverage.target_on_samples or 1.0) * float(areas[open_to_all].sum())
    has = matrix[:, result.candidate].sum(axis=1) > 0
    if float(areas[has].sum()) < target * (1 - 1e-6):
        yield f"repaired to {100 * areas[has].sum() / areas[open_to_all].sum():.3f} % of coverable, not to the target"
    known = len(run.candidates)
    added = [view for view in result.candidate.tolist() if view >= known or view in run.candidate]
    added += [view for view in edit.options.get("add_candidate", ()) if view not in added]
    added = len(result.candidate) - len(added)
    if added < 1 or run.plan.coverage.target_on_samples not in (None, 1.0):
        return
    base = matrix[:, added].sum(axis=1) > 0
    rest = np.flatnonzero(open_to_all & ~base)
    columns = np.array([c for c in np.flatnonzero(reached.reachable) if c not in banned and c not in added])
    block = matrix[rest][:, columns]
    rows = np.asarray(block.sum(axis=1)).ravel() > 0
    best = milp(
        np.ones(len(columns)), integrality=np.ones(len(columns)), bounds=Bounds(0, 1),
        constraints=LinearConstraint(block[rows], lb=1), options={"time_limit": 20.0},
    )  # fmt: skip
    if best.status == 0 and round(best.fun) < added and not result.plan.exclusions:
        yield f"repaired by {added} views, {round(best.fun)} do"
