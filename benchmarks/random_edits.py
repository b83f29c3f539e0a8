"""Random edits of a finished plan, some of them invalid on purpose, and their requested poses.

Every edit depends only on its random stream and the plan. Base frame, metres; user inputs in mm and degrees.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from cell.runs.run import Run
from planner.kinematics.frames import kuka_abc_from_pose, pose_from_kuka_abc
from planner.values import Floats

_WRONG = 0.08  # share of invalid edits
_NEAR, _FAR = (20.0, 5.0), (150.0, 25.0)  # mm and deg, one sigma each: most edits are accepted, many are refused
_SHARE_FAR, _SHARE_REACHABLE = 0.2, 0.8


@dataclass(frozen=True, slots=True, eq=False)
class RandomEdit:
    """An edit and its expected result.

    Attributes:
        options: keyword arguments of `cell.api.edit`.
        poses: (4, 4) T_base_scanner of each changed or added view, by its name in refusals.
        wrong: required text of the refusal; "" if the edit is valid by construction.
    """

    options: dict[str, Any]
    poses: Mapping[str, Floats] = field(default_factory=dict)
    wrong: str = ""

    @property
    def command_line(self) -> str:
        """Return the options as on the command line, without values."""
        return " ".join(f"--{key.replace('_', '-')}" for key, value in self.options.items() if value is not False)


def random_edit(rng: np.random.Generator, run: Run) -> RandomEdit:
    """Draw an edit: drop, move, turn, add or reorder views, with and without repair.

    Args:
        rng: random stream.
        run: a finished plan of at least four views.
    """
    if rng.random() < _WRONG:
        return _wrong(rng, run)
    n = len(run.candidate)
    numbers = [int(number) for number in rng.permutation(n) + 1]
    options: dict[str, Any] = {}
    if rng.random() < 0.5:
        options["drop"] = numbers[: int(rng.integers(1, 3))]
    if rng.random() < 0.4:
        options["move"] = {numbers[2]: _beside(rng, run.T_base_scanner[numbers[2] - 1])}
    if rng.random() < 0.4:
        options["turn"] = {numbers[3]: float(np.round(rng.uniform(-180, 180), 1))}
    if rng.random() < 0.3:
        among = run.reach.reachable
        among = among if rng.random() < _SHARE_REACHABLE else np.ones_like(among)
        others = np.setdiff1d(np.flatnonzero(among), run.candidate)
        options["add_candidate"] = [int(rng.choice(others))]
    if rng.random() < 0.3:
        options["add_pose"] = [_beside(rng, run.T_base_scanner[numbers[0] - 1])]
    if rng.random() < 0.3:
        options["keep_order"] = True
    elif not options or rng.random() < 0.3:
        remaining = [number for number in numbers if number not in options.get("drop", ())]
        added = len(options.get("add_candidate", ())) + len(options.get("add_pose", ()))
        options["order"] = [int(k) for k in rng.permutation([*remaining, *range(n + 1, n + 1 + added)])]
    options["repair"] = bool(rng.random() < 0.4)
    return RandomEdit(options, _poses(options, run))


def _beside(rng: np.random.Generator, T: Floats) -> list[float]:
    """Return x, y, z [mm] and A, B, C [deg] of a pose near another pose, some of them about 150 mm away."""
    mm, degrees = _FAR if rng.random() < _SHARE_FAR else _NEAR
    position, abc = kuka_abc_from_pose(T)
    moved = [*(position * 1000 + rng.normal(0, mm, 3)), *(np.degrees(abc) + rng.normal(0, degrees, 3))]
    return [float(number) for number in np.round(moved, 2)]


def _wrong(rng: np.random.Generator, run: Run) -> RandomEdit:
    """Return an edit that names an absent view or candidate, or one view twice."""
    n, total = len(run.candidate), run.report.verdicts.total
    twice = int(rng.integers(n))
    cases = (
        ({"drop": [n + 3]}, f"view {n + 3}; the plan has the views 1 to {n}"),
        ({"turn": {n + 1: 90.0}}, f"view {n + 1}; the plan has the views 1 to {n}"),
        ({"add_candidate": [total]}, f"no candidate {total} to add; there are candidates 0 to {total - 1}"),
        ({"add_candidate": [int(run.candidate[twice])]}, f"view {n + 1} would have the same pose as view {twice + 1}"),
        ({"order": list(range(n, 1, -1))}, "the order leaves out 1"),
        ({"drop": list(range(1, n + 1))}, "leaves no view"),
        ({"drop": [2], "turn": {2: 90.0}}, "view 2 twice"),
    )
    options, message = cases[rng.integers(len(cases))]
    return RandomEdit(options, wrong=message)


def _poses(options: dict[str, Any], run: Run) -> dict[str, Floats]:
    """Return the requested scanner pose of each changed or added view."""
    candidates = run.candidates.T_object_scanner[:, 0]
    T_base_object = run.scene.T_base_object

    def as_pose(each: list[float]) -> Floats:
        T: Floats = pose_from_kuka_abc(np.array(each[:3]) / 1000, np.radians(each[3:]))
        return T

    poses = {f"view {number}": as_pose(each) for number, each in options.get("move", {}).items()}
    poses |= {f"added pose {k}": as_pose(each) for k, each in enumerate(options.get("add_pose", ()), start=1)}
    for number, angle in options.get("turn", {}).items():
        about = pose_from_kuka_abc(np.zeros(3), np.radians([angle, 0.0, 0.0]))
        poses[f"view {number}"] = T_base_object @ candidates[run.candidate[number - 1]] @ about
    return poses | {f"candidate {k}": T_base_object @ candidates[k] for k in options.get("add_candidate", ())}
