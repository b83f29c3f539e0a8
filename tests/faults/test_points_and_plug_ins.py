"""Points that are no scan, commands that do not end, plug-ins that raise, memory that runs out."""

import json
import os
import re
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cell.cli.failures import report_errors
from cell.errors import FileError, UsageError
from cell.metrology import point_files
from cell.scan.acquisition import Acquired, Command, Context, View, require_scan
from cell.study.trials import open_workers

EYE = np.eye(4)[None]
VIEW = View(3, 30, np.zeros((1, 6)), EYE, EYE, np.eye(4), np.zeros(1, dtype=np.int64))


def command(words: str, folder: Path, timeout_s: float, notes: list[str]) -> Command:
    """Return the source of a command."""
    options = {"points_frame": "base", "points_units": "mm", "acquire_timeout_s": timeout_s}
    return Command(words, Context(None, options, 0, folder, notes.append))  # type: ignore[arg-type]


def test_a_time_out_ends_the_whole_process_group(tmp_path: Path) -> None:
    """Processes that the command has started end with it."""
    children, notes = tmp_path / "children", list[str]()
    program = f"sleep 60 & echo $! >> {children}; sleep 60"
    assert command(f"sh -c '{program}'", tmp_path, 0.5, notes).take(VIEW) is None
    assert "took longer than 0.5 s" in notes[0]
    numbers = [int(line) for line in children.read_text().split()]
    assert numbers
    for number in numbers:
        until = time.monotonic() + 5.0
        while _is_alive(number) and time.monotonic() < until:
            time.sleep(0.05)
        assert not _is_alive(number)


def _is_alive(number: int) -> bool:
    """Return whether a process exists and is no zombie."""
    try:
        return Path(f"/proc/{number}/stat").read_text(encoding="ascii").rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


def test_the_output_of_a_command_is_bounded(tmp_path: Path) -> None:
    """A command that writes without end is ended at its time-out, and the last 64 kB of it are kept."""
    notes: list[str] = []
    source = command("yes", tmp_path, 0.5, notes)
    ending, output = source._call(VIEW, tmp_path / "pose", tmp_path / "out")
    assert ending == "took longer than 0.5 s"
    assert 0 < len(output) <= 65536


def test_the_message_about_a_failed_command_has_its_last_line(tmp_path: Path) -> None:
    """The cause of a failure is what the command said; a program that does not exist is refused before any motion."""
    notes: list[str] = []
    assert command("sh -c 'echo one; echo the laser is off >&2; exit 3'", tmp_path, 5.0, notes).take(VIEW) is None
    assert "sh ended with code 3, its last line is: the laser is off (3 calls)" in notes[0]
    with pytest.raises(UsageError, match=r"the program ./no_scanner is not found; give its path"):
        command("./no_scanner --fast", tmp_path, 5.0, notes)
    (tmp_path / "scanner").touch(mode=0o600)
    with pytest.raises(UsageError, match=r"the program .*scanner is not executable"):
        command(f"{tmp_path / 'scanner'} --fast", tmp_path, 5.0, notes)


def test_the_pose_file_of_a_sweep_on_a_table(tmp_path: Path) -> None:
    """Every pose has its six angles of the arm, and that of the table."""
    q = np.radians(np.arange(56.0).reshape(8, 7))
    T = np.tile(np.eye(4), (8, 1, 1))
    assert command("true", tmp_path, 5.0, []).take(View(3, 30, q, T, T, np.eye(4), np.arange(8))) is None
    pose = json.loads((tmp_path / "raw" / "0003.json").read_text())
    np.testing.assert_allclose(pose["q_deg"], np.degrees(q[:, :6]))
    np.testing.assert_allclose(pose["e_deg"], np.degrees(q[:, 6:]))


def test_a_pose_file_that_cannot_be_written(tmp_path: Path) -> None:
    """The sentence names it."""
    (tmp_path / "raw").touch()
    with pytest.raises(FileError, match=r"0003.json cannot be written: File exists"):
        command("true", tmp_path, 5.0, []).take(VIEW)


