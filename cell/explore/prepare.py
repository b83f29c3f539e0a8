"""What an exploration begins with: the part that stands there, the cylinder about it, the scanner, the voxels."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import trimesh
from scipy.spatial import cKDTree

from cell import scanners
from cell.errors import SceneError, UsageError
from cell.explore.hidden import Cylinder, Hidden, cylinder_about
from cell.explore.options import SPACINGS, VOXELS, ExploreOptions
from cell.explore.state import Paths, digest_of
from cell.part import workpiece
from cell.part.workpiece import Workpiece
from cell.runs.folder import SCHEMA
from cell.runs.schema import ExploredCylinder, ExploreFile
from cell.scan.options import RESUME_OPTIONS, ScanOptions
from cell.scene.model import Scene
from cell.scene.settle import Settings, settle
from cell.session import Session
from planner.errors import PlannerError
from planner.explore.space import VoxelSpace
from planner.ports import Scanner
from planner.values import Bools, Floats

_JOINED = 4.0
"""Distance of points of neighbouring rays, in those of a surface that the laser meets squarely, up to which they are on
one surface: that of one which it meets at 75 degrees. On a steeper one what lies between them stays open."""


_OF_WAITING = ("acquire_wait_s", "acquire_timeout_s")
"""Options of an execution that change no point."""

_RAYS, _ENOUGH = 8, 100
"""Rays beside a known point that are asked how far they came, of 12 on a surface; and points whose share counts."""


@dataclass(frozen=True, slots=True, eq=False)
class Eye:
    """Where a scanner looks, scanner frame.

    Attributes:
        source: (3,) [m].
        sensor: (3,) [m].
        rays: (R, 3) unit vectors, those of a scan, row by row.
        columns: rays of each row.
        near: distance from the source to where it begins to measure [m].
        far: to where it ends [m].
        apart: angle between neighbouring rays [rad].
    """

    source: Floats
    sensor: Floats
    rays: Floats
    columns: int
    near: float
    far: float
    apart: float

    @classmethod
    def of(cls, scanner: Scanner, scene: Scene) -> "Eye":
        """Of a scanner and the scene that it is settled in."""
        assert scene.scanner.range_mm is not None
        near, far = (limit / 1000 for limit in scene.scanner.range_mm)
        rays = np.asarray(scanner.ray_directions())
        apart = float(np.arccos(np.clip(rays[0] @ rays[1], -1.0, 1.0)))
        columns = scanner.grid_shape[1]
        return cls(np.asarray(scanner.source), np.asarray(scanner.sensor), rays, columns, near, far, apart)

    def blank(self, points: Floats, T: Floats) -> Floats:
        """(M, 3) directions of the rays beside which no point came back, in the frame of points (N, 3) [m].

        Args:
            points: of one scan.
            T: (4, 4) pose of the scanner in that frame [m].
        """
        rays = self.rays @ T[:3, :3].T
        return np.asarray(rays[~self._beside(rays, self.towards(points, T))])

    def answered(self, targets: Floats, points: Floats, T: Floats) -> Bools:
        """(M,) whether a point (N, 3) [m] came back beside the ray to each target (M, 3) [m]; `T` as in `blank`."""
        return self._beside(self.towards(targets, T), self.towards(points, T))

    def passed(self, known: Floats, points: Floats, T: Floats, margin: float) -> float:
        """Share of known points past which a view looked: all rays beside them came back from farther off.

        What moved away has such points. Those beside which rays are missing say nothing: at an outline, or where the
        surface is met too steeply, rays pass that belong to what lies behind. Nor do those nearer than the range.

        Args:
            known: (K, 3) points of earlier views [m].
            points: (N, 3) of one scan [m].
            T: (4, 4) pose of the scanner in their frame [m].
            margin: how much farther [m].
        """
        if not len(known) or not len(points):
            return 0.0
        source = self.source_at(T)
        near, far = (np.linalg.norm(each - source, axis=1) for each in (known, points))
        tree = cKDTree(self.towards(points, T))
        apart, at = map(np.asarray, tree.query(self.towards(known, T), k=_RAYS, distance_upper_bound=2 * self.apart))
        looked = np.isfinite(apart).all(axis=1) & (near >= self.near)
        past = far[at[looked]].min(axis=1, initial=np.inf) > near[looked] + margin
        return float(past.mean()) if len(past) >= _ENOUGH else 0.0

    def between(self, points: Floats, T: Floats, gap: float) -> Floats:
        """(M, 3) places between points of neighbouring rays that are on one surface, at most a gap apart [m].

        Args:
            points: (N, 3) of one scan [m]; of several next to a ray the first counts.
            T: (4, 4) pose of the scanner in their frame [m].
            gap: distance [m].
        """
        point_of = np.full(len(self.rays), -1)
        of = np.asarray(cKDTree(self.rays).query(self.towards(points, T) @ T[:3, :3])[1])
        point_of[of[::-1]] = np.arange(len(points))[::-1]
        number = np.arange(len(self.rays)).reshape(-1, self.columns)
        one, other = (
            np.concatenate([rays.ravel() for rays in pair])
            for pair in ((number[:-1], number[:, :-1]), (number[1:], number[:, 1:]))
        )
        known = (point_of[one] >= 0) & (point_of[other] >= 0)
        one, other = one[known], other[known]
        begin, end, squarely = points[point_of[one]], points[point_of[other]], self.rays[one] - self.rays[other]
        length, away = np.linalg.norm(end - begin, axis=1), np.linalg.norm(begin - self.source_at(T), axis=1)
        kept = (length > gap) & (length <= _JOINED * away * np.linalg.norm(squarely, axis=1))
        begin, end, parts = begin[kept], end[kept], np.ceil(length[kept] / gap).astype(np.int64)
        pair = np.repeat(np.arange(len(parts)), parts - 1)
        step = np.arange(len(pair)) - np.repeat(np.cumsum(parts - 1) - (parts - 1), parts - 1) + 1
        return np.asarray(begin[pair] + (step / parts[pair])[:, None] * (end - begin)[pair])

    def source_at(self, T: Floats) -> Floats:
        """(3,) where the rays begin of a scanner that stands at T (4, 4), in its frame [m]."""
        return np.asarray(T[:3, :3] @ self.source + T[:3, 3])

    def towards(self, points: Floats, T: Floats) -> Floats:
        """(N, 3) unit directions from there to points (N, 3) [m]."""
        legs = points - self.source_at(T)
        return np.asarray(legs / np.maximum(np.linalg.norm(legs, axis=1, keepdims=True), 1e-12))

    def _beside(self, rays: Floats, others: Floats) -> Bools:
        """(M,) whether one of the unit vectors `others` (N, 3) is two rays' distance from each of `rays` at most."""
        if not len(others):
            return np.zeros(len(rays), dtype=np.bool_)
        return np.isfinite(cKDTree(others).query(rays, distance_upper_bound=2 * self.apart)[0])


