"""Kernels compiled ahead are the ones that the program then uses, and nothing is compiled twice."""

import ast
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from cell import compile_ahead
from cell.commands.terminal import Terminal
from cell.errors import FileError

_CALLS = {
    "distances": """
import numpy as np
from cell.scene.scene import Scene
from cell.stand_ins import build
from cell.world.collision import MujocoCollisionChecker
from cell.world.model import compile_world
part = build("petanque")
world = compile_world(Scene(), part.vertices, part_faces=part.faces, baseline_mm=100.0)
checker = MujocoCollisionChecker(world)
print(checker.distance(np.array([[0.0, -1.2, 1.4, 0.0, 0.9, 0.0]])))
""",
    "tours": """
import numpy as np
from planner import generalised_tsp
rng = np.random.default_rng(1)
cost = rng.uniform(1.0, 2.0, (60, 60))  # as with sweeps, there and back differ
for costs in (cost, cost + cost.T):
    problem = generalised_tsp.instance(costs, np.arange(0, 61, 3))
    generalised_tsp.solve(problem, np.arange(1, 20), rng, 20)
""",
}


def _compiled(folder: Path) -> set[str]:
    return {path.name for path in folder.rglob("*.nbc")}


@pytest.mark.parametrize("group", list(compile_ahead.GROUPS))
def test_the_program_finds_compiled_what_it_calls(group, tmp_path):
    """It compiles no kernel and no signature that was not there; and the mark says that all is there."""
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path)}
    subprocess.run([sys.executable, "-m", "cell.compile_ahead", group], env=environment, check=True)
    ahead = _compiled(tmp_path)
    assert ahead
    assert (tmp_path / compile_ahead.mark(group)).exists()
    subprocess.run([sys.executable, "-c", _CALLS[group]], env=environment, check=True)
    assert _compiled(tmp_path) == ahead


def test_nothing_is_begun_where_the_marks_are(tmp_path, monkeypatch):
    """A second plan begins no process."""
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))
    for group in compile_ahead.GROUPS:
        (tmp_path / compile_ahead.mark(group)).touch()
    with compile_ahead.begun(compile_ahead.GROUPS) as ahead:
        assert ahead.processes == ()


def test_what_still_compiles_when_a_plan_fails_is_stopped(tmp_path, monkeypatch):
    """Nobody is left at work behind a mistyped path."""
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))
    with pytest.raises(FileError), compile_ahead.begun(["tours"]) as ahead:
        raise FileError("no such part")
    assert [process.returncode for process in ahead.processes] == [-signal.SIGTERM]


def test_a_user_without_a_home_plans_all_the_same(monkeypatch):
    """Compiling ahead is a matter of time alone."""
    for name in ("HOME", "XDG_CACHE_HOME", "NUMBA_CACHE_DIR"):
        monkeypatch.delenv(name, raising=False)

    def homeless() -> Path:
        raise RuntimeError("Could not determine home directory.")

    monkeypatch.setattr(Path, "home", homeless)
    with compile_ahead.begun(compile_ahead.GROUPS) as ahead:
        assert ahead.processes == ()


def test_modules_of_the_folder_that_it_is_started_in_are_not_taken_for_its_own(tmp_path, monkeypatch):
    """A folder may hold a `planner` of its own."""
    (tmp_path / "planner").mkdir()
    (tmp_path / "planner" / "__init__.py").write_text(f"open({str(tmp_path / 'seen')!r}, 'w')")
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "numba"))
    monkeypatch.chdir(tmp_path)
    with compile_ahead.begun(["distances"]) as ahead:
        ahead.wait(Terminal(quiet_stdout=True))
    assert [process.returncode for process in ahead.processes] == [0]
    assert not (tmp_path / "seen").exists()


def test_another_kernel_is_another_mark(monkeypatch):
    """What was compiled before is not taken for what is there now."""
    before = compile_ahead.mark("tours")
    read = Path.read_bytes
    monkeypatch.setattr(Path, "read_bytes", lambda path: read(path) + b"# changed")
    assert compile_ahead.mark("tours") != before


def test_a_process_that_failed_is_waited_for_and_forgotten():
    """Its kernels are compiled where they are called."""
    failed = subprocess.Popen([sys.executable, "-c", "raise SystemExit(1)"])
    compile_ahead.Ahead((failed,)).wait(Terminal(quiet_stdout=True))
    assert failed.returncode == 1


def test_a_kernel_calls_only_kernels_of_its_own_file():
    """Numba would not notice that a kernel of another file has changed."""
    root = Path(compile_ahead.__file__).parents[1]
    kernels = {}
    for folder in ("cell", "planner"):
        for path in (root / folder).rglob("*.py"):
            text = path.read_text(encoding="utf-8")
            if "\n@compiled\n" in text:
                kernels[".".join(path.relative_to(root).with_suffix("").parts)] = ast.parse(text)
    assert len(kernels) >= 6
    for name, tree in kernels.items():
        imported = {node.module for node in ast.walk(tree) if isinstance(node, ast.ImportFrom)}
        assert not imported & kernels.keys(), name