@pytest.mark.parametrize(
    ("points", "words"),
    [
        (np.array([[0.0, 0.0, 0.3], [np.nan, 0.0, 0.3]]), "not finite in 1 of 2 rows"),
        (np.full((4, 3), np.nan), "not finite in 4 of 4 rows"),
        (np.array([[0.0, 0.0, 0.3], [0.0, 0.0, 65.535]]), "are up to 65.5 m away from the scanner"),
        (np.array([[0.0, 0.0, 300.0]]), "another unit"),
        (np.zeros((4, 2)), r"shape \(4, 2\)"),
        (np.array([["a", "b", "c"]]), "type <U1"),
    ],
)
def test_points_that_are_no_scan(points: Any, words: str) -> None:
    """Points that are not finite, not three numbers or far beyond the range are refused with their cause."""
    acquired = Acquired(points, "scanner")
    with pytest.raises(FileError, match=f"the points of view 3 .*{words}"):
        require_scan(acquired, VIEW, [200.0, 900.0])


@pytest.mark.parametrize(
    ("pixel", "grid_shape"),
    [
        ([0, 6], [2, 3]),
        ([-1, 2], [2, 3]),
        ([0.0, 1.0], [2, 3]),
        ([0], [2, 3]),
        ([0, 1], [2.0, 3.0]),
        ([0, 1], [6]),
        ([0, 1], [-2, -3]),
        ([0, 1], [0, 3]),
        (None, [2, 3]),
        ([0, 1], None),
    ],
)
def test_an_invalid_grid(pixel: list[float] | None, grid_shape: list[float] | None) -> None:
    """Pixels outside the grid, fractions, and one of the two arrays alone are refused before they are stored."""
    grid = {"pixel": pixel, "grid_shape": grid_shape}
    arrays = {name: np.array(values) for name, values in grid.items() if values is not None}
    acquired = Acquired(np.array([[0.0, 0.0, 0.3], [0.0, 0.1, 0.3]]), "scanner", arrays)
    with pytest.raises(FileError, match=r"the points of view 3 have an invalid grid: .*rows and columns"):
        require_scan(acquired, VIEW, [200.0, 900.0])


@pytest.mark.parametrize("kind", ["u1", "u8", "i4"])
def test_a_grid_with_holes(kind: str) -> None:
    """Integers of any size are pixels; a scan without points keeps its grid."""
    points, shape = np.array([[0.0, 0.0, 0.3], [0.0, 0.1, 0.3]]), np.array([2, 3], dtype=kind)
    require_scan(Acquired(points, "scanner", {"pixel": np.array([0, 5], kind), "grid_shape": shape}), VIEW, None)
    empty = {"pixel": np.empty(0, dtype=kind), "grid_shape": shape}
    require_scan(Acquired(np.empty((0, 3)), "scanner", empty), VIEW, None)


def test_points_that_are_a_scan() -> None:
    """Points within the range and outliers behind it are kept; so is a scan without points."""
    for points in (np.array([[0.0, 0.0, 0.3], [0.0, 0.0, 2.0]]), np.empty((0, 3))):
        require_scan(Acquired(points, "base"), VIEW, [200.0, 900.0])


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"", "is empty"),
        (b"nan nan nan\nnan nan nan\n", "the coordinates of none are finite"),
        (b"1 2 3\n1 2\n", "1.xyz"),
    ],
)
def test_files_of_points(tmp_path: Path, content: bytes, words: str) -> None:
    """A file of NaN is no scan; lines of different length and empty files are named."""
    path = tmp_path / "1.xyz"
    path.write_bytes(content)
    with pytest.raises(FileError, match=words) as error:
        point_files.read(path)
    assert not re.search("inhomogeneous|reshape", str(error.value))


