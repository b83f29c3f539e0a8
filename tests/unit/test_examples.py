"""The scripts of docs/examples are short, use public modules only, have a picture, and run."""

import ast
import os
import subprocess
import sys
from pathlib import Path

import pytest
from PIL import Image

from benchmarks.methods.pictures import EXAMPLES
from tests.step_files import bored_block, needs_cascadio

ROOT = Path(__file__).parents[2]
FOLDER = ROOT / "docs" / "examples"
FILES = sorted(path.name for path in FOLDER.glob("*.py"))
PUBLIC = {"cell.api", "cell.errors"}
OTHERS = {"matplotlib.pyplot", "numpy", "trimesh"}


def test_every_script_is_an_example_or_its_plug_in() -> None:
    """The folder has the scripts whose pictures are drawn, and the plug-in of one of them."""
    assert set(FILES) == {f"{name}.py" for name in (*EXAMPLES, "range_finder")}


@pytest.mark.parametrize("name", FILES)
def test_it_is_short_and_uses_public_modules(name: str) -> None:
    """A script has at most 30 lines, compiles, and imports `cell.api` and common packages only."""
    text = (FOLDER / name).read_text(encoding="utf-8")
    assert len(text.splitlines()) <= 30
    tree = ast.parse(text)
    compile(tree, name, "exec")
    imported = {alias.name for node in ast.walk(tree) if isinstance(node, ast.Import) for alias in node.names}
    imported |= {str(node.module) for node in ast.walk(tree) if isinstance(node, ast.ImportFrom)}
    assert {module for module in imported if module.split(".")[0] not in sys.stdlib_module_names} <= PUBLIC | OTHERS


@pytest.mark.parametrize("name", EXAMPLES)
def test_it_is_shown(name: str) -> None:
    """Both indices link the script, and its page shows its picture, which has less than 150 kB."""
    page = (FOLDER / "README.md").read_text(encoding="utf-8")
    assert f"({name}.py)" in page
    assert f"(../images/example_{name}.png)" in page
    assert f"(examples/{name}.py)" in (ROOT / "docs" / "index.md").read_text(encoding="utf-8")
    assert 10_000 < (ROOT / "docs" / "images" / f"example_{name}.png").stat().st_size < 150_000


def test_the_step_file_is_that_of_the_tests() -> None:
    """block.step is the block with a bore of the tests."""
    assert (FOLDER / "block.step").read_text(encoding="utf-8") == bored_block()


@pytest.mark.slow
@needs_cascadio
@pytest.mark.parametrize("name", EXAMPLES)
def test_it_runs(name: str, tmp_path: Path, cache: Path) -> None:
    """A script runs in an empty folder and draws its picture there. The larger bore fails, the rest passes."""
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "MPLBACKEND": "agg", "XDG_CACHE_HOME": str(cache)}
    script = FOLDER / f"{name}.py"
    process = subprocess.run(
        [sys.executable, script], cwd=tmp_path, env=environment, capture_output=True, text=True, check=False
    )
    assert process.returncode == 0, process.stderr
    with Image.open(tmp_path / f"example_{name}.png") as picture:
        assert min(picture.size) > 200
    if name == "inspect_step":
        assert [line.split()[-1] for line in process.stdout.splitlines()[-4:]] == ["pass", "pass", "fail", "pass"]
