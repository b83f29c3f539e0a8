"""Files that are written completely or not at all."""

import errno
import os
from pathlib import Path

import pytest
from PIL import Image

from cell.errors import FileError
from cell.files import atomic_folder, atomic_write
from cell.view.rays import save_png
from tests.support.fixture_types import RunCommand


def test_a_file_is_replaced_and_a_device_is_not(tmp_path: Path) -> None:
    """Readers see the new content; a pipe stays a pipe; nothing else is left in the folder."""
    path, pipe = tmp_path / "new" / "a.txt", tmp_path / "pipe"
    for text in ("one", "two"):
        with atomic_write(path) as part:
            part.write_text(text)
        assert path.read_text() == text
    os.mkfifo(pipe)
    with pytest.raises(OSError, match="a device or a pipe"), atomic_write(pipe) as part:
        part.write_text("x")
    assert pipe.is_fifo()
    assert sorted(each.name for each in (*tmp_path.iterdir(), *path.parent.iterdir())) == ["a.txt", "new", "pipe"]


def test_an_error_leaves_the_former_content(tmp_path: Path) -> None:
    """An exception in the block removes the temporary file."""
    path = tmp_path / "a.txt"
    path.write_text("one")

    def fail() -> None:
        with atomic_write(path) as part:
            part.write_text("two")
            raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        fail()
    assert [each.read_text() for each in tmp_path.iterdir()] == ["one"]


def test_a_picture_that_cannot_be_written_leaves_no_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A full disk ends the writing after the file was opened."""

    def save(_: Image.Image, path: Path, **__: object) -> None:
        path.write_bytes(b"\x89PNG")
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(Image.Image, "save", save)
    with pytest.raises(FileError, match="No space left"):
        save_png(Image.new("RGB", (2, 2)), tmp_path / "a.png")
    assert list(tmp_path.iterdir()) == []


def test_a_folder_has_the_files_of_one_process(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Of two processes that write a folder at once, the last one replaces it. An error leaves the former content."""
    for process in (1, 2):
        monkeypatch.setattr("os.getpid", lambda process=process: process)
        with atomic_folder(tmp_path / "why") as first:
            (first / "a").write_text(f"first {process}")
            monkeypatch.setattr("os.getpid", lambda process=process: 10 + process)
            with atomic_folder(tmp_path / "why") as second:
                (second / "a").write_text("second")
                (second / "b").write_text("second")
            (first / "c").write_text("first")
        assert sorted(path.name for path in (tmp_path / "why").iterdir()) == ["a", "c"]
        assert (tmp_path / "why" / "a").read_text() == f"first {process}"
    with pytest.raises(ZeroDivisionError), atomic_folder(tmp_path / "why"):
        raise ZeroDivisionError
    assert [path.name for path in tmp_path.iterdir()] == ["why"]
    assert (tmp_path / "why" / "c").exists()


def test_the_page_of_a_run_does_not_replace_a_pipe(planned: Path, tmp_path: Path, run_cell: RunCommand) -> None:
    """`cell view --out` refuses a pipe in one sentence."""
    os.mkfifo(tmp_path / "pipe")
    process = run_cell("view", planned, "--out", "pipe", cwd=tmp_path, code=6)
    assert "a device or a pipe, not a regular file" in process.stderr
    assert (tmp_path / "pipe").is_fifo()
