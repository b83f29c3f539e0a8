"""`cell points`: write the points or the surface of an execution for other programs, with their deviation.

| suffix | content | unit |
|---|---|---|
| `.e57` | each scan in its scanner's frame with its pose; deviation [mm] as intensity, row and column of the grid | m |
| `.ptx` | each scan in its scanner's frame with its pose | m |
| `.las`, `.laz` | points with number of the view and `deviation_mm` | m |
| `.pcd` | points with `deviation_mm` and `view` | mm |
| `.csv` | points with deviation and view | mm |
| `.ply` | the surface with its deviation, as in the run folder | mm |
| `.stl`, `.obj` | the surface; `.obj` in the colours of the deviation | mm |
| `.glb` | the surface in the colours of the deviation, with the attribute `_DEVIATION_MM` | m |

The frame is that of the part; poses are those of the report, registered if the execution is. A deviation is the signed
distance from the reference, positive outside.
"""

import io
from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from cell.errors import FileError, UsageError
from cell.files import atomic_write, file_errors
from cell.metrology import scan_files
from cell.metrology.scan_files import PosedScan
from cell.runs import ply
from cell.runs.run import ExecutedScan, Execution, RecordedExecution, Run, open_finished, read_execution
from cell.scan.results import merge_execution, usable_scans
from cell.view.palette import SIGNED
from planner.geometry.closest import ClosestPointQuery
from planner.geometry.rigid import inverse_rigid
from planner.registration.rigid import transform_points
from planner.values import Floats

SUFFIXES = (*scan_files.SUFFIXES, ".pcd", ".csv", ".ply", ".stl", ".obj", ".glb")

_LARGEST_GRID = 2**16  # rows or columns that an index of E57 counts
_FULL_COLOUR = 0.95  # share of the deviations within the scale of colours


def write_points(run_folder: Path, out: Path, execution: str = "latest") -> int:
    """Write the points or the surface of an execution to a file, and return the number of points or vertices.

    Args:
        run_folder: of a finished plan.
        out: the file; its suffix selects the format.
        execution: id of the execution, or "latest".

    Raises:
        UsageError: if the suffix is unknown.
        FileError: if the execution has no points or no surface, or a file cannot be read or written.
    """
    kind = out.suffix.lower()
    if kind not in SUFFIXES:
        raise UsageError(f"{out} is '{out.suffix}'; it must be one of: {', '.join(SUFFIXES)}")
    run = open_finished(run_folder)
    recorded = read_execution(run, execution)
    if kind in (".ply", ".stl", ".obj", ".glb"):
        count, write = _surface(recorded, kind)
    else:
        scans = _scans(run, recorded)
        count = sum(len(scan.points) for scan in scans)

        def write(path: Path) -> None:
            if kind in scan_files.SUFFIXES:
                scan_files.write(path, scans, kind)
            else:
                path.write_bytes(_table(scans, kind))

    with file_errors(f"{out} cannot be written"), atomic_write(out) as part:
        write(part)
    return count


def _scans(run: Run, recorded: RecordedExecution) -> list[PosedScan]:
    """Return the scans of an execution at the poses of its report, with the deviation of each point [mm]."""
    usable, _ = usable_scans(recorded, run.plan.views)
    if not any(len(scan.points) for scan in usable):
        raise FileError(f"{recorded.folder} has no points; scan again")
    nearest = ClosestPointQuery(run.reference)
    scans = []
    for scan, T in zip(usable, merge_execution(run, recorded, usable, nearest).poses, strict=True):
        points = transform_points(inverse_rigid(scan.T_reported), scan.points)
        deviation = nearest.signed_distance(transform_points(T, points)) * 1000.0 if len(points) else np.zeros(0)
        scans.append(PosedScan(points, T, deviation, _pixels(scan), scan.stop))
    return scans


def _pixels(scan: ExecutedScan) -> NDArray[np.uint16] | None:
    """Return row and column (P, 2) of the points in the grid of a scan; None without points, or if it has no grid."""
    if not len(scan.points) or not {"pixel", "grid_shape"} <= scan.stored.keys():
        return None
    shape = scan.stored["grid_shape"]
    if max(shape) > _LARGEST_GRID or len(scan.stored["pixel"]) != len(scan.points):
        return None
    return np.stack(np.unravel_index(scan.stored["pixel"], shape), axis=1).astype(np.uint16)


def _table(scans: list[PosedScan], kind: str) -> bytes:
    """Return points [mm], deviation [mm] and view of scans as CSV or packed PCD."""
    points = np.concatenate([scan.points_in_file for scan in scans]) * 1000.0
    deviation = np.concatenate([np.zeros(len(scan.points)) if scan.values is None else scan.values for scan in scans])
    view = np.repeat([scan.number for scan in scans], [len(scan.points) for scan in scans])
    if kind == ".csv":
        out = io.StringIO("x_mm,y_mm,z_mm,deviation_mm,view\n")
        out.seek(0, io.SEEK_END)
        np.savetxt(out, np.column_stack([points, deviation, view]), fmt=["%.6f"] * 4 + ["%d"], delimiter=",")
        return out.getvalue().encode()
    header = (
        "# .PCD v0.7\nVERSION 0.7\nFIELDS x y z deviation_mm view\nSIZE 8 8 8 4 4\nTYPE F F F F I\nCOUNT 1 1 1 1 1\n"
        f"WIDTH {len(points)}\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS {len(points)}\nDATA binary\n"
    )
    rows = np.zeros(len(points), dtype=[("xyz", "<f8", 3), ("deviation", "<f4"), ("view", "<i4")])
    rows["xyz"], rows["deviation"], rows["view"] = points, deviation, view
    return header.encode("ascii") + rows.tobytes()


def _surface(recorded: RecordedExecution, kind: str) -> tuple[int, Callable[[Path], object]]:
    """Return the number of vertices of the surface, and a function that writes it."""
    import trimesh

    execution = Execution.open(recorded.folder)
    if not execution.has("mesh.ply"):
        raise FileError(f"{recorded.folder} has no surface; write it with cell scan --report {recorded.folder.name}")
    content = execution.artefact("mesh.ply")
    vertex = ply.elements(content)["vertex"]
    mesh = ply.to_trimesh(ply.mesh(content))
    if kind == ".ply":
        return len(vertex), lambda path: path.write_bytes(content)
    deviation = np.asarray(vertex["scalar_deviation_mm"], dtype=np.float64)
    if kind != ".glb":
        mesh.apply_scale(1000.0)
    if kind != ".stl":
        mesh.visual = trimesh.visual.ColorVisuals(mesh, vertex_colors=_colours(deviation))
        mesh.vertex_attributes["deviation_mm" if kind == ".obj" else "_DEVIATION_MM"] = deviation.astype(np.float32)
    return len(vertex), lambda path: mesh.export(path, file_type=kind[1:])


def _colours(deviation: Floats) -> NDArray[np.uint8]:
    """Return the colours (V, 4) of deviations on a scale that holds most of them."""
    from matplotlib.colors import LinearSegmentedColormap

    largest = max(float(np.quantile(np.abs(deviation), _FULL_COLOUR)), 1e-6)
    scale = LinearSegmentedColormap.from_list("deviation", SIGNED)
    colours: NDArray[np.uint8] = np.round(scale(0.5 + 0.5 * deviation / largest) * 255.0).astype(np.uint8)
    return colours
