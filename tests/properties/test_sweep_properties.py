"""Properties of swept line sensors."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from cell.scanners.laser_line import LaserLine
from planner.ports import Rejection

MEASURED = Rejection.MEASURED


def _in_pose(points: np.ndarray, normals: np.ndarray, T: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    return (points - T[:3, 3]) @ T[:3, :3], normals @ T[:3, :3]


def _by_pose(scanner: LaserLine, points: np.ndarray, normals: np.ndarray) -> np.ndarray:
    """Return (K, N) whether each pose has each point in view; the viewpoint is the identity."""
    return np.array([scanner.reject(*_in_pose(points, normals, T)) == MEASURED for T in scanner.T_view_scanner])


def _bumpy(rng: np.random.Generator, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Return points with normals that mostly face the scanner, in and about its volume."""
    points = rng.uniform([-0.15, -0.12, 0.2], [0.15, 0.12, 0.45], size=(count, 3))
    normals = rng.normal(size=(count, 3)) * 0.8 - [0, 0, 1]
    return points, normals / np.linalg.norm(normals, axis=1, keepdims=True)


_sweeps = st.one_of(
    st.fixed_dictionaries({"sweep_mm": st.floats(5, 300)}), st.fixed_dictionaries({"sweep_deg": st.floats(1, 90)})
)


@given(sweep=_sweeps, steps=st.integers(1, 24), seed=st.integers(0, 2**32 - 1))
def test_the_poses_tile_the_sweep(sweep: dict, steps: int, seed: int) -> None:
    """If only the sheet decides, each point of the swept volume belongs to exactly one pose, any other to none."""
    scanner = LaserLine(
        fan_deg=179, range_mm=(0.001, 5000), baseline_mm=0, grazing_max_deg=90, sweep_steps=steps, **sweep
    )
    rng = np.random.default_rng(seed)
    points, _ = _bumpy(rng, 300)
    normals = -points / np.linalg.norm(points, axis=1, keepdims=True)
    poses = scanner.T_view_scanner
    count = np.zeros(len(points), dtype=int)
    for T in poses:
        local, _ = _in_pose(points, normals, T)
        facing = -local / np.linalg.norm(local, axis=1, keepdims=True)
        count += scanner.reject(local, facing) == MEASURED
    if "sweep_mm" in sweep:
        place, half = points[:, 0], sweep["sweep_mm"] / 2000
    else:
        place, half = np.arctan2(points[:, 0], points[:, 2]), np.radians(sweep["sweep_deg"] / 2)
    cells = (place + half) / (2 * half) * steps
    clear = np.abs(cells - np.round(cells)) > 1e-6
    assert (count[clear] == (np.abs(place) < half)[clear]).all()


@given(sweep=_sweeps, steps=st.integers(4, 16), finer=st.integers(2, 6), seed=st.integers(0, 2**32 - 1))
def test_refining_a_sweep_changes_only_what_is_undecided_within_half_a_step(
    sweep: dict, steps: int, finer: int, seed: int
) -> None:
    """A sample measured with K poses and not with more (or the other way) passes a limit within half a coarse step."""
    rng = np.random.default_rng(seed)
    points, normals = _bumpy(rng, 1500)
    keys = {"fan_deg": 30.0, "range_mm": (250, 400), "baseline_mm": 120, "sensor_grazing_max_deg": 80, **sweep}
    coarse = LaserLine(sweep_steps=steps, **keys)
    fine = LaserLine(sweep_steps=steps * finer, **keys)
    other = _by_pose(coarse, points, normals).any(axis=0) != _by_pose(fine, points, normals).any(axis=0)
    if not other.any():
        return
    points, normals = points[other], normals[other]
    # The same law with one thick sheet, at poses within half a step to either side of each sample's pose.
    offsets = np.linspace(-0.5, 0.5, 81)
    step = next(iter(sweep.values())) / steps
    verdicts = []
    for share in offsets:
        if "sweep_mm" in sweep:
            thick = LaserLine(**{**keys, "sweep_mm": 1000.0}, sweep_steps=1)
            local = points - np.stack([points[:, 0] + share * step / 1000, 0 * points[:, 0], 0 * points[:, 0]], axis=1)
            facing = normals
        else:
            thick = LaserLine(**{**keys, "sweep_deg": 170.0}, sweep_steps=1)
            turn = np.arctan2(points[:, 0], points[:, 2]) + share * np.radians(step)
            cos, sin = np.cos(turn), np.sin(turn)
            local = np.stack([cos * points[:, 0] - sin * points[:, 2], points[:, 1],
                              sin * points[:, 0] + cos * points[:, 2]], axis=1)  # fmt: skip
            facing = np.stack([cos * normals[:, 0] - sin * normals[:, 2], normals[:, 1],
                               sin * normals[:, 0] + cos * normals[:, 2]], axis=1)  # fmt: skip
        verdicts.append(thick.reject(local, facing) == MEASURED)
    undecided = np.any(verdicts, axis=0) & ~np.all(verdicts, axis=0)
    # A limit passed between two of the 81 offsets and back again may be missed, rarely.
    assert undecided.sum() >= 0.98 * len(undecided) - 1


@given(
    key=st.sampled_from(["fan_deg", "range_mm", "grazing_max_deg", "sensor_grazing_max_deg", "sweep"]),
    sweep=_sweeps,
    seed=st.integers(0, 2**32 - 1),
)
def test_a_wider_limit_never_loses_a_sample(key: str, sweep: dict, seed: int) -> None:
    """Wider fan, range, grazing limits and (with the same step and middle) sweep keep every sample."""
    keys = {"fan_deg": 25.0, "range_mm": (250, 380), "grazing_max_deg": 50, "sensor_grazing_max_deg": 60, **sweep}
    wider: dict = {"fan_deg": 32.0, "range_mm": (240, 400), "grazing_max_deg": 65, "sensor_grazing_max_deg": 75}
    steps = 5
    points, normals = _bumpy(np.random.default_rng(seed), 2000)
    before = _by_pose(LaserLine(sweep_steps=steps, **keys), points, normals).any(axis=0)
    if key == "sweep":  # two more poses of the same step at either end
        name, value = next(iter(sweep.items()))
        after_scanner = LaserLine(**{**keys, name: value * 9 / steps}, sweep_steps=9)
    else:
        after_scanner = LaserLine(**{**keys, key: wider[key]}, sweep_steps=steps)
    after = _by_pose(after_scanner, points, normals).any(axis=0)
    assert not (before & ~after).any()
