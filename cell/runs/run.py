"""Read run folders and executions back into values.

`open_run` reads the manifest of a run folder. Every other artefact is read when it is first used, and its bytes are
compared with the sha256 in the manifest. Each fault is reported in one sentence: a missing artefact (with the stage in
which the run ended), a foreign folder, an unknown schema, damaged or changed content. The folder of a failed run
(`.part`) can be opened too; it holds the results of the finished stages.

Lengths are in metres and angles in radians. docs/internals/run_folder.md describes the files.
"""

from __future__ import annotations

import hashlib
import io
import lzma
import math
import struct
import sys
import tokenize
import warnings
import zipfile
import zlib
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import JsonValue

from cell.errors import FileError
from cell.files import file_errors
from cell.formatting import Summary, percent
from cell.runs import ply
from cell.runs.folder import SCHEMA
from cell.runs.former_keys import FORMER_SCHEMAS, with_present_arrays
from cell.runs.schema import (
    Coverage,
    ExecutedCoverage,
    ExecutedDeviation,
    ExecutionReport,
    Manifest,
    PlanFile,
    Report,
    ResolvedScene,
    parsed,
)
from planner.errors import PlannerError
from planner.geometry.mesh import TriangleMesh
from planner.geometry.sampling import SurfaceSamples
from planner.kinematics.reach import Reach
from planner.measurability.matrix import Measurability
from planner.ports import ARM_AXES, JointLimits, Rejection, axis_name
from planner.timing.motion import Motion
from planner.values import Floats, Ints, Value, freeze, readonly
from planner.viewpoints.viewpoints import Viewpoints

if TYPE_CHECKING:
    import mujoco
    import trimesh

EXECUTIONS = "executions"
"""Subfolder of a run folder that holds one folder for each execution."""

_SMALL, _MAX_EXPANSION = 64 << 20, 50
"""Limits on the uncompressed size of an .npz: in bytes, or as a multiple of its size. Runs reach a multiple of ten."""

SIMULATED = "simulated"
"""Source of points of the virtual scanner; scans of earlier versions do not name it."""

_EXTERNAL: Mapping[str, str] = {
    "via_q": "via_e",
    "q": "e",
    "qd": "ed",
    "qdd": "edd",
    "q_commanded": "e_commanded",
    "q_reported": "e_reported",
}
"""Name of the array of external axes for each array of arm axes."""


@dataclass(frozen=True, eq=False, repr=False)  # no slots: cached properties need a __dict__
class ArtefactFolder(Summary):
    """A folder with a manifest and the artefacts listed in it.

    Attributes:
        folder: its path (with `.part` at the end for a run that did not finish).
        manifest: its manifest.json.
    """

    folder: Path
    manifest: Manifest

    @property
    def is_finished(self) -> bool:
        """Whether every stage was finished."""
        return self.manifest.status == "finished"

    @property
    def ending(self) -> str:
        """The end of the run as part of a sentence: "failed in the stage 'reach': no candidate is reachable"."""
        status, stage = self.manifest.status or "unknown", self.manifest.stage or "unknown"
        if self.is_finished:
            return "finished"
        if status == "running":
            return f"is still running, or was killed, in the stage '{stage}'"
        reason = self.manifest.reason.split(";")[0]
        return f"{status} in the stage '{stage}'" + (f": {reason}" if reason else "")

    @property
    def digest(self) -> str:
        """Digest of the driving artefacts from the manifest; "" if it has none."""
        return self.manifest.digest or ""

    def has(self, name: str) -> bool:
        """Return whether an artefact exists."""
        return (self.folder / name).is_file()

    def artefact(self, name: str) -> bytes:
        """Return the bytes of an artefact after comparing them with the sha256 in the manifest."""
        path = self.folder / name
        if not path.is_file():
            if self.is_finished:
                raise FileError(f"{path} is missing, although the run finished; the folder is damaged, plan again")
            raise FileError(f"{self.folder} has no {name}: the run {self.ending}; plan again")
        content = file_bytes(path)
        expected = self.manifest.artefacts.get(name)
        if expected is not None and hashlib.sha256(content).hexdigest() != expected:
            raise FileError(
                f"{path} is not the file that the run wrote (its sha256 differs from the manifest's): it was changed "
                "or damaged; a run folder is never edited, plan again"
            )
        return content

    def arrays(self, name: str) -> dict[str, NDArray[Any]]:
        """Return the arrays of an .npz artefact."""
        stored = npz_arrays(self.folder / name, self.artefact(name))
        return with_present_arrays(stored) if self.manifest.schema_version in FORMER_SCHEMAS else stored


