"""Shared by all tests: a small part of the tests' own and one finished plan of it, made through the command line."""

import json
import os
import select
import subprocess
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from hypothesis import settings

# Wall time is not a property; and where a machine decides whether a change lands, the same examples run every time.
settings.register_profile("own", deadline=None, derandomize="CI" in os.environ)
settings.load_profile("own")

_SMALL_PLAN = ("--place", "1100,400,100", "--faces", "120", "--samples", "2", "--standoff", "250", "--seed", "3")


def _blob(subdivisions: int = 4) -> trimesh.Trimesh:
    """A closed, bumpy body of some 110 mm with a dent, in millimetres and off the origin."""
    mesh = trimesh.creation.icosphere(subdivisions=subdivisions, radius=1.0)
    x, y, z = mesh.vertices.T
    radius = 50 + 6 * np.sin(3 * x + 1) * np.cos(2 * y) + 4 * np.sin(4 * z) - 14 * np.exp(-8 * ((x - 1) ** 2 + y**2))
    mesh.vertices = mesh.vertices * radius[:, None] + np.array([20.0, -10.0, 35.0])
    return mesh


@pytest.fixture(scope="session")
def cache(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A cache folder of the test session."""
    return tmp_path_factory.mktemp("cache")


@pytest.fixture(scope="session")
def run_cell(cache: Path) -> Callable[..., subprocess.CompletedProcess[str]]:
    """`python -m cell` with arguments in a directory `cwd`, its caches kept apart from the user's."""

    def run(*arguments: str, cwd: Path) -> subprocess.CompletedProcess[str]:
        environment = {**os.environ, "XDG_CACHE_HOME": str(cache), "COLUMNS": "120", "NO_COLOR": "1"}
        environment.pop("SCAN_CELL_TRACEBACK", None)
        return subprocess.run(
            [sys.executable, "-m", "cell", *arguments],
            cwd=cwd, env=environment, capture_output=True, text=True, timeout=300, check=False,
        )  # fmt: skip

    return run


@pytest.fixture(scope="session")
def small_plan() -> tuple[str, ...]:
    """Options of the plan that `planned` holds."""
    return _SMALL_PLAN


@pytest.fixture(scope="session")
def blob() -> Callable[[int], trimesh.Trimesh]:
    """Builds the small part at a number of subdivisions, millimetres."""
    return _blob


@pytest.fixture(scope="session")
def part_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The small part as binary STL, millimetres."""
    path = tmp_path_factory.mktemp("part") / "blob.stl"
    _blob().export(path)
    return path


@pytest.fixture(scope="session")
def planned(
    tmp_path_factory: pytest.TempPathFactory, part_file: Path, run_cell: Callable[..., subprocess.CompletedProcess[str]]
) -> Path:
    """Run folder of one finished plan of the small part."""
    folder = tmp_path_factory.mktemp("runs")
    done = run_cell("plan", str(part_file), "--units", "mm", *_SMALL_PLAN, "--out", "run", "--json", cwd=folder)
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["n_views"] > 1
    return folder / "run"


@dataclass
class Emulated:
    """A process of `cell emulate`.

    Attributes:
        process: the process.
        log: its journal.
        state: file of its arm's position.
    """

    process: subprocess.Popen[str]
    log: Path
    state: Path

    @cached_property
    def url(self) -> str:
        """Where its controller answers; waits until it does."""
        stdout = self.process.stdout
        assert stdout is not None
        ready, _, _ = select.select([stdout], [], [], 60)
        url = stdout.readline().strip() if ready else ""
        assert url, "the emulator did not start"
        return url

    def entries(self, *events: str) -> list[dict[str, Any]]:
        """What the journal says of some kinds of events, of all where none is given, in order."""
        whole = self.log.read_text(encoding="utf-8").rpartition("\n")[0]
        found = [json.loads(line) for line in whole.splitlines()]
        return [entry for entry in found if not events or entry["event"] in events]

    def end(self) -> int:
        """End it in order, as Ctrl-C does; but a process of a background job may ignore that."""
        self.process.terminate()
        return self.process.wait(20)


@pytest.fixture(scope="session")
def emulate(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Callable[..., Emulated]]:
    """Starts `cell emulate` with arguments; given `beside`, with the arm (and the journal) of an earlier one."""
    started: list[Emulated] = []

    def start(*arguments: str, beside: Emulated | None = None) -> Emulated:
        folder = beside.log.parent if beside else tmp_path_factory.mktemp("emulated")
        log, state = folder / "moves.jsonl", folder / "arm.json"
        process = subprocess.Popen(
            [sys.executable, "-m", "cell", "emulate", *arguments, "--log", str(log), "--state", str(state),
             "--seconds", "900"],  # a killed test session leaves nothing behind for ever
            stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True,
        )  # fmt: skip
        started.append(Emulated(process, log, state))
        return started[-1]

    yield start
    for emulated in started:
        if emulated.process.poll() is None:
            emulated.process.kill()
        emulated.process.wait(20)
        if emulated.process.stdout:
            emulated.process.stdout.close()
