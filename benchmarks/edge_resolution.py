"""Fixed steps along straight joint moves compared with certification: time, missed contacts, false refusals.

For the truth, straight moves between reachable set-points of seeded scenes are checked at every millimetre of travel:
in contact, closer than the clearance, or free. A fixed step checks at equal angles of the joint that turns most, for
contact (as is usual) or for the clearance (as our checks do). `planner.path.certified_edge.certify` takes the number of
steps that the bound on travel requires. The time is the number of checks times the measured time of one check; a
collision ends the move in both cases.
"""

from time import process_time
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.seeded_scenes import SeededCell, usable
from cell.world.collision import MujocoCollisionChecker
from cell.world.model import compile_world
from planner.path.certified_edge import certify
from planner.values import Floats

_SCENES, _MOVES = 4, 60
_TRUTH = 1e-3  # m of travel
_STEPS_DEG = (0.25, 0.5, 1.0, 2.0, 4.0, 8.0, 16.0, 32.0)


def run() -> list[dict[str, Any]]:
    """Return one row for each method of checking."""
    moves = [move for number in range(_SCENES) for move in _moves(number)]
    contact, near = (np.array([bool(truth[k].any()) for *_, truth, _, _ in moves]) for k in (0, 1))
    check = float(np.median([seconds for *_, seconds in moves]))
    certified = np.array([passed for *_, (passed, _), _ in moves])
    checks = np.array([count for *_, (_, count), _ in moves])
    rows = [_row("certified", "", certified, checks, contact, near, check)]
    for look, which in (("clearance", 1), ("contact", 0)):
        for degrees in _STEPS_DEG:
            passed, counts = zip(*(_fixed(q, truth[which], degrees) for q, truth, _, _ in moves), strict=True)
            rows.append(_row(f"fixed step, {look}", degrees, np.array(passed), np.array(counts), contact, near, check))
    return rows


def _row(
    method: str, step: float | str, passed: NDArray[Any], checks: NDArray[Any], contact: NDArray[Any],
    near: NDArray[Any], seconds: float,
) -> dict[str, Any]:  # fmt: skip
    return {
        "method": method,
        "step deg": step,
        "moves": len(passed),
        "in contact": int(contact.sum()),
        "contacts missed": int((passed & contact).sum()),
        "too near, missed": int((passed & near).sum()),
        "free moves refused": int((~passed & ~near).sum()),
        "checks a move": float(checks.mean()),
        "ms a move": 1000 * seconds * float(checks.mean()),
    }


def _moves(number: int) -> list[tuple[Floats, NDArray[np.bool_], tuple[bool, int], float]]:
    """Return moves of one scene: configurations every millimetre, the truth there, verdict, time of a check."""
    cell = usable(number, least=4)
    touching = _without_clearance(cell)
    rng, q = np.random.default_rng(number), cell.reach.q
    found = []
    for i, j in rng.integers(0, len(q), (_MOVES, 2)):
        n = 1 + int(np.ceil(cell.checker.travel(q[i][None], q[j][None])[0] / _TRUTH))
        dense = q[i] + np.linspace(0.0, 1.0, n + 1)[:, None] * (q[j] - q[i])
        begin = process_time()
        near = ~cell.checker.free(dense)
        seconds = (process_time() - begin) / len(dense)
        contact = np.zeros_like(near)
        contact[near] = ~touching.free(dense[near])
        found.append((dense, np.stack([contact, near]), certify(q[i], q[j], cell.checker), seconds))
    return found


def _without_clearance(cell: SeededCell) -> MujocoCollisionChecker:
    """Return the checker of the same scene for contact only."""
    scene = cell.world.scene.model_copy(update={"clearance_mm": 0.0})
    return MujocoCollisionChecker(compile_world(scene, cell.part.vertices, baseline_mm=75.0))


def _fixed(dense: Floats, hit: NDArray[np.bool_], degrees: float) -> tuple[bool, int]:
    """Return verdict and checks of evenly spaced configurations, in order until one collides."""
    turned = np.degrees(np.abs(dense[-1] - dense[0]).max())
    count = max(1, int(np.ceil(turned / degrees)))
    looked = hit[np.round(np.linspace(0, len(dense) - 1, count + 1)).astype(int)]
    return (not looked.any()), (int(looked.argmax()) + 1 if looked.any() else count + 1)


def chart(rows: list[dict[str, Any]], folder: Any) -> None:
    """Draw missed contacts over the time of a move: fixed steps as lines, certification as a point."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(figsize=(7.5, 4.8))
    for method, colour in (("fixed step, contact", "C3"), ("fixed step, clearance", "C1")):
        points = [row for row in rows if row["method"] == method]
        share = [100 * row["contacts missed"] / row["in contact"] for row in points]
        axes.plot([row["ms a move"] for row in points], share, "o-", color=colour, label=f"{method} looked for")
        if method.endswith("contact"):  # the other line's steps lie below the same marks
            for row, y in zip(points, share, strict=True):
                axes.annotate(
                    f"{row['step deg']:g}°",
                    (row["ms a move"], y),
                    xytext=(4, 6),
                    textcoords="offset points",
                    fontsize=8,
                )
    point = next(row for row in rows if row["method"] == "certified")
    axes.plot(
        point["ms a move"], 100 * point["contacts missed"] / point["in contact"], "s", color="C0", ms=8,
        label="certified by the bound on travel",
    )  # fmt: skip
    axes.set(xscale="log", xlabel="time of checking a move [ms]", ylabel="moves in contact that pass as free [%]")
    axes.grid(alpha=0.3)
    axes.legend()
    figure.tight_layout()
    figure.savefig(folder / "edge_resolution.png", dpi=150)
    plt.close(figure)