@dataclass(frozen=True, slots=True, eq=False)
class View(Value):
    """A view of a plan.

    Attributes:
        number: from 1 in visiting order, as options name it.
        candidate: row of viewpoints.npz.
        T_object_scanner: (4, 4) scanner in the object frame, the axes of the part's file [m]; middle pose of a sweep.
        T_base_scanner: (4, 4) the same pose in the robot's base frame [m].
        q: (axes,) joint set-points [rad], KUKA signs; the angle of a rotary table is the last axis.
        marginal_coverage: share of the surface that the view measures and the views before do not.
    """

    number: int
    candidate: int
    T_object_scanner: Annotated[Floats, "4 4"]
    T_base_scanner: Annotated[Floats, "4 4"]
    q: Annotated[Floats, "axes"]
    marginal_coverage: float

    def __repr__(self) -> str:
        return f"View({self.number}, candidate {self.candidate}, marginal coverage {percent(self.marginal_coverage)})"


@dataclass(frozen=True, eq=False, repr=False)
class Run(ArtefactFolder):
    """A run folder of `cell plan`, read when used: views in visiting order, arrays in metres and radians."""

    def facts(self) -> list[tuple[str, str]]:
        """Return folder, number of views, coverage, bound and duration; of a run without a report its status."""
        try:
            report = self.report
        except FileError:
            return [("folder", str(self.folder)), ("status", "damaged" if self.is_finished else self.ending)]
        return [
            ("folder", str(self.folder)),
            ("views", str(report.n_views)),
            ("coverage", percent(report.coverage.visible)),
            ("lower bound", f"{report.lower_bound} views"),
            ("motion", f"{report.motion.duration_s:.1f} s"),
        ]

    @property
    def picture(self) -> Path:
        """Picture of the cell, the arm at a view; the file may be missing."""
        return self.folder / "cell.png"

    @property
    def seed(self) -> int:
        """Seed of every random choice."""
        return self.manifest.require_seed(self.folder)

    @property
    def plan_sha256(self) -> str:
        """sha256 of plan.json; "" if there is none."""
        return self.manifest.artefacts.get("plan.json", "")

    @property
    def exit_code(self) -> int:
        """Exit code of the plan: 0, or 3 if it does not reach a requested coverage."""
        return self.manifest.exit_code or 0

    @property
    def is_setup_of_group(self) -> bool:
        """Whether the run is one of several set-ups with a common cover, or an edited copy of one."""
        setups = self.folder.absolute().parent.parent / "setups.json"
        return bool(self.report.common_cover) or setups.is_file()  # older reports do not have the key

    @property
    def is_single_setup(self) -> bool:
        """Whether the coverage target applies to this run alone."""
        return self.report.is_single_setup and not self.is_setup_of_group

    @property
    def is_repairable(self) -> bool:
        """Whether the run has a coverage target of its own, which a repair can restore."""
        return self.report.is_repairable and not self.is_setup_of_group

    @cached_property
    def plan(self) -> PlanFile:
        """The views of the plan and the facts about their selection."""
        return parsed(PlanFile, self.artefact("plan.json"), self.folder / "plan.json")

    @cached_property
    def report(self) -> Report:
        """The content of the report page and of `cell plan --json`."""
        return parsed(Report, self.artefact("report.json"), self.folder / "report.json")

    @cached_property
    def scene(self) -> ResolvedScene:
        """The settings of the plan and all objects of the cell."""
        return parsed(ResolvedScene, self.artefact("scene.resolved.json"), self.folder / "scene.resolved.json")

    @cached_property
    def motion(self) -> Motion:
        """The timed motion from home to home."""
        return motion_from_arrays(self.arrays("motion.npz"), self.folder / "motion.npz")

    @cached_property
    def min_clearance(self) -> tuple[float, str]:
        """Smallest measured clearance of the motion [m] and its pair of objects; (NaN, "") if none was measured."""
        stored = self.arrays("motion.npz")
        with reading(self.folder / "motion.npz"):
            clearance = np.asarray(stored["minimum_clearance"], dtype=np.float64)
            if not np.isfinite(clearance).any():
                return float("nan"), ""
            segment = int(np.nanargmin(clearance))
            return float(clearance[segment]), str(stored["between"][segment])

    @cached_property
    def proven_clearance(self) -> float:
        """Smallest proven lower bound on the clearance of the motion [m]; inf if none was measured."""
        with reading(self.folder / "motion.npz"):
            proven = np.asarray(self.arrays("motion.npz")["clearance_lower_bound"], dtype=np.float64)
            return float(np.min(proven[np.isfinite(proven)], initial=np.inf))

    @cached_property
    def candidates(self) -> Viewpoints:
        """The candidate viewpoints."""
        stored = self.arrays("viewpoints.npz")
        with reading(self.folder / "viewpoints.npz"):
            return Viewpoints(*(stored[name] for name in ("T_object_scanner", "face", "standoff", "roll")))

    @cached_property
    def reach(self) -> Reach:
        """Verdicts and configurations of the candidates."""
        stored = self.arrays("reach.npz")
        with reading(self.folder / "reach.npz"):
            return Reach(
                stored["verdict"], concat_axes(stored, "q"), stored["offsets"], tuple(stored["blocker"].tolist())
            )

    @cached_property
    def measurability(self) -> Measurability:
        """The measurability matrix with occluders applied, and its samples."""
        stored = self.arrays("measurability.npz")
        with reading(self.folder / "measurability.npz"):
            names = ["points", "normals", "areas", "face", "planning_face", *(["region"] if "region" in stored else [])]
            samples = SurfaceSamples(*(stored[name] for name in names))
            return Measurability(
                stored["indptr"], stored["indices"], samples, int(stored["shape"][1]), stored.get("sigma")
            )

    @cached_property
    def part(self) -> trimesh.Trimesh:
        """The part in the axes of its file [m]."""
        return ply.to_trimesh(self.reference)

    @cached_property
    def reference(self) -> TriangleMesh:
        """The part in the axes of its file [m]."""
        return self.mesh("reference.ply")

    @cached_property
    def planning_mesh(self) -> TriangleMesh:
        """The decimated part in the axes of its file [m]."""
        return self.mesh("planning.ply")

    def mesh(self, name: str) -> TriangleMesh:
        """Return a mesh artefact in the object frame [m].

        Vertices and faces keep their numbers. The file is in millimetres, so a coordinate may differ from the planned
        one by the last bit of a double.
        """
        with reading(self.folder / name):
            return ply.mesh(self.artefact(name))

    def cell_spec(self) -> mujoco.MjSpec:
        """Return `cell.xml`, the checked model, as a specification that can be changed before compilation."""
        import mujoco

        text = self.artefact("cell.xml").decode("utf-8", errors="replace")
        with self.compiling():
            return mujoco.MjSpec.from_string(text)

    def cell_model(self) -> mujoco.MjModel:
        """Return `cell.xml`, compiled once; it must not be changed."""
        return self._cell_model

    @cached_property
    def _cell_model(self) -> mujoco.MjModel:
        with self.compiling():
            return self.cell_spec().compile()

    def joint_names(self) -> list[str]:
        """Return the names of the axes of the arm and of a rotary table."""
        return [axis_name(axis) for axis in range(self.motion.q.shape[1])]

    @contextmanager
    def compiling(self) -> Iterator[None]:
        """Turn MuJoCo's errors inside the block into an error about `cell.xml`."""
        try:
            yield
        except ValueError as error:
            raise FileError(f"{self.folder / 'cell.xml'} is damaged: MuJoCo cannot compile it; plan again") from error

    @property
    def coverage(self) -> Coverage:
        """The coverage of the views; `visible` and `coverable` are fractions of the surface."""
        return self.plan.coverage

    @property
    def bound(self) -> int:
        """Lower bound on the number of views, over these candidates and samples."""
        return self.plan.lower_bound

    @cached_property
    def candidate(self) -> Ints:
        """(n,) candidate of each view, row of viewpoints.npz."""
        return readonly("id", [view.id for view in self.plan.views], (None,), np.int64)

    @cached_property
    def views(self) -> tuple[View, ...]:
        """The views in visiting order."""
        gains = [view.marginal_coverage for view in self.report.views]
        rows = zip(self.candidate.tolist(), self.T_object_scanner, self.T_base_scanner, self.q, gains, strict=True)
        return tuple(View(number, *row) for number, row in enumerate(rows, start=1))

    @cached_property
    def q(self) -> Floats:
        """(n, axes) joint set-points of the views [rad], KUKA signs; the angle of a rotary table is the last axis."""
        return readonly("q", [view.q for view in self.plan.views], (None, None))

    @cached_property
    def T_base_scanner(self) -> Floats:
        """(n, 4, 4) scanner poses in base [m]; for a sweep the middle pose."""
        return readonly("T_base_scanner", [view.T_base_scanner for view in self.plan.views], (None, 4, 4))

    @cached_property
    def T_object_scanner(self) -> Floats:
        """(n, 4, 4) scanner poses in the object frame [m]; for a sweep the middle pose."""
        return readonly("T_object_scanner", [view.T_object_scanner for view in self.plan.views], (None, 4, 4))

    @cached_property
    def T_base_object(self) -> Floats:
        """(4, 4) pose of the part's file in base [m]."""
        return readonly("T_base_object", self.scene.T_base_object, (4, 4))

    def as_json(self) -> dict[str, JsonValue]:
        """Return the object that `cell plan --json` prints: report.json, the run folder, digest and exit code."""
        header: dict[str, JsonValue] = {
            "schema": SCHEMA,
            "exit_code": self.exit_code,
            "run_folder": str(self.folder),
            "digest": self.digest,
        }
        return header | self.report.as_json()

    @property
    def execution_ids(self) -> list[str]:
        """Names of the executions of the run, ordered by number. Folders whose name is not a number do not count."""
        root = self.folder / EXECUTIONS
        if not root.is_dir():
            return []
        return sorted((path.name for path in root.iterdir() if path.is_dir() and path.name.isdecimal()), key=int)

    def execution_manifest(self, execution: str) -> Manifest:
        """Return the manifest of an execution, without its scans; an empty one if it is missing or damaged."""
        try:
            return read_manifest(self.folder / EXECUTIONS / execution / "manifest.json")
        except FileError:
            return Manifest()


