"""Run folders with one changed field and renewed hashes and digest: the field is refused, or has no effect.

Every field of every driving artefact and of manifest.json is found by walking over the files, so new fields are tested
without a change here. docs/internals/run_folder_free_fields.csv lists the fields that may be changed.
"""

import copy
import csv
import io
import json
import re
import shutil
import subprocess
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest

from cell.errors import CellError
from cell.runs import ply
from cell.runs.current_files import CurrentFiles
from cell.runs.current_scene import require_current_scene
from cell.runs.run import open_run
from cell.runs.verification import verify_plan
from planner.geometry.mesh import TriangleMesh
from tests.support.fixture_types import RunCommand

Reseal = Callable[[Path], str]

FREE = Path(__file__).parents[2] / "docs" / "internals" / "run_folder_free_fields.csv"
JSON = ("plan.json", "scene.resolved.json", "manifest.json")
ARRAYS = ("motion.npz", "viewpoints.npz")
_OPEN = ("artefacts", "inputs", "versions", "seconds", "options")  # maps of the manifest whose keys are data


@dataclass(frozen=True)
class Change:
    """One field with one change.

    Attributes:
        field: name as in the docs, "plan.json:views[].q_deg".
        what: description of the change, for the failure.
        content: content of the changed file.
    """

    field: str
    what: str
    content: bytes

    @property
    def file(self) -> str:
        """Return the name of the changed file."""
        return self.field.partition(":")[0]


def free_fields() -> list[re.Pattern[str]]:
    """Return patterns of the fields that the docs list, with all fields below them if they end in `.*`."""
    with FREE.open(encoding="utf-8", newline="") as file:
        names = [row["field"] for row in csv.DictReader(file)]
    assert len(names) > 20
    below = r"([.\[@].*)?"
    return [
        re.compile(re.escape(name.removesuffix(".*")) + (below if name.endswith(".*") else r"(\[\])*"))
        for name in names
    ]


def _others(value: Any) -> list[tuple[str, Any]]:
    """Return changed values of a leaf, each with its description."""
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
    """Yield field, place in the tree, description, and a function that changes the value in its parent."""
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
                yield below, at, "taken away", lambda old: _REMOVED
            if isinstance(value, list) and value:
                yield below, at, "its last taken away", lambda old: old[:-1]
                yield below, at, "its last twice", lambda old: [*old, old[-1]]
                if value != value[::-1]:
                    yield below, at, "turned round", lambda old: old[::-1]
            if isinstance(value, dict | list):
                todo.append((value, below + "." if isinstance(value, dict) else below, at))


_REMOVED = object()


def json_changes(run: Path, name: str, below: str = "") -> list[Callable[[], Change]]:
    """Return the changes of every field of a JSON file whose name contains `below`."""
    tree = json.loads((run / name).read_text())

    def change_field(field: str, place: list[Any], what: str, change: Callable[[Any], Any]) -> Change:
        new = copy.deepcopy(tree)
        owner = new
        for key in place[:-1]:
            owner = owner[key]
        value = change(owner[place[-1]])
        if value is _REMOVED:
            del owner[place[-1]]
        else:
            owner[place[-1]] = value
        return Change(field, f"{place} {what}", json.dumps(new, indent=2).encode())

    return [lambda args=args: change_field(*args) for args in _walk(name, tree) if below in args[0]]


def array_changes(run: Path, name: str, rng: np.random.Generator, each: int) -> list[Callable[[], Change]]:
    """Return changes of every array of an .npz: some entries, rows, the array itself."""
    with np.load(run / name) as stored:
        arrays = dict(stored)

    views = [view["id"] for view in json.loads((run / "plan.json").read_text())["views"]]

    def field(key: str, index: int) -> str:
        row = index // max(1, arrays[key].size // max(1, len(arrays[key])))
        return f"{name}:{key}" + (" of a view" if name == "viewpoints.npz" and row in views else "")

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

    def change_array(key: str, what: str, value: Any, index: int = -1) -> Change:
        others = {own: array for own, array in arrays.items() if own != key}
        buffer = io.BytesIO()
        np.savez_compressed(buffer, **others, **({} if value is None else {key: value}))
        return Change(field(key, index) if index >= 0 else f"{name}:{key}", what, buffer.getvalue())

    changes: list[Callable[[], Change]] = []
    for key, array in arrays.items():
        indices = rng.choice(array.size, min(each, array.size), replace=False).tolist()
        if name == "viewpoints.npz" and key in ("T_object_scanner", "roll"):  # and of views of the plan
            per_row = array.size // len(array)
            indices += [view * per_row + int(rng.integers(min(per_row, 12))) for view in views[:each]]
        changes += [lambda key=key, k=k, a=array: change_array(key, f"entry {k}", entry(a, k), k) for k in indices]
        changes.append(lambda key=key: change_array(key, "taken away", None))
        changes.append(lambda key=key, a=array: change_array(key, "its last taken away", a[:-1]))
        changes.append(lambda key=key, a=array: change_array(key, "its last twice", np.concatenate([a, a[-1:]])))
        if not np.array_equal(array, array[::-1]):
            changes.append(lambda key=key, a=array: change_array(key, "turned round", a[::-1]))
    return changes


