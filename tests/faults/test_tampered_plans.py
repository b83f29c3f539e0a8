"""A run folder in which one field was changed, hashes and digest made anew: refused, or a field that changes nothing.

Every field of plan.json, scene.resolved.json, manifest.json and motion.npz is found by walking over the files, so a new
one is looked at without a word here. Which fields may be changed is a list in docs/run_folder.md.
"""

import copy
import io
import json
import re
import shutil
import subprocess
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cell.errors import CellError
from cell.proof.proof import prove

Run = Callable[..., subprocess.CompletedProcess[str]]
Reseal = Callable[[Path], str]

DOCS = Path(__file__).parents[2] / "docs" / "run_folder.md"
JSON = ("plan.json", "scene.resolved.json", "manifest.json")
_OPEN = ("artefacts", "inputs", "versions", "seconds", "options")  # maps of the manifest whose keys are data


@dataclass(frozen=True)
class Change:
    """One field changed in one way.

    Attributes:
        field: as the docs name it, "plan.json:views[].q_deg".
        what: of the change, for the failure.
        content: of the changed file.
    """

    field: str
    what: str
    content: bytes

    @property
    def file(self) -> str:
        """The file that was changed."""
        return self.field.partition(":")[0]


def free_fields() -> list[re.Pattern[str]]:
    """The fields that the docs list, with all that is below where they end in `.*`."""
    listed = DOCS.read_text(encoding="utf-8").partition("<!-- free fields")[2].partition("<!-- end of free fields")[0]
    names = re.findall(r"`([a-z.]+:[^`]+)`", listed)
    assert len(names) > 20
    below = r"(\..*|\[.*)?"
    return [
        re.compile(re.escape(name.removesuffix(".*")) + (below if name.endswith(".*") else r"(\[\])*"))
        for name in names
    ]


def _others(value: Any) -> list[tuple[str, Any]]:
    """What a leaf may be changed to."""
    if isinstance(value, bool):
        return [("turned", not value)]
    if isinstance(value, int):
        return [("one more", value + 1), ("far more", value + 1000)]
    if isinstance(value, float):
        return [("0.01 more", value + 0.01), ("a thousandth less", value * 0.998 - 3e-5), ("negated", -value - 0.5)]
    if isinstance(value, str):
        return [("longer", value + "x"), ("empty", "")]
    return [("a number", 1.0), ("a text", "x")] if value is None else []


def _walk(name: str, tree: Any) -> Iterator[tuple[str, list[Any], str, Callable[[Any], Any]]]:
    """Field, place in the tree, and a function that changes the parent's entry; None takes it away."""
    todo: list[tuple[Any, str, list[Any]]] = [(tree, f"{name}:", [])]
    while todo:
        here, field, place = todo.pop()
        keys = list(here) if isinstance(here, dict) else range(len(here))
        for key in keys:
            value = here[key]
            if isinstance(here, dict):
                parent = field.partition(":")[2].strip(".")
                below = field + ("*" if parent in _OPEN else key)
            else:
                below = field.removesuffix(".") + "[]"
            at = [*place, key]
            for what, other in _others(value):
                yield below, at, what, lambda old, other=other: other
            if isinstance(here, dict):
                yield below, at, "taken away", lambda old: _GONE
            if isinstance(value, list) and value:
                yield below, at, "its last taken away", lambda old: old[:-1]
                yield below, at, "its last twice", lambda old: [*old, old[-1]]
                if value != value[::-1]:
                    yield below, at, "turned round", lambda old: old[::-1]
            if isinstance(value, dict | list):
                todo.append((value, below + "." if isinstance(value, dict) else below, at))


_GONE = object()


def json_changes(run: Path, name: str) -> list[Callable[[], Change]]:
    """Every change of every field of a JSON file, made when it is asked for."""
    tree = json.loads((run / name).read_text())

    def made(field: str, place: list[Any], what: str, change: Callable[[Any], Any]) -> Change:
        new = copy.deepcopy(tree)
        owner = new
        for key in place[:-1]:
            owner = owner[key]
        value = change(owner[place[-1]])
        if value is _GONE:
            del owner[place[-1]]
        else:
            owner[place[-1]] = value
        return Change(field, f"{place} {what}", json.dumps(new, indent=2).encode())

    return [lambda args=args: made(*args) for args in _walk(name, tree)]


