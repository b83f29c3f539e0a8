"""Claims of `cell why` against plans with the change: a plate with a void, a clamp and sides out of reach."""

import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh

from cell.cli.terminal import Terminal
from cell.robot.arm import kinematics_of
from cell.runs.run import Run, open_run
from cell.scanners.laser_area import LaserArea
from cell.scene.file import load_scene
from cell.scene.model import Scene
from cell.view.palette import MEASURED, REASONS
from cell.why import explain
from cell.why import explain as why
from cell.why.explain import Analysis, Group
from cell.world.collision import MujocoCollisionChecker
from cell.world.embree import EmbreeRayCaster
from cell.world.model import World, compile_world
from cell.world.occluders import fixed_occluders
from planner.kinematics import reach
from planner.measurability import coverage
from planner.viewpoints.viewpoints import Viewpoints, optimal_scanning_zone
from planner.why.what_if import ChangeKind
from planner.why.why import Reason
from tests.support.fixture_types import RunCommand

_SCENE = """
[[fixtures]]
name = "clamp"
shape = "box"
size_mm = [50, 40, 6]
position_mm = [20, 0, 36]
attached_to = "object"
"""
_PLACE = "1350,0,0"
_SAMPLES = 6000


@pytest.fixture(scope="module")
def run_folder(tmp_path_factory: pytest.TempPathFactory, run_cell: RunCommand) -> Path:
    """Return a plan of 60 % of the coverable area of a plate (100 x 80 x 40 mm) with a void (40 x 30 x 12 mm)."""
    home = tmp_path_factory.mktemp("why")
    outer = trimesh.creation.box((100, 80, 40)).subdivide().subdivide()
    void = trimesh.creation.box((40, 30, 12)).subdivide()
    void.invert()
    trimesh.util.concatenate([outer, void]).export(home / "plate.stl")
    (home / "scene.toml").write_text(_SCENE)
    options = ["--faces", "200", "--samples", "2", "--standoff", "250", "--coverage", "0.6", "--out", "run"]
    options += ["--sensor", "generic-area-large", "--candidates", "optimal-scanning-zone"]
    run_cell(
        "plan", "plate.stl", "--units", "mm", "--scene", "scene.toml", "--place", _PLACE, *options, cwd=home, code=0
    )
    return home / "run"


@pytest.fixture(scope="module")
def run(run_folder: Path) -> Run:
    """Return the opened run."""
    return open_run(run_folder)


@pytest.fixture(scope="module")
def answer(run: Run) -> Analysis:
    """Return the analysis of the run."""
    return why.analyse(run, Terminal(quiet_stdout=True), _SAMPLES)


def _group(answer: Analysis, reason: Reason, what: str) -> Group:
    found = [group for group in answer.groups if (group.reason, group.what) == (reason, what)]
    assert len(found) == 1, [(group.reason.name, group.what) for group in answer.groups]
    return found[0]


def test_a_closed_void_is_occluded_by_the_part_and_no_change_helps(answer: Analysis) -> None:
    """All samples of the void and no others, with the area of the void; no change is named."""
    group = _group(answer, Reason.SOURCE_SHADED_BY_PART, "part")
    inside = (np.abs(answer.samples.points) < np.array([0.0201, 0.0151, 0.0061])).all(axis=1)
    np.testing.assert_array_equal(np.flatnonzero(inside), group.rows)
    area = 2 * (0.04 * 0.03 + 0.04 * 0.012 + 0.03 * 0.012)
    np.testing.assert_allclose(answer.samples.areas[group.rows].sum(), area, rtol=0.01)
    assert group.changes == ()
    assert [row[3] for row in explain.table_rows(explain.why_report(answer, _NO_RUN)) if "part" in row[0]] == [
        explain.NO_CHANGE
    ]


class _NoRun:
    plan_sha256 = ""


_NO_RUN = _NoRun()


