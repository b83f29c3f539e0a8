"""Degenerate and large parts and scans: each gives a model with all its faces and points."""

from pathlib import Path

import numpy as np
import pytest

from cell.runs.run import open_run
from cell.view.appearance import MAX_FACES
from cell.view.replay_model import MAX_POINTS, build_replay_model
from planner.geometry.mesh import TriangleMesh

_SQUARE = np.array([[0, 0, 0], [0.1, 0, 0], [0.1, 0.1, 0], [0, 0.1, 0]], dtype=np.float64)


def _grid(n: int) -> TriangleMesh:
    x, y = (axis.ravel() / n for axis in np.meshgrid(np.arange(n + 1), np.arange(n + 1)))
    a = (np.arange(n)[:, None] * (n + 1) + np.arange(n)).ravel()
    faces = np.concatenate([np.stack([a, a + 1, a + n + 2], 1), np.stack([a, a + n + 2, a + n + 1], 1)])
    return TriangleMesh(np.stack([x, y, 0.01 * np.sin(9 * x) * np.cos(7 * y)], axis=1), faces)


@pytest.mark.parametrize(
    "reference",
    [
        pytest.param(TriangleMesh(_SQUARE[:3], np.array([[0, 1, 2]])), id="one triangle"),
        pytest.param(TriangleMesh(_SQUARE, np.array([[0, 1, 2], [0, 2, 3]])), id="plane"),
        pytest.param(TriangleMesh(_SQUARE, np.array([[0, 1, 2], [0, 2, 3], [0, 0, 1]])), id="degenerate face"),
        pytest.param(TriangleMesh(_SQUARE, np.array([[0, 1, 2], [0, 2, 3], [0, 2, 1], [0, 3, 2]])), id="both sides"),
        pytest.param(TriangleMesh(1e-4 * _SQUARE, np.array([[0, 1, 2], [0, 2, 3]])), id="ten micrometres"),
        pytest.param(_grid(340), id="231,200 faces"),
    ],
)
def test_any_part_is_shown(planned: Path, reference: TriangleMesh) -> None:
    """The surface has the part's faces, or at most MAX_FACES, and takes no part in contacts."""
    run = open_run(planned)
    replay_model = build_replay_model(run, run.scene, reference)
    surface = replay_model.model.geom("surface")
    faces = int(replay_model.model.mesh_facenum[surface.dataid[0]])
    assert faces == len(reference.faces) or 0.5 * MAX_FACES < faces <= MAX_FACES
    assert (surface.contype[0], surface.conaffinity[0]) == (0, 0)


@pytest.mark.parametrize("count", [0, 1, 2, 100, MAX_POINTS, 50_000])
def test_any_cloud_is_shown(planned: Path, count: int) -> None:
    """A scan without points has no mesh; otherwise each of at most MAX_POINTS points has eight faces."""
    run = open_run(planned)
    points = np.zeros((count, 3)) if count == 2 else np.random.default_rng(0).normal(size=(count, 3)) * 0.05
    replay_model = build_replay_model(run, run.scene, run.mesh("reference.ply"), [points])
    if count == 0:
        assert replay_model.cloud_meshes == (-1,)
    else:
        assert replay_model.model.mesh_facenum[replay_model.cloud_meshes[0]] == 8 * min(count, MAX_POINTS)
