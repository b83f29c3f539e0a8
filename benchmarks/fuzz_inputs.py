"""Corrupted input files of every kind: meshes, scenes (TOML), JSON and npz of run folders.

Valid files are corrupted as bytes (`benchmarks.fuzz.corrupted`) or in their structure: a number, a word or a bracket of
a text is replaced by an invalid one, in a GLB the description, in an npz one member of a valid zip. Every result must
be read, or refused by an error of this program with an exit code other than 70, in bounded time and memory. The readers
run in a separate process. Its memory is limited to one gigabyte above the initial use, and an allocation beyond that
counts as an error.

`FUZZ_FILES` in the environment changes the 10,000 files.
"""

from __future__ import annotations

import io
import json
import logging
import multiprocessing
import os
import re
import resource
import struct
import tempfile
import zipfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from time import process_time
from typing import Any

import numpy as np
import trimesh

from benchmarks.fuzz import corrupted
from cell.errors import CellError
from cell.part import workpiece
from cell.runs.run import Run, read_manifest, read_scan
from cell.runs.schema import Manifest
from cell.scene.file import load_scene

ROOM = 1 << 30
"""Bytes that reading a file may take."""

_NASTY = (
    b"-1", b"0", b"1e999", b"nan", b"inf", b"-0.0", b"4294967295", b"99999999999999999999", b"9" * 5000, b"null",
    b"true", b'"x"', b'""', b"[]", b"{}", b"[" * 3000, b"[[[[1]]]]", b'{"a":{"b":1}}', b"-", b"", b"\x00", "ü".encode(),
    b"a" * 400,
)  # fmt: skip
_TOKEN = re.compile(rb'-?\d+(?:\.\d+)?(?:[eE][-+]?\d+)?|"[^"\n]*"|[\[\]{},:=]|\btrue\b|\bnull\b|\w+')


@dataclass(frozen=True)
class Kind:
    """A kind of file.

    Attributes:
        name: name of the kind.
        files: valid files by name.
        read: function that reads a file; its exceptions are evaluated.
    """

    name: str
    files: dict[str, bytes]
    read: Callable[[Path], object]


def structured(good: bytes, rng: np.random.Generator) -> bytes:
    """Return the text with some tokens replaced or removed."""
    found = list(_TOKEN.finditer(good))
    for at in sorted(rng.choice(len(found), min(len(found), int(rng.integers(1, 4))), replace=False), reverse=True):
        token = found[int(at)]
        other = (
            _NASTY[int(rng.integers(len(_NASTY)))] if rng.random() < 0.8 else found[int(rng.integers(len(found)))][0]
        )
        good = good[: token.start()] + other + good[token.end() :]
    return good


def _glb(good: bytes, rng: np.random.Generator) -> bytes:
    """Return the GLB with another description."""
    size = struct.unpack_from("<I", good, 12)[0]
    described = structured(good[20 : 20 + size].rstrip(), rng)
    described += b" " * (-len(described) % 4)
    rest = good[20 + size :]
    head = b"glTF" + struct.pack("<II", 2, 20 + len(described) + len(rest))
    return head + struct.pack("<II", len(described), 0x4E4F534A) + described + rest


def _npz(good: bytes, rng: np.random.Generator) -> bytes:
    """Return the npz with one corrupted member in a valid zip."""
    with zipfile.ZipFile(io.BytesIO(good)) as stored:
        members = {name: stored.read(name) for name in stored.namelist()}
    name = sorted(members)[int(rng.integers(len(members)))]
    member = members[name]
    if rng.random() < 0.6:
        head, brace, rest = member.partition(b"}")
        members[name] = structured(head, rng) + brace + rest
    else:
        members[name] = corrupted(member, member, rng)
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED) as archive:
        for each, content in members.items():
            archive.writestr(each, content)
    return buffer.getvalue()


def disturbed(name: str, good: bytes, rng: np.random.Generator) -> bytes:
    """Return one corrupted file."""
    if rng.random() < 0.4:
        return corrupted(good, good, rng)
    if name.endswith(".glb"):
        return _glb(good, rng)
    if name.endswith(".npz"):
        return _npz(good, rng)
    return structured(good, rng) if name != "binary.stl" else corrupted(good[:90], good, rng) + good[90:]


