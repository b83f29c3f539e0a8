"""The matrix with its cache: computed and cached columns give the same matrix."""

import os
from pathlib import Path

import numpy as np
import pytest

from cell import files
from cell.part.workpiece import load
from cell.scene.file import load_scene
from cell.scene.settle import settle
from cell.world import measurability
from cell.world.embree import EmbreeRayCaster
from cell.world.measurability import PartSurface, cache_folder, part_matrix
from planner.geometry.decimation import decimate
from planner.geometry.sampling import draw_samples, samples_at_face_centres
from planner.measurability.visibility import fill_matrix
from planner.viewpoints.viewpoints import optimal_scanning_zone


@pytest.fixture(scope="module")
def part(part_file):
    """Return the small part and its planning mesh."""
    part = load(str(part_file), "mm")
    return part, decimate(part.reference, 60)


@pytest.fixture
def measured(part, part_file, tmp_path, monkeypatch):
    """Return a function from viewpoints to (M, number of computed viewpoints), with its own cache."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    part, planning = part
    reference = part.reference
    features = draw_samples(reference, planning, 120, np.random.default_rng(0))
    caster = EmbreeRayCaster(reference.vertices, reference.faces)
    calculated = []

    def counted(views, *args, **keys):
        calculated.append(len(views))
        return fill_matrix(views, *args, **keys)

    monkeypatch.setattr("cell.world.measurability.fill_matrix", counted)

    def ask(views, *, method="aimed", **keys):
        tables = {"plan": {"fill": method}, "scanner": {"resolution_deg": [1.0, 1.0]}}
        scene = load_scene(None, {"part": {"path": str(part_file), "units": "mm"}, **tables})
        rows = features if method == "aimed" else samples_at_face_centres(reference, planning)
        calculated.clear()
        M = part_matrix(
            scene, settle(scene, part).settings, PartSurface(reference, planning, rows, caster), views, **keys
        )
        return M, sum(calculated)

    ask.views = optimal_scanning_zone(planning, (0.25,), (0.0, 1.0))
    return ask


def _same(a, b):
    return a.shape == b.shape and (a.matrix() != b.matrix()).nnz == 0 and a.indices.tobytes() == b.indices.tobytes()


@pytest.mark.parametrize("method", ["aimed", "rays"])
def test_only_new_columns_are_computed(measured, method):
    """After candidates are added, removed or reordered, only new columns are computed. All equal uncached ones."""
    rng = np.random.default_rng(1)
    total = len(measured.views)
    seen: set[int] = set()
    for which in (np.arange(40), np.arange(60), rng.permutation(50), np.arange(55, total), rng.permutation(total)):
        views = measured.views.pick(which)
        M, calculated = measured(views, method=method)
        assert calculated == len(set(which.tolist()) - seen)
        seen |= set(which.tolist())
        assert _same(M, measured(views, method=method, use_cache=False)[0])
    assert len(list(cache_folder().iterdir())) == 1


def test_a_file_does_not_grow_without_end(measured, monkeypatch):
    """Beyond a multiple of the columns of one run, the file is rewritten with the columns of this run."""
    monkeypatch.setattr(measurability, "_MAX_COLUMN_RATIO", 2)
    for start in (0, 10, 20, 30):
        measured(measured.views.pick(np.arange(start, start + 10)))
    (path,) = cache_folder().iterdir()
    with np.load(path) as stored:
        assert stored["shape"][1] <= 20
    assert measured(measured.views.pick(np.arange(30, 40)))[1] == 0


def test_without_the_cache_nothing_is_stored(measured):
    """use_cache=False neither reads nor writes."""
    measured(measured.views, use_cache=False)
    assert not cache_folder().exists()


def test_a_file_that_another_run_deletes_at_the_same_time_is_no_error(measured):
    """The size of the cache is limited by every run; a listed file may be gone before it is looked at."""
    measured(measured.views.pick(np.arange(5)))
    (cache_folder() / "gone.npz").symlink_to("nowhere")
    assert measured(measured.views.pick(np.arange(10)))[1] == 5


def test_the_cache_deletes_its_oldest_files(tmp_path: Path) -> None:
    """The oldest files are deleted until the limit holds. The newest file is kept even if it alone is too large."""
    for age, name in enumerate(("new", "middle", "old")):
        path = tmp_path / f"{name}.npz"
        path.write_bytes(b"x" * 100)
        os.utime(path, (1e9 - age, 1e9 - age))
    files.delete_oldest(tmp_path, 300)
    assert len(list(tmp_path.iterdir())) == 3
    files.delete_oldest(tmp_path, 250)
    assert {path.stem for path in tmp_path.iterdir()} == {"new", "middle"}
    files.delete_oldest(tmp_path, 10)
    assert {path.stem for path in tmp_path.iterdir()} == {"new"}
    (tmp_path / "deleted.npz").symlink_to(tmp_path / "nothing")  # as a file that another run deletes after the listing
    files.delete_oldest(tmp_path, 10)
    assert (tmp_path / "new.npz").is_file()