def xml_changes(run: Path, name: str) -> list[Callable[[], Change]]:
    """Return the changes of every kind of element and attribute of an XML file: first, middle and last of each kind."""
    content = (run / name).read_bytes()
    places: dict[str, list[tuple[int, str]]] = {}
    for number, element in enumerate(ElementTree.fromstring(content).iter()):
        for attribute in ("", *element.attrib):
            places.setdefault(f"{element.tag}@{attribute}" if attribute else element.tag, []).append(
                (number, attribute)
            )

    def change_element(kind: str, number: int, attribute: str, what: str) -> Change:
        root = ElementTree.fromstring(content)
        element = list(root.iter())[number]
        if not attribute:
            parents = {child: parent for parent in root.iter() for child in parent}
            (parents[element].remove if what == "taken away" else parents[element].append)(element)
        elif what == "taken away":
            del element.attrib[attribute]
        else:
            words = element.attrib[attribute].split()
            word = words[-1]
            is_number, changed = re.fullmatch(r"[-+.\de]+", word), what == "changed"
            words[-1] = f"{word}x" if not is_number else repr(float(word) + 0.011) if changed else "nan"
            element.attrib[attribute] = " ".join(words)
        return Change(f"{name}:{kind}", f"{kind} number {number} {what}", ElementTree.tostring(root))

    return [
        lambda args=(kind, *place, what): change_element(*args)
        for kind, found in places.items()
        if kind != "mujoco"  # the root
        for place in dict.fromkeys((found[0], found[len(found) // 2], found[-1]))
        for what in (("changed", "not a number", "taken away") if place[1] else ("taken away", "twice"))
    ]


def mesh_changes(run: Path, name: str, rng: np.random.Generator, each: int) -> list[Callable[[], Change]]:
    """Return changes of a mesh: a vertex, a face, its size, its place."""
    mesh = open_run(run).mesh(name)

    def change_mesh(field: str, what: str, vertices: Any, faces: Any) -> Change:
        new = TriangleMesh(vertices, faces.astype(np.int32), None if len(faces) != len(mesh.faces) else mesh.region)
        return Change(f"{name}:{field}", what, ply.mesh_bytes(new))

    def moved(index: int) -> Any:
        vertices = mesh.vertices.copy()
        vertices[index] += 2e-5
        return vertices

    indices = rng.choice(len(mesh.vertices), each, replace=False).tolist()
    changes: list[Callable[[], Change]] = [
        lambda k=k: change_mesh("vertex", f"vertex {k} moved", moved(k), mesh.faces) for k in indices
    ]
    changes += [
        lambda: change_mesh("face", "the last taken away", mesh.vertices, mesh.faces[:-1]),
        lambda: change_mesh("face", "the last twice", mesh.vertices, mesh.faces[[*range(len(mesh.faces)), -1]]),
        lambda: change_mesh("face", "all inverted", mesh.vertices, mesh.faces[:, ::-1]),
        lambda: change_mesh("vertex", "all at 30 %", 0.3 * mesh.vertices, mesh.faces),
        lambda: change_mesh("vertex", "all 1 mm higher", mesh.vertices + np.array([0.0, 0.0, 1e-3]), mesh.faces),
    ]
    return changes


def undetected(run: Path, changes: list[Callable[[], Change]], resealed: Reseal) -> list[str]:
    """Return the changes that are not refused and whose field is not in the docs. The folder is restored."""
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
            require_current_scene(verify_plan(run), CurrentFiles(), None, wire=True)
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
    """Renew the digest of a changed manifest, unless the digest itself was changed."""
    from cell.runs import digest

    manifest = json.loads(path.read_text())
    shas = manifest.get("artefacts")
    if (
        isinstance(manifest.get("digest"), str)
        and re.fullmatch("[0-9a-f]{64}", manifest["digest"])
        and isinstance(shas, dict)
    ):
        try:
            manifest["digest"] = digest.plan_digest(shas)
        except KeyError:
            return
        path.write_text(json.dumps(manifest))


def all_changes(run: Path, rng: np.random.Generator, each: int) -> list[Callable[[], Change]]:
    """Return the changes of all driving artefacts and of the manifest."""
    of_json = [change for name in JSON for change in json_changes(run, name)]
    of_arrays = [change for name in ARRAYS for change in array_changes(run, name, rng, each)]
    of_meshes = [change for path in sorted(run.glob("*.ply")) if path.name != "planning.ply"
                 for change in mesh_changes(run, path.name, rng, each)]  # fmt: skip
    return [*of_json, *of_arrays, *of_meshes, *xml_changes(run, "cell.xml")]


def test_a_field_changed_alone_is_refused_or_changes_nothing(planned: Path, tmp_path: Path, resealed: Reseal) -> None:
    """A seeded sample of all changes is tested; the slow test below makes all changes."""
    run = Path(shutil.copytree(planned, tmp_path / "run"))
    rng = np.random.default_rng(11)
    changes = all_changes(run, rng, 2)
    indices = rng.choice(len(changes), 25, replace=False)
    assert undetected(run, [changes[k] for k in indices.tolist()], resealed) == []


def test_a_field_of_a_sweep_changed_alone_is_refused(swept: Path, tmp_path: Path, resealed: Reseal) -> None:
    """A seeded sample of changes of the fields of sweeps, of fixtures, and of the arrays of the motion is refused."""
    run = Path(shutil.copytree(swept, tmp_path / "run"))
    rng = np.random.default_rng(13)
    of_sweeps, fixtures = json_changes(run, "plan.json", ".sweep"), json_changes(run, "scene.resolved.json", "fixtures")
    sample = [
        *(of_sweeps[k] for k in rng.choice(len(of_sweeps), 5, replace=False).tolist()),
        *(fixtures[k] for k in rng.choice(len(fixtures), 3, replace=False).tolist()),
        *array_changes(run, "motion.npz", rng, 1)[::30],
    ]
    assert undetected(run, sample, resealed) == []


def test_numbers_of_the_cell_that_are_none_are_refused(planned: Path, tmp_path: Path, resealed: Reseal) -> None:
    """MuJoCo accepts NaN, which is neither above nor below a limit."""
    run = Path(shutil.copytree(planned, tmp_path / "run"))
    places = ("body@pos", "body@quat", "joint@pos", "joint@axis", "joint@range", "geom@pos", "site@pos")
    changes = [make for make in xml_changes(run, "cell.xml") if make().what.endswith("not a number")]
    named = {make().field.removeprefix("cell.xml:"): make for make in changes}
    assert undetected(run, [named[place] for place in places if place in named], resealed) == []


@pytest.mark.slow
@pytest.mark.parametrize("plan", ["planned", "swept"])
def test_every_field_changed_alone_is_refused_or_changes_nothing(
    plan: str, request: pytest.FixtureRequest, tmp_path: Path, resealed: Reseal
) -> None:
    """Every change of every field of every artefact is tested, for plans with views at rest and with sweeps."""
    run = tmp_path / "run"
    shutil.copytree(request.getfixturevalue(plan), run)
    assert undetected(run, all_changes(run, np.random.default_rng(12), 12), resealed) == []


def _with_via(run: Path, q: np.ndarray, row: int) -> None:
    """Insert a via point into the motion and renew its times, so that only the certificate disagrees."""
    from cell.runs.run import open_finished
    from planner.timing.motion import retime

    record = open_finished(run)
    motion = record.motion
    with np.load(run / "motion.npz") as stored:
        arrays = dict(stored)

    def put(array: np.ndarray, value: Any) -> np.ndarray:
        return np.insert(array, row, value, axis=0)

    again = retime(
        put(motion.via_q, q), put(motion.segment, motion.segment[row]), put(motion.view, -1), motion.limits,
        pose=put(motion.pose, -1),
    )  # fmt: skip
    names = ("via_q", "segment", "view", "pose", "line", "via_t", "t", "q", "qd", "qdd", "segment_of_sample")
    np.savez_compressed(run / "motion.npz", **arrays | {name: getattr(again, name) for name in names})


def test_a_via_point_inside_the_part_is_refused_by_the_certificate(
    planned: Path, tmp_path: Path, resealed: Reseal, run_cell: RunCommand
) -> None:
    """With renewed times, hashes and digest, a colliding via point is refused and a free one is accepted."""
    from cell.robot.arm import kr16_kinematics
    from planner.kinematics.setpoints import from_steps, to_steps

    proven = verify_plan(planned)
    row = int(np.flatnonzero(proven.motion.view >= 0)[0])
    inside = proven.plan.views[0].T_base_flange.copy()  # from 250 mm off the surface to 50 mm behind it
    inside[:3, 3] += 0.3 * proven.plan.views[0].T_base_scanner[:3, 2]
    q = next(
        q for q in kr16_kinematics().inverse(inside[None])[0]
        if not np.isnan(q).any() and (q >= proven.motion.limits.lower).all() and (q <= proven.motion.limits.upper).all()
    )  # fmt: skip
    run = Path(shutil.copytree(planned, tmp_path / "inside"))
    _with_via(run, from_steps(to_steps(q)), row)
    digest = resealed(run)
    for command in (("scan", run, "--confirm-motion", digest), ("export", run)):
        process = run_cell(*command, cwd=tmp_path, code=6)
        assert re.search(r"motion.npz (violates the clearance|is not certified collision-free)", process.stderr)
    free = Path(shutil.copytree(planned, tmp_path / "free"))
    via = proven.motion.via_q
    _with_via(free, from_steps(to_steps((via[row - 1] + via[row]) / 2)), row)
    assert resealed(free) != proven.digest
    assert verify_plan(free).digest != proven.digest
    with pytest.raises(CellError, match="nothing was moved"):
        proven.require_path_free(np.stack([via[0], from_steps(to_steps(q))]))


def test_limits_are_the_model_s_even_where_both_files_agree(planned: Path, tmp_path: Path, resealed: Reseal) -> None:
    """Wider ranges or faster axes are refused although scene.resolved.json and motion.npz agree."""
    for key, name, factor, words in (
        ("joint_limits_deg", "limit_upper", 1.1, "contradicts itself, or the part, at joint_limits_deg"),
        ("joint_velocity_limits_deg_s", "limit_velocity", 2.0, "above those of the robot model"),
    ):
        run = tmp_path / name
        shutil.copytree(planned, run)
        resolved = json.loads((run / "scene.resolved.json").read_text())
        resolved[key] = (np.array(resolved[key]) * factor).tolist()
        (run / "scene.resolved.json").write_text(json.dumps(resolved))
        with np.load(run / "motion.npz") as stored:
            arrays = dict(stored)
        np.savez_compressed(run / "motion.npz", **arrays | {name: arrays[name] * factor})
        resealed(run)
        with pytest.raises(CellError, match=words):
            verify_plan(run)


def test_a_plan_without_a_digest_is_read_and_replayed_and_never_driven(
    planned: Path, tmp_path: Path, run_cell: RunCommand
) -> None:
    """A plan without a digest or without the hash of a required file is readable, but not executed."""
    from cell.api import open_run

    run = Path(shutil.copytree(planned, tmp_path / "run"))
    manifest = json.loads((run / "manifest.json").read_text())
    without = {key: value for key, value in manifest.items() if key != "digest"}
    (run / "manifest.json").write_text(json.dumps(without))
    for command in ("scan", "export"):
        process = run_cell(command, "run", cwd=tmp_path, code=6)
        assert "has no digest" in process.stderr
    assert open_run(run).digest == ""
    run_cell("replay", "run", "--picture", "x.png", "--size", "160x120", cwd=tmp_path, code=0)
    del manifest["artefacts"]["motion.npz"]
    (run / "manifest.json").write_text(json.dumps(manifest))
    assert "has no sha256 of motion.npz" in run_cell("scan", "run", cwd=tmp_path).stderr


def test_the_digest_is_that_of_sha256sum(planned: Path) -> None:
    """The command of docs/internals/run_folder.md gives the digest of the plan."""
    names = ["cell.xml", "motion.npz", "plan.json", "reference.ply", "scene.resolved.json", "viewpoints.npz"]
    lines = subprocess.run(["sha256sum", *names], cwd=planned, capture_output=True, check=True).stdout
    digest = subprocess.run(["sha256sum"], input=lines, capture_output=True, check=True).stdout.split()[0].decode()
    assert digest == json.loads((planned / "manifest.json").read_text())["digest"]
