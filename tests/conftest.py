"""Fixtures of all tests: a small part and one finished plan of it, made through the command line.

Expensive results are made once for all workers of a session (`made_once`). All tests read them; a test that changes
one takes a copy. A command runs in the test's process (`run_cell`). Tests of signals, kills and imports of a fresh
process use a separate process (`start_cell`).
"""

import contextlib
import functools
import gc
import hashlib
import io
import json
import logging
import os
import re
import select
import shutil
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from pkgutil import resolve_name
from typing import Any
from urllib.parse import urlsplit

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # NumPy reads it on import; the workers use all cores already

import numpy as np
import pytest
import trimesh
from filelock import FileLock
from hypothesis import settings
from numba.core.compiler_lock import global_compiler_lock
from numba.core.dispatcher import Dispatcher

from cell.report import plots
from cell.runs import digest
from cell.session import Effort, effort_of
from cell.view.run_pages import PARTIAL_PAGE_FILE
from planner import threads
from tests.support.fixture_types import RunCommand, StartCommand

# Tests have no deadline, because wall time is not a property. In CI the examples are the same in every execution.
# `--hypothesis-profile=full` has four times as many examples.
for _name, _examples in (("full", 100), ("own", 25)):
    settings.register_profile(_name, deadline=None, derandomize="CI" in os.environ, max_examples=_examples)
settings.load_profile("own")

# Compiled bytecode is shared by all processes, also by those of `start_cell`.
sys.dont_write_bytecode = False
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)

# Collection makes a million permanent objects. The garbage collector is disabled meanwhile and then ignores them.
gc.disable()

# MuJoCo reads it once, when it is imported: rendering without a display.
os.environ.setdefault("MUJOCO_GL", "egl")


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_auto_num_workers() -> int | None:
    """Return one worker more than cores: the worker of tests in real time hardly uses a core."""
    return None if "PYTEST_XDIST_AUTO_NUM_WORKERS" in os.environ else threads.CORES + 1


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Put tests in real time first: the first worker gets them, and other workers take its last tests."""
    items.sort(key=lambda item: not _is_in_real_time(item))


def pytest_runtest_setup(item: pytest.Item) -> None:
    """Lower the priority of a worker at its first test that computes, in favour of tests in real time."""
    if "PYTEST_XDIST_WORKER" in os.environ and not _is_in_real_time(item):
        _lower_priority()


def _is_in_real_time(item: pytest.Item) -> bool:
    """State whether a test waits for a wire, a process or a browser."""
    is_waiting = {"start_cell", "browser", "chromium"}.intersection(getattr(item, "fixturenames", ()))
    return bool(is_waiting) or item.get_closest_marker("real_time") is not None


@functools.cache
def _lower_priority() -> None:
    if hasattr(os, "nice"):
        os.nice(10)


def pytest_collection_finish() -> None:
    """Freeze the objects of the collection and enable the garbage collector."""
    gc.freeze()
    gc.set_threshold(50_000)  # as in the command line: compiling a kernel takes 10 % less time
    gc.enable()


_SMALL_SETUPS = (
    "--units", "mm", "--place", "1100,400,100", "--faces", "30", "--samples", "2", "--standoff", "250", "--seed", "3",
    "--candidates", "optimal-scanning-zone", "--coverage", "0.97",
)  # fmt: skip
_SMALL_PLAN = (
    "--place", "1100,400,100", "--faces", "120", "--samples", "2", "--standoff", "250", "--seed", "3",
    # Grown candidates take longer and have their own tests.
    "--candidates", "optimal-scanning-zone", "--coverage", "1",
)  # fmt: skip


def _blob(subdivisions: int = 4) -> trimesh.Trimesh:
    """Return a closed, bumpy body of about 110 mm with a dent, in millimetres and off the origin."""
    mesh = trimesh.creation.icosphere(subdivisions=subdivisions, radius=1.0)
    x, y, z = mesh.vertices.T
    radius = 50 + 6 * np.sin(3 * x + 1) * np.cos(2 * y) + 4 * np.sin(4 * z) - 14 * np.exp(-8 * ((x - 1) ** 2 + y**2))
    mesh.vertices = mesh.vertices * radius[:, None] + np.array([20.0, -10.0, 35.0])
    return mesh


@pytest.fixture(scope="session")
def shared(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the folder of the test session, shared by all workers."""
    own = tmp_path_factory.getbasetemp()
    return own.parent if "PYTEST_XDIST_WORKER" in os.environ else own


