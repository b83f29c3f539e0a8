"""Planning the stages of an exploration: selection of samples, order of the surfaces, expected and realised gain."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import trimesh

from cell.explore import explore, stage
from cell.explore.options import ExploreOptions
from cell.explore.policy import Batch, BatchRequest, expected_samples, realised_gain_ratio, select_samples
from cell.explore.stage import StopReason
from cell.explore.state import ExplorationFolder
from cell.runs import ply
from cell.runs.schema import BELIEVED, MEASURED, SurfaceName
from cell.scan.options import ScanOptions
from cell.scan.safety import ANY_MOTION
from cell.scanners.laser_area import LaserArea
from cell.session import Session
from cell.world.embree import EmbreeRayCaster
from planner.explore.gain import GainRecord, gain_ratio
from planner.explore.space import VoxelSpace
from planner.geometry.mesh import TriangleMesh
from planner.geometry.sampling import SurfaceSamples, draw_samples
from planner.values import Bools, Floats
from planner.viewpoints.viewpoints import aim_viewpoints

UNKNOWN = VoxelSpace.from_cylinder(0.06, 0.06, 0.003, 0.002)
LAW = LaserArea(range_mm=(50, 900), baseline_mm=60.0, grazing_max_deg=75.0, sensor_grazing_max_deg=75.0)


@pytest.fixture(scope="module")
def balls() -> TriangleMesh:
    """Return two balls side by side that occlude each other in part."""
    whole = trimesh.util.concatenate([
        trimesh.creation.icosphere(3, 0.02).apply_translation((x, 0.0, 0.0)) for x in (-0.025, 0.025)
    ])  # fmt: skip
    return TriangleMesh(np.asarray(whole.vertices, dtype=np.float64), np.asarray(whole.faces, dtype=np.int32))


def _poses() -> Floats:
    """Return (3, 4, 4) poses: from one side, from above and from a corner."""
    out = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.6, 0.48, 0.64]])
    return np.asarray(aim_viewpoints(np.zeros((3, 3)), out, np.full(3, -1), [0.3], [0.0]).T_object_scanner[:, 0])


def _measured(samples: SurfaceSamples, poses: Floats, mesh: TriangleMesh, grazing_deg: float) -> Bools:
    """Return (N,) samples visible to source and sensor within the grazing limit, by ray casts of trimesh.

    Rays start 0.01 mm above the surface.
    """
    found = np.zeros(len(samples), dtype=bool)
    triangles = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)
    for T in poses:
        sees = np.ones(len(samples), dtype=bool)
        for stand in (T[:3, 3], T[:3, 3] + 0.06 * T[:3, 0]):
            leg = stand - samples.points
            length = np.linalg.norm(leg, axis=1, keepdims=True)
            sees &= np.einsum("ij,ij->i", leg / length, samples.normals) >= np.cos(np.radians(grazing_deg))
            sees &= ~triangles.ray.intersects_any(samples.points + 1e-5 * samples.normals, leg / length)
        found |= sees
    return found


def _asked(poses: Floats | None, whole: bool = False, space: VoxelSpace = UNKNOWN) -> BatchRequest:
    return BatchRequest(space, GainRecord.empty(), Batch(1, include_covered=whole), 0.001, poses=poses)


def test_of_the_measured_surface_is_wanted_what_no_view_measures(balls: TriangleMesh) -> None:
    """On measured surface, exactly the samples that no pose measures are selected, by comparison with brute force.

    Areas and order are kept; the weights of the believed surface do not apply.
    """
    samples = draw_samples(balls, balls, 3000, np.random.default_rng(0))
    caster = EmbreeRayCaster(balls.vertices, balls.faces)
    kept = select_samples(samples, _asked(_poses()), 3000, LAW, caster)
    missed = ~_measured(samples, _poses(), balls, LAW.grazing_max_deg)
    assert 0.2 < missed.mean() < 0.8
    for name in ("points", "normals", "areas", "face", "planning_face"):
        assert np.array_equal(getattr(kept, name), getattr(samples, name)[missed]), name
    assert len(select_samples(samples, _asked(np.repeat(_poses()[:1], 2, axis=0)), 3000, LAW, caster)) > len(kept)


@pytest.mark.parametrize("views", [(1, 1), (2,), (1,)])
def test_what_came_is_what_the_latest_views_measured_first(views: tuple[int, ...], balls: TriangleMesh) -> None:
    """The realised gain counts samples near a point that the latest views measured first, as brute force does.

    Without poses the given ratio is kept, and without expected gain the ratio is 1.
    """
    samples = draw_samples(balls, balls, 3000, np.random.default_rng(0))
    caster = EmbreeRayCaster(balls.vertices, balls.faces)
    space = replace(UNKNOWN, points=samples.points[samples.points[:, 1] > 0])
    near = np.linalg.norm(samples.points[:, None] - space.points[None], axis=2).min(axis=1) <= UNKNOWN.edge
    assert 0.4 < near.mean() < 0.8
    each = np.stack([_measured(samples, T[None], balls, LAW.grazing_max_deg) for T in _poses()])
    left, firsts = near.copy(), list[float]()
    for seen in each:
        firsts.append(float(samples.areas[left & seen].sum()))
        left &= ~seen
    latest = [(count, 0.001 * (number + 1)) for number, count in enumerate(views)]
    asked = replace(_asked(_poses(), space=space), latest=latest)
    areas = np.split(np.array(firsts[-sum(views) :]), np.cumsum(views)[:-1])
    batches = [(expected, float(area.sum())) for (_, expected), area in zip(latest, areas, strict=True)]
    assert realised_gain_ratio(samples, asked, LAW, caster) == pytest.approx(gain_ratio(batches))
    assert realised_gain_ratio(samples, replace(asked, poses=None, gain_ratio=1.5), LAW, caster) == 1.5
    assert realised_gain_ratio(samples, replace(asked, latest=[(2, 0.0)]), LAW, caster) == 1.0


def test_of_more_samples_than_are_kept_the_area_is_the_same(balls: TriangleMesh) -> None:
    """At most the requested number of samples remains; their areas add up to that of all selected samples."""
    samples = draw_samples(balls, balls, 3000, np.random.default_rng(0))
    caster = EmbreeRayCaster(balls.vertices, balls.faces)
    every, few = (select_samples(samples, _asked(_poses()), most, LAW, caster) for most in (3000, 100))
    assert 90 < len(few) <= 100 < len(every)
    assert few.areas.sum() == pytest.approx(every.areas.sum())
    assert {tuple(point) for point in few.points.tolist()} < {tuple(point) for point in every.points.tolist()}


@pytest.mark.parametrize("whole", [False, True])
def test_of_the_believed_surface_is_wanted_what_was_not_seen(whole: bool, balls: TriangleMesh) -> None:
    """On believed surface a sample has its area times its probability of gain.

    Measured samples are left out, unless the batch includes covered surface.
    """
    samples = draw_samples(balls, balls, 3000, np.random.default_rng(0))
    right = samples.points[:, 0] > 0
    space = replace(UNKNOWN, points=samples.points[right])
    asked = _asked(None, whole, space)
    kept = select_samples(samples, asked, 3000, LAW, EmbreeRayCaster(balls.vertices, balls.faces))
    seen = space.is_measured(samples.points, samples.normals)
    assert seen[right].all()
    weights = np.where(
        seen, float(whole), GainRecord.empty().weights(space.open_samples_at(samples.points, samples.normals))
    )
    assert np.array_equal(kept.points, samples.points[weights > 0])
    assert kept.areas == pytest.approx((weights * samples.areas)[weights > 0])
    assert np.array_equal(expected_samples(samples, asked, 3000).areas, kept.areas)


class _Worth:
    """Planners of both surfaces that record each call and return a batch only for the given surfaces."""

    def __init__(self, *surfaces: str) -> None:
        self.surfaces, self.asked = surfaces, list[str]()

    def on(self, surface: str) -> Callable[..., Any]:
        """Return the planner of a surface; it checks that no files of an earlier failed plan remain."""

        def plan(work: Any, *_: object) -> Path | StopReason:
            self.asked.append(surface)
            assert not work.paths.measured(2).exists()
            assert not work.paths.unseen(2).exists()
            work.paths.unseen(2).touch()
            if surface == MEASURED:
                work.paths.measured(2).touch()
            if surface not in self.surfaces:
                return StopReason(f"of {surface}, {len(self.asked)}")
            return Path(surface)

        return plan


@pytest.mark.parametrize(
    ("tried", "worth", "asked", "ends"),
    [
        ((BELIEVED, MEASURED), (BELIEVED, MEASURED), [BELIEVED], BELIEVED),
        ((BELIEVED, MEASURED), (MEASURED,), [BELIEVED, MEASURED], MEASURED),
        ((MEASURED, BELIEVED), (BELIEVED, MEASURED), [MEASURED], MEASURED),
        ((MEASURED, BELIEVED), (BELIEVED,), [MEASURED, BELIEVED], BELIEVED),
        ((BELIEVED, MEASURED), (), [BELIEVED, MEASURED], "of believed"),
        ((MEASURED, BELIEVED), (), [MEASURED, BELIEVED], "of believed, 2"),
        ((BELIEVED, BELIEVED, MEASURED), (), [BELIEVED, BELIEVED, MEASURED], "of believed, 2"),
        ((MEASURED,), (BELIEVED,), [MEASURED], "nothing was tried"),
        ((), (BELIEVED,), [], "nothing was tried"),
    ],
)
def test_batches_are_tried_in_turn_until_one_is_worth_its_views(
    tried: tuple[SurfaceName, ...], worth: tuple[str, ...], asked: list[str], ends: str,
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    """Files of a failed batch are removed. If all batches fail, the reason of the last believed batch is returned."""
    planners, paths = _Worth(*worth), ExplorationFolder(tmp_path)
    (tmp_path / "stages").mkdir()
    monkeypatch.setattr(explore, "_plan_on_belief", planners.on(BELIEVED))
    monkeypatch.setattr(explore, "_plan_on_measured", planners.on(MEASURED))
    file, batches = SimpleNamespace(batches=[None]), [Batch(1, on=on) for on in tried]
    given: Any = (SimpleNamespace(paths=paths), file, None, batches, "nothing was tried")
    if ends in (BELIEVED, MEASURED):
        assert explore._plan_next(*given) == Path(ends)
        assert paths.measured(2).exists() == (ends == MEASURED)
        assert paths.unseen(2).exists()
    else:
        stop = explore._plan_next(*given)
        assert isinstance(stop, StopReason)
        assert ends in stop.sentence
    assert planners.asked == asked


@pytest.mark.parametrize(
    ("views", "seconds", "on", "batches", "ended"),
    [
        (5, 40.0, BELIEVED, (BELIEVED, MEASURED), "no batch of the policy"),
        (5, 40.0, MEASURED, (MEASURED, BELIEVED), "no batch of the policy"),
        (7, 40.0, BELIEVED, (), "the budget of 7 views is used"),
        (8, 90.0, BELIEVED, (), "the budget of 7 views is used"),
        (5, 60.0, BELIEVED, (), "the budget of 60 s of motion is used"),
    ],
)
def test_the_next_batches_are_the_policys_within_the_budget(
    views: int, seconds: float, on: SurfaceName, batches: tuple[SurfaceName, ...], ended: str
) -> None:
    """Stepwise batches have no more views than remain in the budget.

    No batch follows once views or seconds are used up.
    """
    stages = [
        SimpleNamespace(seconds=seconds / 2, planning_surface=BELIEVED),
        SimpleNamespace(seconds=seconds / 2, planning_surface=on),
    ]
    plan = SimpleNamespace(max_views=7, max_sigma_mm=None)
    scene = SimpleNamespace(plan=plan, scanner=SimpleNamespace(max_spacing_mm=None))
    work: Any = SimpleNamespace(scene=scene, options=ExploreOptions(max_seconds=60.0, batch=3))
    found, told = explore._next_batches(work, SimpleNamespace(batches=stages, views=views))  # type: ignore[arg-type]
    assert [(batch.views, batch.per_second, batch.on) for batch in found] == [(2, True, each) for each in batches]
    assert told.startswith(ended)
    first, _ = explore._next_batches(work, SimpleNamespace(batches=[], views=0))  # type: ignore[arg-type]
    assert first == (Batch(1),)


@pytest.mark.parametrize(
    ("batch", "said"),
    [
        (Batch(1), "less than the 0.1 % minimum"),
        (Batch(1, min_gain_factor=1.5), "less than 1.5 x the 0.1 % minimum"),
        (Batch(1, min_gain_factor=0.5), ""),
        (Batch(1, include_covered=True), ""),
    ],
)
def test_a_batch_that_is_not_worth_its_views_says_what_was_asked_of_it(batch: Batch, said: str) -> None:
    """Two views with an expected gain of 0.08 % each are compared with the minimum gain of the batch."""
    chosen: Any = SimpleNamespace(cover=SimpleNamespace(covered_area=0.0001, views=(3, 7)))
    asked = BatchRequest(UNKNOWN, GainRecord.empty(), batch, 0.001, measured_area=0.1, gain_ratio=1.6)
    told = stage._insufficient_gain(chosen, asked)
    assert told.endswith(said)
    assert ("to add 0.080 % of the measured surface" in told) == bool(said)


def test_each_surface_is_planned_for_what_is_known_of_it(
    balls: TriangleMesh, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Measured surface is planned from the executed poses and is stored; believed surface uses the realised gain ratio.

    The minimum gain applies to both, except for the first batch.
    """
    scans = [SimpleNamespace(T_reported=T) for T in _poses()[:2]]
    monkeypatch.setattr(explore, "continue_surface", lambda scans, space, solid: balls)
    monkeypatch.setattr(explore, "_stage", lambda work, asked, number, part: (asked, number, part))
    (tmp_path / "stages").mkdir()
    work: Any = SimpleNamespace(paths=ExplorationFolder(tmp_path), options=SimpleNamespace(min_gain=0.25), name="balls")
    known: Any = SimpleNamespace(space=UNKNOWN, record=GainRecord.empty(), scans=scans, solid=None, surface=balls)
    told = {
        "expected_gain_mm2": 1.0,
        "realised_gain_mm2": 3.0,
        "measured_mm2": 7.0,
        "below_range_mm2": 0.4,
        "planning_surface": BELIEVED,
    }
    told["views"] = 1
    stages = [SimpleNamespace(**told)] * 2
    file, first = SimpleNamespace(batches=stages), SimpleNamespace(batches=[])
    believed: Any = explore._plan_on_belief(work, file, known, Batch(1, min_gain_factor=3.0))
    assert (believed[0].poses, believed[0].min_gain, believed[0].gain_ratio) == (None, 0.25, 2.0)
    assert believed[0].measured_area == pytest.approx(7e-6)
    assert believed[0].min_area == pytest.approx(3 * 0.25 * 7e-6)
    assert (believed[1], believed[2].name) == (3, "balls as believed")
    assert not work.paths.measured(3).exists()
    assert not believed[0].keep_min_range
    near: Any = SimpleNamespace(batches=[stages[0], SimpleNamespace(**{**told, "below_range_mm2": 0.6})])
    assert explore._plan_on_belief(work, near, known, Batch(1))[0].keep_min_range  # type: ignore[index]

    def nothing_from_afar(work: Any, asked: Any, number: int, part: Any) -> Any:
        if asked.keep_min_range:
            return StopReason("too far off")
        return asked, number, part

    with monkeypatch.context() as now:
        now.setattr(explore, "_stage", nothing_from_afar)
        assert not explore._plan_on_belief(work, near, known, Batch(1))[0].keep_min_range  # type: ignore[index]
    begun: Any = explore._plan_on_belief(work, first, known, Batch(1))
    assert (begun[0].min_gain, begun[0].gain_ratio, begun[1]) == (0.0, 1.0, 1)
    on: Any = explore._plan_on_measured(work, file, known, Batch(1, min_gain_factor=2.0))
    assert np.array_equal(on[0].poses, _poses()[:2])
    assert (on[0].min_gain, on[0].min_area, on[0].gain_ratio) == (0.25, pytest.approx(2 * 0.25 * 7e-6), 1.0)
    assert (on[1], on[2].name, on[2].reference) == (3, "balls as measured", balls)
    assert work.paths.measured(3).read_bytes() == ply.mesh_bytes(balls)
    assert on[0].latest == ((1, 0.0), (1, 0.0))
    late: Any = SimpleNamespace(
        batches=[*stages, *(SimpleNamespace(**{**told, "planning_surface": MEASURED, "views": 2}),) * 3]
    )
    after: Any = explore._plan_on_measured(work, late, known, Batch(1))
    assert after[0].latest == ((1, 0.0), *((2, 1e-6),) * 3)


