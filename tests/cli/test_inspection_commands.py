"""`cell features` and `cell inspect`: lists, pictures, results with verdicts and exit codes."""

import csv
import json
from pathlib import Path

import numpy as np

from cell.part.workpiece import load
from planner.geometry.sampling import draw_samples
from tests.qif_files import bored_block_qif
from tests.step_files import bored_block, needs_cascadio
from tests.support.fixture_types import RunCommand


@needs_cascadio
def test_features_are_listed_and_drawn(run_cell: RunCommand, tmp_path: Path) -> None:
    """Features and characteristics of a QIF file have their faces, tolerances and datums."""
    (tmp_path / "block.stp").write_text(bored_block())
    (tmp_path / "block.qif").write_text(bored_block_qif())
    words = ("features", "block.stp", "--qif", "block.qif", "--out", "drawn")
    message = json.loads(run_cell(*words, "--json", cwd=tmp_path, code=0).stdout)
    assert [each["name"] for each in message["characteristics"]] == ["Flatness 41", "Diameter 42", "Position 43"]
    assert (tmp_path / "drawn" / "features.png").stat().st_size > 10_000
    assert "cylinder, diameter 16 mm" in run_cell(*words, cwd=tmp_path, code=0).stdout
    assert run_cell("features", "block.stp", cwd=tmp_path).returncode == 2


@needs_cascadio
def test_points_of_a_file_are_inspected(run_cell: RunCommand, tmp_path: Path) -> None:
    """A bore that is 0.5 too large fails, exit code 3; the table, the page and the QIF file have its value."""
    (tmp_path / "block.stp").write_text(bored_block())
    (tmp_path / "block.qif").write_text(bored_block_qif())
    part = load(tmp_path / "block.stp")
    points = draw_samples(part.reference, part.reference, 20_000, np.random.default_rng(0)).points.copy()
    radial = points[:, :2] - [0.03, 0.02]
    distance = np.linalg.norm(radial, axis=1)
    bore = distance < 0.0080001
    points[bore, :2] += 0.00025 * radial[bore] / distance[bore, None]
    np.savetxt(tmp_path / "points.xyz", 1000 * points, fmt="%.6f")
    words = ("inspect", "points.xyz", "--part", "block.stp", "--qif", "block.qif", "--out", "checked")
    assert run_cell(*words, cwd=tmp_path).returncode == 2  # without a unit
    message = json.loads(run_cell(*words, "--points-units", "mm", "--json", cwd=tmp_path, code=3).stdout)
    verdicts = {each["name"]: each["verdict"] for each in message["characteristics"]}
    assert verdicts == {"Flatness 41": "pass", "Diameter 42": "fail", "Position 43": "pass"}
    with (tmp_path / "checked" / "characteristics.csv").open(newline="") as file:
        rows = {row["name"]: row for row in csv.DictReader(file)}
    assert abs(float(rows["Diameter 42"]["value"]) - 16.5) < 0.05
    for name in ("report.md", "report.pdf", "features.html", "features.png", "features.json", "results.qif"):
        assert (tmp_path / "checked" / name).is_file()
    assert "<CharacteristicStatusEnum>FAIL" in (tmp_path / "checked" / "results.qif").read_text()


def test_two_clouds_are_compared(run_cell: RunCommand, tmp_path: Path) -> None:
    """A plane that is 0.2 higher, of which one end is missing."""
    grid = np.stack(np.meshgrid(np.arange(40.0), np.arange(40.0)), axis=-1).reshape(-1, 2)
    np.savetxt(tmp_path / "a.xyz", np.column_stack([grid, np.zeros(1600)]))
    np.savetxt(tmp_path / "b.xyz", np.column_stack([grid[grid[:, 0] < 30], np.full(1200, 0.2)]))
    assert run_cell("diff", "a.xyz", "b.xyz", cwd=tmp_path).returncode == 2
    words = ("diff", "a.xyz", "b.xyz", "--points-units", "mm")
    found = json.loads(run_cell(*words, "--json", cwd=tmp_path, code=0).stdout)
    assert abs(found["rms_mm"] - 0.2) < 1e-6
    assert abs(found["only_a"] - 0.15) < 0.03
    assert found["only_b"] == 0
    assert "spacing of A 1 mm" in run_cell(*words, cwd=tmp_path, code=0).stdout