@pytest.fixture(scope="session", autouse=True)
def kernels_compiled_once(shared: Path) -> Iterator[None]:
    """Compile each kernel in one worker only. Other workers wait and read numba's cache, without a log message."""
    compile_at_once = Dispatcher.compile
    if compile_at_once.__name__ == "compile_alone":  # by benchmarks/tests, which uses these fixtures too
        yield
        return

    def compile_alone(kernel: Any, signature: Any) -> Any:
        name = f"{kernel.py_func.__module__}.{kernel.py_func.__qualname__}"
        with global_compiler_lock, FileLock(shared / f"{name}.lock"):  # in this order, as in numba
            return compile_at_once(kernel, signature)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Dispatcher, "compile", compile_alone)
        for name in ("planner.compiled", "cell.world.self_collision"):
            patch.setattr(logging.getLogger(name), "disabled", True)
        yield


@pytest.fixture(scope="session")
def made_once(shared: Path) -> Callable[[str, Callable[[Path], object]], Path]:
    """Return a function that makes a folder in the first worker while others wait. Tests must not change the folder."""

    def make_once(name: str, make: Callable[[Path], object]) -> Path:
        folder, finished = shared / name, shared / f"{name}.finished"
        with FileLock(shared / f"{name}.lock"):
            if not finished.exists():
                shutil.rmtree(folder, ignore_errors=True)  # of a worker that failed
                folder.mkdir()
                make(folder)
                finished.touch()
        return folder

    return make_once


@pytest.fixture(scope="session")
def cache(made_once: Callable[..., Path]) -> Path:
    """Return the cache folder of the test session, shared by all workers."""
    return made_once("cache", lambda folder: None)


@pytest.fixture(scope="session")
def run_cell(cache: Path) -> RunCommand:
    """Return a function that runs `cell` in this process in a directory `cwd` and returns a CompletedProcess.

    It requires the exit code `code` if one is given.
    """
    from typer.main import get_command

    from cell.cli import app
    from cell.cli.failures import INTERRUPTED, report_errors

    command = get_command(app)  # made once: it takes 13 ms

    def run(*arguments: object, cwd: Path, code: int | None = None) -> subprocess.CompletedProcess[str]:
        words = [str(word) for word in arguments]
        out, errors = io.StringIO(), io.StringIO()
        with pytest.MonkeyPatch.context() as patch, contextlib.redirect_stdout(out), contextlib.redirect_stderr(errors):
            for name, value in _surroundings(cache).items():
                patch.setenv(name, value)
            patch.delenv("SCAN_CELL_TRACEBACK", raising=False)
            patch.setattr(sys, "argv", ["cell", *words])
            patch.chdir(cwd)
            ended = report_errors(
                lambda: command(args=words, prog_name="cell", standalone_mode=False), as_json="--json" in words
            )
        if ended == INTERRUPTED:  # Ctrl-C at the terminal ends the tests
            raise KeyboardInterrupt
        assert code in (None, ended), errors.getvalue()
        return subprocess.CompletedProcess(words, ended, out.getvalue(), errors.getvalue())

    return run


class _Drawing:
    """State whether this process draws pictures and pages or leaves empty files in their place.

    Most tests need no picture. Drawing takes half of the time of a small plan and more than half of that of a scan.
    """

    is_enabled = False


class _DrawingHere(plots.PlotProcess):
    """Draw in this process the pictures of a plan that a separate process draws otherwise."""

    def __init__(self) -> None:
        self._sent = []

    def _post(self, what: str, path: Path, **arrays: Any) -> None:
        if _Drawing.is_enabled:
            plots.draw(what, path, **{name: np.asarray(value)[()] for name, value in arrays.items()})
        elif not path.is_dir():
            path.write_bytes(b"")
            (path.parent / PARTIAL_PAGE_FILE).write_bytes(b"")

    def _wait(self) -> None:
        pass


