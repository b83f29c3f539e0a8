"""`cell part`: faces are listed with the numbers for a scene file, drawn, and printed as one JSON object."""

import json
from pathlib import Path

import pytest
import trimesh

from tests.step_files import bored_block, needs_cascadio
from tests.support.fixture_types import RunCommand


@needs_cascadio
def test_a_step_file_is_listed_and_drawn(run_cell: RunCommand, tmp_path: Path) -> None:
    """The seven faces and the diameter of the bore are listed. Files are reproducible, and the page has the faces."""
    (tmp_path / "block.stp").write_text(bored_block())
    process = run_cell("part", "block.stp", "--out", "drawn", cwd=tmp_path, code=0)
    assert "7: 6 plane, 1 cylinder" in process.stdout
    assert "diameter 16 mm" in process.stdout
    assert "cell plan block.stp" in process.stdout
    message = json.loads(run_cell("part", "block.stp", "--json", "--out", "again", cwd=tmp_path).stdout)
    assert message["kinds"] == {"plane": 6, "cylinder": 1}
    assert [face["diameter_mm"] for face in message["faces"] if face["kind"] == "cylinder"] == [16.0]
    assert message["extents_mm"] == pytest.approx([60, 40, 30], abs=1e-4)
    page = (tmp_path / "drawn" / "view.html").read_text()
    assert 'id="faces"' in page
    for name in ("view.html", "faces.png"):
        assert (tmp_path / "drawn" / name).read_bytes() == (tmp_path / "again" / name).read_bytes()


def test_a_mesh_is_described_without_faces(run_cell: RunCommand, tmp_path: Path) -> None:
    """A mesh has no CAD faces and requires its units."""
    trimesh.creation.box((20, 30, 40)).export(tmp_path / "box.stl")
    message = json.loads(run_cell("part", "box.stl", "--units", "mm", "--json", "--out", "drawn", cwd=tmp_path).stdout)
    assert message["volume_mm3"] == pytest.approx(24000)
    assert "faces" not in message
    assert (tmp_path / "drawn" / "view.html").is_file()
    assert run_cell("part", "box.stl", cwd=tmp_path).returncode == 2
