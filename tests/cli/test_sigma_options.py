"""`--max-sigma` and `--noise model` on the command line."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cell.runs.cell import read_cell
from cell.runs.run import open_run
from tests.support.fixture_types import RunCommand


@pytest.fixture(scope="module")
def limited(
    tmp_path_factory: pytest.TempPathFactory, part_file: Path, small_plan: tuple[str, ...], run_cell: RunCommand
) -> dict[str, Any]:
    """Return the small plan with a limit that its unlimited matrix exceeds."""
    folder = tmp_path_factory.mktemp("sigma")
    command = ("plan", str(part_file), "--units", "mm", *small_plan, "--max-sigma", "0.04", "--json", "--out", "run")
    process = run_cell(*command, cwd=folder, code=0)
    return {"folder": folder / "run", "summary": json.loads(process.stdout)}


def test_the_limit_holds_for_matrix_prediction_and_summary(limited: dict[str, Any], planned: Path) -> None:
    """The matrix has a sigma layer without a value above the limit. Quantiles are below it, and less is coverable."""
    with np.load(limited["folder"] / "measurability.npz") as stored, np.load(planned / "measurability.npz") as plain:
        assert stored["sigma"].shape == stored["indices"].shape
        assert 0 < stored["sigma"].max() <= 0.04e-3
        n = min(len(stored["indptr"]), len(plain["indptr"])) - 1  # rows of both: a selection may add rows of its own
        assert 0 < stored["indptr"][n] < plain["indptr"][n]
        assert "sigma" not in plain
    summary, without = limited["summary"], json.loads((planned / "report.json").read_text())
    sigma = summary["sigma"]
    assert 0 < sigma["median_mm"] <= sigma["quantile_95_mm"] <= sigma["limit_mm"] == 0.04
    assert "sigma" not in without
    assert 0 < summary["coverage"]["coverable"] < without["coverage"]["coverable"]
    assert json.loads((limited["folder"] / "scene.resolved.json").read_text())["plan"]["max_sigma_mm"] == 0.04


def test_the_scan_of_a_limited_plan_has_no_point_above_the_limit(limited: dict[str, Any], run_cell: RunCommand) -> None:
    """The achieved visible coverage is the predicted one, and the sigma of every point is within the limit."""
    folder = limited["folder"]
    process = run_cell("scan", "run", "--resolution", "2", "--json", cwd=folder.parent, code=0)
    report = json.loads(process.stdout)
    assert report["coverage"]["visible"] == pytest.approx(limited["summary"]["coverage"]["visible"], abs=1e-4)
    assert sum(view["rays"]["too_uncertain"] for view in report["views"]) > 0
    run = open_run(folder)
    scene = read_cell(run, 2.0)
    for stop, view in enumerate(run.plan.views, start=1):
        with np.load(folder / "executions" / "0001" / "scans" / f"{stop:04d}.npz") as scan:
            T, points, face = scan["T_object_scanner_true"], scan["points"], scan["face"]
        corners = scene.reference.vertices[scene.reference.faces[face]]
        normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        normals /= np.linalg.norm(normals, axis=1, keepdims=True)
        sigma = scene.scanner.sigma((points - T[:3, 3]) @ T[:3, :3], normals @ T[:3, :3])
        assert (sigma <= 0.04e-3 * (1 + 1e-9)).all(), view.id


def test_model_noise_is_seeded_scatters_by_sigma_and_stays_on_the_rays(
    planned: Path, tmp_path: Path, run_cell: RunCommand
):
    """Equal seeds give equal scans. The noise is along the ray and standard normal in units of sigma."""
    import shutil

    shutil.copytree(planned, tmp_path / "run")
    scans = []
    for extra in ((), ("--noise", "model"), ("--noise", "model")):
        run_cell("scan", "run", "--resolution", "1", "--view", "1", *extra, cwd=tmp_path, code=0)
        newest = sorted((tmp_path / "run" / "executions").iterdir())[-1]
        with np.load(newest / "scans" / "0001.npz") as stored:
            scans.append({name: stored[name] for name in ("points", "face", "T_object_scanner_true")})
    clean, first, again = scans
    np.testing.assert_array_equal(first["points"], again["points"])
    scene = read_cell(open_run(tmp_path / "run"), 1.0)
    T = clean["T_object_scanner_true"]
    local = (clean["points"] - T[:3, 3]) @ T[:3, :3]
    corners = scene.reference.vertices[scene.reference.faces[clean["face"]]]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    sigma = scene.scanner.sigma(local, normals @ T[:3, :3])
    rays = local / np.linalg.norm(local, axis=1, keepdims=True)
    off = (first["points"] - clean["points"]) @ T[:3, :3]
    along = (off * rays).sum(axis=1)
    assert len(along) > 150
    assert np.abs(off - along[:, None] * rays).max() < 1e-12
    assert np.std(along / sigma) == pytest.approx(1, abs=4 / np.sqrt(2 * len(along)))
    assert np.mean(along / sigma) == pytest.approx(0, abs=4 / np.sqrt(len(along)))


@pytest.mark.parametrize(
    ("command", "words"),
    [
        (("scan", "run", "--noise", "loud"), "valid are: none, model"),
        (("plan", "mug", "--max-sigma", "0"), "--max-sigma is 0.0; it must be above 0"),
        (
            ("plan", "PART", "--units", "mm", "--faces", "40", "--place", "1100,400,100", "--max-sigma", "1e-6"),
            "the best point has an",
        ),
    ],
)
def test_invalid_options_are_refused(
    command: tuple[str, ...], words: str, planned: Path, part_file: Path, tmp_path: Path, run_cell: RunCommand
) -> None:
    """Invalid options end with a message that names the valid values or the cause."""
    import shutil

    shutil.copytree(planned, tmp_path / "run")
    process = run_cell(*(part_file if word == "PART" else word for word in command), cwd=tmp_path, code=2)
    assert words in process.stderr.replace("\n", " ")
    assert "Traceback" not in process.stderr
