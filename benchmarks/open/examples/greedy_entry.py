"""An entry written from docs/benchmark.md alone: greedy selection from random poses, track `free` of tier A.

    python greedy_entry.py [INSTANCE ...]

Poses look at random points of the surface from random directions near their normals. The greedy rule selects on 4,000
own samples; the goal is raised until 40,000 others hold the requirement. Needs numpy and check.py.
"""

import json
import sys
import time
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
import check

NAME, TARGET, N_POSES = "example-greedy", 0.99, 400


def random_poses(instance, count, rng):
    """Return allowed poses (count, 3, 4) that look at random points of the surface."""
    near, far = instance.sensor["depth_mm"] or instance.sensor["range_mm"]
    found = []
    while len(found) < count:
        points, normals, _ = instance.surface.draw(count, int(rng.integers(2**31)))
        for point, normal in zip(points, normals, strict=True):
            outward = normal + 0.5 * rng.standard_normal(3)
            outward /= np.linalg.norm(outward)
            x = np.cross(outward, rng.standard_normal(3))
            x /= np.linalg.norm(x)
            R = np.column_stack([x, np.cross(-outward, x), -outward])
            pose = np.column_stack([R, point + rng.uniform(near, far) * outward])
            if not instance.pose_fault(pose):
                found.append(pose)
    return np.array(found[:count])


def greedy(M, goal):
    """Return columns of M (poses, samples) that measure the goal, or all that can be measured."""
    left, chosen = np.ones(M.shape[1], dtype=bool), []
    while 1 - left.mean() < goal:
        gains = M[:, left].sum(axis=1)
        if gains.max() == 0:
            break
        chosen.append(int(gains.argmax()))
        left &= ~M[chosen[-1]]
    return chosen


def entry(name):
    """Return the entry of an instance; None if the random poses do not suffice."""
    since = time.process_time()
    instance, rng = check.load(name), np.random.default_rng(0)
    poses = random_poses(instance, N_POSES, rng)
    points, normals, _ = instance.surface.draw(4000, 1)
    M = instance.measured_by(poses, points, normals, each=True)
    points, normals, _ = instance.surface.draw(40_000, 2)
    required = goal = TARGET * instance.data["reference"] + 0.0005
    while True:
        views = poses[greedy(M, goal)]
        share = instance.measured_by(views, points, normals).mean()
        if share >= required:
            break
        if goal >= M.any(axis=0).mean():
            return None
        goal += required - share
    seconds = round(time.process_time() - since, 2)
    about = {"instance": name, "target": TARGET, "track": "free", "cpu_s": seconds}
    return about | {"poses": np.round(views, 9).reshape(-1, 12).tolist()}


def main():
    """Write the result file."""
    names = sys.argv[1:] or ["A-mug-area", "A-humerus-area", "A-bracket-area"]
    content = {
        "name": NAME, "authors": "scan-cell", "date": "2026-11-27", "method": "Greedy over 400 random poses.",
        "hardware": "one core", "entries": [found for name in names if (found := entry(name)) is not None],
    }  # fmt: skip
    path = check.HERE / "results" / f"{NAME}.json"
    path.write_text(json.dumps(content) + "\n")
    for row in check.judge_file(path):
        sys.stdout.write(f"{row['instance']}: {row.get('fault') or row['value']}, {row['cpu_s']} s\n")


if __name__ == "__main__":
    main()
