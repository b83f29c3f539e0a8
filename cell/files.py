"""Files of the program: its models, its caches, and files that are written completely or not at all."""

import contextlib
import errno
import os
import secrets
import shutil
import sys
from collections.abc import Iterator
from importlib import resources
from pathlib import Path

from cell.errors import FileError


def model_file(name: str) -> Path:
    """Return the path of a file of `models/`: in the installed package, or beside it in a development tree.

    Raises:
        FileError: if the file is missing.
    """
    package = Path(str(resources.files("cell")))
    candidates = (package / "models" / name, package.parent / "models" / name)
    for path in candidates:
        if path.is_file():
            return path
    raise FileError(
        f"the file {name} is missing: neither {candidates[0]} nor {candidates[1]} exists; install scan-cell again"
    )


def cache_folder(kind: str) -> Path:
    """Return the cache folder of one kind of content.

    This is `$XDG_CACHE_HOME/scan-cell/<kind>` if the variable is set, else a folder below ~/.cache, on macOS below
    ~/Library/Caches and on Windows below %LOCALAPPDATA%.

    Raises:
        RuntimeError: if no cache is named and the user has no home.
    """
    folder = os.environ.get("XDG_CACHE_HOME")
    if folder:
        base = Path(folder)
    elif sys.platform == "win32":
        base = Path(os.environ.get("LOCALAPPDATA") or Path.home() / "AppData" / "Local")
    elif sys.platform == "darwin":
        base = Path.home() / "Library" / "Caches"
    else:
        base = Path.home() / ".cache"
    return base / "scan-cell" / kind


def delete_oldest(folder: Path, limit: int) -> None:
    """Delete the oldest `.npz` files of a folder until it has at most `limit` bytes; the newest file stays."""
    entries = []
    for path in folder.glob("*.npz"):
        with contextlib.suppress(FileNotFoundError):  # another run may have deleted it
            entries.append((path.stat(), path))
    entries.sort(key=lambda entry: entry[0].st_mtime)
    size = sum(stat.st_size for stat, _ in entries)
    for stat, path in entries[:-1]:
        if size <= limit:
            return
        path.unlink(missing_ok=True)
        size -= stat.st_size


def unused_path(path: Path) -> Path:
    """Return a path, or the first of path-2, path-3, ... at which nothing exists."""
    number = 1
    while (candidate := path if number == 1 else path.with_name(f"{path.name}-{number}")).exists():
        number += 1
    return candidate


def read_bytes(path: Path) -> bytes:
    """Return the content of a regular file; a device or a pipe could have no end.

    Raises:
        OSError: if it cannot be read, or is neither a regular file nor a folder.
    """
    _refuse_device(path)
    return path.read_bytes()


def _refuse_device(path: Path) -> None:
    if path.exists() and not path.is_file() and not path.is_dir():
        raise OSError(errno.EINVAL, "it is a device or a pipe, not a regular file", str(path))


@contextlib.contextmanager
def atomic_write(path: Path) -> Iterator[Path]:
    """Yield a temporary path to write; at the end of the block it replaces `path`, after an error it is removed.

    Readers see the complete file or none. A missing folder is created.

    Raises:
        OSError: if the folder or the file cannot be written, or `path` is a device, which a file would replace.
    """
    _refuse_device(path)
    temporary = path.with_name(f".{path.name}.{os.getpid()}.part")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        yield temporary
        temporary.replace(path)
    finally:
        with contextlib.suppress(OSError):  # the folder itself can be the cause of the error
            temporary.unlink(missing_ok=True)


@contextlib.contextmanager
def atomic_folder(path: Path) -> Iterator[Path]:
    """Yield a new temporary folder; at the end of the block it replaces `path`, after an error it is removed.

    The files of two writers are never mixed: the last one replaces the folder of the others.

    Raises:
        OSError: if the folder cannot be written; `path` is as before.
    """
    temporary = path.with_name(f".{path.name}.{secrets.token_hex(8)}.part")
    temporary.mkdir()
    try:
        yield temporary
        while not _replace_folder(path, temporary):
            pass
    finally:
        shutil.rmtree(temporary, ignore_errors=True)


def _replace_folder(path: Path, new: Path) -> bool:
    """Replace a folder that may exist by a new one; return False if another writer put one there meanwhile."""
    former = new.with_suffix(".old")
    with contextlib.suppress(FileNotFoundError):
        path.rename(former)
    try:
        new.rename(path)
    except OSError as error:
        if error.errno not in (errno.ENOTEMPTY, errno.EEXIST):
            with contextlib.suppress(FileNotFoundError):
                former.rename(path)
            raise
        return False
    finally:
        shutil.rmtree(former, ignore_errors=True)
    return True


@contextlib.contextmanager
def file_errors(failure: str, cure: str = "") -> Iterator[None]:
    """Convert an OSError of the block to a FileError.

    Args:
        failure: beginning of its message, such as "FILE cannot be read"; the reason of the system follows.
        cure: end of the message.
    """
    try:
        yield
    except OSError as error:
        message = f"{failure}: {error.strerror or error}"
        raise FileError(f"{message}; {cure}" if cure else message) from error