@dataclass(frozen=True, slots=True, eq=False)
class Exploring:
    """What an exploration works with.

    Attributes:
        scene: checked, its scanner settled.
        options: of the exploration.
        scanning: of each execution.
        part: the part, where its mesh is read: in simulation.
        hidden: the same in the explored frame.
        cylinder: about it.
        unknown: all of the cylinder.
        eye: of the scanner.
        paths: where everything is.
        session: of the command.
    """

    scene: Scene
    options: ExploreOptions
    scanning: ScanOptions
    part: Workpiece | None
    hidden: Hidden | None
    cylinder: Cylinder
    unknown: VoxelSpace
    eye: Eye
    paths: Paths
    session: Session[None]

    @property
    def name(self) -> str:
        """What the part is called."""
        return self.part.name if self.part is not None else Path(self.scene.part.source).stem


def prepared(session: Session[None], scene: Scene, options: ExploreOptions, scanning: ScanOptions) -> Exploring:
    """The part, where there is one to be read, its cylinder, and a scanner that stands still.

    Raises:
        UsageError: if the cylinder is not known, or what was asked for cannot be explored with.
    """
    _require_plain(scene)
    if options.policy == "two-stage" and options.batch != ExploreOptions().batch:
        raise UsageError("--batch is for stepwise; two-stage takes as many views at a time as are worth it")
    scene.require_fixed_part("an exploration")
    part = hidden = None
    if scanning.is_simulated:
        with session.stage("load the part"):
            part = workpiece.load(scene.part.source, scene.part.units)
            hidden = Hidden.of(scene, part)
    if options.cylinder_mm is not None:
        diameter, height = options.cylinder_mm
        cylinder = Cylinder(diameter / 2000, height / 1000, given=True)
    elif hidden is not None:
        cylinder = cylinder_about(hidden)
    else:
        raise UsageError(
            "nobody knows how large the part is; give --cylinder DIAMETER,HEIGHT in mm, about --place, that holds it"
        )
    known = _as_workpiece(cylinder) if part is None or cylinder.given else part
    settled = settle(scene, known)
    scene, settings, scanner = settled.scene, settled.settings, settled.scanner
    if getattr(scanner, "T_view_scanner", np.eye(4)[None]).shape[0] > 1:
        raise SceneError(
            f"the scanner {scene.scanner.type} sweeps, and from where each of its points was seen is not kept; "
            "explore with a scanner that stands still, such as laser-area"
        )
    if scanning.resolution_deg is not None and "resolution_deg" in settings.scanner:
        resolution = {"resolution_deg": (scanning.resolution_deg, scanning.resolution_deg)}
        scanner = scanners.make(scene.scanner.type, {**settings.scanner, **resolution})
    unknown = _unknown(options, scanning, settings, cylinder)
    return Exploring(
        scene, options, scanning, part, hidden, cylinder, unknown, Eye.of(scanner, scene),
        Paths(session.out or Path()), session,
    )  # fmt: skip


