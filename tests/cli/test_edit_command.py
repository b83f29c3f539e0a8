"""`cell edit` on the command line: the new run, its gains and losses, exit codes."""

import json
from pathlib import Path

import pytest

from tests.support.fixture_types import RunCommand


def test_a_dropped_view_and_its_repair(planned: Path, run_cell: RunCommand, tmp_path: Path) -> None:
    """The table ends with gains, losses and a command to copy. The JSON object has the difference. RUN is unchanged."""
    before = {path: path.read_bytes() for path in planned.iterdir() if path.is_file()}
    views = len(json.loads((planned / "plan.json").read_text())["views"])
    process = run_cell("edit", planned, "--drop", "2", "--out", "without", cwd=tmp_path, code=0)
    text = " ".join(process.stdout.replace("│", " ").split())
    assert f"{views - 1} views instead of {views}" in text
    assert "loses" in text
    assert "cell edit without --repair" in text
    process = run_cell("edit", "without", "--repair", "--keep-order", "--out", "repaired", "--json", cwd=tmp_path)
    # The plan requests everything coverable, and the views near the dropped one are banned.
    assert (process.returncode, "edit with a smaller --dropped-range" in process.stderr) in ((0, False), (3, True))
    output = json.loads(process.stdout)
    assert output["against"]["views"]["only_a"] == []
    assert output["against"]["views"]["only_b"]
    assert output["against"]["surface"]["only_b_mm2"] > 0
    assert {path: path.read_bytes() for path in planned.iterdir() if path.is_file()} == before


@pytest.mark.parametrize(
    ("options", "code", "message"),
    [
        (("--drop", "99"), 2, "drop names view 99; the plan has the views 1 to "),
        (("--move", "2:9000,0,0,0,0,0"), 4, "view 2 cannot be used: it is out of the arm's reach"),
    ],
)
def test_refusals_have_a_sentence_and_a_code(
    options: tuple[str, ...], code: int, message: str, planned: Path, run_cell: RunCommand, tmp_path: Path
) -> None:
    """A refused edit reports its cause and exit code, and leaves no finished folder."""
    process = run_cell("edit", planned, *options, "--out", "edited", cwd=tmp_path, code=code)
    assert message in process.stderr
    assert list(tmp_path.iterdir()) == []
