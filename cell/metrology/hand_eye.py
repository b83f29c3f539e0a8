"""`cell calibrate hand-eye`: compute the mount from scans of a target and poses of the flange."""

import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from pydantic import Field
from scipy.spatial.transform import Rotation

from cell.errors import FileError, UsageError
from cell.files import file_errors
from cell.metrology import point_files, point_tables
from cell.metrology.options import HandEyeOptions
from cell.part.workpiece import UNITS
from cell.runs.schema import JsonTable, Transform, Triple
from cell.session import ProgressReporter
from planner.errors import PlannerError
from planner.kinematics.frames import kuka_abc_from_pose, pose_from_kuka_abc
from planner.registration.hand_eye import PoseError, TargetScans, fit_planes, fit_spheres, solve_hand_eye
from planner.values import Floats, readonly

_SEED = 0  # of the start rotations; equal scans give equal mounts

Quaternion = tuple[float, float, float, float]


class MountPrecision(JsonTable):
    """Standard deviations of the determined directions, from the residuals."""

    position_mm: Triple = Field(description="of the scanner's origin along x, y, z of the flange")
    rotation_deg: Triple = Field(description="of the scanner's orientation about x, y, z of the flange")


class TargetScan(JsonTable):
    """A scan of the target."""

    file: str
    points: int = Field(description="number of points in the file")
    inlier_share: float = Field(description="share of them on the target")
    noise_mm: float = Field(description="rms distance of these from the target fitted to this scan")
    residual_mm: float = Field(description="distance of the target from its position in the other scans, by the mount")


class HandEyeResult(JsonTable):
    """Result of `cell calibrate hand-eye --json`."""

    target: str = Field(description="'sphere' or 'plane'")
    T_flange_scanner: Transform = Field(description="the mount")
    position_mm: Triple = Field(description="its position as the scene file takes it")
    abc_deg: Triple = Field(description="its orientation, KUKA A B C")
    quaternion: Quaternion = Field(description="the same orientation as w, x, y, z")
    precision: MountPrecision | None = Field(description="null if there are too few residuals to estimate it")
    rms_mm: float = Field(description="of the residuals of all scans")
    diameter_mm: float | None = Field(description="of the sphere; null for a plane")
    diameter_sd_mm: float | None = Field(description="its standard deviation, 0 if given; null for a plane")
    tolerance_mm: float = Field(description="required precision of a direction, at the target")
    free_motions: tuple[str, ...] = Field(
        description="motions of the scanner on the flange that the poses do not determine"
    )
    scans: tuple[TargetScan, ...]

    @property
    def lines(self) -> str:
        """The mount as lines of a scene file."""
        position, abc = (", ".join(f"{number:.6g}" for number in each) for each in (self.position_mm, self.abc_deg))
        w, x, y, z = self.quaternion
        return (
            f"[mount]\nposition_mm = [{position}]\nabc_deg = [{abc}]\n"
            f"# or, in place of abc_deg: quaternion = [{w:.9g}, {x:.9g}, {y:.9g}, {z:.9g}]"
        )

    def rows(self) -> list[tuple[str, str]]:
        """Return the result as names and values."""
        worst, precision = max(self.scans, key=lambda scan: scan.residual_mm), self.precision
        deviation = (
            "not known: more scans are needed"
            if precision is None
            else f"{_listed(precision.position_mm, 3)} mm, turn {_listed(precision.rotation_deg, 4)} deg"
        )
        largest = f"largest in {worst.file}: {worst.residual_mm:.3f} mm"
        rows = [
            ("mount", f"{_listed(self.position_mm, 3)} mm, A B C {_listed(self.abc_deg, 4)} deg"),
            ("standard deviation", deviation),
            ("left over", f"{self.rms_mm:.3f} mm rms of {len(self.scans)} scans; {largest}"),
            ("not determined", "\n".join(self.free_motions) or f"nothing (to {self.tolerance_mm:g} mm at the target)"),
        ]
        if self.diameter_mm is not None and self.diameter_sd_mm is not None:
            known = f", standard deviation {self.diameter_sd_mm:.4f} mm" if self.diameter_sd_mm else " (given)"
            rows.append(("diameter", f"{self.diameter_mm:.4f} mm{known}"))
        return rows


def _listed(numbers: Triple, digits: int) -> str:
    return ", ".join(f"{number:.{digits}f}" for number in numbers)


