"""Notes on settings and data beyond the tested range."""

import numpy as np
import trimesh

from cell.metrology.reconstruct import NOISIEST, SPARSEST, reconstruct
from cell.part import workpiece
from cell.part.workpiece import MAX_DISTANCE_SIZES, Kind
from cell.robot.plant import MAX_ACCURATE_STEP, PlantSettings
from cell.scene import validation
from planner.geometry.decimation import decimate
from planner.geometry.sampling import draw_samples
from planner.registration.cloud import ScanCloud, merge


def test_a_long_time_step_has_a_note() -> None:
    """A time step above 1 ms has a note, and the default has none."""
    assert PlantSettings().warning == ""
    assert "2 ms is longer than 1 ms" in PlantSettings(time_step=2 * MAX_ACCURATE_STEP).warning


def test_a_part_far_from_its_origin_has_a_note() -> None:
    """A part far from its origin is reported beyond the limit, but not just below it."""
    box = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1.0]])
    faces = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])

    def kinds(away: float) -> set[Kind]:
        return {f.kind for f in workpiece.from_mesh("tip", box - 0.5 + [away, 0, 0], faces, "m", "").findings}

    assert Kind.FAR not in kinds(0.999 * MAX_DISTANCE_SIZES)
    assert Kind.FAR in kinds(1.001 * MAX_DISTANCE_SIZES)


def test_a_steep_grazing_limit_has_a_note() -> None:
    """A grazing limit above the tested range has a note, and the limit of that range has none."""
    for limit, output in ((validation.STEEPEST_GRAZING_DEG, 0), (validation.STEEPEST_GRAZING_DEG + 1, 1)):
        assert bool(validation.grazing_note(limit)) == bool(output)


def test_a_coarse_planning_mesh_has_a_note() -> None:
    """A coarse planning mesh has a note. The deviation falls with the number of faces."""
    ball = trimesh.creation.icosphere(subdivisions=4, radius=0.1)
    part = workpiece.from_mesh("ball", np.array(ball.vertices), np.array(ball.faces), "m", "").reference
    off = {}
    for faces in (12, 150, 600):
        planning = decimate(part, faces)
        off[faces] = validation.mesh_deviation(draw_samples(part, planning, 2000, np.random.default_rng(0)), planning)
    assert off[12] > off[150] > off[600]
    assert validation.coarse_mesh_note(off[600], 600) == ""
    assert "of 12 faces is coarse" in validation.coarse_mesh_note(off[12], 12)
    assert validation.coarse_mesh_note(validation.COARSEST_MESH, 99) == ""


def _plane(step: float, sigma: float) -> ScanCloud:
    x, y = np.meshgrid(np.arange(0.0, 0.1, step), np.arange(0.0, 0.1, step))
    z = np.random.default_rng(0).normal(0, 1, x.shape) * sigma
    return ScanCloud(np.stack([x.ravel(), y.ravel(), z.ravel()], axis=1), np.array([0.05, 0.05, 1.0]))


def test_sparse_and_noisy_clouds_have_notes() -> None:
    """A sparse and a noisy cloud have a note each, and a dense exact plane has none."""
    assert reconstruct(merge([_plane(0.001, 0.0)])).doubts == ()
    (sparse,) = reconstruct(merge([_plane(1.2 * SPARSEST * 0.14, 0.0)])).doubts
    assert "apart" in sparse
    (noisy,) = reconstruct(merge([_plane(0.001, 0.001)])).doubts
    assert "scatter" in noisy
    assert NOISIEST < 1
