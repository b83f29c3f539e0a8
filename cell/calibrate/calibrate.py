"""`cell calibrate hand-eye`: scans and poses in, the mount out."""

import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from cell.acquisition import point_files
from cell.calibrate import targets
from cell.calibrate.hand_eye import Observed, PoseError, solve
from cell.calibrate.mounted import Mounted, MountPrecision, SeenTarget
from cell.calibrate.options import HandEye
from cell.errors import FileError, UsageError
from cell.part.workpiece import UNITS
from cell.robot.frames import kuka_abc_from_pose, pose_from_kuka_abc
from cell.session import ProgressReporter
from planner.errors import PlannerError
from planner.values import Floats, readonly

_SEED = 0  # of the beginnings; equal scans give equal mounts


def hand_eye(files: Sequence[Path], wanted: HandEye, reporter: ProgressReporter) -> Mounted:
    """Find the mount.

    Args:
        files: scans of the target, scanner frame.
        wanted: the target, and where the poses stand.
        reporter: is told what goes on.

    Raises:
        UsageError: if a scan shows no target, or the scans are too few.
        FileError: if a file is missing or cannot be read.
    """
    T_base_flange = np.stack(_poses(files, wanted)) if files else np.empty((0, 4, 4))
    rng, metres = np.random.default_rng(_SEED), UNITS[str(wanted.points_units)]
    clouds = [point_files.read(path) * metres for path in files]
    with reporter.stage(f"find the {wanted.target}"):
        seen, spheres = _seen(files, clouds, wanted, rng)
    with reporter.stage("solve for the mount"):
        points = np.stack([each[0] for each in seen]) if seen else np.empty((0, 1, 3))
        error = PoseError(wanted.pose_sd_mm / 1000, float(np.radians(wanted.pose_sd_deg)))
        fit = solve(Observed(T_base_flange, points, wanted.target == "plane"), error, rng)
    position, abc = kuka_abc_from_pose(fit.T)
    sd = None if fit.covariance is None else np.sqrt(np.diag(fit.covariance))
    return Mounted(
        target=wanted.target,
        T_flange_scanner=fit.T,
        position_mm=tuple((1000 * position).round(6).tolist()),
        abc_deg=tuple(np.degrees(abc).round(7).tolist()),
        quaternion=tuple(_quaternion(fit.T).round(12).tolist()),
        precision=None
        if sd is None
        else MountPrecision(position_mm=tuple((1000 * sd[:3]).tolist()), turn_deg=tuple(np.degrees(sd[3:]).tolist())),
        rms_mm=1000 * fit.rms,
        diameter_mm=2000 * spheres[0].radius if spheres else None,
        diameter_sd_mm=2000 * spheres[0].radius_sd if spheres else None,
        within_mm=wanted.within_mm,
        undetermined=(*(motion.sentence for motion in fit.undetermined(wanted.within_mm / 1000)), *fit.rivals),
        scans=tuple(
            SeenTarget(
                file=str(path), points=len(cloud), used=used, noise_mm=1000 * noise, residual_mm=1000 * float(left)
            )
            for path, cloud, (_, used, noise), left in zip(files, clouds, seen, fit.residuals, strict=True)
        ),
    )


def _seen(
    files: Sequence[Path], clouds: list[Floats], wanted: HandEye, rng: np.random.Generator
) -> tuple[list[tuple[Floats, float, float]], list[targets.Sphere]]:
    """Of each scan points of the target (J, 3), share of points and noise [m]; and the spheres."""
    try:
        if wanted.target == "plane":
            planes = targets.planes_in(clouds, rng)
            return [(each.points, each.used, each.rms) for each in planes], []
        radius = None if wanted.diameter_mm is None else wanted.diameter_mm / 2000
        spheres = targets.spheres_in(clouds, radius, rng)
        return [(each.centre[None], each.used, each.rms) for each in spheres], spheres
    except targets.NoTargetError as error:
        raise UsageError(f"{files[error.scan]}: {error}") from error


def _poses(files: Sequence[Path], wanted: HandEye) -> list[Floats]:
    """T_base_flange of each scan [m]."""
    if wanted.poses is None:
        return [_beside(path) for path in files]
    path = Path(wanted.poses).expanduser()
    try:
        lines = path.read_text(encoding="utf-8-sig").replace(",", " ").replace(";", " ").splitlines()
        rows = [[float(word) for word in line.split()] for line in lines if line.split() and line[0] != "#"]
        table = readonly("poses", rows, (None, 6))
    except OSError as error:
        raise FileError(f"{path} cannot be read: {error.strerror or error}") from error
    except (ValueError, PlannerError) as error:
        raise FileError(f"{path}: a line must be six numbers, x y z [mm] and A B C [deg] of the flange") from error
    if len(table) != len(files):
        raise UsageError(f"{path} has {len(table)} poses for {len(files)} scans; give one line a scan, in their order")
    return list(pose_from_kuka_abc(table[:, :3] / 1000, np.radians(table[:, 3:])))


def _beside(path: Path) -> Floats:
    """The pose in the JSON file that stands beside a scan."""
    beside = path.with_suffix(".json")
    try:
        content = json.loads(beside.read_text(encoding="utf-8"))
        T = np.asarray(content["T_base_flange"], dtype=np.float64)
        T = readonly("T_base_flange", T[len(T) // 2] if T.ndim == 3 else T, (4, 4))
        kuka_abc_from_pose(T)  # raises where it is no rigid transform
    except OSError as error:
        raise FileError(
            f"{beside} cannot be read: {error.strerror or error}; it must hold T_base_flange of the scan beside it, or "
            "give --poses"
        ) from error
    except (ValueError, KeyError, TypeError, PlannerError) as error:
        raise FileError(f"{beside} must be a JSON object with T_base_flange, four rows of four numbers [m]") from error
    return T


def _quaternion(T: Floats) -> Floats:
    """(4,) w, x, y, z of a transform's rotation, w not negative."""
    from scipy.spatial.transform import Rotation

    x, y, z, w = Rotation.from_matrix(T[:3, :3]).as_quat(canonical=True)
    return np.array([w, x, y, z])
