"""The paper's Tables 1 to 4 on the built-in parts, reduced to three tenths of the faces: trends, and both methods.

The full tables are `python -m benchmarks paper all`; docs/internals/paper_tables.md has them. Table 5 has a separate
test (tests/golden), and test_paper_command.py tests one part of Table 2.
"""

from collections.abc import Sequence
from pathlib import Path

import pytest

from benchmarks.paper.study import TOLERANCE_POINTS, table_study
from cell.study.study import Row
from cell.study.trials import Processes, run_trials

_SHARE = 0.3
_CASES = (("table1", "mseke"), ("table2", "mug"), ("table3", "humerus"), ("table4", "mug"))


@pytest.fixture(scope="module")
def rows(tmp_path_factory: pytest.TempPathFactory) -> dict[str, list[Row]]:
    """Return the rows of one part of each table, in the order of the paper."""
    folder: Path = tmp_path_factory.mktemp("trials")
    found = {}
    with Processes(2) as workers:
        for table, part in _CASES:
            study = table_study(table, faces_share=_SHARE, parts=[part])
            outcomes = run_trials(study.trials, workers, folder=folder)
            assert not [outcome.failure for outcome in outcomes if outcome.failure]
            found[table] = list(study.rows(outcomes))
    return found


def _column(rows: Sequence[Row], name: str) -> list[float]:
    return [row[name] for row in rows]


@pytest.mark.slow
def test_the_paper_s_method_shows_the_paper_s_trends(rows: dict[str, list[Row]]) -> None:
    """More faces give more views at about equal coverage.

    The best standoff lies inside the range. A wider field of view and a finer resolution give fewer views.
    """
    faces = rows["table1"]
    views = _column(faces, "views rays")
    assert views == sorted(set(views))
    covered = _column(faces, "sampled rays %")
    assert max(covered) - min(covered) < 3
    standoffs = _column(rows["table2"], "views rays")
    assert min(standoffs[1:-1]) < min(standoffs[0], standoffs[-1])
    for table, order in (("table3", -1), ("table4", 1)):  # the tables give FOV and angle between rays ascending
        views = _column(rows[table], "views rays")[::order]
        assert views == sorted(views)
        assert views[0] < views[-1]


@pytest.mark.slow
def test_ours_needs_no_more_views_than_the_paper_s_method_at_its_coverage(rows: dict[str, list[Row]]) -> None:
    """At equal coverage ours needs no more views.

    With equal views it measures at least the same share, within the tolerance of 0.2 points.
    """
    for row in (row for table in rows.values() for row in table):
        assert row["views ours at visible rays"] <= row["views rays"], row
        assert row["visible ours at views rays %"] >= row["visible rays %"] - TOLERANCE_POINTS, row
        assert row["bound ours"] <= row["views ours"]
        assert row["bound rays"] <= row["views rays"]