def test_points_that_describe_no_surface_give_none_to_plan_on(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """If the points describe no surface, planning stops with that reason and writes no file."""
    monkeypatch.setattr(explore, "continue_surface", lambda scans, space, solid: None)
    work: Any = SimpleNamespace(paths=ExplorationFolder(tmp_path))
    known: Any = SimpleNamespace(space=UNKNOWN, scans=(), solid=None)
    stop = explore._plan_on_measured(work, SimpleNamespace(batches=[None]), known, Batch(1))  # type: ignore[arg-type]
    assert stop == StopReason("the points describe no surface")
    assert list(tmp_path.iterdir()) == []


def test_a_plan_that_finished_is_taken_with_its_surface(tmp_path: Path) -> None:
    """A finished plan is used again without new planning, and its files remain."""
    paths = ExplorationFolder(tmp_path)
    paths.stage(2).mkdir(parents=True)
    for path in (paths.unseen(2), paths.measured(2)):
        path.touch()
    work: Any = SimpleNamespace(paths=paths)
    file: Any = SimpleNamespace(batches=[None])
    known: Any = None
    assert explore._plan_next(work, file, known, [Batch(1)], "") == paths.stage(2)
    assert paths.unseen(2).is_file()
    assert paths.measured(2).is_file()


@pytest.mark.parametrize("word", ["explore", "0123abcd", None])
def test_one_word_releases_every_motion_of_an_exploration(
    word: str | None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """`explore` confirms every motion, a digest only its own. Points are read from a new folder of the stage."""
    given: list[Any] = []
    monkeypatch.setattr(explore, "execute_batch", lambda session, folder, options, **_: given.append(options))
    work: Any = SimpleNamespace(
        options=ExploreOptions(confirm_motion=word), ground_truth=None, session=Session(None),
        scanning=ScanOptions(acquire=f"files:{tmp_path}", points_frame="base", points_units="mm"),
    )  # fmt: skip
    explore._execute(work, Path("stages") / "0007")
    assert given[0].confirm_motion == (ANY_MOTION if word == "explore" else word)
    assert given[0].acquire == f"files:{tmp_path}/0007"
    assert (tmp_path / "0007").is_dir()


def test_a_stage_says_what_its_views_stood_too_near_for(balls: TriangleMesh, monkeypatch: pytest.MonkeyPatch) -> None:
    """The entry of a batch reports the area [mm2] below the minimum range.

    It is computed from the expected samples, the scans and the space before the batch.
    """
    asked: list[Any] = []
    monkeypatch.setattr(
        explore, "open_finished", lambda folder: SimpleNamespace(digest="d", motion=SimpleNamespace(duration=1.5))
    )

    monkeypatch.setattr(explore, "area_below_min_range", lambda *given: asked.append(given) or 3e-6)
    known: Any = SimpleNamespace(space=UNKNOWN, surface=balls)
    samples = draw_samples(balls, balls, 5, np.random.default_rng(0))
    expected: Any = SimpleNamespace(samples=samples, sees=np.ones((5, 1), dtype=bool), surface=1.0, on=BELIEVED)
    scan: Any = SimpleNamespace(points=balls.vertices, T_reported=np.eye(4))
    stage_ = explore._batch_entry(Path("stages") / "0002", [scan], expected, UNKNOWN, known, None)  # type: ignore[arg-type]
    assert stage_.below_range_mm2 == pytest.approx(3.0)
    assert stage_.expected_gain_mm2 == pytest.approx(1e6 * samples.areas.sum(), abs=1e-3)
    (told,) = asked
    assert told[0] is samples
    assert told[2] == [(scan.points, scan.T_reported)]
    assert told[3] is UNKNOWN
