"""Regions of a part: selected triangles, targets, and refusals."""

import json
import math
import re
from pathlib import Path

import numpy as np
import pytest
import trimesh

from cell.errors import CellError, FileError, SceneError
from cell.part.workpiece import Workpiece, load
from cell.plan.selection import RegionGroups
from cell.scanners.laser_area import LaserArea
from cell.scene.file import load_scene
from cell.scene.model import Scene, require_no_region_targets, with_rest
from cell.scene.regions import region_areas, with_limits, with_regions
from cell.scene.settle import require_attainable, settle_scene
from cell.world.measurability import MIN_REGION_SAMPLES, surface_samples
from cell.world.prediction import held_out_samples
from planner.cover import CoverProblem
from planner.geometry.decimation import decimate
from planner.geometry.mesh import TriangleMesh
from planner.geometry.sampling import draw_samples
from planner.measurability.quality import LimitedScanner, QualityLimits
from planner.ports import Rejection
from tests.step_files import StepFile, bored_block, needs_cascadio

NO = {"name": "no", "care": "no"}


def scene_with(path: Path, regions: list[dict], units: str | None = None, **tables: dict) -> Scene:
    """Return a scene of a part's file with regions."""
    part = {"path": str(path)} | ({"units": units} if units else {})
    return load_scene(None, {"part": part, **tables}).model_copy(
        update={"region": Scene.model_validate({"region": regions}, context={"folder": path.parent}).region}
    )


def tagged(path: Path, regions: list[dict], units: str | None = None) -> Workpiece:
    """Return the part with its regions."""
    return with_regions(load(path, units), scene_with(path, regions, units))


def area(part: Workpiece, number: int) -> float:
    """Return the area of a region [mm^2]."""
    return 1e6 * float(part.reference.areas[part.reference.region == number].sum())


@pytest.fixture
def box(tmp_path: Path) -> Path:
    """Return a box of 20 x 30 x 40 mm, twelve triangles, about the origin."""
    path = tmp_path / "box.ply"
    trimesh.creation.box((20.0, 30.0, 40.0)).export(path)
    return path


@needs_cascadio
@pytest.mark.parametrize(
    ("selects", "expected"),
    [
        ({"kind": "cylinder"}, 2 * math.pi * 8 * 30),
        ({"kind": "cylinder", "diameter_below_mm": 20}, 2 * math.pi * 8 * 30),
        ({"diameter_above_mm": 15.9}, 2 * math.pi * 8 * 30),
        ({"kind": "plane", "box_mm": [-1, -1, 29, 61, 41, 31]}, 60 * 40 - math.pi * 64 + 2 * 1 * (60 + 40)),
    ],
    ids=["kind", "kind and diameter", "diameter", "kind and box"],
)
def test_faces_are_selected_by_all_selectors(tmp_path: Path, selects: dict, expected: float) -> None:
    """A face must satisfy all selectors of a region, and the area is that of the drawing."""
    path = tmp_path / "block.stp"
    path.write_text(bored_block())
    part = tagged(path, [{"name": "it", **selects}, NO])
    assert area(part, 0) == pytest.approx(expected, rel=2e-3)
    assert part.cad.counts() == {"plane": 6, "cylinder": 1}


@needs_cascadio
def test_a_face_belongs_to_the_first_region_that_selects_it(tmp_path: Path) -> None:
    """The bore belongs to the first region, and the second region has all other faces."""
    path = tmp_path / "block.stp"
    path.write_text(bored_block())
    number = next(face.number for face in load(path).cad.faces if face.kind == "cylinder")
    part = tagged(path, [{"name": "bore", "faces": [number]}, {"name": "planes", "kind": "plane"}, NO | {"name": "x"}])
    assert area(part, 0) == pytest.approx(2 * math.pi * 8 * 30, rel=2e-3)
    assert area(part, 0) + area(part, 1) == pytest.approx(1e6 * part.reference.areas.sum())