def test_the_surface_under_the_clamp_is_gained_without_it(answer: Analysis) -> None:
    """The group is under the clamp, on the top. The change "without fixture clamp" gains all of it."""
    for group in answer.groups:
        if group.what != "clamp":
            continue
        points = answer.samples.points[group.rows]
        assert (points[:, 2] > 0.0199).all()
        assert (np.abs(points[:, :2] - [0.02, 0]) < [0.03, 0.025]).all()
        without = [
            recommendation for recommendation in group.changes if recommendation.change.kind is ChangeKind.FIXTURE
        ]
        assert [recommendation.change.sentence for recommendation in without] == ["without fixture clamp"]
        assert without[0].gained[group.rows].all()
        return
    pytest.fail("the clamp occludes nothing")


def test_sides_out_of_reach_and_views_that_are_not_needed_are_distinguished(answer: Analysis) -> None:
    """The far side is out of reach; below full coverage some surface only needs one more view."""
    assert (answer.samples.points[_group(answer, Reason.OUT_OF_REACH, "").rows, 0] > -0.0499).any()
    waiting = _group(answer, Reason.NOT_SELECTED, "")
    assert {recommendation.change.kind for recommendation in waiting.changes} == {ChangeKind.VIEW}
    assert answer.share(waiting.rows) > 0.02


def test_the_groups_and_the_measured_samples_are_the_surface(answer: Analysis, run: Run) -> None:
    """Each sample is measured or in exactly one group and patch; the share equals the plan's to sampling error."""
    count = answer.covered.astype(int)
    for group in answer.groups:
        count[group.rows] += 1
        np.testing.assert_array_equal(np.sort(np.concatenate([p.rows for p in group.patches])), group.rows)
    assert (count == 1).all()
    planned = run.plan.coverage.visible
    assert abs(answer.covered.mean() - planned) < 4 * np.sqrt(planned * (1 - planned) / _SAMPLES)


class _Cell:
    """The scene with a change, built by the public functions."""

    def __init__(self, run: Run, scene: Scene) -> None:
        self.reference, self.planning = run.mesh("reference.ply"), run.mesh("planning.ply")
        self.world: World = compile_world(scene, self.reference.vertices, baseline_mm=62.5)
        part = EmbreeRayCaster(self.reference.vertices, self.reference.faces)
        self.casters = [part, *(EmbreeRayCaster(o.vertices, o.faces) for o in fixed_occluders(self.world))]

    def measured(self, views: Viewpoints, scanner: LaserArea, answer: Analysis) -> np.ndarray:
        reached = reach.solve_reach(
            views, self.world.T_base_object, self.world.T_flange_scanner,
            kinematics_of(self.world.model), MujocoCollisionChecker(self.world),
        ).reachable  # fmt: skip
        return coverage.visible_coverage(views.T_object_scanner[reached], answer.samples, scanner, self.casters).covered