BREAKS = {
    "ValueError": "raise ValueError('no light')",
    "SystemExit": "raise SystemExit(3)",
    "OSError": "raise OSError(5, 'Input/output error')",
    "MemoryError": "raise MemoryError",
}


@pytest.mark.parametrize("error", BREAKS)
@pytest.mark.parametrize(("group", "code"), [("scanner", 2), ("driver", 5), ("acquisition", 2)])
def test_a_plug_in_that_raises(
    group: str, code: int, error: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Any
) -> None:
    """The plug-in is named with its error; it is neither a bug of this program nor its end."""
    name = f"acme_{group}_{error.lower()}"
    (tmp_path / f"{name}.py").write_text(f"def work():\n    {BREAKS[error]}\n")
    info = tmp_path / f"{name}-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: 1.0\n")
    kind = {"scanner": "cell.scanners", "driver": "cell.drivers", "acquisition": "cell.acquisition"}[group]
    (info / "entry_points.txt").write_text(f"[{kind}]\nacme = {name}:work\n")
    monkeypatch.syspath_prepend(str(tmp_path))
    work: Callable[[], None] = __import__(name).work
    ended = report_errors(work, as_json=False)
    message = capsys.readouterr().err
    if error == "MemoryError":
        assert ended == 2
        assert f"out of memory in the {group} 'acme'" in message
    else:
        assert ended == code
        assert f"the {group} 'acme' ({name}:work) failed with {error}" in message
    assert "bug" not in message


def test_out_of_memory_and_a_full_disk_are_named(capsys: Any) -> None:
    """Neither is a bug; a write without a name says where it was."""

    def fail(error: Exception) -> Callable[[], None]:
        def run() -> None:
            raise error

        return run

    assert report_errors(fail(MemoryError()), as_json=False) == 2
    assert "out of memory; close other programs" in capsys.readouterr().err
    assert report_errors(fail(OSError(28, "No space left on device")), as_json=False) == 6
    assert f"a file below {Path.cwd()} or at --out, cannot be used: no space left" in capsys.readouterr().err


def test_a_scheduler_with_certificates(tmp_path: Path) -> None:
    """tls:// and its security file belong together; a wrong file is named."""
    pytest.importorskip("distributed")
    file = tmp_path / "tls.toml"
    file.write_text('ca_file = "ca.pem"\ncert_file = "cert.pem"\nkey_file = "key.pem"\n')
    for cluster, security, words in (
        ("tls://127.0.0.1:1", None, "do not agree"),
        ("tcp://127.0.0.1:1", file, "do not agree"),
        (None, file, "is for --cluster tls://"),
        ("tls://127.0.0.1:1", tmp_path / "none.toml", "cannot be read as TOML"),
        ("tls://127.0.0.1:1", file, "ca.pem, which does not exist"),
    ):
        with pytest.raises(UsageError, match=words):
            open_workers(1, cluster, security)


@pytest.mark.skipif(not hasattr(os, "killpg"), reason="process groups")
def test_an_interrupt_ends_the_command_too(tmp_path: Path) -> None:
    """Ctrl-C while a command runs ends the command."""
    program = (
        "import signal, sys, threading, os, time\n"
        "from pathlib import Path\n"
        "from tests.faults.test_points_and_plug_ins import VIEW, command\n"
        "signal.signal(signal.SIGINT, signal.default_int_handler)  # a parent may ignore it, as nohup does\n"
        "threading.Timer(1.0, lambda: os.kill(os.getpid(), signal.SIGINT)).start()\n"
        f"source = command('sh -c \"echo $$ > {tmp_path}/number; sleep 60\"', Path({str(tmp_path)!r}), 50.0, [])\n"
        "source.take(VIEW)\n"
    )
    process = subprocess.run([sys.executable, "-c", program], capture_output=True, timeout=60, check=False)
    assert b"KeyboardInterrupt" in process.stderr
    assert not _is_alive(int((tmp_path / "number").read_text()))