def test_a_box_cuts_triangles(box: Path) -> None:
    """A slab through the box has its closed-form area, and the remaining surface has the other triangles."""
    part = tagged(box, [{"name": "slab", "box_mm": [-50, -50, 2, 50, 50, 5]}], "mm")
    assert area(part, 0) == pytest.approx(3 * 2 * (20 + 30))
    assert area(part, 1) == pytest.approx(2 * (20 * 30 + 20 * 40 + 30 * 40) - 300)
    message = region_areas(part, scene_with(box, [{"name": "slab", "box_mm": [-50, -50, 2, 50, 50, 5]}], "mm"))
    assert message == {"slab": pytest.approx(300), "the rest": pytest.approx(4900)}
    assert [region.name for region in with_rest(scene_with(box, [{"name": "s", "kind": "plane"}], "mm").region)] == [
        "s", "the rest",
    ]  # fmt: skip


def test_paint_selects_by_colour(tmp_path: Path, box: Path) -> None:
    """A fine mesh with one red side marks that side of a coarse part. Colours in the part's file mark its faces."""
    fine = trimesh.creation.box((20.0, 30.0, 40.0)).subdivide().subdivide().subdivide()
    red = fine.face_normals[:, 2] > 0.5
    fine.visual.face_colors = np.where(red[:, None], [250, 10, 0, 255], [200, 200, 200, 255])
    fine.export(tmp_path / "fine.ply")
    red_region = {"name": "red", "colour": "#ff0000"}
    by_other = tagged(box, [red_region | {"painted": "fine.ply", "painted_units": "mm"}, NO], "mm")
    own = tagged(tmp_path / "fine.ply", [red_region, NO], "mm")
    assert area(by_other, 0) == pytest.approx(600, rel=0.05)
    assert area(own, 0) == pytest.approx(600)
    with pytest.raises(FileError, match="has no colours"):
        tagged(box, [red_region, NO], "mm")


def test_samples_lie_in_measured_regions(box: Path) -> None:
    """Held-out samples are on measured faces with their region, and a small region has enough samples."""
    part = tagged(
        box,
        [
            {"name": "slab", "box_mm": [-50, -50, 2, 50, 50, 2.2]},
            {"name": "top", "box_mm": [-50, -50, 19, 50, 50, 21]},
            NO,
        ],
        "mm",
    )
    planning = decimate(part.reference, 200)
    samples = held_out_samples(part.reference, planning, 0, 2000)
    assert set(samples.region.tolist()) == {0, 1}
    z = 1000 * samples.points[:, 2]
    assert (np.abs(z[samples.region == 0] - 2.1) < 0.1001).all()
    assert (z[samples.region == 1] > 18.999).all()
    assert samples.areas.sum() == pytest.approx(1e-6 * (area(part, 0) + area(part, 1)))
    rows = surface_samples(scene_with(box, [], "mm"), part.reference, planning, np.random.default_rng(0))
    assert np.bincount(rows.region).min() >= MIN_REGION_SAMPLES
    assert np.bincount(rows.region, rows.areas) * 1e6 == pytest.approx([area(part, 0), area(part, 1)])


def test_a_part_without_regions_is_itself(box: Path) -> None:
    """A part without regions is neither tagged, cut nor copied."""
    part = load(box, "mm")
    assert with_regions(part, scene_with(box, [], "mm")) is part
    assert draw_samples(part.reference, part.reference, 10, np.random.default_rng(0)).region is None


@needs_cascadio
def test_colours_of_a_step_file_select_its_faces(tmp_path: Path) -> None:
    """The bore is red and its block blue. A file without colours gives a message."""
    file, path = StepFile(), tmp_path / "block.stp"
    file.block((0, 0, 0), (60, 40, 30), (30, 20, 8))
    bore = next(k for k, line in enumerate(file.lines, 1) if line.startswith("ADVANCED_FACE") and line.endswith(".F.)"))
    red, blue = {"name": "bore", "colour": "#cc2010"}, {"name": "block", "colour": "#3050a0"}
    path.write_text(bored_block())
    with pytest.raises(FileError, match="has no colours"):
        tagged(path, [red, NO])
    file.colours = [(file.solids[0], (0x30 / 255, 0x50 / 255, 0xA0 / 255)), (f"#{bore}", (0.8, 0.125, 0.0625))]
    path.write_text(file.text())
    part = tagged(path, [red, blue, NO])
    assert area(part, 0) == pytest.approx(2 * math.pi * 8 * 30, rel=2e-3)
    assert area(part, 1) == pytest.approx(2 * (60 * 40 - math.pi * 64) + 2 * 30 * (60 + 40), rel=2e-3)
    assert not (part.reference.region < 0).any()
    # The colours of a file without a unit have the scale of its surface.
    path.write_text(re.sub(r"GLOBAL_UNIT_ASSIGNED_CONTEXT\(\([^)]*\)\)", "", file.text()))
    in_inches = tagged(path, [red, blue, NO], "in")
    assert [area(in_inches, k) / 25.4**2 for k in (0, 1)] == pytest.approx([area(part, 0), area(part, 1)], rel=1e-6)
    painted = {**red, "painted": str(path), "painted_units": "mm"}
    plain = tmp_path / "plain.stp"
    plain.write_text(bored_block())
    assert area(tagged(plain, [painted, NO]), 0) == pytest.approx(area(part, 0), rel=1e-6)


