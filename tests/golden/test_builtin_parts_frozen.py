"""The built-in parts are frozen: benchmarks of different versions are comparable only with equal parts."""

import hashlib
from collections.abc import Callable
from functools import cache
from pathlib import Path

import numpy as np
import pytest
import trimesh

from benchmarks.part_models.build import PART_MODELS
from cell.errors import FileError, UsageError
from cell.files import model_file
from cell.part import builtin
from planner.geometry.mesh import TriangleMesh

# Area [mm^2], volume [mm^3], centre of the surface [mm], and begin of the sha256 of vertices and faces.
FROZEN = {
    "mseke": (123049, 3.23568e6, (-0.0581, 2.4888, 87.001), "e01cec6b14e40e2b"),
    "mug": (16533.3, 24993.3, (-3.9888, -0.1105, 20.9449), "7d2ff8005ea46bfb"),
    "robinet": (70448.5, 203984, (-20.489, 4.985, 57.4804), "431919b21f75092e"),
    "petanque": (47781.9, 360064, (-3.9543, 8.2153, 37.9587), "819c14d99273e85b"),
    "humerus": (1059.02, 1277.12, (-2.3415, -0.0681, 4.3323), "92c7d2776336e745"),
    "st-jean": (24249.3, 119311, (-0.3899, -22.192, 23.9094), "66bcc9a1eab293ef"),
}

LARGE = ("petanque", "st-jean")
"""Parts whose counts take a second each. The hash above shows a change of them, too."""


@cache
def shipped(name: str) -> TriangleMesh:
    """Return the part, read once in a session."""
    return builtin.load(name)


@pytest.mark.parametrize("name", builtin.NAMES)
def test_the_part_is_the_one_that_was_frozen(name: str) -> None:
    """Area, volume, centre of the surface and every byte equal those of the first build."""
    mesh = shipped(name)
    areas = mesh.areas
    corners = mesh.vertices[mesh.faces]
    volume = np.einsum("fj,fj->", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])) / 6
    area_mm2, volume_mm3, centre_mm, digest = FROZEN[name]
    assert hashlib.sha256(mesh.vertices.tobytes() + mesh.faces.tobytes()).hexdigest().startswith(digest)
    assert areas.sum() * 1e6 == pytest.approx(area_mm2, rel=1e-4)
    assert volume * 1e9 == pytest.approx(volume_mm3, rel=1e-4)
    assert areas @ mesh.centres / areas.sum() * 1e3 == pytest.approx(np.array(centre_mm), abs=0.02)


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=pytest.mark.slow) if name in LARGE else name for name in builtin.NAMES]
)
def test_the_part_has_the_papers_counts_bounds_and_genus(name: str) -> None:
    """Faces, vertices and bounding box are those printed in Fig. 6; it is one closed, outward body without slivers."""
    mesh, paper = shipped(name), PART_MODELS[name]
    assert len(mesh.faces) == paper.faces
    assert len(mesh.vertices) == paper.vertices
    assert np.abs(np.ptp(mesh.vertices, axis=0) * 1000 - paper.size_mm).max() < 1e-6
    assert mesh.vertices[:, 2].min() == 0
    body = trimesh.Trimesh(mesh.vertices * 1000, mesh.faces, process=False)
    assert body.is_watertight
    assert body.is_winding_consistent
    assert body.volume > 0
    assert body.body_count == 1
    assert body.euler_number == 2 - 2 * paper.genus
    assert mesh.areas.min() > 1e-5 * mesh.areas.mean()
    assert len(np.unique(np.sort(mesh.faces, axis=1), axis=0)) == paper.faces
    assert body.area == pytest.approx(paper.area_mm2, rel=0.3)


PRINTED_VERTICES = {
    "mug": 74994, "petanque": 169952, "robinet": 81450, "mseke": 93169, "humerus": 138966, "st-jean": 374995,
}  # fmt: skip


@pytest.mark.parametrize("name", builtin.NAMES)
def test_the_genus_is_the_one_that_the_printed_counts_imply(name: str) -> None:
    """The genus of the table gives the number of vertices that the paper prints."""
    assert PART_MODELS[name].vertices == PRINTED_VERTICES[name]


def test_an_unknown_name_is_refused_with_the_names_that_exist() -> None:
    """The message lists all six names."""
    with pytest.raises(UsageError, match="mseke, mug, robinet, petanque, humerus, st-jean"):
        builtin.load("teapot")


@pytest.mark.parametrize(
    "spoil",
    [
        lambda content: b"",
        lambda content: b"not a mesh",
        lambda content: content[:100_000],
        lambda content: content[:100_000] + bytes([content[100_000] ^ 0xFF]) + content[100_001:],
    ],
    ids=["empty", "text", "cut short", "one byte flipped"],
)
def test_a_damaged_file_is_one_sentence(
    spoil: Callable[[bytes], bytes], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The message names the file and the remedy."""
    path = tmp_path / "mug.npz"
    path.write_bytes(spoil(model_file("parts/mug.npz").read_bytes()))
    monkeypatch.setattr(builtin, "model_file", lambda name: path)
    with pytest.raises(FileError, match=r"mug\.npz is damaged .* install scan-cell again"):
        builtin.load("mug")
