"""Causes of points off the part are named: unit, mirrored frame, swapped views, flange frame."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from cell.part import workpiece
from cell.runs.run import ExecutedScan
from cell.scan import point_checks
from cell.scan.simulated import Disturbance
from cell.scanners.laser_area import LaserArea
from cell.world import virtual_scan
from cell.world.embree import EmbreeRayCaster
from planner.geometry.closest import ClosestPointQuery
from planner.geometry.decimation import decimate
from planner.geometry.mesh import TriangleMesh
from planner.kinematics.frames import pose_from_kuka_abc
from planner.viewpoints.viewpoints import enclosing_radius, optimal_scanning_zone

BUILT_IN = ("mseke", "mug", "robinet", "petanque", "humerus", "st-jean")
CAUSES = {
    "metres": "their unit is m, not mm",
    "inches": "their unit is in, not mm",
    "mirrored": "mirrored in x",
    "swapped": "given as view",
    "flange": "in the flange frame, not in the scanner frame",
}
T_FLANGE_SCANNER = pose_from_kuka_abc(np.array([0.0, 0.0, 0.12]), np.zeros(3))


def scans_of(part: workpiece.Workpiece, views: int = 8) -> tuple[list[ExecutedScan], Any, ClosestPointQuery]:
    """Return scans with noise of 0.03 mm and pose errors of 0.5 mm and 0.1 deg, a cell, and the closest-point query."""
    mesh = TriangleMesh(part.reference.vertices, part.reference.faces)
    standoff = max(0.03, 1.5 * enclosing_radius(mesh, part.centre))
    keys = {"fov_deg": [60.0, 60.0], "range_mm": [500 * standoff, 1500 * standoff]}
    scanner = LaserArea(**keys, resolution_deg=(2.0, 2.0), baseline_mm=250 * standoff, grazing_max_deg=75.0)
    poses = optimal_scanning_zone(decimate(mesh, 60), (standoff,), (0.0,)).T_object_scanner[:, 0]
    caster, nowhere = (
        EmbreeRayCaster(mesh.vertices, mesh.faces),
        EmbreeRayCaster(np.array([[90.0, 90, 90], [91, 90, 90], [90, 91, 90]]), np.array([[0, 1, 2]])),
    )
    disturbance, rng = Disturbance(3e-5, 5e-4, np.radians(0.1)), np.random.default_rng(0)
    scans = []
    for number, T in enumerate(poses[rng.permutation(len(poses))], start=1):
        true = disturbance.true_pose(T, rng)
        seen = virtual_scan.scan(scanner, true, caster, mesh, nowhere)
        if len(seen.points) < 50:
            continue
        points = disturbance.reported_points(seen.points, true, T, scanner.source, rng)
        still = np.zeros(6)
        scans.append(
            ExecutedScan(number, number, still, still, T, T[None], None, None, points, None, "files", "scanner")
        )
        if len(scans) == views:
            break
    T_base_object = pose_from_kuka_abc(np.array([1.2, 0.5, 0.0]), np.radians([30.0, 0.0, 0.0]))
    scene = SimpleNamespace(T_flange_scanner=T_FLANGE_SCANNER, T_base_object=T_base_object)
    cell = SimpleNamespace(
        reference=mesh, scene=scene, scanner_keys=SimpleNamespace(own=keys), in_base=lambda q, T: T
    )  # fmt: skip
    return scans, cell, ClosestPointQuery(mesh)


def spoilt(scans: list[ExecutedScan], cause: str) -> list[ExecutedScan]:
    """Return the scans as they arrive with the given cause of error."""
    raw = []
    for scan in scans:
        back = np.linalg.inv(scan.T_reported)
        raw.append(scan.points @ back[:3, :3].T + back[:3, 3])
    change = {
        "metres": lambda points: points / 1000,
        "inches": lambda points: points / 25.4,
        "mirrored": lambda points: points * [-1, 1, 1],
        "flange": lambda points: points + T_FLANGE_SCANNER[:3, 3],
    }
    if cause == "swapped":
        raw[0], raw[1] = raw[1], raw[0]
    elif cause:
        raw = [change[cause](points) for points in raw]
    found = []
    for scan, points in zip(scans, raw, strict=True):
        T = scan.T_reported
        in_base = points @ T[:3, :3].T + T[:3, 3]
        found.append(
            ExecutedScan(scan.stop, scan.view, scan.q_commanded, scan.q_reported, T, T[None], None, None, in_base, None,
                         "files", "scanner")
        )  # fmt: skip
    return found


def report_causes(part: workpiece.Workpiece) -> dict[str, list[str]]:
    """Return the reported sentences for each cause, and for scans without an error."""
    scans, cell, nearest = scans_of(part)
    return {
        cause: point_checks.find_contradictions(spoilt(scans, cause), cell, nearest, "mm") for cause in ("", *CAUSES)
    }


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=() if name == "mug" else pytest.mark.slow) for name in BUILT_IN]
)
def test_each_cause_is_named_and_nothing_where_all_is_well(name: str) -> None:
    """Each cause is named despite noise and pose errors, and correct scans are not reported."""
    output = report_causes(workpiece.load(name))
    assert output.pop("") == []
    if name == "humerus":
        assert output.pop("swapped") == []
    wrong = {cause: sentences for cause, sentences in output.items() if CAUSES[cause] not in " ".join(sentences)}
    assert wrong == {}


def test_points_without_a_given_unit_are_in_metres() -> None:
    """The other units are tested, and the sentence names both."""
    T, still, points = np.eye(4), np.zeros(6), np.ones((1, 3))
    scan = ExecutedScan(1, 1, still, still, T, T[None], None, None, points, None, "plug-in", "scanner")
    scene = SimpleNamespace(T_flange_scanner=T, T_base_object=T)
    cell: Any = SimpleNamespace(scene=scene, in_base=lambda q, T: T)
    causes = dict(point_checks._hypotheses([points], [scan], cell, None))
    np.testing.assert_allclose(causes["their unit is mm, not m"], [0.001 * points])
    assert not any(cause.startswith("their unit is m,") for cause in causes)
