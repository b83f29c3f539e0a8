"""State of an exploration: interrupted folders, plausibility of points, policies, limits and stored knowledge."""

from dataclasses import dataclass, replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import trimesh
from scipy.sparse import csr_array

from cell.errors import FileError, UnreachableError
from cell.explore import belief, report, stage
from cell.explore.explore import _belief_gain_ratio, _finish, _min_range_history, require_plausible
from cell.explore.frustum import SensorFrustum
from cell.explore.options import ExploreOptions
from cell.explore.policy import POLICIES, Batch, ExplorationState
from cell.explore.prepare import initial_file, prepare_exploration
from cell.explore.state import Belief, ExplorationFolder
from cell.part import mesh_files
from cell.runs.schema import BELIEVED, MEASURED, ExploreFile
from cell.scan.options import ScanOptions
from cell.scanners.laser_area import LaserArea
from cell.scene.file import scene_from_options
from cell.scene.model import Scene
from cell.session import Session
from planner.explore.gain import GainRecord
from planner.explore.space import FREE, UNKNOWN, VoxelSpace
from planner.geometry.closest import ClosestPointQuery
from planner.geometry.mesh import TriangleMesh
from planner.values import Floats
from planner.viewpoints.viewpoints import aim_viewpoints


def _scene(**settings: float) -> Scene:
    return scene_from_options(None, {"place": (1100, 400, 100), **settings}, "mug")


def _eye() -> SensorFrustum:
    """Return the frustum of a scanner with rays one degree apart."""
    scanner = LaserArea(fov_deg=(30, 30), resolution_deg=(1.0, 1.0), range_mm=(100, 900))
    rays = np.asarray(scanner.ray_directions())
    apart = float(np.arccos(rays[0] @ rays[1]))
    return SensorFrustum(
        np.asarray(scanner.source), np.asarray(scanner.sensor), rays, scanner.grid_shape[1], 0.1, 0.9, apart
    )


def _begun(root: Path) -> ExploreFile:
    return initial_file(prepare_exploration(Session(None, out=root), _scene(), ExploreOptions(), ScanOptions()))


@pytest.mark.parametrize("left", [(), ("stages",), ("stages", "explore.json.tmp")])
def test_a_kill_before_the_first_explore_json_is_gone_on_after(left: tuple[str, ...], tmp_path: Path) -> None:
    """A folder that was interrupted before its first explore.json can be continued."""
    root = tmp_path / "explored"
    for name in left:
        (root / "stages").mkdir(parents=True, exist_ok=True)
        if name != "stages":
            (root / name).write_text('{"half')
    file = _begun(root)
    assert ExplorationFolder(root).begin(file) == file
    assert ExplorationFolder(root).begin(file) == file  # read back from its own file
    assert ExplorationFolder(root).file.is_file()


def test_a_folder_of_something_else_is_left_alone(tmp_path: Path) -> None:
    """A folder with other files is refused, and nothing is written into it."""
    (tmp_path / "notes.txt").write_text("mine")
    with pytest.raises(FileError, match="not an exploration"):
        ExplorationFolder(tmp_path).begin(_begun(tmp_path))
    assert [path.name for path in tmp_path.iterdir()] == ["notes.txt"]


@pytest.mark.parametrize(
    ("points", "message"),
    [
        (np.empty((0, 3)), "no ray of stages/0001 hit a surface"),
        (np.tile([[0.2, 0.0, 0.0]], (5, 1)), "outside the cylinder"),
        (np.tile([[0.0, 0.0, 0.0]], (5, 1)), "the part was moved"),
    ],
    ids=["nothing hit", "outside its cylinder", "moved"],
)
def test_points_that_cannot_be_stop_an_exploration(points: Floats, message: str) -> None:
    """Implausible points stop an exploration with one sentence on the cause."""
    space = VoxelSpace.from_cylinder(0.1, 0.1, 0.004, 0.003)
    space = replace(space, state=np.full_like(space.state, FREE))
    with pytest.raises(FileError, match=message):
        require_plausible(space, Path("stages/0001"), [(points, np.eye(4))], _eye())