@pytest.mark.parametrize(
    ("regions", "output"),
    [
        ([{"name": "a", "faces": [1]}], "is a mesh, which has none"),
        ([{"name": "a", "box_mm": [90, 90, 90, 99, 99, 99]}], "no surface of the part matches"),
        (
            [{"name": "a", "box_mm": [-9, -9, -9, 0, 9, 99]}, {"name": "b", "box_mm": [-9, -9, -9, 0, 9, 99]}],
            "before it",
        ),
        ([{"name": "a", "colour": "#ff0000"}], "has no colours"),
    ],
    ids=["faces of a mesh", "empty", "taken", "no paint"],
)
def test_a_property_that_the_part_does_not_have_is_refused(box: Path, regions: list[dict], output: str) -> None:
    """The message has the name of the region and a remedy."""
    with pytest.raises(CellError, match=output):
        tagged(box, regions, "mm")


@pytest.mark.parametrize(
    ("regions", "plan", "output"),
    [
        ([{"name": "a", "care": "no"}], {}, "measures nothing"),
        ([{"name": "a"}, {"name": "b", "faces": [1]}], {}, "put it last"),
        ([{"name": "a", "faces": [1]}, {"name": "a", "faces": [2]}], {}, "more than once"),
        ([{"name": "a", "care": "no", "views": 2}], {}, "care is 'no'"),
        ([{"name": "a", "painted": __file__}], {}, "needs region.colour"),
        ([{"name": "a", "painted": __file__, "colour": "#112233"}], {}, "painted_units"),
        ([{"name": "a", "painted": "nowhere.ply", "colour": "#112233"}], {}, "there is no file"),
        ([{"name": "a", "colour": "red"}], {}, "colour"),
        ([{"name": "a", "box_mm": [0, 0, 0, 1, 1, 0]}], {}, "lowest"),
        ([{"name": "a", "diameter_above_mm": 5, "diameter_below_mm": 5}], {}, "not below"),
        ([{"name": "a", "views": 2}], {"max_views": 3}, "excludes"),
        ([{"name": "a", "coverage": 0.5}], {"overlap_share": 0.2}, "excludes"),
        ([{"name": "a"}], {"fill": "rays"}, "aimed"),
        ([{"name": "the rest", "faces": [1]}], {}, "choose another"),
        ([{"name": "a|b", "faces": [1]}], {}, "one line without"),
        ([{"name": "a\nb", "faces": [1]}], {}, "one line without"),
        ([{"name": " ", "faces": [1]}], {}, "one line without"),
    ],
)
def test_a_scene_that_contradicts_itself_is_refused(
    tmp_path: Path, regions: list[dict], plan: dict, output: str
) -> None:
    """Each contradiction gives one line with the key."""
    lines = ["[plan]", *(f"{key} = {value!r}" for key, value in plan.items())]
    for region in regions:
        lines += ["[[region]]", *(f"{key} = {json.dumps(value)}" for key, value in region.items())]
    (tmp_path / "scene.toml").write_text("\n".join(lines))
    with pytest.raises(SceneError, match=output):
        load_scene(tmp_path / "scene.toml")


