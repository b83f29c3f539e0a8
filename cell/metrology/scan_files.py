"""Files with several scans and their poses: E57 (pye57), PTX, LAS and LAZ (laspy). Lengths are in metres.

A scan has its points in the frame of the scanner, and the pose of the scanner in the frame of the file. LAS and LAZ
have one frame and one cloud. The values of a scan, here deviations, are stored as intensity (E57), or as a dimension of
their own (LAS, LAZ). PTX is text: for each scan its columns and rows, the pose, and a point a line, `0 0 0` for a ray
without an echo.
"""

import contextlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from types import ModuleType
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from cell.errors import FileError
from cell.text import decode
from planner.registration.rigid import transform_points
from planner.values import Floats

SUFFIXES: Final = (".e57", ".ptx", ".las", ".laz")

_LAS_STEP = 1e-6  # of coordinates [m]
_LAS_VALUE = "deviation_mm"


@dataclass(frozen=True, slots=True, eq=False)
class PosedScan:
    """One scan.

    Attributes:
        points: (P, 3) [m], scanner frame.
        T: (4, 4) pose of the scanner in the frame of the file [m].
        values: (P,) of the points; None: none.
        pixels: (P, 2) row and column of each point in the grid of the scan, uint16; None: not organised.
        number: of the view.
    """

    points: Floats
    T: Floats
    values: Floats | None = None
    pixels: NDArray[np.uint16] | None = None
    number: int = 1

    @property
    def points_in_file(self) -> Floats:
        """(P, 3) points in the frame of the file [m]."""
        return transform_points(self.T, self.points)


def read(path: Path) -> list[PosedScan]:
    """Read the scans of a file.

    Raises:
        FileError: if it cannot be read, or the package for it is not installed.
    """
    reader = {".e57": _read_e57, ".ptx": _read_ptx}.get(path.suffix.lower(), _read_las)
    try:
        return reader(path)
    except FileError:
        raise
    except OSError as error:
        raise FileError(f"{path} cannot be read: {error.strerror or error}") from error
    except Exception as error:  # the packages and libE57 raise errors of many kinds for damaged files
        reason = " ".join(str(error).split())[:200]
        raise FileError(f"{path} is no readable {path.suffix} file ({reason}); export it again") from error


def write(path: Path, scans: Sequence[PosedScan], kind: str) -> None:
    """Write scans to a file of a kind, one of `SUFFIXES`.

    Raises:
        FileError: if the package for it is not installed.
        OSError: if it cannot be written.
    """
    if kind == ".e57":
        _write_e57(path, scans)
    elif kind == ".ptx":
        with path.open("w", encoding="ascii", newline="\n") as stream:
            stream.writelines(_ptx_lines(scans))
    else:
        _write_las(path, scans, kind)


def _package(name: str, path: Path) -> ModuleType:
    import importlib

    try:
        return importlib.import_module(name)
    except ImportError as error:
        raise FileError(f"{path} needs the package {name}: pip install 'scan-cell[points]'") from error


def _read_e57(path: Path) -> list[PosedScan]:
    from scipy.spatial.transform import Rotation

    pye57 = _package("pye57", path)
    scans = []
    with path.open("rb"):  # the errors of a missing file are those of the system
        pass
    with contextlib.closing(pye57.E57(str(path))) as file:
        for number in range(file.scan_count):
            header = file.get_header(number)
            T = np.eye(4)
            if header.has_pose():
                w, *xyz = header.rotation
                T[:3, :3] = Rotation.from_quat([*xyz, w]).as_matrix()
                T[:3, 3] = header.translation
            has_values = "intensity" in header.point_fields
            data = file.read_scan(number, transform=False, intensity=has_values, ignore_missing_fields=True)
            if "cartesianX" not in data:
                data = data | _cartesian(data)
            points = np.stack([np.asarray(data[f"cartesian{axis}"], dtype=np.float64) for axis in "XYZ"], axis=1)
            scans.append(PosedScan(points, T, np.asarray(data["intensity"], np.float64) if has_values else None))
    return scans


