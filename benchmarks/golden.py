"""Golden runs: compare the artefacts of small runs with a committed reference.

`python -m benchmarks golden` executes about 45 small runs of the command line in one process, in a temporary folder,
and compares the SHA-256 of each artefact with `golden.json`. Each artefact has up to two hashes. `data` covers
numbers, arrays and keys: npz files by name, type and bytes of each array; JSON without sentences (strings with a
space), digests and command lines; pages by their embedded JSON; programs without comments. `words` covers the full
text of files that people read. Neither covers pictures, logs, clock times, durations, absolute paths, process and host
names, and package versions. Numbers may differ in the last digit on another kind of processor: compare runs of one
machine.
"""

import contextlib
import gc
import hashlib
import io
import json
import logging
import os
import re
import shlex
import shutil
import sys
import tempfile
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from time import perf_counter
from typing import Annotated, Any, TypeAlias
from unittest import mock

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # read by NumPy as it is imported: sums in the same order

import matplotlib
import numpy as np
import trimesh
import typer
from rich.console import Console
from rich.table import Table

from benchmarks.edits import no_pictures
from cell.cli import app as cell_app
from cell.cli.failures import INTERRUPTED, report_errors

REFERENCE = Path(__file__).with_suffix(".json")
_DIGITS = 16  # hexadecimal digits of a hash that are kept
_IGNORED_SUFFIXES = (".png", ".log", ".lock")
_IGNORED_FOLDERS = ("cache",)
_DIGEST = re.compile(r"[0-9a-f]{40,64}")  # some of them cover texts or absolute paths
_TIME = re.compile(r"\d{4}-\d\d-\d\d[T ]\d\d:\d\d(:\d\d)?(\.\d+)?(Z|\+00:00)?")

Step: TypeAlias = str | Callable[[Path], None]
"""A command line of `cell`, or a function of the folder of the run."""


@dataclass(frozen=True)
class Case:
    """One run.

    Attributes:
        name: name of the run and of its folder.
        steps: commands and functions, executed in order in the folder of the run.
        inputs: local name to path of a result of an earlier run, copied before the first step.
        scene: text of the scene file `in.toml`.
        pages: whether plans and executions draw their pages; the others take half the time.
    """

    name: str
    steps: tuple[Step, ...]
    inputs: Mapping[str, str]
    scene: str
    pages: bool


def _case(
    name: str,
    *steps: Step,
    run: str = "",
    inputs: Mapping[str, str] | None = None,
    scene: str = "",
    pages: bool = False,
) -> Case:
    """Return a case; `run` names the earlier case whose run folder it continues."""
    return Case(name, steps, inputs or ({"run": f"{run}/run"} if run else {}), scene, pages)


_REGIONS = """
[part]
path = "../block.stl"
units = "mm"
[scanner]
sensor = "generic-area-medium"
[plan]
faces = 60
samples_per_face = 2
candidates = "optimal-scanning-zone"
coverage = 0.9
[[region]]
name = "top"
box_mm = [-31, -31, 19, 31, 31, 21]
views = 2
max_spacing_mm = 0.6
[[region]]
name = "side"
box_mm = [-31, -31, 0, 31, -29, 19]
coverage = 0.5
[[region]]
name = "skin"
care = "no"
"""

_LINE = """
[scanner]
type = "laser-line"
sweep_deg = 24.0
sweep_steps = 5
line_points = 160
[[fixtures]]
name = "clamp"
shape = "mesh"
units = "mm"
path = "../blob.stl"
position_mm = [700, -700, 200]
abc_deg = [10, 20, 30]
"""

_SETUPS = """
[part]
path = "../blob.stl"
units = "mm"
[placement]
position_mm = [1100, 400, 100]
[plan]
standoffs_mm = [250]
faces = 30
samples_per_face = 2
seed = 3
candidates = "optimal-scanning-zone"
coverage = 0.95
"""

_GIVEN_SETUPS = (
    _SETUPS
    + """
[[setup]]
name = "upright"
position_mm = [1100, 400, 100]
[[setup]]
name = "over"
position_mm = [1100, 400, 100]
abc_deg = [0, 0, 180]
fixtures = [{ name = "vise", shape = "box", position_mm = [1100, 560, 0], size_mm = [60, 60, 60] }]
[[setup]]
name = "blocked"
position_mm = [1100, 400, 100]
abc_deg = [0, 0, 90]
fixtures = [{ name = "block", shape = "box", position_mm = [1100, 400, 0], size_mm = [60, 60, 260] }]
"""
)