def _only_where_enabled(draw: Callable[..., object], result: object) -> Callable[..., object]:
    """Return a function that draws if drawing is enabled. Otherwise it writes an empty file or returns `result`."""

    def draw_if_enabled(*arguments: Any, **keywords: Any) -> object:
        if _Drawing.is_enabled:
            return draw(*arguments, **keywords)
        if result is Path:
            next(path for path in arguments if isinstance(path, Path)).write_bytes(b"")
        return result

    return draw_if_enabled


_PICTURES = (
    "matplotlib.figure.Figure.savefig", "cell.report.figures.cover_curve", "cell.report.scan_report.draw_deviation",
    "cell.scan.results.draw_part_and_views", "cell.view.pictures.draw_reasons",
    "cell.inspect.pictures.features_picture", "cell.inspect.pictures.report_pdf",
)  # fmt: skip
_PAGES = (
    "cell.view.run_pages.execution_page", "cell.view.run_pages.why_page", "cell.view.explore_page.explore_page",
    "cell.report.diff.difference_page",
)  # fmt: skip
_CANVASES = ("cell.scan.results.canvas_of", "cell.why.explain.canvas_of")


@contextlib.contextmanager
def _drawing() -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(_Drawing, "is_enabled", True)
        yield


@pytest.fixture(scope="session", autouse=True)
def drawing_is_here() -> Iterator[None]:
    """Draw the pictures of plans in this process. Processes of `start_cell` use their own drawing process."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(plots, "plot_process", lambda: contextlib.nullcontext(_DrawingHere()))
        for names, instead in ((_PICTURES, Path), (_PAGES, ""), (_CANVASES, None)):
            for name in names:
                patch.setattr(name, _only_where_enabled(resolve_name(name), instead))
        yield


@pytest.fixture(scope="session", autouse=True)
def one_thread() -> Iterator[None]:
    """Use one core in this process, because the workers use all. Processes of `start_cell` use threads."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(threads, "CORES", 1)
        yield


