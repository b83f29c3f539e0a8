"""From cloud to mesh, and registration: seconds and error, on the built-in Mseke.

The cloud is eight virtual scans from 300 mm, fine enough for 300,000 points. Rows `mesh` vary the grid and the range
noise; `seconds` is normals, merging and reconstruction together (`processor s` adds up both cores and excludes other
programs), the errors are the mesh's deviation from the reference. A row `poisson` is Open3D's screened
Poisson reconstruction of the same points, if Open3D is installed: its normals, its surface of depth 8, and the same
cut at two spacings, without which it closes the part. Rows `registration` vary the pose error (one sigma, translation
and rotation together) on scans of 0.5 degree with 30 micrometres of noise; the errors are the merged cloud's rms
distance to the reference before and after.
"""

import time
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from benchmarks.eight_scans import eight_scans, noisy
from cell.metrology.reconstruct import REACH, reconstruct
from cell.part.workpiece import Workpiece, load
from planner.geometry.closest import ClosestPointQuery
from planner.geometry.mesh import TriangleMesh
from planner.registration.cloud import ScanCloud, merge, point_spacing
from planner.registration.registration import RegistrationStatus, register
from planner.registration.surface import Deviation, measure_deviation
from planner.values import Floats

GRIDS = (0.8, 1.25, 2.0, 3.0, 5.0)
NOISES_UM = (0.0, 30.0, 100.0)
POSE_ERRORS = ((0.1, 0.02), (0.25, 0.05), (0.5, 0.1), (1.0, 0.2), (2.0, 0.4), (5.0, 1.0), (10.0, 2.0), (20.0, 4.0))
_COLOURS = ("#2a6f97", "#7a9e3a", "#c4622d")

DEPTH = 8
"""Of Open3D's octree: 256 cells along the longest side of the cloud's box."""


def run() -> list[dict[str, Any]]:
    """Return one row per grid and noise, one per noise by Poisson if Open3D is installed, then one per pose error."""
    part = load("mseke")
    nearest = ClosestPointQuery(part.reference)
    return _mesh_rows(part, nearest) + _registration_rows(part, nearest)


