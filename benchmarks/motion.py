"""Order against the Christofides baseline and against the budget; certification of paths; narrow gaps.

All instances are seeded and synthetic: joint solutions drawn in the KR 16's range, obstacles as boxes in a space in
which travel and distance are known exactly. Times are of this machine and this moment, durations and counts are not.
"""

from __future__ import annotations

from time import perf_counter
from typing import Any

import numpy as np
from numpy.typing import NDArray

from planner.order.moves import Moves
from planner.order.orderings import sequence
from planner.path.certified_edge import certify
from planner.path.path import PathStatus, connect
from planner.ports import JointLimits

Floats = NDArray[np.float64]

LIMITS = JointLimits(
    lower=np.radians([-185, -155, -130, -350, -130, -350]),
    upper=np.radians([185, 35, 154, 350, 130, 350]),
    velocity=np.radians([156, 156, 156, 330, 330, 615]),
    acceleration=np.radians([312, 312, 312, 660, 660, 1230]),
)
HOME = np.radians([0.0, -90, 90, 0, 90, 0])


class Boxes:
    """A point that moves 1 m per rad of A1..A3 and 0.1 m per rad of A4..A6, between boxes of that space."""

    clearance = 0.01
    scale = np.array([1, 1, 1, 0.1, 0.1, 0.1])

    def __init__(self, *boxes: tuple[list[float], list[float]]) -> None:
        self.low, self.high = (np.array([box[side] for box in boxes]) for side in (0, 1))

    def distances(self, q: Floats) -> Floats:
        """(N, boxes) distance to each box [m]."""
        q = q * self.scale
        outside = np.maximum(np.maximum(self.low - q[:, None], q[:, None] - self.high), 0.0)
        return np.asarray(np.linalg.norm(outside, axis=2))

    def free(self, q: Floats) -> NDArray[np.bool_]:
        """As the protocol."""
        return np.asarray((self.distances(q) >= self.clearance).all(axis=1))

    def contacts(self, q: Floats) -> tuple[str, ...]:
        """As the protocol."""
        near = self.distances(q[None])[0]
        return tuple(f"point with box {k}" for k in np.argsort(near) if near[k] < self.clearance)

    def distance(self, q: Floats) -> tuple[Floats, tuple[str, ...]]:
        """As the protocol."""
        near = self.distances(q)
        return near.min(axis=1), tuple(f"point with box {k}" for k in near.argmin(axis=1))

    def travel(self, q_from: Floats, q_to: Floats) -> Floats:
        """As the protocol."""
        return np.asarray(np.linalg.norm((q_to - q_from) * self.scale, axis=1))


def gate(half_width: float, half_depth: float = 0.02) -> Boxes:
    """A wall across A1 = 0 with a gate in A2 at -1 rad."""
    low, high = [-half_depth, -100.0, *[-100.0] * 4], [half_depth, 100.0, *[100.0] * 4]
    below, above = high.copy(), low.copy()
    below[1], above[1] = -1.0 - half_width, -1.0 + half_width
    return Boxes((low, below), (above, high))


def views(seed: int, n: int, solutions: int) -> tuple[list[Floats], Floats]:
    """Joint solutions of views that lie near each other in joint space, and scanner positions that say so."""
    rng = np.random.default_rng(seed)
    centres = HOME + rng.uniform(-1.0, 1.0, (n, 6))
    poses = np.tile(np.eye(4), (n, 1, 1))
    poses[:, :3, 3] = centres[:, :3] * 0.5
    spread = rng.uniform(-1.0, 1.0, (n, solutions, 6)) * [0.1, 0.1, 0.1, 3.0, 1.0, 4.0]
    return [np.clip(c + s, LIMITS.lower, LIMITS.upper) for c, s in zip(centres, spread, strict=True)], poses


def run() -> list[dict[str, Any]]:
    """Rows of the three tables: `order`, `certify` and `gate`."""
    return [*_order(), *_certify(), *_gates()]