def calibrate_hand_eye(files: Sequence[Path], options: HandEyeOptions, reporter: ProgressReporter) -> HandEyeResult:
    """Compute the mount from scans of the target, scanner frame.

    Raises:
        UsageError: if a scan shows no target, or there are too few scans.
        FileError: if a file is missing or cannot be read.
    """
    T_base_flange = np.stack(_read_poses(files, options)) if files else np.empty((0, 4, 4))
    rng, metres = np.random.default_rng(_SEED), UNITS[str(options.points_units)]
    clouds = [point_files.read(path) * metres for path in files]
    is_plane, names = options.target == "plane", [str(path) for path in files]
    radius = None if options.diameter_mm is None else options.diameter_mm / 2000
    error = PoseError(options.pose_sd_mm / 1000, float(np.radians(options.pose_sd_deg)))
    try:
        with reporter.stage(f"find the {options.target}"):
            targets = fit_planes(clouds, rng, names) if is_plane else fit_spheres(clouds, radius, rng, names)
        with reporter.stage("solve for the mount"):
            points = np.stack([target.points for target in targets]) if targets else np.empty((0, 1, 3))
            fit = solve_hand_eye(TargetScans(T_base_flange, points, is_plane), error, rng)
    except PlannerError as problem:
        raise UsageError(str(problem)) from problem
    position, abc = kuka_abc_from_pose(fit.T)
    sd = None if fit.covariance is None else np.sqrt(np.diag(fit.covariance))
    x, y, z, w = Rotation.from_matrix(fit.T[:3, :3]).as_quat(canonical=True).round(12).tolist()
    return HandEyeResult(
        target=options.target,
        T_flange_scanner=fit.T,
        position_mm=tuple((1000 * position).round(6).tolist()),
        abc_deg=tuple(np.degrees(abc).round(7).tolist()),
        quaternion=(w, x, y, z),
        precision=None
        if sd is None
        else MountPrecision(
            position_mm=tuple((1000 * sd[:3]).tolist()), rotation_deg=tuple(np.degrees(sd[3:]).tolist())
        ),
        rms_mm=1000 * fit.rms,
        diameter_mm=None if is_plane else 2000 * targets[0].radius,
        diameter_sd_mm=None if is_plane else 2000 * targets[0].radius_sd,
        tolerance_mm=options.tolerance_mm,
        free_motions=(
            *(motion.sentence for motion in fit.undetermined_motions(options.tolerance_mm / 1000)),
            *fit.alternatives,
        ),
        scans=tuple(
            TargetScan(
                file=name,
                points=len(cloud),
                inlier_share=target.used,
                noise_mm=1000 * target.rms,
                residual_mm=1000 * float(residual),
            )
            for name, cloud, target, residual in zip(names, clouds, targets, fit.residuals, strict=True)
        ),
    )


def _read_poses(files: Sequence[Path], options: HandEyeOptions) -> list[Floats]:
    """Read T_base_flange of each scan [m]."""
    if options.poses is None:
        return [_read_pose_next_to(path) for path in files]
    path = Path(options.poses).expanduser()
    rows: list[list[float | None]] = []
    for row in point_files.read_rows(path):
        numbers = [point_tables.number_of(word) for word in row.words]
        if not rows and None in numbers:
            continue  # the names of the columns
        if len(numbers) != 6 or None in numbers or not np.isfinite(np.array(numbers, np.float64)).all():
            raise FileError(
                f"{path}, line {row.line}: it must be six numbers, x y z [mm] and A B C [deg] of the flange"
            )
        rows.append(numbers)
    table = np.array(rows, np.float64).reshape(-1, 6)
    if len(table) != len(files):
        raise UsageError(f"{path} has {len(table)} poses for {len(files)} scans; give one line a scan, in their order")
    return list(pose_from_kuka_abc(table[:, :3] / 1000, np.radians(table[:, 3:])))


def _read_pose_next_to(scan: Path) -> Floats:
    """Read the pose in the JSON file next to a scan."""
    path = scan.with_suffix(".json")
    try:
        with file_errors(f"{path} cannot be read", "it must contain T_base_flange of the scan, or give --poses"):
            content = json.loads(path.read_text(encoding="utf-8"))
        T = np.asarray(content["T_base_flange"], dtype=np.float64)
        T = readonly("T_base_flange", T[len(T) // 2] if T.ndim == 3 else T, (4, 4))
        kuka_abc_from_pose(T)  # raises if it is no rigid transform
    except (ValueError, KeyError, TypeError, PlannerError) as error:
        raise FileError(f"{path} must be a JSON object with T_base_flange, four rows of four numbers [m]") from error
    return T
