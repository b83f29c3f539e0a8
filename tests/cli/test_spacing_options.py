"""`--max-spacing` on the command line, and the density of plans and scans."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cell.scanners.laser_area import LaserArea
from tests.support.fixture_types import RunCommand

LIMIT_MM = 1.3  # at 250 mm and 0.25 deg points are 1.09 mm apart where the scanner faces the surface


@pytest.fixture(scope="module")
def limited(
    tmp_path_factory: pytest.TempPathFactory, part_file: Path, small_plan: tuple[str, ...], run_cell: RunCommand
) -> dict[str, Any]:
    """Return the small plan with a limit on the distance of points."""
    folder = tmp_path_factory.mktemp("spacing")
    options = (*small_plan, "--max-spacing", str(LIMIT_MM), "--json", "--out", "run")
    process = run_cell("plan", str(part_file), "--units", "mm", *options, cwd=folder, code=0)
    return {"folder": folder / "run", "summary": json.loads(process.stdout)}


def test_the_limit_holds_for_matrix_prediction_and_summary(limited: dict[str, Any], planned: Path) -> None:
    """The matrix has exactly the entries of the unlimited matrix within the limit. Quantiles are below the limit."""
    spacing, entries, rows = {}, {}, {}
    scanner = LaserArea(range_mm=(150, 450))
    for name, run in (("limited", limited["folder"]), ("planned", planned)):
        with np.load(run / "measurability.npz") as M, np.load(run / "viewpoints.npz") as views:
            row, T = np.repeat(np.arange(len(M["points"])), np.diff(M["indptr"])), views["T_object_scanner"][:, 0]
            at = T[M["indices"]]
            points = np.einsum("nji,nj->ni", at[:, :3, :3], M["points"][row] - at[:, :3, 3])
            spacing[name] = 1000 * scanner.spacing(points, np.einsum("nji,nj->ni", at[:, :3, :3], M["normals"][row]))
            sample = [tuple(point) for point in M["points"].tolist()]
            rows[name] = set(sample)
            entries[name] = [(sample[i], j) for i, j in zip(row.tolist(), M["indices"].tolist(), strict=True)]
    assert spacing["limited"].max() <= LIMIT_MM * (1 + 1e-9) < spacing["planned"].max()
    both = rows["limited"] & rows["planned"]  # samples may be added if the coverage of a plan is too low
    dense = [entry for entry, gap in zip(entries["planned"], spacing["planned"], strict=True) if gap <= LIMIT_MM]
    subsets = [{entry for entry in each if entry[0] in both} for each in (entries["limited"], dense)]
    assert len(both) > 100
    assert subsets[0] == subsets[1]
    assert subsets[0]
    message, without = limited["summary"]["spacing"], json.loads((planned / "report.json").read_text())
    assert (
        1.0
        < message["median_mm"]
        <= message["quantile_95_mm"]
        <= message["quantile_99_mm"]
        <= message["limit_mm"]
        == LIMIT_MM
    )
    assert without["spacing"]["limit_mm"] is None
    assert without["spacing"]["quantile_99_mm"] > LIMIT_MM
    assert 0 < limited["summary"]["coverage"]["coverable"] < without["coverage"]["coverable"]


def test_the_scan_has_the_planned_density(limited: dict[str, Any], run_cell: RunCommand) -> None:
    """The achieved coverage is the predicted one. At most 1 % of it has no scan point within the planned density."""
    process = run_cell("scan", "run", "--json", cwd=limited["folder"].parent, code=0)
    report = json.loads(process.stdout)
    coverage = report["coverage"]
    assert coverage["visible"] == pytest.approx(limited["summary"]["coverage"]["visible"], abs=1e-4)
    assert coverage["visible"] - 0.01 <= coverage["dense"] <= coverage["visible"]
    assert coverage["dense"] <= coverage["sampled"]
    assert sum(view["rays"]["too_sparse"] for view in report["views"]) > 0


def test_why_tries_a_greater_spacing_and_a_finer_grid(limited: dict[str, Any], run_cell: RunCommand) -> None:
    """Both changes measure some of the uncovered surface. The change of spacing names its option."""
    run_cell("why", "run", "--samples", "3000", "--json", cwd=limited["folder"].parent, code=0)
    changes = json.loads((limited["folder"] / "why" / "why.json").read_text())["all_changes"]
    for kind in ("spacing", "resolution"):
        assert max(change["estimated_gain"] for change in changes if change["kind"] == kind) > 0
    assert all(change["setting"].startswith("--max-spacing ") for change in changes if change["kind"] == "spacing")


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--max-spacing", "0.2"), "at the near end of its range this scanner's points are 0.6"),
        (("--max-spacing", "2", "--fill", "rays"), "choose plan.fill = 'aimed'"),
        (("--max-spacing", "2", "--sensor", "gocator-2340", "--baseline", "90"), "set scanner.profile_rate_hz"),
        (("--max-spacing", "2", "--sensor", "gocator-2340", "--baseline", "90"), "set scanner.line_points"),
    ],
)
def test_invalid_limits_are_refused(
    options: tuple[str, ...], words: str, part_file: Path, run_cell: RunCommand, tmp_path: Path
) -> None:
    """The error has exit code 2 and a remedy."""
    process = run_cell("plan", str(part_file), "--units", "mm", "--faces", "40", *options, cwd=tmp_path, code=2)
    assert words in process.stderr
