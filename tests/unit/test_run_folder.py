"""Guarantees of the run folder: no overwriting, no loss of finished files, no clock value in an artefact."""

import errno
import json
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cell.errors import FileError
from cell.runs.folder import RunFolder, json_text

NOW = datetime(2026, 1, 2, 3, 4, 5, tzinfo=UTC)


def make(out: Path | None) -> RunFolder:
    """Return the folder of a new run."""
    return RunFolder.create(out, ["plan"], 7, {"part": "abc"}, NOW)


def test_it_is_a_part_folder_until_it_is_finished(tmp_path: Path) -> None:
    """The folder is named `.part` until `finish`, and the manifest has the status."""
    folder = make(tmp_path / "run")
    assert json.loads((tmp_path / "run.part" / "manifest.json").read_text())["status"] == "running"
    folder.finish(0)
    assert not (tmp_path / "run.part").exists()
    assert json.loads((tmp_path / "run" / "manifest.json").read_text())["status"] == "finished"


def test_a_finished_run_is_never_overwritten(tmp_path: Path) -> None:
    """The same --out is refused, and the first run is unchanged."""
    make(tmp_path / "run").finish(0)
    before = (tmp_path / "run" / "manifest.json").read_bytes()
    with pytest.raises(FileError, match="never overwritten"):
        make(tmp_path / "run")
    assert (tmp_path / "run" / "manifest.json").read_bytes() == before


def test_a_failed_run_makes_way_and_is_kept(tmp_path: Path) -> None:
    """After a failure the same --out is accepted; the failed folder is kept under a numbered name."""
    for number in (1, 2):
        folder = make(tmp_path / "run")
        folder.write_text("kept.txt", f"attempt {number}")
        folder.fail("failed", 4, "nothing reachable")
    make(tmp_path / "run").finish(0)
    assert (tmp_path / "run.part.1" / "kept.txt").read_text() == "attempt 1"
    assert (tmp_path / "run.part.2" / "kept.txt").read_text() == "attempt 2"
    assert (tmp_path / "run").is_dir()


def test_a_run_that_may_still_be_going_on_is_left_alone(tmp_path: Path) -> None:
    """A `.part` folder with the status running is not moved."""
    make(tmp_path / "run")
    with pytest.raises(FileError, match="exists already"):
        make(tmp_path / "run")


@pytest.mark.parametrize("out", [".", "/"])
def test_a_folder_without_a_name_is_refused(out: str) -> None:
    """`--out .` and `--out /` are refused with one sentence."""
    with pytest.raises(FileError, match="has no name"):
        make(Path(out))


def test_a_stage_that_fails_is_named_and_timed(tmp_path: Path) -> None:
    """The manifest has the stage, the status and the seconds of a failed run."""
    folder = make(tmp_path / "run")

    def fails() -> None:
        with folder.stage("reach"):
            raise ValueError("x")

    with pytest.raises(ValueError, match="x"):
        fails()
    folder.fail("failed", 70, "x")
    manifest = json.loads((tmp_path / "run.part" / "manifest.json").read_text())
    assert (manifest["stage"], manifest["status"], manifest["exit_code"]) == ("reach", "failed", 70)
    assert manifest["seconds"]["reach"] >= 0


def test_equal_arrays_give_equal_bytes(tmp_path: Path) -> None:
    """An .npz holds no clock value: equal arrays written at different times give equal bytes."""
    files = []
    for name in ("one", "two"):
        folder = make(tmp_path / name)
        folder.write_arrays("a.npz", q=np.linspace(0, 1, 50).reshape(10, 5), names=np.array(["x", "y"]))
        files.append((folder.path / "a.npz").read_bytes())
    assert files[0] == files[1]


def test_a_full_disk_in_the_last_manifest_does_not_hide_the_first_error(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """`fail` raises no error on a full disk, and the last complete manifest is kept."""
    folder = make(tmp_path / "run")

    def full(*_: Any, **__: Any) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(Path, "write_text", full)
    folder.fail("failed", 6, "the disk is full")
    monkeypatch.undo()
    assert json.loads((tmp_path / "run.part" / "manifest.json").read_text())["status"] == "running"


def test_incomplete_files_leave_a_full_disk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The space of a file that does not fit, and of pictures, is free for the manifest, which states the failure."""
    folder, write = make(tmp_path / "run"), Path.write_bytes
    (folder.path / "cell.png").touch()

    def full(path: Path, content: bytes) -> None:
        write(path, content[:5])
        raise OSError(errno.ENOSPC, "No space left on device")

    def full_with_picture(path: Path, text: str, encoding: str) -> None:
        (full if (folder.path / "cell.png").exists() else write)(path, text.encode(encoding))

    monkeypatch.setattr(Path, "write_bytes", full)
    monkeypatch.setattr(Path, "write_text", full_with_picture)
    with pytest.raises(FileError, match="the disk is full"):
        folder.write_text("report.md", "too much")
    folder.fail("failed", 6, "the disk is full")
    assert [path.name for path in folder.path.iterdir()] == ["manifest.json"]
    assert json.loads((folder.path / "manifest.json").read_text())["status"] == "failed"


def test_nan_never_reaches_a_json_file() -> None:
    """NaN is refused with an error, because JSON has no NaN."""
    with pytest.raises(ValueError, match="JSON"):
        json_text({"x": float("nan")})