def test_every_named_change_measures_the_claimed_share(answer: Analysis, run: Run, run_folder: Path) -> None:
    """Settings are taken from the printed options, the scene is built from its file, reach is computed again."""
    path = run_folder.parent / "scene.toml"
    place = [float(value) for value in _PLACE.split(",")]
    views = run.candidates
    limits = dict(run.scene.scanner.own)
    seen = set()
    for group in answer.groups:
        changes = [*((recommendation, group.rows) for recommendation in group.changes)]
        changes += [(patch.change, patch.rows) for patch in group.patches if patch.change is not None]
        for recommendation, rows in changes:
            change = recommendation.change
            options = {"position_mm": place}
            scene = load_scene(path, {"placement": options})
            candidates, parameters = views, dict(limits)
            match change.kind:
                case ChangeKind.FIXTURE if "clamp" in change.sentence:
                    scene = load_scene(None, {"placement": options})
                case ChangeKind.FIXTURE:
                    scene = scene.model_copy(update={"post": scene.post.model_copy(update={"enabled": False})})
                case ChangeKind.TURN:
                    numbers = [float(value) for value in change.setting.rpartition("--place ")[2].split(",")]
                    scene = load_scene(path, {"placement": {"position_mm": numbers[:3], "abc_deg": numbers[3:]}})
                case ChangeKind.STANDOFF | ChangeKind.ROLL:
                    numbers = [float(value) for value in change.setting.split()[1].split(",")]
                    standoffs = [n / 1000 for n in numbers] if change.kind is ChangeKind.STANDOFF else [0.25]
                    rolls = np.radians(numbers if change.kind is ChangeKind.ROLL else [0, 90]).tolist()
                    candidates = optimal_scanning_zone(run.mesh("planning.ply"), standoffs, rolls)
                case ChangeKind.VIEW:
                    indices = [int(n) for n in re.findall(r"\d+", change.sentence.split("candidate")[1])]
                    candidates = Viewpoints(*(getattr(views, name)[indices] for name in _FIELDS))
                case ChangeKind.AIMED:
                    T = change.T_object_scanner
                    candidates = Viewpoints(T, np.full(len(T), -1), np.full(len(T), 0.25), np.zeros(len(T)))
                case _:
                    name, value = change.setting.removeprefix("scanner.").split(" = ")
                    parameters[name] = json.loads(value)
            now = _Cell(run, scene).measured(candidates, LaserArea(**parameters), answer)
            np.testing.assert_array_equal(now[rows] | ~recommendation.gained[rows], True, err_msg=change.sentence)
            assert recommendation.gained[rows].any()
            seen.add(change.kind)
    assert {ChangeKind.VIEW, ChangeKind.AIMED, ChangeKind.FIXTURE, ChangeKind.TURN} <= seen


_FIELDS = ("T_object_scanner", "face", "standoff", "roll")


@pytest.mark.usefixtures("drawn_pictures")
def test_the_files_repeat_and_the_plan_is_unchanged(
    run_folder: Path, run: Run, data_of: Callable[[str], dict[str, Any]]
) -> None:
    """Two runs give the same bytes in why/, and the page's first colours have the shares of why.json."""
    contents = []
    for _ in range(2):
        outcome = why.explain(run_folder, Terminal(quiet_stdout=True), samples=1500)
        contents.append({path.name: path.read_bytes() for path in sorted(outcome.folder.iterdir())})
    assert contents[0] == contents[1]
    assert set(contents[0]) == {"view.html", "why.json", "why.ply", "why.png"}
    layer = data_of(contents[0]["view.html"].decode())["surfaces"][0]["layers"][0]
    groups, seen = outcome.summary.groups, 1 - outcome.summary.uncovered
    message = [("measured", seen), *((group.title, group.share) for group in groups)]
    assert 1 < len(message) <= len(REASONS)
    assert [name for name, _ in layer["named"]] == [f"{name} ({100 * share:.2f}\u00a0%)" for name, share in message]
    assert [colour for _, colour in layer["named"]] == [MEASURED, *REASONS[: len(groups)]]
    for name in run.manifest.artefacts:
        run.artefact(name)


def test_points_have_reason_group_and_gain(run_folder: Path) -> None:
    """Another program can read why.ply: each sample in mm, and the counts of why.json."""
    outcome = why.explain(run_folder, Terminal(quiet_stdout=True), samples=1500)
    cloud = trimesh.load(outcome.folder / "why.ply", process=False)
    assert len(cloud.vertices) == 1500
    np.testing.assert_allclose(np.ptp(cloud.vertices, axis=0), [100, 80, 40], atol=0.5)
    content = (outcome.folder / "why.ply").read_bytes().split(b"end_header\n", 1)[1]
    kinds = [(n, "<f8") for n in "xyz"] + [(n, "u1") for n in ("r", "g", "b", "reason")]
    points = np.frombuffer(content, dtype=[*kinds, ("group", "<u2"), ("gained", "u1")])
    for group in outcome.summary.groups:
        here = points["group"] == group.group
        assert (points["reason"][here] == group.code).all()
        np.testing.assert_allclose(here.mean(), group.share, atol=1e-9)
        gained = group.changes[0].gain if group.changes else 0.0
        np.testing.assert_allclose(points["gained"][here].mean(), gained, atol=1e-9)
    assert (points["reason"][points["group"] == 0] == 0).all()
