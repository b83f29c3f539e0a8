"""`cell scan --actual`: an as-built mesh, which the simulated rays hit in place of the nominal part.

The mesh lies in the object frame, with the axes and the origin of the nominal part's file. The nominal part remains the
reference of coverage, registration and deviation. The planned motion was checked beside the nominal part: its proven
clearance minus the largest excess of the actual part is a clearance of the actual part, and has to remain positive.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np

from cell.errors import UsageError
from cell.part import workpiece
from cell.part.formats import own_units
from cell.part.workpiece import UNITS, Workpiece
from cell.runs.cell import RunCell
from cell.scan.options import ScanOptions
from planner.geometry.closest import ClosestPointQuery
from planner.registration.surface import sample_by_area

_SAMPLES = 50_000  # points of the actual surface, beside its vertices, whose distance to the nominal part is measured


def read_actual(options: ScanOptions) -> Workpiece | None:
    """Read the as-built mesh of an execution; None without one.

    Raises:
        UsageError: if its unit is missing.
        FileError: if it cannot be used.
    """
    if options.actual is None:
        return None
    if options.actual_units is None and own_units(options.actual.name) is None:
        raise UsageError(
            f"{options.actual} does not state its units; give --actual-units with one of {', '.join(UNITS)}"
        )
    return workpiece.load(options.actual, options.actual_units)


def manifest_keys(part: Workpiece | None) -> dict[str, str]:
    """Return the keys of the manifest beside the options: the sha256 of the file."""
    return {} if part is None else {"actual_sha256": part.sha256}


def as_scanned(cell: RunCell, options: Mapping[str, Any]) -> RunCell:
    """Return the cell of the simulated rays, from the options of a manifest.

    Raises:
        UsageError: if the file is not the one of the execution.
    """
    part = read_actual(ScanOptions.from_manifest(options))
    if part is None:
        return cell
    if part.sha256 != options.get("actual_sha256"):
        raise UsageError(
            f"{options['actual']} is not the file of this execution (its sha256 differs); restore it, or start a new "
            "execution"
        )
    return cell.with_surface(part.reference)


def require_clearance(part: Workpiece | None, cell: RunCell, clearance: float) -> None:
    """Refuse an actual part that reaches into the proven clearance of the motion.

    Args:
        part: the as-built part; None without one.
        cell: with the nominal part.
        clearance: proven lower bound of the motion [m].

    Raises:
        UsageError: with both lengths.
    """
    if part is None:
        return
    mesh = part.reference
    points = np.concatenate([mesh.vertices, sample_by_area(mesh, _SAMPLES, np.random.default_rng(0))])
    excess = float(ClosestPointQuery(cell.reference).signed_distance(points).max())
    if excess >= clearance:
        raise UsageError(
            f"the actual part reaches up to {1000 * excess:.2f} mm outside the nominal one, and the motion is proven "
            f"with {1000 * clearance:.2f} mm of clearance; check the frame and the units of its file, or plan for it"
        )
