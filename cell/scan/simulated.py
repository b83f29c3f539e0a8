"""`--acquire simulated`: rays are traced from where the scanner really is; its face, pixel and codes are known."""

import zlib

import numpy as np

from cell.acquisition import SIMULATED
from cell.acquisition.sources import Acquired, Context, View
from cell.errors import UsageError
from cell.runs.cell import RunCell
from cell.scan.options import ScanOptions
from cell.scan.pose_error import Disturbance
from cell.scan.sweep_scan import scan_of
from cell.session import Stream, random_stream
from planner.ports import Rejection


class Simulated:
    """Points of the virtual scanner.

    Attributes:
        source: "simulated".
    """

    source = SIMULATED

    def __init__(self, cell: RunCell, disturbance: Disturbance, seed: int) -> None:
        """Nothing is traced yet.

        Args:
            cell: part, surroundings and scanner.
            disturbance: noise and pose error.
            seed: of the disturbance.
        """
        if disturbance.part is not None:  # what does not carry the part stays where it is
            cell = cell.about_part(np.asarray(np.linalg.inv(disturbance.part), dtype=np.float64))
        self._cell, self._disturbance, self._seed = cell, disturbance, seed

    def take(self, view: View) -> Acquired:
        """Trace the rays of a view; its stop has streams of its own, so that one view alone is disturbed equally."""
        T_true, points, scans = scan_of(
            view.T_object_scanner, self._cell, self._disturbance, [self._seed, Stream.POSE_DISTURBANCE, view.stop],
            random_stream(self._seed, Stream.RANGE_NOISE, view.stop),
        )  # fmt: skip
        rays = len(scans[0].codes)
        rows, columns = scans[0].grid_shape
        codes = np.concatenate([seen.codes for seen in scans])
        kept = {
            "T_object_scanner_true": T_true[view.middle],
            "face": np.concatenate([seen.face for seen in scans]),
            "pixel": np.concatenate([seen.pixel + np.int32(line * rays) for line, seen in enumerate(scans)]),
            "grid_shape": np.array([rows * len(scans), columns], dtype=np.int64),
            "codes": codes,
            "counts": np.bincount(codes, minlength=len(Rejection)),
        }
        sweep = {} if len(T_true) == 1 else {"sweep_T_object_scanner_true": T_true[view.order]}
        return Acquired(points, "object", kept | sweep)


def simulated(argument: str, context: Context) -> Simulated:
    """The entry point.

    Raises:
        UsageError: if there is an argument.
    """
    if argument:
        raise UsageError(
            "--acquire simulated takes nothing behind it; its errors are --range-noise, --pose-error and --setup-error"
        )
    scene = context.cell.scene
    # A placement has a stream of its own, so that a part that is turned over is off in another direction.
    rng = random_stream(context.seed, Stream.PART_DISTURBANCE, zlib.crc32(scene.T_base_object.tobytes()))
    errors = Disturbance.of(ScanOptions.begun(context.options), scene.T_object_centre[:3, 3], rng)
    return Simulated(context.cell, errors, context.seed)
