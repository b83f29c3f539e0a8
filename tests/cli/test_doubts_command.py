"""Notes of `cell plan` and `cell scan` on settings and data beyond the tested range (docs/internals/stability.md)."""

from pathlib import Path

from tests.support.fixture_types import RunCommand


def test_a_coarse_mesh_a_steep_limit_and_a_sparse_scan_have_notes(
    part_file: Path, run_cell: RunCommand, tmp_path: Path
) -> None:
    """Three notes are on stderr, and plan and execution are made."""
    (tmp_path / "cell.toml").write_text("[scanner]\ngrazing_max_deg = 85\n")
    process = run_cell(
        "plan", str(part_file), "--units", "mm", "--scene", "cell.toml", "--place", "1100,400,100", "--faces", "12",
        "--samples", "2", "--standoff", "250", "--coverage", "0.5",
        "--candidates", "optimal-scanning-zone", "--out", "run", "--json", cwd=tmp_path,
    )  # fmt: skip
    assert process.returncode in (0, 3), process.stderr
    assert "note: scanner.grazing_max_deg is 85" in process.stderr
    assert "note: the planning mesh of 12 faces is coarse" in process.stderr
    scanned = run_cell("scan", "run", "--resolution", "3", "--json", cwd=tmp_path)
    assert scanned.returncode in (0, 3), scanned.stderr
    assert "note: the points lie" in scanned.stderr