def kinds(run: Path, scan: Path | None) -> list[Kind]:
    """Return all kinds with valid files of each.

    Args:
        run: a run folder, whose JSON and npz files are used.
        scan: a file of a scan; None omits it.
    """
    body = trimesh.creation.icosphere(subdivisions=1, radius=20.0)
    meshes = {f"body.{kind}": body.export(file_type=kind) for kind in ("obj", "ply", "off")}
    meshes |= {"text.stl": body.export(file_type="stl_ascii"), "binary.stl": body.export(file_type="stl")}
    meshes |= {"text.ply": body.export(file_type="ply", encoding="ascii")}
    scene = trimesh.Scene([body, body.copy().apply_translation([50, 0, 0])])
    meshes["body.glb"] = scene.export(file_type="glb")
    whole = {name: content.encode() if isinstance(content, str) else content for name, content in meshes.items()}
    built_in = (Path(__file__).parents[1] / "models" / "scene.toml").read_bytes()
    own = b'[[fixtures]]\nname = "a"\nshape = "box"\nsize_mm = [1, 2, 3]\n[plan]\nrolls_deg = [0, 90]\nfaces = 60\n'
    of_json = {
        name: (run / name).read_bytes() for name in ("plan.json", "scene.resolved.json", "report.json", "manifest.json")
    }
    of_npz = {name: (run / name).read_bytes() for name in ("motion.npz", "viewpoints.npz", "reach.npz")}
    if scan is not None:
        of_npz["scan.npz"] = scan.read_bytes()
    return [
        Kind("mesh", whole, lambda path: workpiece.load(path, "mm")),
        Kind("TOML", {"scene.toml": built_in, "own.toml": own}, load_scene),
        Kind("JSON", of_json, _read_json),
        Kind("npz", of_npz, _read_npz),
    ]


def _read_json(path: Path) -> object:
    if path.name == "manifest.json":
        return read_manifest(path)
    run = Run(path.parent, Manifest(status="finished"))
    return getattr(run, {"plan.json": "plan", "scene.resolved.json": "scene", "report.json": "report"}[path.name])


def _read_npz(path: Path) -> object:
    if path.name == "scan.npz":
        return read_scan(path)
    run = Run(path.parent, Manifest(status="finished"))
    return getattr(run, {"motion.npz": "motion", "viewpoints.npz": "candidates", "reach.npz": "reach"}[path.name])


def _results(kind: Kind, count: int, seed: int) -> Iterator[tuple[str, float, str]]:
    """Yield result, seconds and foreign error of each mangled file."""
    rng = np.random.default_rng(seed)
    names = sorted(kind.files)
    with tempfile.TemporaryDirectory() as folder:
        for number in range(count):
            name = names[number % len(names)]
            path = Path(folder) / name
            path.write_bytes(disturbed(name, kind.files[name], rng))
            began = process_time()
            try:
                kind.read(path)
                ended, message = "read", ""
            except CellError as error:
                ended, message = ("refused", "") if error.exit_code != CellError.exit_code else ("foreign", str(error))
            except BaseException as error:  # any other exception is a bug
                ended, message = "foreign", f"{name} {number}: {type(error).__name__}: {str(error)[:200]}"
            yield ended, process_time() - began, message


def _row(kind: Kind, count: int, seed: int) -> dict[str, Any]:
    logging.disable(logging.CRITICAL)
    used = int(Path("/proc/self/statm").read_text().split()[0]) * os.sysconf("SC_PAGE_SIZE")
    resource.setrlimit(resource.RLIMIT_AS, (used + ROOM, used + ROOM))
    results = list(_results(kind, count, seed))
    ends = [ended for ended, _, _ in results]
    return {
        "files": kind.name,
        "mangled": count,
        "read": ends.count("read"),
        "refused": ends.count("refused"),
        "foreign": ends.count("foreign"),
        "slowest_s": max(seconds for _, seconds, _ in results),
        "first foreign": next((message for _, _, message in results if message), ""),
    }


def _into(pipe: Any, kind: Kind, count: int, seed: int) -> None:
    pipe.send(_row(kind, count, seed))


def fuzzed(run: Path, scan: Path | None, count: int, seed: int = 0) -> list[dict[str, Any]]:
    """Return a row for each kind of file, each read in a separate process.

    Args:
        run: a run folder.
        scan: a file of a scan.
        count: total number of corrupted files.
        seed: seed of the corruption.
    """
    rows = []
    for kind in kinds(run, scan):
        here, there = multiprocessing.get_context("fork").Pipe()
        process = multiprocessing.get_context("fork").Process(target=_into, args=(there, kind, count // 4, seed))
        process.start()
        there.close()
        try:
            rows.append(here.recv())
        except EOFError:
            rows.append(
                {"files": kind.name, "mangled": count // 4, "foreign": count // 4, "first foreign": "the process died"}
            )
        process.join()
    return rows


def run() -> list[dict[str, Any]]:
    """Return a row for each kind of file, of a plan of a small part."""
    from cell import api

    with tempfile.TemporaryDirectory() as folder:
        planned = api.plan("petanque", place=(1100, 400, 100), faces=60, samples=2, out=Path(folder) / "plan")
        executed = api.scan(planned, resolution=4.0)
        scan = next((executed.folder / "scans").glob("*.npz"))
        return fuzzed(planned.folder, scan, int(os.environ.get("FUZZ_FILES", "10000")))


if __name__ == "__main__":
    print(json.dumps(run(), indent=2))  # noqa: T201  # a quick look