def test_limits_of_regions_apply_to_their_points() -> None:
    """Spacing and sigma are refused exactly above the limit of the point's region; other points keep the scanner's."""
    bare = LaserArea()
    rng = np.random.default_rng(0)
    z = rng.uniform(0.16, 0.44, 500)
    points, normals = np.stack([0 * z, 0 * z, z], axis=1), np.tile([0.0, 0.0, -1.0], (500, 1))
    region = rng.integers(0, 3, 500).astype(np.int32)
    spacing, sigma = bare.spacing(points, normals), bare.sigma(points, normals)
    limits = (
        QualityLimits(spacing=float(np.median(spacing))),
        QualityLimits(sigma=float(np.median(sigma))),
        QualityLimits(),
    )
    codes = LimitedScanner(bare, regions=limits).reject_in(points, normals, region)
    expected = np.full(500, Rejection.MEASURED)
    expected[(region == 0) & (spacing > limits[0].spacing)] = Rejection.TOO_SPARSE
    expected[(region == 1) & (sigma > limits[1].sigma)] = Rejection.TOO_UNCERTAIN
    assert (codes == expected).all()
    assert 0 < (codes == Rejection.TOO_SPARSE).sum() < 500
    assert with_limits(bare, None, ()) is bare


def test_an_unattainable_spacing_has_remedies(box: Path) -> None:
    """The message has spacing, range, resolution and device, and its proposed numbers satisfy the limit."""
    regions = [{"name": "seat", "max_spacing_mm": 0.3, "box_mm": [-50, -50, 2, 50, 50, 5]}, NO]
    scene = scene_with(box, regions, "mm", scanner={"sensor": "generic-area-large"})
    scene = settle_scene(scene, load(box, "mm"))
    settings = {"range_mm": (150.0, 450.0), "baseline_mm": 75.0}
    with pytest.raises(
        SceneError, match=r"'seat' requires points at most 0.3 mm apart.*150 mm.*generic-area-medium"
    ) as output:
        require_attainable(scene, LaserArea(**settings))
    resolution = float(str(output.value).partition("resolution_deg = [")[2].partition(",")[0])
    require_attainable(scene, LaserArea(**settings, resolution_deg=(resolution, resolution)))
    require_attainable(scene, LaserArea(range_mm=(50.0, 150.0), baseline_mm=25.0))


def test_regions_become_demands_weights_and_targets(box: Path) -> None:
    """Regions with a coverage have separate targets, and the others share the plan's. Samples follow their region."""
    requests = [
        {"name": "a", "box_mm": [-50, -50, 2, 50, 50, 5], "coverage": 0.9},
        {"name": "b", "box_mm": [-50, -50, 8, 50, 50, 9], "views": 3},
        {"name": "c", "weight": 2.0},
    ]
    scene = scene_with(box, requests, "mm")
    goals = RegionGroups.of(scene.region, scene.plan)
    assert goals.coverage.tolist() == [0.99, 0.9]
    assert goals.group.tolist() == [1, 0, 0]
    assert not goals.is_plain
    part = with_regions(load(box, "mm"), scene)
    rows = draw_samples(part.reference, part.reference, 300, np.random.default_rng(0))
    problem = goals.apply(CoverProblem(np.ones((300, 2), bool), rows.areas), rows)
    assert (problem.demand == np.array([1, 3, 1])[rows.region]).all()
    assert (problem.region == np.array([1, 0, 0])[rows.region]).all()
    assert problem.weights == pytest.approx(rows.areas * np.array([1, 1, 2])[rows.region])
    assert RegionGroups.of((), scene.plan) is None
    huge = scene.region[0].model_copy(update={"views": 10**20})
    assert RegionGroups.of((huge,), scene.plan).views.dtype == np.int64
    only = scene_with(box, [{"name": "a", "kind": "plane", "max_spacing_mm": 1.0}, NO], "mm")
    assert RegionGroups.of(only.region, only.plan).is_plain


def test_studies_refuse_targets_of_regions(box: Path) -> None:
    """Studies accept only the key care of a region."""
    require_no_region_targets(scene_with(box, [{"name": "a", "kind": "plane"}, NO], "mm").region)
    with pytest.raises(SceneError, match="'a' has the target views, and studies"):
        require_no_region_targets(scene_with(box, [{"name": "a", "kind": "plane", "views": 2}, NO], "mm").region)


def test_a_mesh_without_a_measured_face_is_refused() -> None:
    """A mesh without a measured face is refused, because it cannot be sampled."""
    mesh = trimesh.creation.box((1, 1, 1))
    with pytest.raises(ValueError, match="must belong to a region"):
        TriangleMesh(mesh.vertices, mesh.faces, np.full(12, -1))
