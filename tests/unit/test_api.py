"""The Python interface returns the results of the command line."""

import json
import subprocess
import sys
from base64 import b64decode
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
import trimesh

from cell.api import edit, explore, open_run, plan, scan, setups
from cell.errors import FileError, SceneError, UsageError
from cell.runs import run as run_folders
from cell.runs.run import Run
from cell.scan.options import ScanOptions
from cell.scene.file import load_scene

_QUICK = {"place": (1100, 400, 100), "standoff": 200, "faces": 40, "samples": 2, "seed": 3, "coverage": 1}
_QUICK |= {"candidates": "optimal-scanning-zone"}


@pytest.fixture(scope="module", autouse=True)
def _cache(cache: Path) -> Iterator[None]:
    """Use the cache of the tests in place of the user's."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_CACHE_HOME", str(cache))
        yield


@pytest.fixture(scope="module")
def planned(tmp_path_factory: pytest.TempPathFactory) -> Run:
    """Return a small plan of a ball in memory."""
    ball = trimesh.creation.icosphere(subdivisions=3, radius=60.0)
    return plan(ball, units="mm", out=tmp_path_factory.mktemp("api") / "run", **_QUICK)


def test_importing_it_imports_nothing_heavy() -> None:
    """Importing `cell.api` imports no heavy package, not even NumPy."""
    heavy = ("numpy", "pydantic", "mujoco", "matplotlib", "rich", "typer", "numba")
    code = f"import sys, cell.api; print([m for m in {heavy} if m in sys.modules])"
    process = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert process.stdout.strip() == "[]"


def test_a_plan_is_a_value_of_arrays(planned: Run) -> None:
    """Array shapes agree with the number of views, and the poses agree with each other."""
    n = len(planned.candidate)
    assert planned.q.shape == (n, 6)
    assert planned.T_base_scanner.shape == planned.T_object_scanner.shape == (n, 4, 4)
    T_base_object = planned.T_base_scanner @ np.linalg.inv(planned.T_object_scanner)
    assert np.abs(T_base_object - T_base_object[0]).max() < 1e-9
    assert 1 <= planned.bound <= n
    assert 0 < planned.coverage.visible <= planned.coverage.coverable
    assert planned.exit_code == 0
    assert planned.motion.duration > 0
    assert not planned.q.flags.writeable


def test_views_are_objects(planned: Run) -> None:
    """Each view has its number, pose and joint angles; the marginal coverages add up to the coverage."""
    assert [view.number for view in planned.views] == [*range(1, len(planned.q) + 1)]
    assert np.array_equal([view.T_base_scanner for view in planned.views], planned.T_base_scanner)
    assert np.array_equal([view.q for view in planned.views], planned.q)
    assert sum(view.marginal_coverage for view in planned.views) == pytest.approx(planned.coverage.visible, abs=0.002)
    assert repr(planned.views[0]).startswith(f"View(1, candidate {planned.candidate[0]}, marginal coverage ")


def test_a_result_is_one_line_in_a_terminal_and_a_table_in_a_notebook(planned: Run, tmp_path: Path) -> None:
    """The line has the most important facts. The table has the picture if there is one. A failed run is shown too."""
    views, coverage = len(planned.views), f"{100 * planned.coverage.visible:.2f} %"
    assert repr(planned) == (
        f"Run({str(planned.folder)!r}, views {views}, coverage {coverage}, lower bound {planned.bound} views, "
        f"motion {planned.motion.duration:.1f} s)"
    )
    table = planned._repr_html_()
    assert f"<th>views</th><td>{views}</td>" in table
    assert b64decode(table.partition("base64,")[2].partition('"')[0]) == (planned.folder / "cell.png").read_bytes()
    failed = tmp_path / "failed"
    failed.mkdir()
    manifest = {"schema": planned.manifest.schema_version, "status": "failed", "stage": "reach", "reason": "<no>"}
    (failed / "manifest.json").write_text(json.dumps(manifest))
    assert repr(run_folders.open_run(failed)) == f"Run({str(failed)!r}, status failed in the stage 'reach': <no>)"
    assert run_folders.open_run(failed)._repr_html_().endswith("&lt;no&gt;</td></tr></table>")


def test_meshes_are_of_trimesh(planned: Run) -> None:
    """The part is a mesh of trimesh in metres, with the vertices of the run, and may be changed."""
    assert isinstance(planned.part, trimesh.Trimesh)
    assert planned.part.units == "m"
    assert np.array_equal(planned.part.vertices, planned.reference.vertices)
    assert planned.part.extents == pytest.approx([0.12, 0.12, 0.12], abs=0.002)
    planned.part.copy().vertices[0] = 0.0


def test_a_run_opened_again_is_the_same_value(planned: Run) -> None:
    """`open_run` reads back what `plan` returned."""
    again = open_run(str(planned.folder))
    assert again.report == planned.report
    assert np.array_equal(again.q, planned.q)
    assert np.array_equal(again.part.faces, planned.part.faces)


def test_a_mesh_in_memory_is_planned_as_the_scene_of_its_file(
    planned: Run, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    """A checked scene with the mesh as a file gives the same number of views. Nothing is printed."""
    file = tmp_path / "ball.ply"
    trimesh.creation.icosphere(subdivisions=3, radius=60.0).export(file, vertex_normal=False)
    settings = {"standoffs_mm": [200.0], "faces": 40, "samples_per_face": 2, "seed": 3, "coverage": 1.0}
    settings["candidates"] = "optimal-scanning-zone"
    tables = {"part": {"path": str(file), "units": "mm"}, "placement": {"position_mm": [1100, 400, 100]}}
    of_scene = plan(load_scene(None, tables | {"plan": settings}), out=tmp_path / "scene")
    assert len(of_scene.candidate) == len(planned.candidate)
    assert capfd.readouterr() == ("", "")


def test_a_plan_of_a_mesh_in_memory_can_be_edited(planned: Run, tmp_path: Path) -> None:
    """A plan of a mesh in memory can be edited; dropping a view leaves the others unchanged."""
    edited = edit(planned, drop=1, keep_order=True, out=tmp_path / "edited")
    assert edited.candidate.tolist() == planned.candidate.tolist()[1:]


def test_an_execution_is_a_value_too(planned: Run) -> None:
    """An execution without errors returns points on the ball, a mesh and its deviation."""
    message: list[tuple[str, int, int]] = []
    execution = scan(planned, resolution=1.0, progress=lambda *words: message.append(words))
    assert execution.exit_code == 0
    assert isinstance(execution.mesh, trimesh.Trimesh)
    assert repr(execution).startswith(f"Execution({str(execution.folder)!r}, views {len(planned.q)}, coverage ")
    radius = np.linalg.norm(execution.points, axis=1) * 1000
    assert np.abs(radius - 60).max() < 1.0
    assert execution.deviation is not None
    assert execution.deviation.rms_mm < 1.0
    assert execution.coverage.visible == pytest.approx(execution.coverage.predicted, abs=0.02)
    assert {stage for stage, _, _ in message} >= {"execute and scan", "merge"}


@pytest.mark.parametrize(
    ("call", "error", "words"),
    [
        (lambda: plan("mug", stand_off=100), UsageError, "standoff"),
        (lambda: setups("mug", max_setup=2), UsageError, "max_setups"),
        (lambda: scan("run", ScanOptions(), seed=4), UsageError, "seed"),
        (lambda: scan("run", resume="latest", seed=4), UsageError, "--resume"),
        (lambda: plan("mug", units="mm"), SceneError, "units"),
        (lambda: plan("no_such.stl", units="mm"), FileError, "no_such.stl"),
        (lambda: plan(trimesh.creation.box()), UsageError, "units"),
        (lambda: plan("mug", coverage=1.5), SceneError, "coverage"),
        (lambda: plan(load_scene(None), coverage=0.9), UsageError, "coverage"),
        (lambda: open_run("no/such/run"), FileError, "does not exist"),
        (lambda: scan("no/such/run"), FileError, "does not exist"),
        (lambda: plan(trimesh.Scene(), units="mm"), UsageError, r"the part is a Scene; .* scene\.to_mesh"),
    ],
    ids=[
        "unknown wish",
        "unknown option of set-ups",
        "options twice",
        "options of a resumed execution",
        "units of a built-in",
        "no file",
        "no units",
        "too much",
        "scene and wish",
        "no run",
        "no plan",
        "scene of meshes",
    ],
)
def test_invalid_calls_are_refused(call: object, error: type[Exception], words: str) -> None:
    """An invalid call is refused with an error of the matching class that names the cause."""
    with pytest.raises(error, match=words):
        call()  # type: ignore[operator]


@pytest.mark.parametrize("count", [1, pytest.param(None, marks=pytest.mark.slow)], ids=["first", "all"])
def test_the_page_runs(count: int | None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The examples of docs/python.md run as printed, one after the other."""
    page = (Path(__file__).parents[2] / "docs" / "python.md").read_text(encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    names: dict[str, object] = {}
    for block in page.split("```python\n")[1:][:count]:
        exec(block.split("```")[0], names)
    run = names["other"]
    assert isinstance(run, Run)
    assert run.folder == Path("edited")


def test_an_exploration_goes_on_where_it_is(tmp_path: Path) -> None:
    """Options of exploration, execution and scene are keywords, and a repeated call returns the same value."""
    ball = trimesh.creation.icosphere(subdivisions=3, radius=60.0)
    ball.export(tmp_path / "ball.stl")
    options = {
        **_QUICK,
        "ring": 2,
        "max_views": 2,
        "resolution": 2.0,
        "voxel": 4,
        "candidates": "optimal-scanning-zone",
    }
    del options["coverage"]
    exploration = explore(tmp_path / "ball.stl", units="mm", out=tmp_path / "explored", **options)
    assert [len(stage.q) for stage in exploration.stages] == [2]
    assert [stage.digest for stage in exploration.stages] == [stage.digest for stage in exploration.file.batches]
    assert exploration.mesh is not None
    assert np.abs(exploration.mesh.vertices).max() < 0.07
    assert explore(tmp_path / "ball.stl", units="mm", out=tmp_path / "explored", **options) == exploration
    with pytest.raises(UsageError, match="is an exploration with other options"):
        explore(tmp_path / "ball.stl", units="mm", out=tmp_path / "explored", **{**options, "seed": 4})
