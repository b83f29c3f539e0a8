"""Rows of two versions of the program."""

import pytest

from benchmarks import versions


def test_a_version_beside_itself_has_equal_results(monkeypatch: pytest.MonkeyPatch) -> None:
    """This checkout as both versions gives the same plan and the same scan."""
    monkeypatch.setenv("SCAN_CELL_OTHER", str(versions.CODE))
    monkeypatch.setenv("SCAN_CELL_JOBS", "plan,scan")
    monkeypatch.setenv("SCAN_CELL_PARTS", "mug")
    rows = versions.run()
    measured = {"version", "s", "cpu s", "peak MB"}
    other, this = ([row for row in rows if row["version"] == version] for version in ("other", "this"))
    results = [[{name: row[name] for name in row if name not in measured} for row in each] for each in (other, this)]
    assert results[0] == results[1]
    assert [row["job"] for row in this] == ["plan", "scan"]
    assert all(row["views"] > 1 and row["cpu s"] > 0 for row in rows)