_TAKE = """
import os, pathlib, shutil, signal, sys, time
view, pose, out = sys.argv[1:]
mark = pathlib.Path("stopped")
if view == "2" and not mark.exists():  # a person presses Ctrl-C at the second view, once
    mark.touch()
    os.kill(os.getppid(), signal.SIGINT)
    time.sleep(60)
shutil.copy(f"points/{int(view):04d}.ply", out)
"""

_INDEXED = '[table]\nmoves = "indexed"\n'
_TABLE_SETUPS = _SETUPS + "[table]\nangles = 12\n"

_STOPPED = "scan-stopped"
_PLACE = "--units mm --place 1100,400,100 --samples 2 --standoff 250 --seed 3"
_COARSE = f"{_PLACE} --faces 24 --candidates optimal-scanning-zone"
_SMALL = f"{_PLACE} --faces 60 --candidates optimal-scanning-zone"
_EXPLORE = f"{_SMALL} --resolution 1"
_RAYS = "--fill rays --candidates view-sphere --place 1200,500,0"
_SIGMA_HULL = "--max-sigma 0.05 --max-spacing 3 --collision hull"
_NOISE = "--noise model --range-noise 0.02"
_POINTS = "--points-frame scanner --points-units mm"
_PROGRAM = f"--acquire 'command:{sys.executable} take.py' {_POINTS} --no-register"
_ELSEWHERE = "sim://?start=0,-90,90,0,20,0"
_BASE = "--points-frame base --points-units mm --out there"


def _export_points(folder: Path) -> None:
    """Write the scans of the first execution as files of points in the frame of the scanner, in millimetres."""
    (folder / "points").mkdir()
    for path in sorted((folder / "run" / "executions" / "0001" / "scans").glob("*.npz")):
        with np.load(path) as scan:
            back = np.linalg.inv(scan["T_object_scanner"])
            points = 1000 * (scan["points"] @ back[:3, :3].T + back[:3, 3])
        trimesh.PointCloud(points).export(folder / "points" / f"{path.stem}.ply")


def _write_program(folder: Path) -> None:
    (folder / "take.py").write_text(_TAKE)


def _remove_first_scan(folder: Path) -> None:
    min((folder / "run" / "executions" / "0001" / "scans").glob("*.npz")).unlink()


def _remove_second_points(folder: Path) -> None:
    (folder / "points" / "0002.ply").rename(folder / "0002.ply")


def _restore_second_points(folder: Path) -> None:
    (folder / "0002.ply").rename(folder / "points" / "0002.ply")


def _displace_points(folder: Path) -> None:
    """Write one scan as if the part stood 9 mm and 2 deg elsewhere, seen from the planned first view."""
    plan = json.loads((folder / "run" / "plan.json").read_text())
    T_base_scanner = np.array(plan["views"][0]["T_base_scanner"])
    with np.load(folder / "run" / "executions" / "0001" / "scans" / "0001.npz") as scan:
        T_base_object = T_base_scanner @ np.linalg.inv(plan["views"][0]["T_object_scanner"])
        points = scan["points"] @ T_base_object[:3, :3].T + T_base_object[:3, 3]
    centre = points.mean(axis=0)
    turn = trimesh.transformations.rotation_matrix(np.radians(2.0), [0.3, -0.5, 1.0], centre)
    moved = trimesh.transform_points(points, turn) + np.array([0.007, -0.005, 0.002])
    np.savetxt(folder / "far.xyz", 1000 * moved, fmt="%.6f")


def _write_pairs(folder: Path) -> None:
    """Write six points of the part and where they would be measured if the part stood elsewhere."""
    mesh = trimesh.load(folder / "run" / "reference.ply", process=False)
    plan = json.loads((folder / "run" / "plan.json").read_text())
    view = plan["views"][0]
    T_base_object = np.array(view["T_base_scanner"]) @ np.linalg.inv(view["T_object_scanner"])
    nominal = mesh.vertices[np.linspace(0, len(mesh.vertices) - 1, 6).astype(int)]
    measured = trimesh.transform_points(nominal, T_base_object) + np.array([0.005, -0.003, 0.001])
    lines = [f"p{k}; " + ", ".join(f"{1000 * x:.6f}" for x in (*nominal[k], *measured[k])) for k in range(6)]
    (folder / "pairs.csv").write_text("\n".join(lines) + "\n")