def _require_plain(scene: Scene) -> None:
    """Refuse wishes that name candidates or surface, which nobody knows before there is a part, or that nothing heeds.

    Raises:
        UsageError: naming the first.
    """
    plan = scene.plan
    asked = {
        "--fill rays": plan.fill == "rays",
        "--multiplicity": plan.multiplicity > 1,
        "--overlap": plan.overlap_mm2 is not None or plan.overlap_share is not None,
        "--pose-sd": plan.pose_sd_mm > 0 or plan.pose_sd_deg > 0,
        "--cost time": plan.cost == "time",
        "--curve": plan.curve,
        "--require": plan.required_visible > 0,
        "--solver": plan.solver != "auto",
        "--pin and --ban": bool(plan.pinned or plan.banned),
        "a region of the part": bool(scene.region),
    }
    if wish := next((name for name, wished in asked.items() if wished), None):
        raise UsageError(f"{wish} is for a part that is known; leave it away here, and plan with it on model.ply")
    if scene.setup:
        raise UsageError("set-ups are for a part that is known; leave [[setup]] away, and plan with them on model.ply")
    if scene.placement.origin_mm is not None:
        raise UsageError("--place-origin says where a file's origin stands; give --place, the middle of the cylinder")
    if on := [fixture.name for fixture in scene.fixtures if fixture.attached_to == "object"]:
        raise UsageError(
            f"the fixture '{on[0]}' is attached to the part's frame, which nobody knows; attach it to base"
        )


def _as_workpiece(cylinder: Cylinder) -> Workpiece:
    """The cylinder as a part, by whose size a scanner is chosen."""
    mesh = trimesh.creation.cylinder(cylinder.radius, cylinder.height)
    return workpiece.from_arrays("cylinder", mesh.vertices, mesh.faces, "m")


def _unknown(options: ExploreOptions, scanning: ScanOptions, settings: Settings, cylinder: Cylinder) -> VoxelSpace:
    """The cylinder's voxels, by default so large that points fall into each where the scanner looks squarely.

    Raises:
        UsageError: if there would be too many.
    """
    resolution = scanning.resolution_deg or float(np.max(settings.scanner.get("resolution_deg", 0.0)))
    spacing = max(settings.standoffs) * float(np.tan(np.radians(resolution)))
    usual = max(2 * cylinder.radius / VOXELS, cylinder.height / VOXELS, SPACINGS * spacing)
    try:
        edge = usual if options.voxel_mm is None else options.voxel_mm / 1000
        return VoxelSpace.from_cylinder(cylinder.radius, cylinder.height, edge, spacing)
    except PlannerError as error:
        raise UsageError(f"--voxel or --cylinder cannot be: {error}") from error


def begun(work: Exploring) -> ExploreFile:
    """explore.json before the first stage."""
    options = work.options.model_dump(mode="json", exclude={"confirm_motion"})
    scanning = work.scanning.model_dump(mode="json", exclude={*RESUME_OPTIONS, *_OF_WAITING})
    said = work.scene.model_dump(mode="json"), scanning, options
    cylinder = work.cylinder
    return ExploreFile(
        schema=SCHEMA,
        part=work.name,
        status="running",
        ended="",
        inputs=digest_of(*said, None if work.part is None else work.part.sha256),
        seed=work.scene.plan.seed,
        policy=work.options.policy,
        source=work.scanning.acquire,
        options=options,
        cylinder=ExploredCylinder(
            diameter_mm=round(2000 * cylinder.radius, 6), height_mm=round(1000 * cylinder.height, 6),
            middle_mm=work.scene.placement.position_mm, given=cylinder.given,
        ),
        voxel_mm=round(1000 * work.unknown.edge, 6),
        stages=(),
    )  # fmt: skip
