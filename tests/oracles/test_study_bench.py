"""Numbers of the studies against independent computations."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh

from cell.errors import FileError
from cell.scene.file import load_scene
from cell.study.placement_trial import COVERAGE_ONLY, WITH_VIEWS, evaluate_placement
from cell.study.prepared_part import Bench, scene_from_settings, scene_settings, shared_bench
from cell.world import virtual_scan
from cell.world.collision import MujocoCollisionChecker
from cell.world.occluders import fixed_occluders, make_caster
from planner.kinematics import reach
from planner.measurability import coverage
from planner.measurability.visibility import apply_occluders


@pytest.fixture(scope="module")
def tables(part_file: Path) -> dict[str, Any]:
    """Return tables of a small, coarse scene."""
    return {
        "part": {"path": str(part_file), "units": "mm"},
        "plan": {"faces": 60, "samples_per_face": 3, "candidates": "optimal-scanning-zone"},
        "scanner": {"resolution_deg": [1.0, 1.0]},
    }


@pytest.fixture(scope="module")
def bench(tables: dict[str, Any]) -> Bench:
    """Return the bench of the small scene with 4,000 held-out samples."""
    return Bench(load_scene(None, tables), samples=4000)


def test_sampled_coverage_view_by_view_is_that_of_the_merged_cloud(bench: Bench) -> None:
    """The coverage is unchanged if the samples of earlier views are skipped."""
    views = bench.candidates.T_object_scanner[[0, 17, 40, 63]]
    points = [virtual_scan.scan(bench.scanner, T, bench.caster, bench.part.reference).points for T in views[:, 0]]
    merged = coverage.sampled_coverage(
        np.concatenate(points), bench.samples, coverage.sampling_radius(bench.part.reference)
    )
    assert 0.05 < merged.fraction < 1.0
    assert bench.sampled_coverage(views) == pytest.approx(merged.fraction, abs=1e-12)


def test_a_scene_survives_the_settings_of_a_trial(tables: dict[str, Any], tmp_path: Path) -> None:
    """A scene with a fixture and its own field of view equals the scene from its settings."""
    path = tmp_path / "cell.toml"
    path.write_text(
        '[scanner]\nfov_deg = [40.0, 30.0]\n[[fixtures]]\nname = "clamp"\nshape = "box"\nsize_mm = [50, 40, 6]\n'
    )
    scene = load_scene(path, tables)
    assert scene_from_settings(scene_settings(scene)) == scene
    assert scene_settings(scene) != scene_settings(load_scene(None, tables))


def test_a_file_that_changed_under_a_study_is_refused(tmp_path: Path) -> None:
    """A changed file is refused, because the keys of the trials would belong to another part."""
    path = tmp_path / "part.stl"
    trimesh.creation.box((0.1, 0.1, 0.1)).export(path)
    settings = scene_settings(load_scene(None, {"part": {"path": str(path), "units": "m"}}))
    assert scene_from_settings(settings).part.path == str(path)
    path.write_bytes(path.read_bytes() + b" ")
    with pytest.raises(FileError, match="changed since"):
        scene_from_settings(settings)


def test_meshes_of_robot_and_regions_are_files_of_a_study(tmp_path: Path) -> None:
    """A robot's description names its meshes, a region its painted mesh: all are inputs of the trials."""
    robot, mesh, painted = (tmp_path / name for name in ("arm.urdf", "link.stl", "painted.ply"))
    painted.touch()
    trimesh.creation.box((0.1, 0.1, 0.1)).export(mesh)
    shape = '<collision><geometry><mesh filename="link.stl"/></geometry></collision>'
    robot.write_text(f'<robot name="arm"><link name="base">{shape}</link></robot>', encoding="utf-8")
    region = 'name = "seat"\npainted = "painted.ply"\npainted_units = "mm"\ncolour = "#ff0000"'
    scene = tmp_path / "cell.toml"
    scene.write_text(f'robot.model = "arm.urdf"\n[[region]]\n{region}', encoding="utf-8")
    files: Any = scene_settings(load_scene(scene))["files"]
    assert {str(robot), str(mesh), str(painted)} <= files.keys()


def test_the_values_of_a_placement_are_those_of_its_steps(tables: dict[str, Any]) -> None:
    """Reach, occlusion and coverage computed one by one give equal shares."""
    scene = load_scene(None, tables)
    settings = scene_settings(scene)
    values = evaluate_placement(
        {**settings, "position_mm": [1100, 400, 100], "abc_deg": [30, 0, 0], "what": "whole", "solver": "auto",
         "candidates": None}
    )  # fmt: skip
    bench = shared_bench(settings)
    a = np.deg2rad(30)
    T = np.array([[np.cos(a), -np.sin(a), 0, 1.1], [np.sin(a), np.cos(a), 0, 0.4], [0, 0, 1, 0.1], [0, 0, 0, 1]])
    placed = bench.world.T_base_object_at(T)
    reached = reach.solve_reach(
        bench.candidates,
        placed,
        bench.world.T_flange_scanner,
        bench.world.kinematics,
        MujocoCollisionChecker(bench.world, placed),
    ).reachable
    casters = make_caster(fixed_occluders(bench.world, placed))
    M = apply_occluders(bench.matrix("aimed", bench.candidates), bench.candidates, bench.scanner, casters).matrix()
    measured = M.toarray()[:, reached].any(axis=1)
    areas = bench.matrix("aimed", bench.candidates).samples.areas
    assert 0.1 < values["coverable"] < 1.0
    assert values["reachable"] == pytest.approx(reached.mean())
    assert values["coverable"] == pytest.approx(areas[measured].sum() / areas.sum())
    assert values["lower_bound"] <= values["views"]
    assert values["cycle_s"] > 0


def test_grown_candidates_count_for_coverage_and_for_views(tables: dict[str, Any]) -> None:
    """Both kinds of trial have the same coverage, which the views keep; without growth it is lower."""
    place = {"position_mm": [1100, 400, 100], "abc_deg": [30, 0, 0], "solver": "auto", "candidates": None}

    def values(generator: str, what: str) -> dict[str, Any]:
        scene = load_scene(None, tables | {"plan": tables["plan"] | {"candidates": generator}})
        return evaluate_placement({**scene_settings(scene), **place, "what": what})

    coverage_only, whole = values("grown", COVERAGE_ONLY), values("grown", WITH_VIEWS)
    assert coverage_only["coverable"] == pytest.approx(whole["coverable"], abs=1e-12)
    assert coverage_only["reachable"] == whole["reachable"]
    assert whole["coverable"] > values("optimal-scanning-zone", COVERAGE_ONLY)["coverable"] + 0.01
    assert whole["visible"] > 0.95 * 0.99 * whole["coverable"]  # held-out samples, 99 % requested of few rows