CASES = (
    _case("plan", f"plan ../blob.stl {_SMALL} --coverage 0.95 --out run", pages=True),
    _case("plan-grown", f"plan ../blob.stl {_PLACE} --faces 30 --coverage 0.9 --out run"),
    _case("plan-mug-rays", f"plan mug --faces 60 --samples 1 {_RAYS} --coverage 0.8 --out run --json"),
    _case("plan-regions", "plan --scene in.toml --place 1000,300,200 --out run", scene=_REGIONS, pages=True),
    _case("plan-line", f"plan ../blob.stl {_COARSE} --coverage 0.7 --scene in.toml --out run", scene=_LINE, pages=True),
    _case("plan-table", f"plan ../blob.stl {_SMALL} --coverage 1 --table --out run", pages=True),
    _case("plan-indexed", f"plan ../blob.stl {_SMALL} --coverage 0.95 --scene in.toml --out run", scene=_INDEXED),
    _case("plan-max-views", f"plan ../blob.stl {_SMALL} --max-views 3 --curve --out run"),
    _case("plan-overlap", f"plan ../blob.stl {_SMALL} --coverage 0.9 --overlap 10% --overlap-in-order --out run"),
    _case("plan-least-time", f"plan ../blob.stl {_SMALL} --coverage 0.95 --cost time --out run"),
    _case("plan-multiplicity", f"plan ../blob.stl {_SMALL} --coverage 0.9 --multiplicity 2 --out run"),
    _case("plan-pose-sd", f"plan ../blob.stl {_SMALL} --coverage 0.9 --pose-sd 0.5mm,0.1deg --out run"),
    _case("plan-pins", f"plan ../blob.stl {_SMALL} --coverage 0.95 --pin 27 --ban 12,67 --out run"),
    _case("plan-sigma-hull", f"plan ../blob.stl {_SMALL} {_SIGMA_HULL} --coverage 0.9 --solver greedy --out run"),
    _case("setups", "setups --scene in.toml --proposals 2 --coverage 0.98 --out made", scene=_SETUPS),
    _case("setups-given", "setups --scene in.toml --out made", scene=_GIVEN_SETUPS, pages=True),
    _case("setups-table", "setups --scene in.toml --proposals 3 --coverage 1 --out made", scene=_TABLE_SETUPS),
    _case("setups-first", f"setups ../blob.stl {_SMALL} --first run --proposals 2 --out made", run="plan"),
    _case("edit-drop", "edit run --drop 2 --repair --out edited", run="plan", pages=True),
    _case("edit-order", "edit run --order 4,2,1,3 --out edited --json", run="plan"),
    _case("edit-turn", "edit run --turn 1:90 --keep-order --out edited", run="plan"),
    _case("edit-add", "edit run --add-candidate 27 --out edited", run="plan"),
    _case("edit-move", "edit run --move 2:1284,430,330,98,0,-137 --out edited", run="plan"),
    _case("edit-pose", "edit run --add-pose 1250,400,340,98.3,0,-142 --keep-order --out edited", run="plan"),
    _case("scan", "scan run --resolution 1 --close-holes", run="plan", pages=True),
    _case("scan-noise", f"scan run --resolution 1 {_NOISE} --pose-error 0.3mm,0.05deg --seed 4 --json", run="plan"),
    _case("scan-files", _export_points, f"scan run --acquire files:points {_POINTS} --no-register", run="scan"),
    _case(
        "scan-missing", _export_points, _remove_second_points, f"scan run --acquire files:points {_POINTS}",
        _restore_second_points, "scan run --resume latest", run="scan",
    ),
    _case(_STOPPED, _export_points, _write_program, f"scan run {_PROGRAM}", "scan run --resume latest", run="scan"),
    _case("scan-elsewhere", _remove_first_scan, f"scan run --resume 0001 --driver {_ELSEWHERE}", run="scan"),
    _case("scan-line", "scan run", run="plan-line"),
    _case("scan-table", "scan run --resolution 1", run="plan-table"),
    _case(
        "scan-setups", "scan made --setup 1 --setup-error 5mm,2deg --range-noise 0.03 --resolution 1",
        "scan made --resume latest", inputs={"made": "setups/made"}, pages=True,
    ),
    _case("locate-points", _displace_points, f"locate run --points far.xyz {_BASE} --repair --json", run="scan"),
    _case("locate-pairs", _write_pairs, f"locate run --pairs pairs.csv {_BASE}", run="plan"),
    _case("explore", f"explore ../blob.stl {_EXPLORE} --ring 2 --batch 1 --max-views 4 --out explored", pages=True),
    _case("explore-batch", f"explore ../blob.stl {_EXPLORE} --policy two-stage --max-views 6 --out explored"),
    _case("why", "why run --samples 5000 --json", "why run --samples 3000 --advise", run="plan"),
    _case("diff", "diff a b --out diff.html --json", inputs={"a": "plan/run", "b": "edit-drop/edited"}),
    _case("export-krl", "export run --name GOLDEN", run="plan"),
    _case("export-line", "export run --name GOLDEN", "export run --format csv --name GOLDEN", run="plan-line"),
    _case("export-table", "export run --format csv --name GOLDEN", run="plan-table"),
    _case("export-json", "export run --format json --name GOLDEN", run="plan"),
    _case("view", "view run --no-open --out page.html", run="scan-noise"),
    _case("check", "check in.toml", scene=_SETUPS),
)  # fmt: skip


