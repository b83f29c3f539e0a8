"""Kernels compiled ahead are the ones that the program then uses, and nothing is compiled twice."""

import os
import subprocess
import sys
from pathlib import Path

from cell import compile_ahead
from cell.commands.narrator import Narrator

_CHECK = """
import numpy as np
from cell.scene.scene import Scene
from cell.stand_ins import build
from cell.world.collision import MujocoCollisionChecker
from cell.world.world import compile
part = build("petanque")
world = compile(Scene(), part.vertices, part_faces=part.faces, baseline_mm=100.0)
checker = MujocoCollisionChecker(world)
print(checker.distance(np.array([[0.0, -1.2, 1.4, 0.0, 0.9, 0.0]])))
"""


def _compiled(folder: Path) -> set[str]:
    return {path.name for path in folder.rglob("*.nbc")}


def test_the_program_finds_compiled_what_it_calls(tmp_path):
    """A checker with the true triangles compiles no kernel and no signature that was not there."""
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path)}
    subprocess.run([sys.executable, "-m", "cell.compile_ahead", "distances"], env=environment, check=True)
    ahead = _compiled(tmp_path)
    assert any(name.startswith("triangle_kernels.nearest_triangle") for name in ahead)
    subprocess.run([sys.executable, "-c", _CHECK], env=environment, check=True)
    assert _compiled(tmp_path) == ahead


def test_nothing_is_begun_where_the_marks_are(tmp_path, monkeypatch):
    """A second plan begins no process."""
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))
    for group in compile_ahead.GROUPS:
        (tmp_path / compile_ahead._mark(group)).touch()
    assert compile_ahead.begin().processes == ()


def test_another_kernel_is_another_mark(monkeypatch):
    """What was compiled before is not taken for what is there now."""
    before = compile_ahead._mark("tours")
    monkeypatch.setattr(compile_ahead, "_KERNELS", compile_ahead._KERNELS[:-1])
    assert compile_ahead._mark("tours") != before


def test_a_process_that_failed_is_waited_for_and_forgotten():
    """Its kernels are compiled where they are called."""
    failed = subprocess.Popen([sys.executable, "-c", "raise SystemExit(1)"])
    compile_ahead.Ahead((failed,)).wait(Narrator(quiet_stdout=True))
    assert failed.returncode == 1
