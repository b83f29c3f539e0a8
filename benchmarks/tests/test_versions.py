"""Rows of two versions of the program."""

from pathlib import Path

import pytest

from benchmarks import cell_process, versions


def test_a_version_beside_itself_has_equal_results(monkeypatch: pytest.MonkeyPatch) -> None:
    """This checkout as both versions gives the same plan and the same scan."""
    monkeypatch.setenv("SCAN_CELL_OTHER", str(cell_process.CODE))
    monkeypatch.setenv("SCAN_CELL_JOBS", "plan,scan")
    monkeypatch.setenv("SCAN_CELL_PARTS", "mug")
    rows = versions.run()
    measured = {"version", "s", "cpu s", "peak MB"}
    other, this = ([row for row in rows if row["version"] == version] for version in ("other", "this"))
    results = [[{name: row[name] for name in row if name not in measured} for row in each] for each in (other, this)]
    assert results[0] == results[1]
    assert [row["job"] for row in this] == ["plan", "scan"]
    assert all(row["views"] > 1 and row["cpu s"] > 0 for row in rows)


def test_the_other_version_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A command runs the code of the given checkout, also when the working directory is another one."""
    (tmp_path / "cell").mkdir()
    (tmp_path / "cell/__init__.py").touch()
    (tmp_path / "cell/__main__.py").write_text('print(\'{"version": "other"}\')')
    monkeypatch.chdir(cell_process.CODE)
    assert cell_process.run_cell(tmp_path, "plan", code=tmp_path)[0] == {"version": "other"}