@pytest.mark.parametrize(("away", "message"), [(0.0, False), (0.006, False), (0.02, True), (-0.02, False)])
def test_a_part_that_was_moved_away_stops_an_exploration(away: float, message: bool) -> None:
    """A plate found farther away is reported as moved, because its rays pass the known points."""
    eye, T = _eye(), np.diag([1.0, -1.0, -1.0, 1.0])
    T[2, 3] = 0.4

    def plate(height: float) -> Floats:
        rays = eye.rays @ T[:3, :3].T
        points = T[:3, 3] + rays * ((height - T[2, 3]) / rays[:, 2:])
        return np.asarray(points[np.abs(points[:, :2]).max(axis=1) < 0.05])

    space = VoxelSpace.from_cylinder(0.1, 0.1, 0.004, 0.003).with_points(plate(0.01), [])
    views = [(plate(0.01 - away), T)]
    if not message:
        require_plausible(space, Path("stages/0002"), views, eye)
        return
    assert space.contradicted_share(views[0][0]) == 0
    views.append((plate(0.01), T))  # one view of a batch is sufficient
    with pytest.raises(FileError, match=r"100.0 % of the known points .* were not measured again; the part was moved"):
        require_plausible(space, Path("stages/0002"), views, eye)


def test_invisible_points_are_no_sign_of_motion() -> None:
    """Known points below the range, beyond the outline or fewer than 100 give no share of passed points."""
    eye, T = _eye(), np.diag([1.0, -1.0, -1.0, 1.0])
    T[2, 3] = 0.4
    rays = eye.rays @ T[:3, :3].T
    wall = T[:3, 3] + rays * ((0.0 - T[2, 3]) / rays[:, 2:])
    before = T[:3, 3] + 0.75 * (wall - T[:3, 3])
    assert eye.passed(before, wall, T, 0.01) == 1.0
    assert eye.passed(before, wall, T, 0.2) == 0.0
    assert eye.passed(T[:3, 3] + 0.2 * (wall - T[:3, 3]), wall, T, 0.01) == 0.0
    assert eye.passed(before[:99], wall, T, 0.01) == 0.0
    assert eye.passed(before, wall[::3], T, 0.01) == 0.0
    assert eye.passed(before[:0], wall, T, 0.01) == eye.passed(before, wall[:0], T, 0.01) == 0.0


def test_a_later_batch_without_points_is_accepted() -> None:
    """After a first hit, a batch without points is accepted, and its rays add votes to the voxels."""
    space, stand = VoxelSpace.from_cylinder(0.1, 0.1, 0.004, 0.003), np.array([0.3, 0.0, 0.0])
    space, nothing = space.with_points(np.zeros((1, 3)), [stand]), np.empty((0, 3))
    require_plausible(space, Path("stages/0002"), [(nothing, np.eye(4))], _eye())
    after = space.with_points(nothing, [stand]).with_votes(nothing, stand, stand, np.array([[-1.0, 0, 0]]), 0.1, 0.5)
    assert np.array_equal(after.state, space.state)
    assert after.votes.max() == 2
    assert not space.is_new(nothing).any()


def test_limits_hold_in_the_fine_stage_alone() -> None:
    """The rough stage of two-stage has no limits. Its fine stage and all stages of stepwise have them."""
    scene = _scene(max_sigma=0.05, max_spacing=1.0)
    assert report.has_limits(scene)
    rough = report.without_limits(scene)
    assert not report.has_limits(rough)
    assert rough.plan.model_copy(update={"max_sigma_mm": 0.05}) == scene.plan
    batches = {
        name: [policy(ExploreOptions(), ExplorationState(n, None)) for n in (0, 1)] for name, policy in POLICIES.items()
    }
    output = {name: [[batch.rough for batch in batch_list] for batch_list in each] for name, each in batches.items()}
    assert output == {"stepwise": [[False], [False] * 2], "two-stage": [[True], [False] * 4]}
    limited = [POLICIES["two-stage"](ExploreOptions(), ExplorationState(n, 7, limited=True)) for n in (1, 2)]
    assert limited[0] == (Batch(7, include_covered=True),)
    assert not any(batch.include_covered for batch in limited[1])


def test_stepwise_begins_with_one_view_and_goes_on_with_the_surface_that_it_was_on() -> None:
    """Stepwise begins with one view or with the ring, and then tries the surface of the latest batch first."""
    policy = POLICIES["stepwise"]
    assert policy(ExploreOptions(), ExplorationState(0, None)) == (Batch(1),)
    assert policy(ExploreOptions(ring=4), ExplorationState(0, None)) == (Batch(4),)
    assert policy(ExploreOptions(ring=4), ExplorationState(0, 2)) == (Batch(2),)
    believed = Batch(3, per_second=True, on=BELIEVED, min_gain_factor=2.0)
    measured = Batch(3, per_second=True, on=MEASURED, min_gain_factor=0.6)
    assert policy(ExploreOptions(batch=3), ExplorationState(1, 9)) == (believed, measured)
    assert policy(ExploreOptions(batch=3), ExplorationState(7, 9, on=MEASURED)) == (measured, believed)


