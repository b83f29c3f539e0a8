"""Kernels compiled ahead, by processes of their own, while the first plan after an installation does other work.

numba compiles a kernel when it is first called and keeps the code on disk: some ten seconds in all, once. A thread
would not hide them, because numba holds the interpreter while it compiles. `python -m cell.compile_ahead tours` (or
`distances`) calls the kernels of one group on a toy problem, so that exactly the signatures are compiled that the
program uses, and leaves a mark beside the code; where all marks are there, nothing is begun.

All of this is a matter of time alone: what is not compiled ahead is compiled where it is called.
"""

import contextlib
import hashlib
import os
import subprocess
import sys
import time
from collections.abc import Collection, Iterator
from dataclasses import dataclass
from importlib import metadata
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

import cell
import planner
from cell import caches

if TYPE_CHECKING:
    from cell.narrator import Narrator

_PATIENCE_S = 120.0


@dataclass(frozen=True, slots=True)
class Ahead:
    """Processes that compile."""

    processes: tuple[subprocess.Popen[bytes], ...]

    def wait(self, narrator: "Narrator") -> None:
        """Return when all is compiled, or a process failed or took too long."""
        if any(process.poll() is None for process in self.processes):
            with narrator.stage("compile (once)"):
                deadline = time.monotonic() + _PATIENCE_S
                for process in self.processes:
                    with contextlib.suppress(subprocess.TimeoutExpired):
                        process.wait(max(0.0, deadline - time.monotonic()))


@contextlib.contextmanager
def begun(groups: Collection[str]) -> Iterator[Ahead]:
    """Compile what is not on disk yet; whatever still compiles at the end is stopped.

    Args:
        groups: of `GROUPS`, those that will be called.
    """
    try:
        missing = [group for group in groups if not any((place / mark(group)).exists() for place in _places())]
    except (OSError, RuntimeError):  # sources inside an archive, or a user without a home
        missing = []
    ahead = Ahead(tuple(_process(group) for group in missing))
    try:
        yield ahead
    finally:
        for process in ahead.processes:
            process.terminate()
            process.wait()


def _process(group: str) -> subprocess.Popen[bytes]:
    silent = subprocess.DEVNULL
    # -P and the path: the modules of this program, not those of the folder that it was started in.
    command = [sys.executable, "-P", "-m", "cell.compile_ahead", group]
    paths = [str(Path(cell.__file__).parents[1]), os.environ.get("PYTHONPATH", "")]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, paths))}
    return subprocess.Popen(command, stdin=silent, stdout=silent, stderr=silent, env=environment)


def tours() -> None:
    """Call the kernels that order views."""
    from planner.order import generalised_tsp, tour_bound

    at = np.random.default_rng(0).random((8, 2))
    cost = np.linalg.norm(at[:, None] - at, axis=2)
    problem = generalised_tsp.instance((cost + cost.T) / 2, np.arange(0, 9, 2))
    found, _ = generalised_tsp.search(problem, np.arange(0, 8, 2), 0, 1)
    tour_bound.by_walks(problem.either, problem.first, found, 1000)


def distances() -> None:
    """Call the kernels that measure how far the arm is from the part's triangles, and whether it is inside."""
    from cell.world.triangle_distance import BOX
    from cell.world.triangles import TriangleTree
    from planner.surface.mesh import TriangleMesh

    corners = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]])
    faces = np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]])
    tree = TriangleTree(TriangleMesh(corners, faces))
    upright = np.eye(3).ravel()
    tree.distance(BOX, np.full(3, 0.01), np.full(3, 0.1), upright, np.zeros(3), upright, 9.0)


GROUPS = {"tours": tours, "distances": distances}
"""What one process compiles; two of about equal length."""

_SOURCES = {
    "tours": ("ruin_and_recreate.py", "walk_relaxation.py"),
    "distances": ("triangle_distance.py", "crossings.py"),
}


def mark(group: str) -> str:
    """Name of a group's mark: another numba, Python or kernel makes another."""
    folder = Path(planner.__file__).parent if group == "tours" else Path(cell.__file__).parent / "world"
    digest = hashlib.sha256("\n".join([sys.version, metadata.version("numba")]).encode())
    for name in _SOURCES[group]:
        digest.update((folder / name).read_bytes())
    return f"scan_cell_{group}_{digest.hexdigest()[:16]}.compiled"


def _places() -> tuple[Path, ...]:
    """Where a mark may be: like the code beside the modules, or with the user's caches where that is not allowed."""
    named = os.environ.get("NUMBA_CACHE_DIR")
    return (Path(named),) if named else (Path(planner.__file__).parent / "__pycache__", caches.folder("kernels"))


def _leave_mark(group: str) -> None:
    for place in _places():
        with contextlib.suppress(OSError):
            place.mkdir(parents=True, exist_ok=True)
            for old in place.glob(f"scan_cell_{group}_*.compiled"):
                old.unlink()
            (place / mark(group)).touch()
            return


if __name__ == "__main__":
    GROUPS[sys.argv[1]]()
    _leave_mark(sys.argv[1])
