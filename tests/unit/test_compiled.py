"""Compiled kernels: one note to the user, cache on disk, calls within one file only."""

import ast
import os
import subprocess
import sys
from pathlib import Path

import pytest

import planner

_CALL = """
import numpy as np
from cell.cli.terminal import Terminal
Terminal()
from planner.geometry.distance import count_crossings
first, bounds = np.array([0, 1]), np.zeros((2, 3, 3))
count_crossings(np.zeros(3), np.ones(3), (np.zeros((1, 3, 3)), first, bounds))
"""


def test_compilation_is_announced_once(tmp_path):
    """The first process prints one note for all kernels, and calls a function once that is registered twice.

    A second one uses the cache, and does neither.
    """
    code = """
from planner.compiled import call_at_first_compilation
show = lambda: print("first compilation")
call_at_first_compilation(show)
call_at_first_compilation(show)
"""
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path)}
    first, second = (
        subprocess.run([sys.executable, "-c", code + _CALL], env=environment, check=True, capture_output=True)
        for _ in range(2)
    )
    assert first.stderr.count(b"note: compiling inner loops") == 1
    assert first.stdout == b"first compilation\n"
    assert (second.stdout, second.stderr) == (b"", b"")


_LATE = """
from numba.core import event

class Listener(event.Listener):
    def on_start(self, event):
        print(event.data["dispatcher"].py_func.__module__)
    def on_end(self, event):
        pass

event.register("numba:compile", Listener())
"""


@pytest.mark.slow
def test_the_second_process_compiles_the_kernels_of_selection_and_ordering(tmp_path, part_file):
    """A plan after it compiles no kernel of `planner.cover` and `planner.tour`: the small problems have its types."""
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path / "cache")}
    plan = f"from cell.cli import main; main(['plan', {str(part_file)!r}, '--units', 'mm', '--out', 'run'])"

    def compiled_modules(code: str) -> set[str]:
        command = [sys.executable, "-c", _LATE + code]
        process = subprocess.run(command, env=environment, check=True, capture_output=True, text=True, cwd=tmp_path)
        return {line for line in process.stdout.splitlines() if line.startswith(("planner.", "cell."))}

    late = compiled_modules("from planner.first_use import compile_late_kernels; compile_late_kernels()")
    assert {"planner.cover.search", "planner.tour.ruin_and_recreate"} <= late
    others = compiled_modules("from planner import first_use; first_use.share_compilation = lambda: None\n" + plan)
    assert "planner.viewpoints.pose_search" in others
    assert not {name for name in others if name.startswith(("planner.cover", "planner.tour"))}


def test_a_process_that_does_not_start_is_no_failure(tmp_path):
    """The second process is optional: a missing interpreter ends no command."""
    code = """
import sys
from planner.first_use import share_compilation
share_compilation()
sys.executable = "/missing/python"
"""
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path)}
    process = subprocess.run([sys.executable, "-c", code + _CALL], env=environment, check=True, capture_output=True)
    assert b"compiling inner loops" in process.stderr


def test_a_kernel_calls_only_kernels_of_its_own_file():
    """Kernels call no kernel of another file, since Numba does not notice changes there."""
    root = Path(planner.__file__).parents[1]
    kernels: dict[str, list[ast.FunctionDef]] = {}
    trees = {}
    for folder in ("cell", "planner"):
        for path in (root / folder).rglob("*.py"):
            name, text = ".".join(path.relative_to(root).with_suffix("").parts), path.read_text(encoding="utf-8")
            if "@compiled" not in text:
                continue
            trees[name] = ast.parse(text)
            functions = [node for node in trees[name].body if isinstance(node, ast.FunctionDef)]
            kernels[name] = [f for f in functions if "compiled" in map(ast.unparse, f.decorator_list)]
    assert sum(map(bool, kernels.values())) >= 6
    names = {module: {kernel.name for kernel in each} for module, each in kernels.items()}
    for module, each in kernels.items():
        nodes = [node for node in ast.walk(trees[module]) if isinstance(node, ast.ImportFrom)]
        imported = {
            a.asname or a.name for node in nodes for a in node.names if a.name in names.get(node.module or "", ())
        }
        for kernel in each:
            used = {node.id for node in ast.walk(kernel) if isinstance(node, ast.Name)}
            assert not used & imported, f"{module}.{kernel.name}"