@dataclass(frozen=True, eq=False, repr=False)
class Execution(ArtefactFolder):
    """A reported execution of a run. Object frame, metres unless a name says otherwise.

    Attributes:
        report: its report.json.
    """

    report: ExecutionReport

    @classmethod
    def open(cls, folder: Path) -> Self:
        """Open the folder of an execution."""
        files = ArtefactFolder(folder, read_manifest(folder / "manifest.json"))
        report = parsed(ExecutionReport, files.artefact("report.json"), folder / "report.json")
        return cls(folder, files.manifest, report)

    def facts(self) -> list[tuple[str, str]]:
        """Return folder, number of scanned views, coverage and deviation."""
        rows = [
            ("folder", str(self.folder)),
            ("views", str(self.report.n_views)),
            ("coverage", percent(self.coverage.visible)),
        ]
        return [*rows, *([("deviation", f"{self.deviation.rms_mm:.3f} mm rms")] if self.deviation else [])]

    @property
    def picture(self) -> Path:
        """Picture of the measured surface, or of the views without one; the file may be missing."""
        return self.folder / ("deviation.png" if self.has("deviation.png") else "views.png")

    @property
    def exit_code(self) -> int:
        """Exit code: 0, or 3 if a complete execution does not reach the coverage that the plan requires."""
        return self.manifest.exit_code or 0

    @property
    def coverage(self) -> ExecutedCoverage:
        """The measured coverage."""
        return self.report.coverage

    @property
    def deviation(self) -> ExecutedDeviation | None:
        """Deviation of the measured surface from the part; None if there is no surface."""
        return self.report.deviation

    @cached_property
    def mesh(self) -> trimesh.Trimesh | None:
        """The surface reconstructed from the points [m], object frame; None if there is none."""
        return None if self.surface is None else ply.to_trimesh(self.surface)

    @cached_property
    def surface(self) -> TriangleMesh | None:
        """The same surface as a value of the planner."""
        if not self.has("mesh.ply"):
            return None
        with reading(self.folder / "mesh.ply"):
            return ply.mesh(self.artefact("mesh.ply"))

    @cached_property
    def is_closed_hole(self) -> NDArray[np.bool_]:
        """(F,) faces of the surface that close holes and were not measured; empty without a surface."""
        if not self.has("mesh.ply"):
            return np.zeros(0, dtype=np.bool_)
        with reading(self.folder / "mesh.ply"):
            return ply.elements(self.artefact("mesh.ply"))["face"]["closed"] > 0

    @cached_property
    def points(self) -> Floats:
        """(N, 3) points of the merged cloud [m], object frame."""
        with reading(self.folder / "cloud.ply"):
            positions = ply.positions(ply.elements(self.artefact("cloud.ply"))["vertex"])
            return readonly("points", positions, (None, 3))


