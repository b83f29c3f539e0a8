"""Differences between the plan and the current files of the cell: each has a name and must be accepted."""

import json
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest
import trimesh

from cell.errors import SceneError
from cell.runs import ply
from cell.runs.cell import world_of
from cell.runs.current_files import CurrentFiles
from cell.runs.current_scene import require_current_scene
from cell.runs.run import open_run
from cell.runs.verification import VerifiedPlan, verify_plan
from cell.world.files import write_mjcf
from planner.geometry.mesh import TriangleMesh
from tests.support.fixture_types import RunCommand

_SCENE = """
[placement]
position_mm = [1100, 400, 100]
[plan]
faces = 60
samples_per_face = 2
candidates = "optimal-scanning-zone"
coverage = 0.9
standoffs_mm = [250]
[[fixtures]]
name = "box"
shape = "box"
size_mm = [60, 50, 40]
position_mm = [700, -700, 0]
[[fixtures]]
name = "clamp"
shape = "mesh"
path = "clamp.stl"
units = "mm"
position_mm = [0, -900, 50]
"""


@pytest.fixture(scope="module")
def cell_of_files(made_once: Callable[..., Path], part_file: Path, run_cell: RunCommand) -> Path:
    """Return a folder with a part, a scene, a mesh of a fixture, and the run folder of their plan."""

    def make(folder: Path) -> None:
        shutil.copy(part_file, folder / "part.stl")
        trimesh.creation.box((80, 60, 40)).export(folder / "clamp.stl")
        (folder / "cell.toml").write_text(_SCENE)
        run_cell("plan", "part.stl", "--units", "mm", "--scene", "cell.toml", "--out", "run", cwd=folder, code=0)

    return made_once("cell_of_files", make)


@pytest.fixture(scope="module")
def proven(cell_of_files: Path) -> VerifiedPlan:
    """Return the verified plan of `cell_of_files`."""
    return verify_plan(cell_of_files / "run")


@pytest.fixture
def now(cell_of_files: Path, tmp_path: Path) -> Path:
    """Return a folder with a copy of the files, to be changed."""
    for name in ("part.stl", "clamp.stl", "cell.toml"):
        shutil.copy(cell_of_files / name, tmp_path)
    return tmp_path


def _refused(proven: VerifiedPlan, files: CurrentFiles, *, wire: bool = False) -> str:
    """Return the names that the refusal asks to accept."""
    with pytest.raises(SceneError, match="the cell differs from the plan") as refusal:
        require_current_scene(proven, files, None, wire=wire)
    return str(refusal.value).rpartition(" ")[2]


def test_files_as_they_were_are_driven(proven: VerifiedPlan, now: Path) -> None:
    """The files of the manifest and other files of the same content are accepted."""
    require_current_scene(proven, CurrentFiles(), None, wire=True)
    require_current_scene(proven, CurrentFiles(scene=now / "cell.toml", part=str(now / "part.stl")), None, wire=True)
    (now / "cell.toml").write_text("# moved nothing\n" + _SCENE)
    require_current_scene(proven, CurrentFiles(scene=now / "cell.toml"), None, wire=True)


@pytest.mark.parametrize(
    ("was", "is_now", "name"),
    [
        ("[1100, 400, 100]", "[1100, 400, 101]", "placement"),
        ("[plan]", "[mount]\nposition_mm = [0, 0, 121]\n[plan]", "mount,housing"),
        ("[plan]", "[housing]\nsize_mm = [160, 80, 61]\n[plan]", "housing"),
        ("[plan]", "[post]\ndiameter_mm = 41\n[plan]", "post"),
        ("[plan]", "[robot]\npedestal_height_mm = 610\n[plan]", "pedestal"),
        ("[plan]", "[table]\nenabled = true\n[plan]", "table"),
        ("[60, 50, 40]", "[60, 50, 41]", "fixture:box"),
        ('name = "box"', 'name = "crate"', "fixture:box,fixture:crate"),
        ("[0, -900, 50]", "[0, -900, 51]", "fixture:clamp"),
        ("[plan]", "plan", "scene"),
    ],
)
def test_differences_are_named_and_can_be_accepted(
    was: str, is_now: str, name: str, proven: VerifiedPlan, now: Path
) -> None:
    """Each difference is refused by its name until that name is accepted. Other accepted names have no effect."""
    (now / "cell.toml").write_text(_SCENE.replace(was, is_now))
    assert _refused(proven, CurrentFiles(scene=now / "cell.toml")) == name
    assert _refused(proven, CurrentFiles(scene=now / "cell.toml", accept_changed_scene=("missing", "nothing"))) == name
    require_current_scene(
        proven, CurrentFiles(scene=now / "cell.toml", accept_changed_scene=tuple(name.split(","))), None, wire=True
    )


def test_another_surface_is_another_part_and_another_header_is_not(proven: VerifiedPlan, now: Path) -> None:
    """A file with the same triangles and another header is the same part; a shifted mesh is not."""
    content = (now / "part.stl").read_bytes()
    (now / "part.stl").write_bytes(b"exported again".ljust(80) + content[80:])
    require_current_scene(proven, CurrentFiles(part=str(now / "part.stl")), None, wire=True)
    mesh = trimesh.load(now / "part.stl")
    mesh.apply_translation([0, 0, 0.1])
    mesh.export(now / "part.stl")
    assert _refused(proven, CurrentFiles(part=str(now / "part.stl"))) == "part"
    assert _refused(proven, CurrentFiles(part="mug")) == "part"


