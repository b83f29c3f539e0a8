"""Compiled kernels: one note to the user, cache on disk, calls within one file only."""

import ast
import os
import subprocess
import sys
from pathlib import Path

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
    """The first process prints one note for all kernels. A second one uses the cache and prints nothing."""
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path)}
    errors = [
        subprocess.run([sys.executable, "-c", _CALL], env=environment, check=True, capture_output=True).stderr
        for _ in range(2)
    ]
    assert errors[0].count(b"note: compiling inner loops") == 1
    assert errors[1] == b""


def test_a_kernel_calls_only_kernels_of_its_own_file():
    """Kernels call no kernel of another file, since Numba does not notice changes there."""
    root = Path(planner.__file__).parents[1]
    kernels: dict[str, list[ast.FunctionDef]] = {}
    trees = {}
    for folder in ("cell", "planner"):
        for path in (root / folder).rglob("*.py"):
            name = ".".join(path.relative_to(root).with_suffix("").parts)
            trees[name] = ast.parse(path.read_text(encoding="utf-8"))
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
