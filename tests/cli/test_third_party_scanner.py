"""Scanners of other distributions: installed by pip, found by an entry point, used in a plan; broken scanners."""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import cell.scanners
from cell.errors import FileError, SceneError
from cell.scene.file import load_scene
from cell.study.prepared_part import scene_from_settings, scene_settings
from cell.study.scanner_study import select_views
from cell.study.trials import Trial
from tests.support.fixture_types import RunCommand

PACKAGE = Path(__file__).parents[1] / "third_party_scanner"


@pytest.fixture(scope="module")
def installed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with the example package, installed by pip without a network."""
    target = tmp_path_factory.mktemp("site")
    source = tmp_path_factory.mktemp("source") / "package"
    source.mkdir()
    for name in ("pyproject.toml", "cone_scanner.py"):  # building writes files: build outside the folder of the tests
        (source / name).write_bytes((PACKAGE / name).read_bytes())
    pip = [sys.executable, "-m", "pip", "install", "--quiet", "--no-index", "--no-deps", "--no-build-isolation"]
    process = subprocess.run(
        [*pip, "--disable-pip-version-check", "--target", str(target), str(source)],
        capture_output=True, text=True, timeout=120, check=False,
    )  # fmt: skip
    assert process.returncode == 0, process.stderr
    return target


@pytest.fixture
def on_path(installed: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Put the installed package on the path of this process."""
    monkeypatch.syspath_prepend(str(installed))


@pytest.mark.usefixtures("on_path")
def test_a_plan_is_made_with_a_scanner_of_another_distribution(
    run_cell: RunCommand, part_file: Path, tmp_path: Path
) -> None:
    """The scene has the scanner's key, the scanner's model decides on measurability, and its parameters are stored."""
    scene = tmp_path / "cell.toml"
    scene.write_text('[scanner]\ntype = "cone"\nhalf_angle_deg = 20.0\n', encoding="utf-8")
    arguments = ["--units", "mm", "--place", "1100,400,100", "--faces", "60", "--samples", "2", "--standoff", "250"]
    arguments += ["--candidates", "optimal-scanning-zone"]
    process = run_cell("plan", part_file, *arguments, "--scene", scene, "--out", "run", "--json", cwd=tmp_path, code=0)
    summary = json.loads(process.stdout)
    assert summary["settings"]["scanner"] == "cone"
    assert summary["coverage"]["visible"] > 0.5
    resolved = json.loads((tmp_path / "run" / "scene.resolved.json").read_text())
    assert resolved["scanner"] == {"type": "cone", "half_angle_deg": 20.0, "range_mm": [150.0, 450.0]}
    # Every entry of the matrix is inside the requested cone, and the cone has an effect.
    views = np.load(tmp_path / "run" / "viewpoints.npz")["T_object_scanner"][:, 0]
    M = np.load(tmp_path / "run" / "measurability.npz")
    row = np.repeat(np.arange(len(M["points"])), np.diff(M["indptr"]))
    T = views[M["indices"]]
    local = np.einsum("nji,nj->ni", T[:, :3, :3], M["points"][row] - T[:, :3, 3])
    angle = np.degrees(np.arccos(local[:, 2] / np.linalg.norm(local, axis=1)))
    assert 8 < angle.max() <= 20 + 1e-9


@pytest.mark.usefixtures("on_path")
def test_its_unknown_key_is_refused_with_a_hint(run_cell: RunCommand, tmp_path: Path) -> None:
    """The hint names a key among the arguments of the scanner's class."""
    (tmp_path / "cell.toml").write_text('[scanner]\ntype = "cone"\nhalf_angel_deg = 20.0\n', encoding="utf-8")
    process = run_cell("check", "cell.toml", cwd=tmp_path, code=2)
    assert "scanner.half_angel_deg is an unknown key of cone; did you mean 'half_angle_deg'?" in process.stderr