@dataclass(frozen=True, slots=True, eq=False)
class ExecutedScan(Value):
    """One readable scan of an execution.

    Attributes:
        stop: number of the view, from 1 in visiting order.
        view: its candidate, row of viewpoints.npz.
        q_commanded: (axes,) set-points sent [rad], KUKA signs.
        q_reported: (axes,) joint angles that the controller reported at the view [rad].
        T_reported: (4, 4) T_object_scanner from the controller's report [m].
        T_reported_poses: (K, 4, 4) all poses of a sweep [m]; `T_reported` is the middle one. K is 1 for a view at rest.
        T_true: (4, 4) origin of the traced rays [m]; None if the points are not simulated.
        T_true_poses: (K, 4, 4) the same for all poses [m].
        points: (P, 3) measured points [m], object frame.
        counts: number of rays by `Rejection`; None if the points are not simulated.
        source: source of the points.
        frame: frame in which the points were delivered.
        name: file name below `scans/`.
        stored: every array of the file by name.
    """

    stop: int
    view: int
    q_commanded: Annotated[Floats, "axes"]
    q_reported: Annotated[Floats, "axes"]
    T_reported: Annotated[Floats, "4 4"]
    T_reported_poses: Annotated[Floats, "K 4 4"]
    T_true: Annotated[Floats, "4 4"] | None
    T_true_poses: Annotated[Floats, "K 4 4"] | None
    points: Annotated[Floats, "P 3"]
    counts: tuple[int, ...] | None
    source: str
    frame: str
    name: str = ""
    stored: Mapping[str, NDArray[Any]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        freeze(self)
        for name in ("q_commanded", "q_reported", "points"):
            if not np.isfinite(getattr(self, name)).all():
                raise PlannerError(f"{name} contains infinity; every value must be finite")
        if self.counts is None:
            return
        if not 0 < len(self.counts) <= len(Rejection):  # reasons are appended: an older scan has fewer
            raise ValueError(f"it has {len(self.counts)} counts of rays; there must be 1 to {len(Rejection)}")
        object.__setattr__(self, "counts", (*self.counts, *[0] * (len(Rejection) - len(self.counts))))

    @property
    def poses(self) -> Floats:
        """(K, 4, 4) true poses [m]; the reported ones if the points are not simulated."""
        return self.T_reported_poses if self.T_true_poses is None else self.T_true_poses


@dataclass(frozen=True, slots=True, eq=False)
class RecordedExecution:
    """The files of an execution, finished or stopped.

    Each scan is written before the next move, so a stopped execution can be read up to its last complete scan.

    Attributes:
        folder: executions/<id>.
        manifest: its manifest.json; empty if it is missing or damaged.
        scans: the readable scans, in the order in which they were taken.
        motion: the motion that the execution recorded itself; None if it recorded none.
        unreadable: one sentence for each file that cannot be read.
    """

    folder: Path
    manifest: Manifest
    scans: tuple[ExecutedScan, ...]
    motion: Motion | None
    unreadable: tuple[str, ...]


def open_run(folder: Path) -> Run:
    """Open a run folder by its manifest, finished or not."""
    if not folder.is_dir():
        raise FileError(_missing_folder(folder))
    path = folder / "manifest.json"
    if not path.is_file():
        raise FileError(f"{folder} is not a run folder: it has no manifest.json; give the folder that cell plan made")
    if (folder / "setups.json").is_file():
        runs = ", ".join(str(path) for path in sorted((folder / "setups").glob("*"))) or "none is there"
        raise FileError(f"{folder} holds several set-ups; give the run folder of one of them: {runs}")
    manifest = read_manifest(path)
    schema = manifest.schema_version
    if schema not in (SCHEMA, *FORMER_SCHEMAS):
        if schema is not None and schema.startswith("scan-cell/run/"):
            raise FileError(
                f"{folder} has the schema {schema}, and this version of scan-cell reads "
                f"{', '.join(FORMER_SCHEMAS)} and {SCHEMA}; plan again, or use the version that its "
                f"manifest.json names"
            )
        raise FileError(
            f"{folder} is not a run folder: its manifest.json does not have the schema {SCHEMA}; give the folder "
            "that cell plan made"
        )
    return Run(folder, manifest)


def execution_of(folder: Path) -> tuple[Path, str] | None:
    """Return the run folder and the id of an execution's folder; None for another folder."""
    path = folder if folder.parent.name else folder.absolute()
    return (path.parent.parent, path.name) if path.parent.name == EXECUTIONS else None


def open_finished(folder: Path) -> Run:
    """Open the run folder of a finished plan."""
    run = open_run(folder)
    if not run.is_finished:
        raise FileError(f"{folder} has no finished plan: the run {run.ending}; plan again")
    return run


def read_execution(run: Run, execution: str) -> RecordedExecution:
    """Read an execution of a run by its id or by "latest"."""
    ids = run.execution_ids
    if not ids:
        raise FileError(f"{run.folder} has no execution yet; make one with cell scan {run.folder}")
    if execution == "latest":
        execution = ids[-1]
    if execution not in ids:
        raise FileError(f"{run.folder} has no execution {execution}; it has {', '.join(ids)}")
    folder = run.folder / EXECUTIONS / execution
    manifest = Manifest()
    scans: list[ExecutedScan] = []
    unreadable: list[str] = []
    if (folder / "manifest.json").is_file():
        try:
            manifest = read_manifest(folder / "manifest.json")
        except FileError as error:
            unreadable.append(f"{error}; the report is made without it")
    for path in sorted((folder / "scans").glob("*.npz")):
        try:
            scans.append(read_scan(path))
        except FileError as error:
            unreadable.append(str(error))
    recorded, path = None, folder / "motion.npz"
    if path.is_file():
        try:
            recorded = motion_from_arrays(npz_arrays(path, file_bytes(path)), path)
        except FileError as error:
            unreadable.append(str(error))
    return RecordedExecution(folder, manifest, tuple(scans), recorded, tuple(unreadable))


def read_scan(path: Path) -> ExecutedScan:
    """Read one scan of an execution."""
    stored = with_present_arrays(npz_arrays(path, file_bytes(path)))  # a scan does not state its schema
    with reading(path):
        T, source = stored["T_object_scanner"], str(stored.get("source", SIMULATED))
        T_true = stored["T_object_scanner_true"] if source == SIMULATED else None
        return ExecutedScan(
            stop=int(stored["number"]),
            view=int(stored["view"]),
            q_commanded=concat_axes(stored, "q_commanded"),
            q_reported=concat_axes(stored, "q_reported"),
            T_reported=T,
            T_reported_poses=stored.get("sweep_T_object_scanner", T[None]),
            T_true=T_true,
            T_true_poses=None if T_true is None else stored.get("sweep_T_object_scanner_true", T_true[None]),
            points=stored["points"],
            counts=None if T_true is None else tuple(int(count) for count in stored["counts"]),
            source=source,
            frame=str(stored.get("frame", "object")),
            name=path.name,
            stored=stored,
        )


def motion_from_arrays(stored: Mapping[str, NDArray[Any]], path: Path) -> Motion:
    """Return a motion from the arrays of a motion.npz; `path` is for the error messages."""
    with reading(path):
        names = ("lower", "upper", "velocity", "acceleration")
        # Motions of earlier versions were timed without a jerk limit.
        jerk = stored.get("limit_jerk", np.full_like(stored["limit_lower"], np.inf))
        limits = JointLimits(**{name: stored[f"limit_{name}"] for name in names}, jerk=jerk)
        stored = {**stored, **{name: concat_axes(stored, name) for name in ("via_q", "q", "qd", "qdd")}}
        fields = ["via_q", "segment", "view", "via_t", "t", "q", "qd", "qdd", "segment_of_sample"]
        fields += [name for name in ("pose", "line") if name in stored]  # motions of earlier versions do not sweep
        return Motion(**{name: stored[name] for name in fields}, duration=float(stored["via_t"][-1]), limits=limits)


def split_axes(**arrays: Floats) -> dict[str, Floats]:
    """Return arrays (..., axes) as they are stored: the arm's six axes, and external axes in a second array.

    `via_q` (N, 6) and `via_e` (N, n) are one `q` (N, 6 + n) in code. A plan without external axes has no second array.
    """
    parts = {}
    for name, values in arrays.items():
        parts[name] = values[..., :ARM_AXES]
        if values.shape[-1] > ARM_AXES:
            parts[_EXTERNAL[name]] = values[..., ARM_AXES:]
    return parts


def concat_axes(stored: Mapping[str, NDArray[Any]], name: str) -> Floats:
    """Return the (..., axes) array whose arm axes are stored under `name` (see `split_axes`)."""
    external = stored.get(_EXTERNAL[name])
    return stored[name] if external is None else np.concatenate([stored[name], external], axis=-1)


def npz_arrays(path: Path, content: bytes) -> dict[str, NDArray[Any]]:
    """Return the arrays of an .npz; nothing is unpickled. `path` is for the error message."""
    try:
        with warnings.catch_warnings(action="ignore"):  # numpy parses a header as Python, which may warn
            _require_size(content)
            with np.load(io.BytesIO(content), allow_pickle=False) as stored:
                arrays = {name: stored[name] for name in stored.files}
        for array in arrays.values():  # an invalid character would raise where it is first used
            code_points = array.astype(array.dtype.newbyteorder("=")).tobytes() if array.dtype.kind == "U" else b""
            if (np.frombuffer(code_points, dtype=np.uint32) > sys.maxunicode).any():
                raise ValueError("holds an invalid character")
        return arrays
    except (
        ValueError, OSError, EOFError, TypeError, NotImplementedError, OverflowError, RuntimeError, SyntaxError,
        KeyError, struct.error, tokenize.TokenError, zipfile.BadZipFile, zlib.error, lzma.LZMAError,
    ) as error:  # fmt: skip
        raise FileError(f"{path} is damaged or cut short and cannot be read; plan or scan again") from error


def _require_size(content: bytes) -> None:
    """Check the announced sizes of an .npz before anything is allocated: a few bytes may announce gigabytes."""
    with zipfile.ZipFile(io.BytesIO(content)) as members:
        entries = members.infolist()
        if sum(member.file_size for member in entries) > max(_SMALL, _MAX_EXPANSION * len(content)):
            raise ValueError("is larger, uncompressed, than a run folder's files")
        for member in entries:
            with members.open(member) as file:
                version = np.lib.format.read_magic(file)
                header = (
                    np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
                )
                shape, _, dtype = header(file)
                if math.prod(shape) * dtype.itemsize != member.file_size - file.tell():
                    raise ValueError("holds an array of another length than its header states")


def read_manifest(path: Path) -> Manifest:
    """Read a manifest.json; any entry may be missing."""
    return parsed(Manifest, file_bytes(path), path)


def file_bytes(path: Path) -> bytes:
    """Return the content of a file."""
    with file_errors(f"{path} cannot be read", "check its permissions"):
        return path.read_bytes()


@contextmanager
def reading(path: Path) -> Iterator[None]:
    """Turn the errors that wrong content raises inside the block into an error about the file."""
    try:
        yield
    except KeyError as error:
        raise FileError(f"{path} is damaged: it has no {str(error.args[0])[:80]}; plan or scan again") from error
    except PlannerError as error:
        raise FileError(f"{path} is damaged: {error}; plan or scan again") from error
    except (ValueError, TypeError, IndexError, AttributeError, OverflowError, ArithmeticError) as error:
        # a library's message does not help the user
        raise FileError(f"{path} is damaged: its content is not valid; plan or scan again") from error


def _missing_folder(folder: Path) -> str:
    if folder.exists():
        return f"{folder} is a file; give the run folder that cell plan made"
    unfinished = folder.with_name(folder.name + ".part")
    if unfinished.is_dir():
        return f"{folder} does not exist, but {unfinished} does: a run that did not finish; give that name to see it"
    parent = folder.parent
    runs = sorted(path.parent.name for path in parent.glob("*/manifest.json")) if parent.is_dir() else []
    hint = f"; run folders next to it: {', '.join(runs[-3:])}" if runs else ""
    return f"the run folder {folder} does not exist; give the folder that cell plan made{hint}"