def array_changes(run: Path, name: str, rng: np.random.Generator, each: int) -> list[Callable[[], Change]]:
    """Changes of every array of an .npz: some entries, rows, the array itself."""
    with np.load(run / name) as stored:
        arrays = dict(stored)

    def entry(array: Any, index: int) -> Any:
        new = array.copy()
        flat = new.reshape(-1)
        if array.dtype.kind == "U":
            new = new.astype(f"<U{array.dtype.itemsize // 4 + 1}")
            new.reshape(-1)[index] = str(array.reshape(-1)[index]) + "x"
        elif array.dtype.kind == "f":
            flat[index] = 0.0 if not np.isfinite(flat[index]) else flat[index] + 1e-3
        else:
            flat[index] += 1
        return new

    def made(key: str, what: str, value: Any) -> Change:
        others = {own: array for own, array in arrays.items() if own != key}
        buffer = io.BytesIO()
        np.savez_compressed(buffer, **others, **({} if value is None else {key: value}))
        return Change(f"{name}:{key}", what, buffer.getvalue())

    changes: list[Callable[[], Change]] = []
    for key, array in arrays.items():
        chosen = rng.choice(array.size, min(each, array.size), replace=False)
        changes += [lambda key=key, k=k, a=array: made(key, f"entry {k}", entry(a, k)) for k in chosen.tolist()]
        changes.append(lambda key=key: made(key, "taken away", None))
        changes.append(lambda key=key, a=array: made(key, "its last taken away", a[:-1]))
        changes.append(lambda key=key, a=array: made(key, "its last twice", np.concatenate([a, a[-1:]])))
        if not np.array_equal(array, array[::-1]):
            changes.append(lambda key=key, a=array: made(key, "turned round", a[::-1]))
    return changes


def judged(run: Path, changes: list[Callable[[], Change]], resealed: Reseal) -> list[str]:
    """Changes that are neither refused nor of a field that the docs list; the folder is as it was afterwards."""
    free, open_ = free_fields(), []
    for make in changes:
        change = make()
        path = run / change.file
        before, manifest = path.read_bytes(), (run / "manifest.json").read_bytes()
        path.write_bytes(change.content)
        try:
            if change.file == "manifest.json":
                _digest_anew(path)
            else:
                resealed(run)
            prove(run)
        except CellError:
            pass
        else:
            if not any(pattern.fullmatch(change.field) for pattern in free):
                open_.append(f"{change.field}: {change.what}")
        finally:
            path.write_bytes(before)
            (run / "manifest.json").write_bytes(manifest)
    return open_


def _digest_anew(path: Path) -> None:
    """The digest that a changed manifest would have, unless the change was of the digest itself."""
    from cell.run import digest

    manifest = json.loads(path.read_text())
    shas = manifest.get("artefacts")
    if (
        isinstance(manifest.get("digest"), str)
        and re.fullmatch("[0-9a-f]{64}", manifest["digest"])
        and isinstance(shas, dict)
    ):
        try:
            manifest["digest"] = digest.of_plan(shas)
        except KeyError:
            return
        path.write_text(json.dumps(manifest))


def all_changes(run: Path, rng: np.random.Generator, each: int) -> list[Callable[[], Change]]:
    """Of all four files."""
    of_json = [change for name in JSON for change in json_changes(run, name)]
    return [*of_json, *array_changes(run, "motion.npz", rng, each)]


def test_a_field_changed_alone_is_refused_or_changes_nothing(planned: Path, tmp_path: Path, resealed: Reseal) -> None:
    """A seeded handful of all changes; the long form below makes them all."""
    run = tmp_path / "run"
    shutil.copytree(planned, run)
    rng = np.random.default_rng(11)
    changes = all_changes(run, rng, 2)
    chosen = rng.choice(len(changes), 70, replace=False)
    assert judged(run, [changes[k] for k in chosen.tolist()], resealed) == []


@pytest.mark.slow
def test_every_field_changed_alone_is_refused_or_changes_nothing(
    planned: Path, tmp_path: Path, resealed: Reseal
) -> None:
    """Every field of the four files, in every way."""
    run = tmp_path / "run"
    shutil.copytree(planned, run)
    assert judged(run, all_changes(run, np.random.default_rng(12), 12), resealed) == []
