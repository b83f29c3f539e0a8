"""Random edits of the small plan: what is accepted passes the judge of plans, what is refused is refused truly."""

import importlib.util
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest

from cell.api import open_run
from cell.errors import UnreachableError
from cell.robot.frames import kuka_abc_from_pose, pose_from_kuka_abc

SHOULDER, HEIGHT, UPPER, FORE, WRIST = 0.26, 0.675, 0.68, float(np.hypot(0.67, 0.035)), 0.158  # data sheet [m]


@pytest.fixture(scope="module")
def judge() -> ModuleType:
    """The judge of plans, which reads a run folder alone."""
    path = Path(__file__).with_name("test_plan_against_independent_judge.py")
    spec = importlib.util.spec_from_file_location("independent_judge", path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def near(rng: np.random.Generator, T: np.ndarray) -> list[float]:
    """x, y, z [mm] and A, B, C [deg] of a pose some centimetres and degrees from another."""
    position, abc = kuka_abc_from_pose(T)
    moved = [*(position * 1000 + rng.normal(0, 20, 3)), *(np.degrees(abc) + rng.normal(0, 5, 3))]
    return [float(number) for number in np.round(moved, 2)]


def random_edit(rng: np.random.Generator, run: Any) -> dict[str, Any]:
    """Keywords of an edit: views dropped, moved, turned, added, in another order."""
    n = len(run.candidate)
    numbers = [int(number) for number in rng.permutation(n) + 1]
    edit: dict[str, Any] = {}
    if rng.random() < 0.5:
        edit["drop"] = numbers[:1]
    if rng.random() < 0.4:
        edit["move"] = {numbers[1]: near(rng, run.T_base_scanner[numbers[1] - 1])}
    if rng.random() < 0.4:
        edit["turn"] = {numbers[2]: float(np.round(rng.uniform(-180, 180), 1))}
    if rng.random() < 0.3:
        others = np.setdiff1d(np.arange(run.report.verdicts.total), run.candidate)
        edit["add_candidate"] = [int(rng.choice(others))]
    if rng.random() < 0.3:
        edit["add_pose"] = [near(rng, run.T_base_scanner[numbers[3] - 1])]
    if rng.random() < 0.3:
        edit["keep_order"] = True
    elif not edit or rng.random() < 0.3:
        kept = [number for number in numbers if number not in edit.get("drop", ())]
        added = len(edit.get("add_candidate", ())) + len(edit.get("add_pose", ()))
        edit["order"] = [int(k) for k in rng.permutation([*kept, *range(n + 1, n + 1 + added)])]
    edit["repair"] = bool(rng.random() < 0.3)
    return edit


def asked_poses(edit: dict[str, Any], run: Any, candidates: np.ndarray, T_base_object: np.ndarray) -> list[np.ndarray]:
    """Where the scanner has to be for the views that an edit names anew, base frame."""
    given = [*edit.get("move", {}).values(), *edit.get("add_pose", ())]
    poses = [pose_from_kuka_abc(np.array(each[:3]) / 1000, np.radians(each[3:])) for each in given]
    for number, angle in edit.get("turn", {}).items():
        turned = T_base_object @ candidates[run.candidate[number - 1]]
        poses.append(turned @ pose_from_kuka_abc(np.zeros(3), np.radians([angle, 0, 0])))
    return poses + [T_base_object @ candidates[candidate] for candidate in edit.get("add_candidate", ())]


def wrist_in_reach(T_base_flange: np.ndarray) -> bool:
    """Whether upper arm and forearm can bring the wrist where this flange needs it, facing it or turned away."""
    wrist = T_base_flange[:3, 3] - WRIST * T_base_flange[:3, 2]
    across = np.hypot(*wrist[:2])
    lengths = [np.hypot(across - SHOULDER, wrist[2] - HEIGHT), np.hypot(across + SHOULDER, wrist[2] - HEIGHT)]
    return any(abs(UPPER - FORE) <= length <= UPPER + FORE for length in lengths)


@pytest.mark.parametrize("seed", [*range(3), *(pytest.param(k, marks=pytest.mark.slow) for k in range(3, 60))])
def test_random_edits(
    seed: int, planned: Path, judge: ModuleType, tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch, cache: Path,
) -> None:  # fmt: skip
    """Poses where they were asked for, every check of the judge, order as told; or the condition that fails."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(cache))
    rng, run = np.random.default_rng(seed), open_run(planned)
    before = judge.files_of(planned)
    candidates = before["viewpoints"]["T_object_scanner"][:, 0]
    T_base_object = np.array(before["scene.resolved"]["T_base_object"])
    T_scanner_flange = np.linalg.inv(before["scene.resolved"]["T_flange_scanner"])
    edit = random_edit(rng, run)
    poses = asked_poses(edit, run, candidates, T_base_object)
    made, refused = None, ""
    try:
        made = run.edited(out=tmp_path / "edited", **edit)
    except UnreachableError as error:
        refused = str(error)
    if made is None:
        out = [not wrist_in_reach(T @ T_scanner_flange) for T in poses]
        if "out of the arm's reach" in refused:
            assert any(out), refused
        else:
            assert not all(out), refused
            assert "joint limit" in refused or " with " in refused or "path" in refused, refused
        return
    after = judge.files_of(made.folder)
    judge.test_every_view_is_where_its_joint_angles_put_it(after)
    judge.test_the_motion_visits_every_view_from_home_and_back(after)
    judge.test_the_motion_keeps_every_limit(after)
    judge.test_the_motion_touches_nothing_when_checked_ten_times_finer(after)
    judge.test_predicted_coverage_is_true_by_brute_force(after)
    for T in poses:  # each pose that was asked for is a view, within what rounded joint angles leave
        apart = np.linalg.norm(made.T_base_scanner[:, :3, 3] - T[:3, 3], axis=1)
        assert apart.min() < 20e-6
        assert np.abs(made.T_base_scanner[apart.argmin()] - T).max() < 1e-4
    for name, rows in before["viewpoints"].items():
        assert after["viewpoints"][name][: len(rows)].tobytes() == rows.tobytes()
    assert (after["reach"]["verdict"][: len(candidates)] == before["reach"]["verdict"]).all()
    for number in edit.get("drop", ()):
        assert run.candidate[number - 1] not in made.candidate
    kept = [c for c in run.candidate if c in made.candidate]
    if edit.get("keep_order"):
        assert [c for c in made.candidate if c in kept] == kept
    if "order" in edit:
        told = [run.candidate[number - 1] for number in edit["order"] if number <= len(run.candidate)]
        assert [c for c in made.candidate if c in kept] == [c for c in told if c in kept]
    if edit["repair"]:
        assert made.plan.coverage.planned_on_features >= run.plan.coverage.planned_on_features - 0.002
    assert made.bound <= len(made.q)