def _order() -> list[dict[str, Any]]:
    rows = []
    for n in (8, 15, 25, 40):
        for budget in (0, 1000, 10_000):
            found, seconds = [], []
            for seed in range(3):
                configurations, poses = views(seed, n, 24)
                start = perf_counter()
                rng = np.random.default_rng(seed)
                found.append(sequence(Moves.straight(configurations, HOME, LIMITS), poses, rng, budget=budget))
                seconds.append(perf_counter() - start)
            rows.append(
                {
                    "case": f"order {n} views x 24 solutions",
                    "budget": budget,
                    "seconds": float(np.mean(seconds)),
                    "over baseline": float(np.mean([s.duration / s.baseline_duration for s in found])),
                    "over lower bound": float(np.mean([s.duration / s.lower_bound for s in found])),
                    "status": "/".join(sorted({s.status.name for s in found})),
                }
            )
    return rows


def _certify() -> list[dict[str, Any]]:
    """Straight moves between random configurations beside boxes: verdicts against a ten times finer look."""
    rng = np.random.default_rng(0)
    corners = rng.uniform(LIMITS.lower * Boxes.scale, LIMITS.upper * Boxes.scale, (24, 6))
    checker = Boxes(*((list(c - 0.6), list(c + 0.6)) for c in corners))
    q = rng.uniform(LIMITS.lower, LIMITS.upper, (800, 6))
    q = q[checker.free(q)][:600]
    checks = certified = missed = refused = 0
    seconds = 0.0
    for a, b in zip(q[:300], q[300:], strict=True):
        start = perf_counter()
        free, used = certify(a, b, checker, ends_free=True)
        seconds += perf_counter() - start
        checks += used
        certified += free
        n = 10 * (1 + int(checker.travel(a[None], b[None])[0] / (0.9 * checker.clearance)))
        nearest = float(checker.distances(a + np.linspace(0, 1, n)[:, None] * (b - a)).min())
        missed += free and nearest <= 0.0
        refused += not free and nearest >= checker.clearance
    return [
        {
            "case": "certify 300 random moves",
            "seconds": seconds,
            "checks": checks,
            "certified": certified,
            "contacts missed": missed,
            "free moves refused": refused,
        }
    ]


def _gates() -> list[dict[str, Any]]:
    rows = []
    start, goal = np.radians([-40.0, -40, 40, 0, 20, 0]), np.radians([40.0, -70, 60, 90, 20, 0])
    for beyond_mm in (20, 10, 5, 3):
        found, seconds = [], []
        for seed in range(8):
            begin = perf_counter()
            checker = gate(Boxes.clearance + beyond_mm / 1000)
            found.append(connect(start, goal, checker, LIMITS, np.random.default_rng(seed), measure=False))
            seconds.append(perf_counter() - begin)
        paths = [p for p in found if p.status is PathStatus.DETOUR]
        rows.append(
            {
                "case": f"gate {beyond_mm} mm wider than the clearance on each side",
                "budget": 40_000,
                "seconds": float(np.mean(seconds)),
                "checks": int(np.median([p.checks for p in found])),
                "found": f"{len(paths)} of {len(found)}",
                "via points": float(np.mean([len(p.via) for p in paths if p.via is not None])) if paths else 0.0,
                "path time s": float(np.mean([p.duration for p in paths])) if paths else 0.0,
            }
        )
    return rows


def chart(rows: list[dict[str, Any]], folder: Any) -> None:
    """Cycle time over the Christofides baseline, against the ordering's time."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(figsize=(7, 4.5))
    cases = dict.fromkeys(row["case"] for row in rows if row["case"].startswith("order"))
    for case in cases:
        points = [row for row in rows if row["case"] == case]
        axes.plot([row["seconds"] for row in points], [row["over baseline"] for row in points], "o-", label=case[6:])
    axes.set(xscale="log", xlabel="time of the ordering [s]", ylabel="motion time / Christofides baseline")
    axes.grid(alpha=0.3)
    axes.legend()
    figure.tight_layout()
    figure.savefig(folder / "motion_order.png", dpi=150)
    plt.close(figure)
