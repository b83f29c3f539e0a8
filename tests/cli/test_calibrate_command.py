"""`cell calibrate hand-eye`: scans and poses from files, lines for the scene file, insufficient sets."""

import json
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from benchmarks.hand_eye import _ball, _flange, _mount, corners
from cell.scene.file import load_scene
from planner.kinematics.frames import kuka_abc_from_pose
from tests.support.fixture_types import RunCommand


@pytest.fixture(scope="module")
def scans(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with twelve scans of a ball, with their poses in JSON files and in a table."""
    folder, rows = tmp_path_factory.mktemp("scans"), []
    for number, view in enumerate(corners(), start=1):
        rng = np.random.default_rng(number)
        np.savetxt(folder / f"{number:04d}.xyz", 1000 * _ball(view, rng)[:800], fmt="%.6f")
        T = _flange(view, rng)
        (folder / f"{number:04d}.json").write_text(json.dumps({"T_base_flange": [T.tolist()]}))
        position, abc = kuka_abc_from_pose(T)
        rows.append(", ".join(f"{value:.9f}" for value in (*(1000 * position), *np.degrees(abc))))
    (folder / "poses.csv").write_text("# x y z a b c\n" + "\n".join(rows))
    return folder


def test_the_mount_as_lines_of_a_scene_file(run_cell: RunCommand, scans: Path, tmp_path: Path) -> None:
    """Both sources of poses give one mount, to 0.1 mm and 0.04 deg. The printed lines are valid in a scene file."""
    files = sorted(scans.glob("*.xyz"))
    beside = run_cell(
        "calibrate", "hand-eye", *files, "--points-units", "mm", "--diameter", "38.1", cwd=tmp_path, code=0
    )
    text = beside.stdout[beside.stdout.index("[mount]") :]
    (tmp_path / "scene.toml").write_text(text)
    T = load_scene(tmp_path / "scene.toml").mount.T
    assert np.linalg.norm(T[:3, 3] - _mount()[:3, 3]) < 1e-4
    assert np.degrees(Rotation.from_matrix(T[:3, :3].T @ _mount()[:3, :3]).magnitude()) < 0.04
    (tmp_path / "other.toml").write_text(
        text.replace("abc_deg", "# abc_deg").replace("# or, in place of # abc_deg: ", "")
    )
    np.testing.assert_allclose(load_scene(tmp_path / "other.toml").mount.T, T, atol=1e-6)
    table = run_cell(
        "calibrate", "hand-eye", *files, "--points-units", "mm", "--diameter", "38.1", "--poses", scans / "poses.csv",
        "--json", cwd=tmp_path,
    )  # fmt: skip
    found = json.loads(table.stdout)
    np.testing.assert_allclose(found["T_flange_scanner"], T, atol=1e-6)
    assert found["free_motions"] == []
    assert found["diameter_sd_mm"] == 0.0
    assert len(found["scans"]) == 12


def test_insufficient_scans_are_refused(run_cell: RunCommand, scans: Path, tmp_path: Path) -> None:
    """Insufficient scans and invalid options have exit code 2 with a message. Unreadable files have 6."""
    files = sorted(scans.glob("*.xyz"))
    for words, code, message in (
        ((*files[:3], "--points-units", "mm"), 2, "at least 5"),
        (files, 2, "--points-units is missing"),
        ((*files, "--points-units", "mm", "--target", "plane", "--diameter", "3"), 2, "is for a sphere"),
        ((*files[:4], "--points-units", "mm", "--poses", scans / "poses.csv"), 2, "12 poses for 4 scans"),
        ((*files, "--points-units", "mm", "--poses", files[0]), 6, "six numbers"),
        ((*files, tmp_path / "gone.ply", "--points-units", "mm"), 6, "cannot be read"),
    ):
        process = run_cell("calibrate", "hand-eye", *words, cwd=tmp_path)
        assert (process.returncode, message in process.stderr) == (code, True), process.stderr
    rows = (scans / "poses.csv").read_text().splitlines()
    (tmp_path / "one.csv").write_text("\n".join([rows[1]] * 6))
    same = [files[0]] * 6
    process = run_cell(
        "calibrate", "hand-eye", *same, "--points-units", "mm", "--poses", tmp_path / "one.csv", cwd=tmp_path, code=2
    )
    assert "do not determine the mount" in process.stderr
    assert "[mount]" not in process.stdout
