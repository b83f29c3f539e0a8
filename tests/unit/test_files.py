"""Files that are written completely or not at all."""

import contextlib
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


def test_a_folder_has_the_files_of_one_writer(tmp_path: Path) -> None:
    """Of two writers of a folder at once, the last one replaces it. An error leaves the former content."""
    for number in (1, 2):
        with atomic_folder(tmp_path / "why") as first:
            (first / "a").write_text(f"first {number}")
            with atomic_folder(tmp_path / "why") as second:
                (second / "a").write_text("second")
                (second / "b").write_text("second")
            (first / "c").write_text("first")
        assert sorted(path.name for path in (tmp_path / "why").iterdir()) == ["a", "c"]
        assert (tmp_path / "why" / "a").read_text() == f"first {number}"
    with pytest.raises(ZeroDivisionError), atomic_folder(tmp_path / "why"):
        raise ZeroDivisionError
    assert [path.name for path in tmp_path.iterdir()] == ["why"]
    assert (tmp_path / "why" / "c").exists()


@pytest.mark.parametrize("is_other_first", [True, False])
def test_a_folder_that_cannot_be_replaced_is_as_before(
    is_other_first: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A folder that another writer puts there between the two renames is replaced; another failure restores it."""
    path, rename = tmp_path / "why", Path.rename
    path.mkdir()
    (path / "former").touch()

    def disturbed(self: Path, target: Path) -> Path:
        if target == path and self.suffix == ".part" and (is_other_first or not path.exists()):
            monkeypatch.setattr(Path, "rename", rename)
            if not is_other_first:
                raise OSError(errno.ENOSPC, "No space left")
            path.mkdir()
            (path / "other").touch()
        return rename(self, target)

    monkeypatch.setattr(Path, "rename", disturbed)
    expected = contextlib.nullcontext() if is_other_first else pytest.raises(OSError, match="No space left")
    with expected, atomic_folder(path) as new:
        (new / "new").touch()
    assert [each.name for each in path.iterdir()] == ["new" if is_other_first else "former"]
    assert [each.name for each in tmp_path.iterdir()] == ["why"]


def test_the_page_of_a_run_does_not_replace_a_pipe(planned: Path, tmp_path: Path, run_cell: RunCommand) -> None:
    """`cell view --out` refuses a pipe in one sentence."""
    os.mkfifo(tmp_path / "pipe")
    process = run_cell("view", planned, "--out", "pipe", cwd=tmp_path, code=6)
    assert "a device or a pipe, not a regular file" in process.stderr
    assert (tmp_path / "pipe").is_fifo()