def test_the_files_of_the_manifest_are_looked_at_again(
    cell_of_files: Path, tmp_path: Path, run_cell: RunCommand
) -> None:
    """Export and scan report a changed file and a missing file."""
    for name in ("part.stl", "clamp.stl", "cell.toml"):
        shutil.copy(cell_of_files / name, tmp_path)
    shutil.copytree(cell_of_files / "run", tmp_path / "run")
    manifest = json.loads((tmp_path / "run/manifest.json").read_text())
    assert [each["role"] for each in manifest["files"]] == ["scene", "part", "fixture:clamp"]
    for each in manifest["files"]:
        each["path"] = str(tmp_path / Path(each["path"]).name)
    (tmp_path / "run/manifest.json").write_text(json.dumps(manifest))

    (tmp_path / "cell.toml").write_text(_SCENE.replace("[1100, 400, 100]", "[1100, 401, 100]"))
    process = run_cell("export", "run", cwd=tmp_path, code=2)
    assert "the placement differs from the plan" in process.stderr
    process = run_cell("export", "run", "--accept-changed-scene", "placement", cwd=tmp_path, code=0)
    assert "the placement differs" in process.stderr

    (tmp_path / "cell.toml").write_text(_SCENE)
    (tmp_path / "clamp.stl").write_bytes(b"solid")
    assert "fixture:clamp" in run_cell("scan", "run", cwd=tmp_path).stderr
    (tmp_path / "clamp.stl").unlink()
    process = run_cell("export", "run", cwd=tmp_path, code=0)
    assert f"{tmp_path / 'clamp.stl'} is missing" in process.stderr
    word = ("--confirm-motion", manifest["digest"], "--driver", "modbus://127.0.0.1:1")
    process = run_cell("scan", "run", *word, cwd=tmp_path, code=2)
    assert "--accept-changed-scene missing" in process.stderr
    run_cell("scan", "run", *word, "--accept-changed-scene", "missing", cwd=tmp_path, code=5)
    assert not (tmp_path / "run/executions").exists()


def test_options_of_the_command_line_are_no_difference(
    cell_of_files: Path, tmp_path: Path, run_cell: RunCommand
) -> None:
    """A placement of the command line is no difference from the scene file of the run."""
    for name in ("part.stl", "clamp.stl", "cell.toml"):
        shutil.copy(cell_of_files / name, tmp_path)
    run_cell(
        "plan", "part.stl", "--units", "mm", "--scene", "cell.toml", "--place", "1100,420,100", "--out", "run",
        cwd=tmp_path, code=0,
    )  # fmt: skip
    placed = verify_plan(tmp_path / "run")
    (tmp_path / "cell.toml").write_text(_SCENE.replace("[60, 50, 40]", "[60, 50, 42]"))
    assert _refused(placed, CurrentFiles()) == "fixture:box"
    assert _refused(placed, CurrentFiles(scene=tmp_path / "cell.toml")) == "placement,fixture:box"


def _without_box(folder: Path) -> None:
    path = folder / "scene.resolved.json"
    content = json.loads(path.read_text())
    content["fixtures"] = [each for each in content["fixtures"] if each["name"] != "box"]
    path.write_text(json.dumps(content))


def _thinner_part(folder: Path) -> None:
    path = folder / "reference.ply"
    mesh = ply.mesh(path.read_bytes())
    middle = (mesh.vertices.min(axis=0) + mesh.vertices.max(axis=0)) / 2
    path.write_bytes(ply.mesh_bytes(TriangleMesh(middle + (mesh.vertices - middle) * [0.5, 0.5, 1.0], mesh.faces)))


@pytest.mark.parametrize(
    ("change", "sentence"), [(_without_box, "the fixture 'box' is new"), (_thinner_part, "has another surface")]
)
def test_a_changed_folder_is_refused_although_it_is_consistent(
    cell_of_files: Path, tmp_path: Path, resealed: Callable[[Path], str], change: Callable[[Path], None], sentence: str
) -> None:
    """A fixture removed from the cell and a smaller part pass the verification, but differ from the user's files."""
    folder = tmp_path / "changed"
    shutil.copytree(cell_of_files / "run", folder)
    change(folder)
    resealed(folder)
    run = open_run(folder)
    write_mjcf(world_of(run, run.mesh("reference.ply")), folder)
    resealed(folder)
    verified = verify_plan(folder)
    with pytest.raises(SceneError, match=sentence):
        require_current_scene(verified, CurrentFiles(), None, wire=False)


def test_options_of_the_command_are_no_differences(proven: VerifiedPlan) -> None:
    """The manifest names the keys that are not from the file; the plan itself passes."""
    assert proven.run.manifest.overrides == ("part.path", "part.units")
    require_current_scene(proven, CurrentFiles(), None, wire=False)