@dataclass
class Executed:
    """Result of one run: hashes of its artefacts by path, and seconds."""

    artefacts: dict[str, dict[str, str]]
    seconds: float


def execute(folder: Path, case: Case) -> Executed:
    """Execute a case in `folder/NAME` and hash what it wrote."""
    home = folder / case.name
    home.mkdir()
    for local, source in case.inputs.items():
        shutil.copytree(folder / source, home / local)
    if case.scene:
        (home / "in.toml").write_text(case.scene)
    inputs = {path: path.read_bytes() for path in _files(home)}
    start = perf_counter()
    artefacts: dict[str, dict[str, str]] = {}
    for number, step in enumerate(case.steps, 1):
        if callable(step):
            step(home)
            continue
        with contextlib.nullcontext() if case.pages else no_pictures():
            code, out, errors = _cell(home, shlex.split(step))
        if code == INTERRUPTED and case.name != _STOPPED:  # Ctrl-C ends all runs
            raise KeyboardInterrupt
        (home / f"step {number}.log").write_text(f"cell {step}\n{out}\n{errors}\nexit code {code}\n")
        artefacts[f"step {number}: exit code"] = {"data": str(code)}
        artefacts[f"step {number}: stdout"] = (
            _hashes_of_text(out, folder) if "--json" not in step else _json(out, folder)
        )
        artefacts[f"step {number}: stderr"] = _hashes_of_text(errors, folder)
    seconds = perf_counter() - start
    for path in _files(home):
        if path not in inputs or path.read_bytes() != inputs[path]:
            artefacts[path.relative_to(home).as_posix()] = hashes(path, folder)
    return Executed(artefacts, seconds)


def _files(home: Path) -> list[Path]:
    return [
        path
        for path in sorted(home.rglob("*"))
        if path.is_file()
        and path.suffix not in _IGNORED_SUFFIXES
        and not set(path.relative_to(home).parts) & set(_IGNORED_FOLDERS)
    ]


def _cell(home: Path, words: list[str]) -> tuple[int, str, str]:
    """Execute a command of `cell` in this process; return exit code, stdout and stderr."""
    out, errors = io.StringIO(), io.StringIO()
    environment = {"XDG_CACHE_HOME": str(home / "cache"), "COLUMNS": "120", "NO_COLOR": "1"}
    with (
        mock.patch.dict(os.environ, environment),
        mock.patch.object(sys, "argv", ["cell", *words]),
        contextlib.chdir(home),
        contextlib.redirect_stdout(out),
        contextlib.redirect_stderr(errors),
    ):
        code = report_errors(
            lambda: cell_app(args=words, prog_name="cell", standalone_mode=False), as_json="--json" in words
        )
    gc.collect()
    return code, out.getvalue(), errors.getvalue()