def test_two_stages_begin_with_six_views_and_ask_less_of_each_plan() -> None:
    """After six rough views the minimum gain factor falls from 3 to 1 with the stages."""
    policy = POLICIES["two-stage"]
    much, less, least = (Batch(9, min_gain_factor=factor) for factor in (3.0, 1.5, 1.0))
    last = Batch(9, on=MEASURED, min_gain_factor=0.6)
    assert policy(ExploreOptions(), ExplorationState(0, 9)) == (Batch(6, rough=True),)
    every = (much, less, least, last)
    for stages, expected in enumerate((every, every, every[1:], every[2:], every[3:]), start=1):
        assert policy(ExploreOptions(), ExplorationState(stages, 9)) == expected
        assert policy(ExploreOptions(), ExplorationState(stages, 9, on=MEASURED)) == (last,)


def test_the_share_beyond_the_limits() -> None:
    """The share of a square beyond the spacing limit falls from 1 to 0 as the limit grows."""
    square = trimesh.creation.box((0.08, 0.08, 0.002))
    mesh = TriangleMesh(np.asarray(square.vertices, dtype=np.float64), np.asarray(square.faces, dtype=np.int32))
    up = np.array([[0.0, 0.0, 1.0]])
    poses = aim_viewpoints(np.zeros((1, 3)), up, np.array([-1]), [0.1], [0.0]).T_object_scanner[:, 0]
    step = 0.1 * np.radians(0.25)
    shares = [
        report.share_beyond_limits(_scene(max_spacing=1000 * limit * step), mesh, poses)
        for limit in (0.9, 1.0, 1.05, 1.1, 4.0)
    ]
    assert shares[0] == 1.0
    assert shares[-1] == 0.0
    assert (np.diff(shares) <= 0).all()
    assert 0 < shares[2] < 1


@pytest.mark.parametrize("share", [0.0, 0.02, 0.3])
def test_unseen_space_contains_every_voxel_that_is_not_free(share: float, tmp_path: Path) -> None:
    """The mesh of unseen space contains all corners of each voxel that is not free, including isolated voxels."""
    space = VoxelSpace.from_cylinder(0.02, 0.05, 0.002, 0.002)
    state = np.where(np.random.default_rng(1).random(space.state.shape) < share, UNKNOWN, FREE).astype(np.uint8)
    if share:
        space = replace(space, state=np.where(space.state == UNKNOWN, state, space.state))
    path = tmp_path / "unseen.ply"
    belief.write_unseen(space, path)
    vertices, faces = mesh_files.parse(path, path.read_bytes())
    around = np.stack(np.meshgrid(*[[-0.5, 0.5]] * 3), axis=-1).reshape(-1, 3) * space.edge
    corners = (space.centres(space.state != FREE)[:, None] + around).reshape(-1, 3)
    mesh = TriangleMesh(vertices / 1000, faces.astype(np.int32))
    assert ClosestPointQuery(mesh).signed_distance(corners).max() < 0
    assert np.abs(mesh.vertices).max(axis=0) == pytest.approx(np.abs(corners).max(axis=0), abs=3 * space.edge)


@dataclass
class Stub:
    """The part of a planning problem that `_views_with_gain` reads."""

    M: Any
    usable: Any


def test_a_batch_has_as_many_views_as_reach_the_minimum_gain() -> None:
    """A batch has as many views as reach the minimum gain; a gain ratio of 0 leaves one view to be refused."""
    areas = np.array([3.0, 2.0, 1.0])
    M = SimpleNamespace(matrix=lambda: csr_array(np.eye(3, dtype=bool)), samples=SimpleNamespace(areas=areas))
    problem = Stub(M, lambda: np.ones(3, dtype=bool))
    for came, factor, views in ((1.0, 1.0, 3), (1.0, 50.0, 2), (0.5, 50.0, 1), (0.0, 1.0, 1)):
        requests = stage.BatchRequest(None, None, Batch(None, min_gain_factor=factor), 0.01, 3.0, came)
        assert max(len(stage._views_with_gain(problem, requests)), 1) == views


