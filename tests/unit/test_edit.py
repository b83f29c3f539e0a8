"""Edits of a plan: accepted values, refused values, and edits without effect."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from cell.api import edit as make_edit
from cell.api import open_run
from cell.errors import UnreachableError, UsageError
from cell.plan.edit import Neighbourhood
from cell.plan.edit_options import Edit, Move, Pose, Turn
from cell.runs.run import Run
from cell.scene.options import flag, parse_options
from planner.kinematics.frames import kuka_abc_from_pose

POSE = (812.0, 430.0, 655.0, 90.0, 0.0, 180.0)


@pytest.fixture(autouse=True)
def _own_cache(monkeypatch: pytest.MonkeyPatch, cache: Path) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(cache))


@pytest.mark.parametrize(
    "options",
    [
        {"drop": "4,7", "move": "7:812,430,655,90,0,180,8:812,430,655,90,0,180", "turn": "1:90,2:-45.5"},
        {"drop": [4, 7], "move": {7: POSE, 8: POSE}, "turn": {1: 90, 2: -45.5}},
        {"drop": np.array([4, 7]), "move": [(7, *POSE), (8, *POSE)], "turn": [(1, 90), (2, -45.5)]},
    ],
    ids=["texts", "tables", "sequences"],
)
def test_texts_and_values_say_the_same(options: dict[str, Any]) -> None:
    """Texts, tables and sequences give the same edit. A view that is edited twice is refused."""
    with pytest.raises(UsageError, match="view 7 twice"):
        parse_options(Edit, options)
    edit = parse_options(Edit, options | {"drop": 4})
    assert edit.drop == (4,)
    assert edit.move == (Move(7, Pose(*POSE)), Move(8, Pose(*POSE)))
    assert edit.turn == (Turn(1, 90.0), Turn(2, -45.5))


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"move": "7:1,2,3"}, "--move 7:1,2,3 must be number:x,y,z,a,b,c"),
        ({"turn": "1.5:90"}, "--turn 1.5:90 must be number:angle"),
        ({"turn": "x"}, "--turn x must be number:angle"),
        ({"add_pose": "1,2,3,4,5"}, "--add-pose 1,2,3,4,5 must be x,y,z,a,b,c"),
        ({"drop": "0"}, "--drop.*must be at least 1"),
        ({"order": "1,2,2"}, "view 2 twice"),
        ({"order": "1,2", "keep_order": True}, "give one of them"),
        ({"drop": "1", "turn": "1:90"}, "view 1 twice"),
        ({"drop": "1", "table_angle": 30}, "concerns the poses of move and add_pose"),
    ],
)
def test_invalid_edits_are_refused(options: dict[str, Any], message: str) -> None:
    """An invalid edit is refused with one sentence that contains the option as the user wrote it."""
    with pytest.raises(UsageError, match=message):
        parse_options(Edit, options, flag)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (lambda views: {"drop": 99}, "drop names view 99; the plan has the views 1 to {views}"),
        (lambda views: {"add_candidate": 9999}, "no candidate 9999 to add; there are candidates 0 to {last_candidate}"),
        (lambda views: {"order": [2, 1]}, "the order leaves out 3"),
        (lambda views: {"order": [*range(1, 30)]}, "the order names {one_more}"),
        (lambda views: {"drop": [*range(1, views + 1)]}, "leaves no view"),
    ],
)
def test_missing_views_are_refused_before_a_folder_is_made(
    options: Callable[[int], dict[str, Any]], message: str, planned: Path, tmp_path: Path
) -> None:
    """Views and candidates that the plan does not have are refused with its own numbers, before a folder is made."""
    run = open_run(planned)
    views, last = len(run.candidate), run.report.verdicts.total - 1
    with pytest.raises(UsageError, match=message.format(views=views, one_more=views + 1, last_candidate=last)):
        make_edit(run, out=tmp_path / "edited", **options(views))
    assert not list(tmp_path.iterdir())


_LONG = [pytest.param(options, marks=pytest.mark.slow) for options in ({}, {"keep_order": True})]


@pytest.mark.parametrize("options", [{"turn": {2: 360}}, "its order", *_LONG])
def test_an_edit_that_changes_nothing_changes_nothing(
    options: dict[str, Any] | str, planned: Path, tmp_path: Path
) -> None:
    """An edit without effect keeps the views, their order and the bytes of the artefacts."""
    run = open_run(planned)
    requests = {"order": [*range(1, len(run.candidate) + 1)]} if isinstance(options, str) else options
    same = make_edit(run, out=tmp_path / "same", **requests)
    names = ("viewpoints.npz", "reach.npz", "measurability.npz", "reference.ply", "planning.ply")
    for name in (*names, "cell.xml", "scene.toml"):
        assert (same.folder / name).read_bytes() == (planned / name).read_bytes(), name
    assert same.candidate.tolist() == run.candidate.tolist()
    assert same.coverage == run.coverage
    assert same.scene.as_json() == run.scene.as_json()


def test_a_view_in_collision_is_refused_with_the_pair(planned: Path, tmp_path: Path) -> None:
    """A view with the scanner inside the part is refused with its number and the pair in collision."""
    run = open_run(planned)
    reached = run.reach
    assert reached.reachable[run.candidate[0]]
    deeper = run.T_base_scanner[0, :3, 3] + 0.26 * run.T_base_scanner[0, :3, 2]
    a, b, c = np.degrees(kuka_abc_from_pose(run.T_base_scanner[0])[1])
    with pytest.raises(UnreachableError, match=r"view 1 cannot be used: .* collides \(\w+ with part\)"):
        make_edit(run, out=tmp_path / "edited", move={1: (*(deeper * 1000), a, b, c)})


def test_a_pose_that_is_a_view_already_is_refused(planned: Path, tmp_path: Path) -> None:
    """A pose that is a view of the plan already cannot be added."""
    run = open_run(planned)
    with pytest.raises(UsageError, match=f"view {len(run.candidate) + 1} would have the same pose as view 3"):
        make_edit(run, out=tmp_path / "edited", add_candidate=int(run.candidate[2]))


def test_a_pose_is_added_to_a_part_at_another_placement(planned: Path, tmp_path: Path) -> None:
    """A new pose is a candidate behind the last one, measured at the new placement like all others."""
    run = open_run(planned)
    T = run.scene.T_base_object.copy()
    T[0, 3] += 0.005
    a, b, c = np.degrees(kuka_abc_from_pose(run.T_base_scanner[0])[1])
    pose = (*(1000 * run.T_base_scanner[0, :3, 3] + [9.0, 0.0, 1.0]), a, b, c)
    made = make_edit(run, T_base_object=T, add_pose=[pose], out=tmp_path / "there")
    last = len(run.candidates)
    assert sorted(made.candidate) == [*sorted(run.candidate), last]
    stop = made.candidate.tolist().index(last)
    assert 1000 * made.T_base_scanner[stop, :3, 3] == pytest.approx(np.array(pose[:3]), abs=0.01)
    assert made.plan.views[stop].id == last


@pytest.fixture(scope="module")
def without(planned: Path, tmp_path_factory: pytest.TempPathFactory) -> Run:
    """Return the plan without its second view."""
    return make_edit(open_run(planned), drop=[2], out=tmp_path_factory.mktemp("edit") / "without")


@pytest.fixture(scope="module")
def repaired(without: Run, tmp_path_factory: pytest.TempPathFactory) -> Run:
    """Return the plan without its second view after a later repair."""
    return make_edit(without, repair=True, out=tmp_path_factory.mktemp("edit") / "repaired")


def test_a_dropped_view_can_be_put_back(planned: Path, without: Run, repaired: Run, tmp_path: Path) -> None:
    """Candidates keep their numbers through repeated edits. A later repair does not bring the dropped view back."""
    run = open_run(planned)
    assert without.coverage.visible < run.coverage.visible
    assert without.bound == 1
    back = make_edit(without, add_candidate=int(run.candidate[1]), out=tmp_path / "back")
    assert sorted(back.candidate) == sorted(run.candidate)
    # Another order has other configurations, whose rounded set-points move samples at the limits in or out.
    assert back.coverage.visible == pytest.approx(run.coverage.visible, abs=5e-4)
    assert run.candidate[1] not in repaired.candidate
    assert set(without.candidate) < set(repaired.candidate)
    assert without.coverage.planned_on_samples < repaired.coverage.planned_on_samples
    assert repaired.coverage.planned_on_samples <= run.coverage.planned_on_samples + 1e-9


def test_the_neighbourhood_of_a_view_is_bounded_by_distance_and_viewing_angle() -> None:
    """A turn about the viewing axis does not leave it. A neighbourhood without extent holds the pose alone."""

    def at(x_mm: float, tilt_deg: float, roll_deg: float) -> np.ndarray:
        T = np.eye(4)
        T[:3, :3] = Rotation.from_euler("xz", [tilt_deg, roll_deg], degrees=True).as_matrix()
        T[0, 3] = x_mm / 1000
        return T

    poses = np.stack([at(0, 0, 0), at(0, 0, 90), at(49.9, 19.9, 0), at(50.1, 0, 0), at(0, 20.1, 0)])
    near = Neighbourhood(poses[:1], 0.05, np.radians(20))
    assert near.contains(poses).tolist() == [True, True, True, False, False]
    assert Neighbourhood(poses[:1], 0.0, 0.0).contains(poses).tolist() == [True, False, False, False, False]


def test_a_repair_stays_away_from_the_dropped_view(planned: Path, repaired: Run, tmp_path: Path) -> None:
    """No added view is within 50 mm and 20 deg of the dropped one, also if the repair is a later edit."""
    run = open_run(planned)
    dropped = run.candidates.T_object_scanner[run.candidate[1], 0]

    def nearest(result: Any) -> list[tuple[float, float]]:
        added = np.setdiff1d(result.candidate, run.candidate)
        T = result.candidates.T_object_scanner[added, 0]
        apart = 1000 * np.linalg.norm(T[:, :3, 3] - dropped[:3, 3], axis=1)
        angle = np.degrees(np.arccos(np.clip(T[:, :3, 2] @ dropped[:3, 2], -1, 1)))
        return list(zip(apart, angle, strict=True))

    at_once = make_edit(run, drop=[2], repair=True, out=tmp_path / "at_once")
    for result in (at_once, repaired):
        assert run.candidate[1] not in result.candidate
        assert nearest(result)
        assert all(apart > 50 or angle > 20 for apart, angle in nearest(result))
    assert set(at_once.report.settings.banned or ()) == set(repaired.report.settings.banned or ())
    alone = make_edit(run, drop=[2], dropped_range="0mm,0deg", repair=True, out=tmp_path / "alone")
    assert alone.report.settings.banned == (run.candidate[1],)
    assert len(alone.candidate) <= len(at_once.candidate)
    wide = make_edit(run, drop=[2], dropped_range={"mm": 5000, "deg": 180}, repair=True, out=tmp_path / "wide")
    assert set(wide.candidate) < set(run.candidate)
    assert wide.exit_code == 3