def hashes(path: Path, root: Path) -> dict[str, str]:
    """Return the hashes of an artefact by class."""
    content = path.read_bytes()
    match path.suffix:
        case ".npz":
            return {"data": _hash_of_arrays(path, root)}
        case ".json":
            return _json(content.decode(), root)
        case ".jsonl":
            return _json("[" + ",".join(content.decode().splitlines()) + "]", root)
        case ".html":
            text = content.decode()
            blocks = re.findall(r'<script type="application/json"[^>]*>(.*?)</script>', text, re.DOTALL)
            return {"data": _json("[" + ",".join(blocks) + "]", root)["data"], **_hashes_of_text(text, root)}
        case ".ply":
            header, end, body = content.partition(b"end_header\n")
            code = re.sub(rb"^comment .*\n", b"", header, flags=re.MULTILINE) + end + body
            return {"data": _sha(code), "words": _sha(_neutral(header.decode(), root).encode())}
        case ".md" | ".txt":
            return _hashes_of_text(content.decode(), root)
        case ".src" | ".dat":
            text = content.decode()
            code = re.sub(r"^\s*;.*$|;[^;\n]*$", "", text, flags=re.MULTILINE)
            return {"data": _sha(code.encode()), **_hashes_of_text(text, root)}
        case _:
            return {"data": _sha(content.replace(str(root).encode(), b"ROOT"))}


def _hash_of_arrays(path: Path, root: Path) -> str:
    digest = hashlib.sha256()
    with np.load(path) as arrays:
        for name in sorted(arrays.files):
            array = arrays[name]
            if array.dtype.kind == "U":  # some name a folder
                array = np.array([_neutral(text, root) for text in array.ravel().tolist()], dtype=np.str_)
            digest.update(f"{name} {array.dtype.str} {array.shape}".encode())
            digest.update(np.ascontiguousarray(array).tobytes())
    return digest.hexdigest()[:_DIGITS]


def _json(text: str, root: Path) -> dict[str, str]:
    value = _canonical(json.loads(text), root, words=True)
    data = _canonical(value, root, words=False)
    return {kind: _sha(json.dumps(each, sort_keys=True).encode()) for kind, each in (("data", data), ("words", value))}


def _canonical(value: Any, root: Path, *, words: bool) -> Any:
    """Return JSON without values that differ between executions and, unless `words`, without wording."""
    if isinstance(value, dict):
        return {
            key: _canonical(each, root, words=words)
            for key, each in value.items()
            if key != "versions"
            and not (key == "seconds" and isinstance(each, dict))  # durations of stages; a number is of the motion
            and not (key == "argv" and not words)
        }
    if isinstance(value, list):
        return [_canonical(each, root, words=words) for each in value]
    if not isinstance(value, str):
        return value
    if words:
        return "DIGEST" if _DIGEST.fullmatch(value) else _neutral(value, root)
    return None if " " in value else value


def _hashes_of_text(text: str, root: Path) -> dict[str, str]:
    return {"words": _sha(_neutral(text, root).encode())}


def _neutral(text: str, root: Path) -> str:
    """Replace paths of this machine and clock times."""
    return _TIME.sub("TIME", text.replace(str(root), "ROOT").replace(sys.executable, "PYTHON"))