def test_the_gain_ratio_is_the_median_of_realised_over_expected() -> None:
    """The ratio is the median of newly measured over expected area."""
    went = [(5.0, 20.0, BELIEVED), (2.0, 4.0, BELIEVED), *[(9.0, 0.0, MEASURED)] * 2, (1.0, 3.0, BELIEVED)]
    stages = [
        SimpleNamespace(expected_gain_mm2=area, realised_gain_mm2=new, planning_surface=on) for area, new, on in went
    ]
    assert _belief_gain_ratio(SimpleNamespace(batches=stages)) == 2.0  # median of 1, 2 and 3
    assert _belief_gain_ratio(SimpleNamespace(batches=stages[:1])) == 1.0
    little = [
        stages[0],
        *[SimpleNamespace(expected_gain_mm2=2.0, realised_gain_mm2=0.5, planning_surface=BELIEVED)] * 3,
    ]
    assert _belief_gain_ratio(SimpleNamespace(batches=little)) == 1.0  # a smaller gain is part of the gain record


def test_the_believed_solid_is_that_of_the_space() -> None:
    """The believed solid is that of the space, and the believed surface encloses it."""
    space = VoxelSpace.from_cylinder(0.02, 0.05, 0.002, 0.002).with_points(
        np.zeros((1, 3)), [np.array([0.2, 0.0, 0.0])]
    )
    known = Belief(space, GainRecord.empty())
    assert not np.array_equal(space.belief_voxels(), space.maybe_part)
    assert np.array_equal(known.solid, space.belief_voxels())
    assert np.array_equal(known.surface.vertices, belief.surface_about(space, space.belief_voxels()).vertices)


def test_a_belief_is_written_and_read_back(tmp_path: Path) -> None:
    """Voxels, points and gain record are equal after writing and reading."""
    (tmp_path / "stages").mkdir()
    rng, unknown = np.random.default_rng(3), VoxelSpace.from_cylinder(0.02, 0.05, 0.002, 0.002)
    points = rng.uniform(-0.01, 0.01, (100, 3))
    space = (
        unknown.with_points(points, [np.array([0.2, 0.0, 0.0])]).with_tries(points[:5]).with_surface_between(points / 2)
    )
    space = replace(space, votes=rng.integers(-3, 4, space.votes.shape).astype(np.int16))
    of = space.open_samples_at(points, np.tile([0.0, 0.0, 1.0], (100, 1)))
    record = GainRecord.empty().with_batch(of, rng.random(100), rng.random(100))
    ExplorationFolder(tmp_path).keep(1, Belief(space, record))
    again = ExplorationFolder(tmp_path).known(1, unknown)
    for one, other in ((again.space, space), (again.record, record)):
        for name in one.__slots__:
            assert np.array_equal(getattr(one, name), getattr(other, name)), name


def test_the_scanner_is_chosen_for_the_cylinder_that_was_given(tmp_path: Path) -> None:
    """The given cylinder selects the scanner for simulated and real parts."""
    options, elsewhere = ExploreOptions(cylinder_mm=(400, 300)), ScanOptions(
        acquire="command:take", points_frame="base", points_units="mm"
    )  # fmt: skip
    work, real, own = (
        prepare_exploration(Session(None, out=tmp_path), _scene(), requests, scanning)
        for requests, scanning in ((options, ScanOptions()), (options, elsewhere), (ExploreOptions(), ScanOptions()))
    )
    assert work.scene.scanner == real.scene.scanner != own.scene.scanner
    assert work.frustum.near == real.frustum.near > own.frustum.near


def test_nothing_that_can_be_reached_has_the_exit_code_of_that() -> None:
    """An exploration without a reachable first view ends with exit code 4."""
    arguments: Any = (None, SimpleNamespace(batches=()), (), "the arm reaches no view", ())
    with pytest.raises(UnreachableError, match="no view can be planned: the arm reaches no view") as message:
        _finish(*arguments)
    assert message.value.exit_code == 4


def test_the_ring_is_not_part_of_the_minimum_range_history() -> None:
    """The first batch is not part of the minimum-range history, since it was planned for an unknown cylinder."""
    ring, batch = (SimpleNamespace(below_range_mm2=near, expected_gain_mm2=9.0) for near in (8.0, 1.0))
    file: Any = SimpleNamespace(batches=[ring, batch])
    assert _min_range_history(file) == [(1.0, 9.0)]