def _cartesian(data: dict[str, Any]) -> dict[str, Floats]:
    """Return Cartesian coordinates of spherical ones (ASTM E2807)."""
    distance, azimuth, elevation = (
        np.asarray(data[f"spherical{name}"], dtype=np.float64) for name in ("Range", "Azimuth", "Elevation")
    )
    across = distance * np.cos(elevation)
    return {
        "cartesianX": across * np.cos(azimuth),
        "cartesianY": across * np.sin(azimuth),
        "cartesianZ": distance * np.sin(elevation),
    }


def _write_e57(path: Path, scans: Sequence[PosedScan]) -> None:
    from scipy.spatial.transform import Rotation

    pye57 = _package("pye57", path)
    with contextlib.closing(pye57.E57(str(path), mode="w")) as file:
        for scan in scans:
            data = {f"cartesian{axis}": np.ascontiguousarray(scan.points[:, k]) for k, axis in enumerate("XYZ")}
            if scan.values is not None:
                data["intensity"] = np.ascontiguousarray(scan.values)
            if scan.pixels is not None:
                data["rowIndex"], data["columnIndex"] = map(np.ascontiguousarray, scan.pixels.T)
            x, y, z, w = Rotation.from_matrix(scan.T[:3, :3]).as_quat()
            file.write_scan_raw(
                data, name=f"view {scan.number}", rotation=np.array([w, x, y, z]), translation=scan.T[:3, 3].copy()
            )


def _read_ptx(path: Path) -> list[PosedScan]:
    lines = iter(decode(path.read_bytes()).split("\n"))
    scans = []
    for line in lines:
        if not line.strip():
            continue
        columns, rows = int(line), int(next(lines))
        header = [np.array(next(lines).split(), dtype=np.float64) for _ in range(8)]
        T = np.stack(header[4:]).T
        words = [point.split() for point in islice(lines, columns * rows)]
        if len(words) < columns * rows or any(len(row) < 4 for row in words):
            raise ValueError("it is cut short, or a point has not x, y, z and intensity")
        table = np.array([row[:4] for row in words], dtype=np.float64).reshape(-1, 4)
        table = table[table[:, :3].any(axis=1)]
        scans.append(PosedScan(table[:, :3], T, table[:, 3]))
    return scans


def _ptx_lines(scans: Sequence[PosedScan]) -> Iterator[str]:
    """Yield the lines of a PTX file; a scan without a grid is one column."""
    for scan in scans:
        yield f"1\n{len(scan.points)}\n"
        yield " ".join(f"{value:.12g}" for value in scan.T[:3, 3]) + "\n"
        for axis in scan.T[:3, :3].T:
            yield " ".join(f"{value:.12g}" for value in axis) + "\n"
        for row in scan.T.T:
            yield " ".join(f"{value:.12g}" for value in row) + "\n"
        for x, y, z in scan.points.tolist():
            yield f"{x:.7f} {y:.7f} {z:.7f} 0.500000\n"


def _read_las(path: Path) -> list[PosedScan]:
    laspy = _package("laspy", path)
    with path.open("rb"):
        pass
    content = laspy.read(path)
    has_values = _LAS_VALUE in content.point_format.extra_dimension_names
    values = np.asarray(content[_LAS_VALUE], dtype=np.float64) if has_values else None
    return [PosedScan(np.asarray(content.xyz, dtype=np.float64), np.eye(4), values)]


def _write_las(path: Path, scans: Sequence[PosedScan], kind: str) -> None:
    laspy = _package("laspy", path)
    points = np.concatenate([scan.points_in_file for scan in scans])
    header = laspy.LasHeader(version="1.4", point_format=6)
    header.generating_software = "scan-cell"
    header.scales = np.full(3, _LAS_STEP)
    header.offsets = np.round(points.mean(axis=0), 3) if len(points) else np.zeros(3)
    values = [scan.values for scan in scans if scan.values is not None]
    has_values = len(values) == len(scans) > 0
    if has_values:
        header.add_extra_dim(laspy.ExtraBytesParams(name=_LAS_VALUE, type=np.float64))
    content = laspy.LasData(header)
    content.x, content.y, content.z = points.T
    content.point_source_id = np.repeat([scan.number for scan in scans], [len(scan.points) for scan in scans])
    if has_values:
        content[_LAS_VALUE] = np.concatenate(values)
    with path.open("wb") as stream:
        content.write(stream, do_compress=kind == ".laz")