@pytest.fixture
def four_threads(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Use four threads in this process on every machine, for tests of the functions that work in threads."""
    monkeypatch.setattr(threads, "CORES", 4)
    threads._threads.cache_clear()
    yield
    threads._threads().shutdown()
    threads._threads.cache_clear()


_LOW_EFFORT = Effort(
    held_out_samples=10_000, deviation_samples=10_000, searched_samples=50, pose_search_share=0.1, motion_share=0.25,
    clearance_share=0.5, cover_work=15_000_000, probe_work=5_000_000, selection_work=10_000_000,
    repeat_work=5_000_000, constrained_work=100_000_000, curve_work=10_000_000,
)  # fmt: skip


@pytest.fixture(scope="session", autouse=True)
def low_effort() -> Iterator[None]:
    """Reduce the effort of commands in this process. Properties of 10,000 samples hold for 100,000 samples as well.

    Processes of `start_cell` and tests that use `full_effort` have the default effort.
    """
    with effort_of(_LOW_EFFORT):
        yield


@pytest.fixture
def full_effort() -> Iterator[None]:
    """Use the effort of the product, with all samples of the definition of coverage."""
    with effort_of(Effort()):
        yield


@pytest.fixture(scope="session", autouse=True)
def nothing_waits_for_the_disk() -> Iterator[None]:
    """Disable fsync in this process: no test simulates a power failure. Processes of `start_cell` use fsync."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(os, "fsync", lambda file: None)
        yield


@pytest.fixture(scope="session")
def drawing() -> Callable[[], contextlib.AbstractContextManager[None]]:
    """Return a context manager in which this process draws pictures and pages."""
    return _drawing


@pytest.fixture
def drawn_pictures() -> Iterator[None]:
    """Enable drawing of pictures and pages in this process for one test."""
    with _drawing():
        yield


@pytest.fixture(scope="session")
def start_cell(cache: Path) -> StartCommand:
    """Return a function that starts `python -m cell` in a directory `cwd`, with both outputs in pipes by default."""

    def start(*arguments: object, cwd: Path | None = None, **streams: int) -> "subprocess.Popen[str]":
        # A background job of a shell ignores Ctrl-C, and its children inherit this.
        inherited = signal.signal(signal.SIGINT, signal.default_int_handler)
        try:
            return subprocess.Popen(
                [sys.executable, "-m", "cell", *map(str, arguments)],
                cwd=cwd, env={**os.environ, **_surroundings(cache)}, text=True,
                **{"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, **streams},
            )  # fmt: skip
        finally:
            signal.signal(signal.SIGINT, inherited)

    return start


def _surroundings(cache: Path) -> dict[str, str]:
    return {"XDG_CACHE_HOME": str(cache), "COLUMNS": "120", "NO_COLOR": "1"}


@pytest.fixture(scope="session")
def small_plan() -> tuple[str, ...]:
    """Return the options of the plan in `planned`."""
    return _SMALL_PLAN


@pytest.fixture(scope="session")
def data_of() -> Callable[[str], dict[str, Any]]:
    """Return a function that reads the data of a page's script."""

    def read(page: str) -> dict[str, Any]:
        pattern = r'<script type="application/json" id="(?:page-scene|page-contents)">(.*?)</script>'
        stage, play = re.findall(pattern, page, re.DOTALL)
        return json.loads(stage) | json.loads(play)

    return read


@pytest.fixture(scope="session")
def blob() -> Callable[[int], trimesh.Trimesh]:
    """Return a function that builds the small part with a number of subdivisions, in millimetres."""
    return _blob


@pytest.fixture(scope="session")
def part_file(made_once: Callable[..., Path]) -> Path:
    """Return the small part as binary STL, in millimetres."""
    return made_once("part", lambda folder: _blob().export(folder / "blob.stl")) / "blob.stl"


@pytest.fixture(scope="session")
def planned(made_once: Callable[..., Path], part_file: Path, run_cell: RunCommand) -> Path:
    """Return the run folder of one finished plan of the small part."""

    def make(folder: Path) -> None:
        with _drawing():
            process = run_cell(
                "plan", part_file, "--units", "mm", *_SMALL_PLAN, "--out", "run", "--json", cwd=folder, code=0
            )
        assert json.loads(process.stdout)["n_views"] > 1

    return made_once("planned", make) / "run"


@pytest.fixture(scope="session")
def made_setups(made_once: Callable[..., Path], part_file: Path, run_cell: RunCommand) -> Path:
    """Return the folder of the small part's set-ups, chosen from four candidates. The file `stdout` is next to it."""

    def make(folder: Path) -> None:
        process = run_cell("setups", part_file, *_SMALL_SETUPS, "--proposals", "4", "--out", "made", cwd=folder, code=0)
        (folder / "stdout").write_text(process.stdout)

    return made_once("setups", make) / "made"


@pytest.fixture(scope="session")
def swept(made_once: Callable[..., Path], part_file: Path, run_cell: RunCommand) -> Path:
    """Return the run folder of a plan of sweeps with a mesh fixture. Files `stdout` and `stderr` are next to it."""

    def make(folder: Path) -> None:
        (folder / "line.toml").write_text(
            '[scanner]\ntype = "laser-line"\nsweep_deg = 24.0\nsweep_steps = 5\nline_points = 160\n'
            f'[[fixtures]]\nname = "clamp"\nshape = "mesh"\nunits = "mm"\npath = "{part_file}"\n'
            "position_mm = [700, -700, 200]\nabc_deg = [10, 20, 30]\n"
        )
        options = (
            "--place",
            "1100,400,100",
            "--faces",
            "24",
            "--samples",
            "2",
            "--standoff",
            "250",
            *_SMALL_PLAN[-4:-2],
        )
        more = ("--coverage", "0.7", "--scene", "line.toml", "--out", "run", "--json")
        process = run_cell("plan", part_file, "--units", "mm", *options, *more, cwd=folder, code=0)
        (folder / "stdout").write_text(process.stdout)
        (folder / "stderr").write_text(process.stderr)

    return made_once("swept", make) / "run"


@pytest.fixture(scope="session")
def resealed() -> Callable[[Path], str]:
    """Return a function that updates the hashes and the digest of a changed run folder and returns the digest."""

    def seal(run: Path) -> str:
        manifest = json.loads((run / "manifest.json").read_text())
        paths = {name: run / name for name in manifest["artefacts"]}
        shas = {name: hashlib.sha256(path.read_bytes()).hexdigest() for name, path in paths.items()}
        manifest |= {"artefacts": shas, "digest": digest.plan_digest(shas)}
        (run / "manifest.json").write_text(json.dumps(manifest, indent=2) + "\n")
        return str(manifest["digest"])

    return seal


@pytest.fixture(scope="session")
def executed(made_once: Callable[..., Path], planned: Path, run_cell: RunCommand) -> Path:
    """Return a copy of the planned run with a finished execution `0001` at 1 degree. `scan.json` is its JSON object."""

    def make(folder: Path) -> None:
        shutil.copytree(planned, folder / "run")
        with _drawing():
            process = run_cell("scan", "run", "--resolution", "1", "--json", cwd=folder, code=0)
        (folder / "scan.json").write_text(process.stdout)

    return made_once("executed", make) / "run"


@pytest.fixture(scope="session")
def turned(made_once: Callable[..., Path], part_file: Path, small_plan: tuple[str, ...], run_cell: RunCommand) -> Path:
    """Return a plan of the small part on a rotary table, with one execution."""

    def make(folder: Path) -> None:
        run_cell(
            "plan", part_file, "--units", "mm", *small_plan, "--table", "--out", "run", "--json", cwd=folder, code=0
        )
        run_cell("scan", "run", "--resolution", "1", cwd=folder, code=0)

    return made_once("turned", make) / "run"


_OPEN_TERMINALS: list[int] = []
"""Pseudo-terminals of emulators, held to the end of the session: the system gives a freed one's name to the next that
is opened, and a client that looks for its dead controller would find that of another test."""


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

    @functools.cached_property
    def url(self) -> str:
        """Return the URL of the controller; wait until it is ready."""
        stdout = self.process.stdout
        assert stdout is not None
        ready, _, _ = select.select([stdout], [], [], 60)
        url = stdout.readline().strip() if ready else ""
        assert url, "the emulator did not start"
        terminal = Path(urlsplit(url).path)
        if terminal.is_char_device():
            _OPEN_TERMINALS.append(os.open(terminal, os.O_RDWR | os.O_NOCTTY))
        return url

    def entries(self, *events: str) -> list[dict[str, Any]]:
        """Return the entries of the journal in order, limited to `events` if any are given."""
        whole = self.log.read_text(encoding="utf-8").rpartition("\n")[0]
        found = [json.loads(line) for line in whole.splitlines()]
        return [entry for entry in found if not events or entry["event"] in events]

    def end(self, how: signal.Signals = signal.SIGTERM) -> int:
        """End the process by a signal and return its exit code."""
        self.process.send_signal(how)
        return self.process.wait(20)


@contextlib.contextmanager
def _emulating(tmp_path_factory: pytest.TempPathFactory, start_cell: StartCommand) -> Iterator[Callable[..., Emulated]]:
    started: list[Emulated] = []

    def start(*arguments: str, partner: Emulated | None = None) -> Emulated:
        folder = partner.log.parent if partner else tmp_path_factory.mktemp("emulated")
        log, state = folder / "moves.jsonl", folder / "arm.json"
        process = start_cell(
            "emulate", *arguments, "--log", log, "--state", state,
            "--seconds", "900", stderr=subprocess.DEVNULL,  # the process ends after a killed test session
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


@pytest.fixture
def emulate(tmp_path_factory: pytest.TempPathFactory, start_cell: StartCommand) -> Iterator[Callable[..., Emulated]]:
    """Yield a function that starts `cell emulate`. With `partner`, it uses the state and the journal of an earlier one.

    Processes end with the test, because an idle controller polls its line fifty times a second.
    """
    with _emulating(tmp_path_factory, start_cell) as start:
        yield start


@pytest.fixture(scope="module")
def emulate_for_all(
    tmp_path_factory: pytest.TempPathFactory, start_cell: StartCommand
) -> Iterator[Callable[..., Emulated]]:
    """Yield the same function as `emulate`, for all tests of a module."""
    with _emulating(tmp_path_factory, start_cell) as start:
        yield start