def _sha(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()[:_DIGITS]


@contextlib.contextmanager
def _quiet() -> Iterator[None]:
    """Leave pictures of this process empty, and the note on compiled kernels out: both are not compared."""
    # Fonts are listed once for all executions, not once for each cache folder.
    fonts = {"MPLCONFIGDIR": matplotlib.get_configdir()}
    with (
        mock.patch("matplotlib.figure.Figure.savefig", lambda _figure, target, *_, **__: Path(target).write_bytes(b"")),
        mock.patch.object(logging.getLogger("planner.compiled"), "disabled", True),
        mock.patch.dict(os.environ, fonts),
    ):
        yield


app = typer.Typer(add_completion=False)


@app.command()
def main(
    only: Annotated[list[str] | None, typer.Option(metavar="NAME[,NAME...]", help="runs to execute")] = None,
    update: Annotated[bool, typer.Option("--update", help="write the reference")] = False,
    keep: Annotated[Path | None, typer.Option(help="new folder for the runs, kept for inspection")] = None,
) -> None:
    """Execute the golden runs and compare their artefacts with the reference; exit with code 1 if data changed."""
    names = [case.name for case in CASES]
    selection = {name for each in only or names for name in each.split(",")}
    if unknown := sorted(selection - set(names)):
        raise typer.BadParameter(f"no run named {', '.join(unknown)}; there are {', '.join(names)}")
    needed = _with_inputs(selection)
    reference = json.loads(REFERENCE.read_text()) if REFERENCE.exists() else {}
    progress = Console(stderr=True)
    console = Console() if sys.stdout.isatty() else Console(width=160)
    table = Table("run", "seconds", "equal", "words changed", "data changed", "missing", "new")
    changes: list[str] = []
    results: dict[str, dict[str, dict[str, str]]] = {}
    with tempfile.TemporaryDirectory() as scratch, _quiet():
        folder = (keep or Path(scratch)).resolve()
        folder.mkdir(parents=True, exist_ok=True)
        _write_parts(folder)
        for case in CASES:
            if case.name not in needed:
                continue
            execution = execute(folder, case)
            if case.name in selection:
                results[case.name] = execution.artefacts
                found = compare(reference.get(case.name, {}), execution.artefacts)
                table.add_row(case.name, f"{execution.seconds:.1f}", *(str(len(found[kind])) for kind in found))
                changes += [f"{case.name}: {kind}: {name}" for kind in found if kind != "equal" for name in found[kind]]
                progress.print(f"{case.name} {execution.seconds:.1f} s", highlight=False)
    console.print(table)
    if update:
        entries = {name: each for name, each in (reference | results).items() if name in names}
        REFERENCE.write_text(_as_json(entries), encoding="utf-8")
        return
    for change in changes:
        console.print(change, markup=False, highlight=False, soft_wrap=True)
    if any(": words changed: " not in change for change in changes):
        raise typer.Exit(1)


def _as_json(runs: dict[str, dict[str, dict[str, str]]]) -> str:
    """Return the reference as JSON with a line for each artefact, so that changes of it can be read."""
    texts = []
    for run, artefacts in sorted(runs.items()):
        lines = ",\n".join(f"  {json.dumps(name)}: {json.dumps(each)}" for name, each in sorted(artefacts.items()))
        texts.append(f" {json.dumps(run)}: {{\n{lines}\n }}")
    return "{\n" + ",\n".join(texts) + "\n}\n"


def compare(reference: dict[str, dict[str, str]], executed: dict[str, dict[str, str]]) -> dict[str, list[str]]:
    """Return the names of the artefacts by outcome."""
    found: dict[str, list[str]] = {kind: [] for kind in ("equal", "words changed", "DATA CHANGED", "missing", "new")}
    for name in sorted(reference.keys() | executed.keys()):
        before, now = reference.get(name), executed.get(name)
        if before is None or now is None:
            kind = "new" if before is None else "missing"
        elif before.get("data") != now.get("data"):
            kind = "DATA CHANGED"
        else:
            kind = "equal" if before == now else "words changed"
        found[kind].append(name)
    return found


def _with_inputs(names: set[str]) -> set[str]:
    """Return the names and those of all runs whose results they need."""
    needed = set(names)
    for case in reversed(CASES):  # a run only needs earlier ones
        if case.name in needed:
            needed |= {source.split("/")[0] for source in case.inputs.values()}
    return needed


def _write_parts(folder: Path) -> None:
    """Write a bumpy ball of about 110 mm with a dent, and a block of 60 x 60 x 40 mm."""
    mesh = trimesh.creation.icosphere(subdivisions=3, radius=1.0)
    x, y, z = mesh.vertices.T
    radius = 50 + 6 * np.sin(3 * x + 1) * np.cos(2 * y) + 4 * np.sin(4 * z) - 14 * np.exp(-8 * ((x - 1) ** 2 + y**2))
    mesh.vertices = mesh.vertices * radius[:, None] + np.array([20.0, -10.0, 35.0])
    mesh.export(folder / "blob.stl")
    trimesh.creation.box((60.0, 60.0, 40.0)).export(folder / "block.stl")


if __name__ == "__main__":
    app()