def chart(rows: list[dict[str, Any]], folder: Path) -> None:
    """Draw `reconstruction.png`: mesh error over grid and noise, time over grid, registration over pose error."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(13.0, 4.2), dpi=110, layout="constrained")
    error, seconds, registered = figure.subplots(1, 3)
    meshes = [row for row in rows if row["what"] == "mesh"]
    poisson = [row for row in rows if row["what"] == "poisson"]
    for noise, colour in zip(dict.fromkeys(row["noise um"] for row in meshes), _COLOURS, strict=False):
        line = [row for row in meshes if row["noise um"] == noise]
        label = f"noise {noise:g} \N{MICRO SIGN}m"
        for axis, value in ((error, "rms um"), (seconds, "processor s")):
            axis.plot([row["grid mm"] for row in line], [row[value] for row in line], "o-", color=colour, label=label)
            for row in (row for row in poisson if row["noise um"] == noise):
                axis.plot(row["grid mm"], row[value], "X", color=colour, markersize=9, markeredgecolor="white")
    for axis in (error, seconds) if poisson else ():
        axis.plot([], [], "X", color="0.4", markersize=9, label=f"Open3D Poisson, depth {DEPTH}")
    points, spacing = (meshes[0][name] for name in ("points", "spacing mm"))
    error.set_title(f"Mesh of {points:,} points {spacing:.2f} mm apart", fontsize=10, loc="left")
    error.set(xlabel="edge of a grid cell [mm]", ylabel="rms deviation from the part [\N{MICRO SIGN}m]", ylim=(0, None))
    seconds.set_title("Its time", fontsize=10, loc="left")
    seconds.set(xlabel="edge of a grid cell [mm]", ylabel="cloud to mesh, both cores [processor s]", ylim=(0, None))
    _draw_registration(registered, [row for row in rows if row["what"] == "registration"])
    for axis in (error, seconds, registered):
        axis.grid(color="0.92", linewidth=0.6)
        axis.set_axisbelow(True)
        axis.spines[["top", "right"]].set_visible(False)
        axis.legend(frameon=False, fontsize=8)
    FigureCanvasAgg(figure).print_png(str(folder / "reconstruction.png"))


def _draw_registration(axis: Any, line: list[dict[str, Any]]) -> None:
    """Draw error before and after over the pose error, and the errors at which scans no longer converge."""
    sigma = [row["pose mm"] for row in line]
    axis.loglog(sigma, [row["before um"] for row in line], "o-", color="0.55", label="reported poses")
    axis.loglog(sigma, [row["after um"] for row in line], "o-", color=_COLOURS[0], label="registered")
    for row in line:
        good = row["converged"].split()[0]
        axis.annotate(
            good, (row["pose mm"], row["after um"]), xytext=(0, 6), textcoords="offset points", ha="center",
            fontsize=7.5, color="0.35",
        )  # fmt: skip
    failures = [row["pose mm"] for row in line if len(set(row["converged"].split(" of "))) > 1]
    if failures:
        before = [value for value in sigma if value < min(failures)]
        start = np.sqrt(max(before) * min(failures)) if before else min(failures)
        axis.axvspan(start, 1.3 * max(sigma), color="#c4622d", alpha=0.12, linewidth=0, label="scans are lost")
        axis.set_xlim(right=1.3 * max(sigma))
    axis.set_ylim(bottom=10)
    axis.set_title("Registration (number of 8 scans that converge)", fontsize=10, loc="left")
    axis.set(
        xlabel="pose error, one sigma [mm], and 0.2 deg for each mm",
        ylabel="rms of the merged cloud [\N{MICRO SIGN}m]",
    )


def _mesh_rows(part: Workpiece, nearest: ClosestPointQuery) -> list[dict[str, Any]]:
    rows = []
    exact = eight_scans(part, resolution_deg=0.165)
    for noise in NOISES_UM:
        scans = noisy(exact, noise * 1e-6)
        spacing = point_spacing(np.concatenate([s.points for s in scans]), np.repeat(range(8), [len(s) for s in scans]))
        common = {"points": sum(len(s) for s in scans), "spacing mm": spacing * 1e3, "noise um": noise}
        for factor in GRIDS:
            start, busy = time.perf_counter(), time.process_time()
            result = reconstruct(merge(scans), grid=factor * spacing)
            took = {"seconds": time.perf_counter() - start, "processor s": time.process_time() - busy}
            assert result.mesh is not None  # eight full views of a part
            grid = {"what": "mesh", "grid mm": result.grid * 1e3}
            rows.append(grid | common | took | _errors(result.mesh, nearest))
        if find_spec("open3d"):
            start, busy = time.perf_counter(), time.process_time()
            mesh, cell = _poisson(scans, REACH * spacing)
            took = {"seconds": time.perf_counter() - start, "processor s": time.process_time() - busy}
            rows.append({"what": "poisson", "grid mm": cell * 1e3} | common | took | _errors(mesh, nearest))
    return rows


def _errors(mesh: TriangleMesh, nearest: ClosestPointQuery) -> dict[str, Any]:
    measured: Deviation = measure_deviation(mesh, nearest, np.random.default_rng(0))
    return {
        "rms um": measured.rms * 1e6,
        "95 % um": measured.quantile_95 * 1e6,
        "largest um": measured.largest * 1e6,
        "faces": len(mesh.faces),
    }


def _poisson(scans: list[ScanCloud], cut: float) -> tuple[TriangleMesh, float]:
    """Return Open3D's surface, cut beyond `cut` [m] from all points, and the edge of its cells [m]."""
    import open3d

    cloud = open3d.geometry.PointCloud(open3d.utility.Vector3dVector(np.concatenate([s.points for s in scans])))
    cloud.estimate_normals(open3d.geometry.KDTreeSearchParamKNN(12))
    # Turned toward the scanner, scan by scan: Open3D can do that for one sensor only.
    normals = np.asarray(cloud.normals)
    sight = np.concatenate([s.sensor - s.points for s in scans])
    normals *= np.where(np.einsum("nj,nj->n", normals, sight) < 0, -1.0, 1.0)[:, None]
    found, _ = open3d.geometry.TriangleMesh.create_from_point_cloud_poisson(cloud, depth=DEPTH)
    distance = open3d.geometry.PointCloud(found.vertices).compute_point_cloud_distance(cloud)
    found.remove_vertices_by_mask(np.asarray(distance) > cut)
    mesh = TriangleMesh(np.asarray(found.vertices).copy(), np.asarray(found.triangles, dtype=np.int32).copy())
    # Open3D makes its box 1.1 times the cloud's longest side.
    return mesh, 1.1 * float(np.ptp(np.asarray(cloud.points), axis=0).max()) / 2**DEPTH


def _registration_rows(part: Workpiece, nearest: ClosestPointQuery) -> list[dict[str, Any]]:
    rows = []
    scans = noisy(eight_scans(part, resolution_deg=0.5), 30e-6)
    for millimetres, degrees in POSE_ERRORS:
        rng = np.random.default_rng(1)
        disturbed = [_disturbed(s, rng.normal(0, millimetres * 1e-3, 3), rng.normal(0, degrees, 3)) for s in scans]
        start = time.perf_counter()
        result = register(disturbed, nearest)
        seconds = time.perf_counter() - start
        registered = [s.transformed(r.T_correction) for s, r in zip(disturbed, result.scans, strict=True)]
        before, after = _rms(disturbed, nearest), _rms(registered, nearest)
        good = sum(scan.status is RegistrationStatus.CONVERGED for scan in result.scans)
        rows.append(
            {
                "what": "registration",
                "points": sum(len(s) for s in disturbed),
                "noise um": 30.0,
                "pose mm": millimetres,
                "pose deg": degrees,
                "seconds": seconds,
                "before um": before * 1e6,
                "after um": after * 1e6,
                "gain": before / after,
                "converged": f"{good} of {len(scans)}",
            }
        )
    return rows


def _disturbed(cloud: ScanCloud, shift: Floats, turn_deg: Floats) -> ScanCloud:
    """Return the cloud as a scanner with a shift [m] and a rotation about itself [deg] reports it."""
    T = np.eye(4)
    T[:3, :3] = Rotation.from_rotvec(turn_deg, degrees=True).as_matrix()
    T[:3, 3] = cloud.sensor + shift - T[:3, :3] @ cloud.sensor
    return cloud.transformed(T)


def _rms(scans: list[ScanCloud], nearest: ClosestPointQuery) -> float:
    """Return the root mean square distance of all points to the reference [m]."""
    distance = nearest.closest(np.concatenate([cloud.points for cloud in scans])).distance
    return float(np.sqrt(np.mean(distance**2)))