def test_equal_parameters_of_other_types_and_versions_are_other_scanners(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Identities of plug-ins differ by type, distribution and version: caches separate their matrices and trials."""
    code = (PACKAGE / "cone_scanner.py").read_text()
    seen, trials = [], []
    for number, (distribution, version, name) in enumerate(
        [("acme", "1.0", "one"), ("acme", "1.1", "one"), ("acme", "1.0", "two"), ("other", "1.0", "one")]
    ):
        folder = tmp_path / str(number)
        info = folder / f"{distribution}-{version}.dist-info"
        info.mkdir(parents=True)
        (folder / "cone_of_two.py").write_text(code, encoding="utf-8")
        (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {distribution}\nVersion: {version}\n")
        (info / "entry_points.txt").write_text(f"[cell.scanners]\n{name} = cone_of_two:Cone\n")
        with monkeypatch.context() as patch:
            patch.syspath_prepend(str(folder))
            seen.append(json.dumps(cell.scanners.identity(name, cell.scanners.make(name, {})), sort_keys=True))
            trials.append(Trial.of(select_views, scene_settings(load_scene(None, {"scanner": {"type": name}}))))
            assert scene_from_settings(json.loads(trials[-1].settings)).scanner.type == name
            if name == "one" and number:
                with pytest.raises(FileError, match="install the same version"):
                    scene_from_settings(json.loads(trials[0].settings))
    assert len(set(seen)) == len(set(trials)) == len(seen)
    own = cell.scanners.make("laser-line", {})
    assert cell.scanners.identity("laser-line", own) == own.parameters()


BROKEN = {
    "an import that fails": ("import no_such_module_anywhere\n", "cannot be imported .*No module named"),
    "a syntax error": ("class Broken(\n", "cannot be imported .*SyntaxError"),
    "an exception at import": ("raise RuntimeError('no licence')\n", "cannot be imported .*RuntimeError: no licence"),
    "no such class": ("class Other: pass\n", "cannot be imported .*AttributeError.*Broken"),
    "an instance in place of a class": ("Broken = object()\n", "which is not a class"),
    "a class without the methods": (
        "class Broken:\n    source = sensor = (0, 0, 0)\n    grid_shape = (1, 1)\n",
        "has no ray_directions, reject, parameters",
    ),
    "a constructor that fails": (
        "class Broken:\n    def __init__(self): raise KeyError('calibration')\n",
        "cannot be created with no keys: KeyError: 'calibration'",
    ),
    "parameters that JSON cannot hold": (
        "class Broken:\n    source = sensor = grid_shape = ray_directions = reject = None\n"
        "    def parameters(self): return {'gain': float('nan')}\n",
        r"invalid parameters\(\)",
    ),
    "parameters that are no dict": (
        "class Broken:\n    source = sensor = grid_shape = ray_directions = reject = None\n"
        "    def parameters(self): return [1]\n",
        "it is a list",
    ),
}


@pytest.mark.parametrize("case", BROKEN)
def test_a_broken_plug_in_gets_an_error_that_names_its_distribution(
    case: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The error names the distribution and the cause. Names and keys of other scanners still work."""
    code, words = BROKEN[case]
    module = f"broken_{sorted(BROKEN).index(case)}"
    (tmp_path / f"{module}.py").write_text(code, encoding="utf-8")
    info = tmp_path / "acme_scanners-2.1.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: acme-scanners\nVersion: 2.1\n", encoding="utf-8")
    (info / "entry_points.txt").write_text(f"[cell.scanners]\nbroken = {module}:Broken\n", encoding="utf-8")
    monkeypatch.syspath_prepend(str(tmp_path))
    assert {"broken", "laser-area", "laser-line"} <= set(cell.scanners.names())
    with pytest.raises(SceneError, match=words) as caught:
        cell.scanners.make("broken", {})
    assert "distribution acme-scanners 2.1" in str(caught.value)
    assert "fov_deg" in (cell.scanners.keys("laser-area") or ())


def test_two_distributions_with_one_name_of_a_scanner_are_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The error names both distributions."""
    for distribution in ("acme", "rival"):
        info = tmp_path / f"{distribution}-1.0.dist-info"
        info.mkdir()
        (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {distribution}\nVersion: 1.0\n")
        (info / "entry_points.txt").write_text(f"[cell.scanners]\ncone = {distribution}_cone:Cone\n")
    monkeypatch.syspath_prepend(str(tmp_path))
    with pytest.raises(SceneError, match=r"acme_cone.* and .*rival_cone|rival_cone.* and .*acme_cone"):
        cell.scanners.load("cone")
