"""RRT-Connect (Kuffner and LaValle 2000, doi:10.1109/ROBOT.2000.844730) on certified edges.

Two trees grow from start and goal towards random targets and towards each other. Every edge of a tree is a straight
joint segment between quantised configurations, certified by `planner.path.certified_edge`, so a path needs no later
check. Distances between configurations weigh each joint by its motion of arm and tool, so that steps and neighbours
are measured in metres rather than degrees. A share of the targets is drawn in narrow places, with an obstacle near on
two sides. There is no wrap-around: A4 at 350 and at -10 deg are different configurations, as for the real cable.
"""

import numpy as np

from planner.path.certified_edge import STEP, certify_many, quantise_inside
from planner.ports import CollisionChecker, JointLimits
from planner.values import Bools, Floats

_STEP_CHECKS = 32  # checks per tree edge: long enough for large batches, short enough to bend around a part
_FEWEST_CHECKS = 4  # a blocked step is tried once more at this length, to enter narrow gaps
_NEAR_SHARE = 0.6  # share of the targets drawn around the straight line; the rest covers the full joint range
_BEFORE_BRIDGES, _BRIDGE_SHARE = 20, 0.2  # rounds before narrow places are searched, and probability per round
_BRIDGES = 256  # bridges tested at once
_BRIDGE_LENGTH = (-2.0, -0.3)  # decimal logarithm of their half-lengths [m], 1 cm to 50 cm
_SLIDES, _SLIDE_STEPS = 40, 48  # most slides towards a narrow place, and random steps drawn for each
_FIRST_MARGIN, _LAST_MARGIN = 0.3, 1.5  # half-width of the box around the straight line, growing with the search [rad]


class _Tree:
    """Configurations with their parents, in growing arrays."""

    def __init__(self, root: Floats) -> None:
        self.q = np.empty((256, len(root)))
        self.parent = np.empty(256, dtype=np.int64)
        self.size = 0
        self.blocked: list[Floats] = []  # colliding configurations that ended a step
        self.add(root, -1)

    def add(self, q: Floats, parent: int) -> int:
        if self.size == len(self.q):
            self.q = np.concatenate((self.q, np.empty_like(self.q)))
            self.parent = np.concatenate((self.parent, np.empty_like(self.parent)))
        self.q[self.size], self.parent[self.size] = q, parent
        self.size += 1
        return self.size - 1

    def nearest(self, q: Floats, weights: Floats) -> int:
        return int((((self.q[: self.size] - q) * weights) ** 2).sum(axis=1).argmin())

    def branch(self, node: int) -> list[Floats]:
        """Return the configurations from the root to the node."""
        configurations = []
        while node >= 0:
            configurations.append(self.q[node])
            node = int(self.parent[node])
        return configurations[::-1]


def rrt_connect(
    q_from: Floats, q_to: Floats, checker: CollisionChecker, limits: JointLimits, rng: np.random.Generator, budget: int
) -> tuple[Floats | None, int]:
    """Search a path of certified edges between two free configurations.

    Args:
        q_from: (axes,) free, quantised [rad].
        q_to: (axes,) free, quantised [rad].
        checker: collision checker.
        limits: the joint range to search.
        rng: source of the random targets.
        budget: checks; the search ends with the step that reaches them.

    Returns:
        (m, axes) via points with both ends or None, and the checks. None only means that the budget is spent: the
        search is probabilistically complete, not exhaustive.
    """
    search = _Search(checker, limits, joint_weights(q_from, checker), rng)
    low, high = np.minimum(q_from, q_to), np.maximum(q_from, q_to)
    trees = [_Tree(q_from), _Tree(q_to)]
    grown, other, rounds, margin = 0, 1, 0, _FIRST_MARGIN
    gates: list[Floats] = []
    through_gate = False
    target = q_to
    while search.checks < budget:
        before = search.checks
        tip = search.advance(trees[grown], target)
        if through_gate:
            before = search.checks
            tip = search.slide(trees[grown], target)
        if tip >= 0:
            goal = trees[grown].q[tip].copy()
            meeting = search.advance(trees[other], goal)
            if meeting >= 0 and np.array_equal(trees[other].q[meeting], goal):
                from_start = trees[0].branch(tip if grown == 0 else meeting)
                from_goal = trees[1].branch(meeting if grown == 0 else tip)
                return np.array(from_start + from_goal[::-1][1:]), search.checks
        elif search.checks == before:
            search.checks += 1  # the target is a node already; count the round, so that the search ends
        grown, other = other, grown
        rounds += 1
        if not gates and rounds > _BEFORE_BRIDGES and rng.random() < _BRIDGE_SHARE:
            gates = search.bridges(trees, low - margin, high + margin)
        through_gate = bool(gates)
        if gates:
            target = gates.pop()
        elif rng.random() < _NEAR_SHARE:
            target = rng.uniform(np.maximum(low - margin, limits.lower), np.minimum(high + margin, limits.upper))
            margin = min(margin * 1.02, _LAST_MARGIN)
        else:
            target = rng.uniform(limits.lower, limits.upper)
        target = quantise_inside(target, limits)
    return None, search.checks


def joint_weights(q: Floats, checker: CollisionChecker) -> Floats:
    """Return (axes,) metres that arm and tool move per radian of each joint, at least 2 % of the largest."""
    nudged = q + 1e-3 * np.eye(len(q))
    weights = checker.travel(np.broadcast_to(q, nudged.shape), nudged) / 1e-3
    return np.maximum(weights, max(0.02 * float(weights.max()), 1e-6))


class _Search:
    """Steps that grow the trees, and the number of checks."""

    def __init__(
        self, checker: CollisionChecker, limits: JointLimits, weights: Floats, rng: np.random.Generator
    ) -> None:
        self.checker, self.limits, self.weights, self.rng = checker, limits, weights, rng
        self.spacing = 2.0 * STEP * checker.clearance
        self.checks = 0

    def free(self, q: Floats) -> Bools:
        self.checks += len(q)
        return self.checker.free(q)

    def certified(self, q_from: Floats, q_to: Floats) -> Bools:
        certified, used = certify_many(q_from, q_to, self.checker)
        self.checks += used
        return certified

    def bridges(self, trees: list[_Tree], low: Floats, high: Floats) -> list[Floats]:
        """Return free configurations in narrow places: middles of short bridges with colliding ends.

        This is the bridge test of Hsu, Jiang, Reif and Sun (2003, doi:10.1109/ROBOT.2003.1242285). One end is a place
        where a tree was blocked, or drawn from the box. Each configuration occurs twice, so that both trees get it as a
        target.
        """
        rng, limits = self.rng, self.limits
        low, high = np.maximum(low, limits.lower), np.minimum(high, limits.upper)
        hit = [q for tree in trees for q in tree.blocked[-_BRIDGES:]]
        samples = rng.uniform(low, high, (_BRIDGES if not hit else _BRIDGES // 4, len(low)))
        ends = samples[~self.free(samples)]
        if hit:
            ends = np.concatenate((ends, np.array(hit)[rng.integers(0, len(hit), _BRIDGES)]))
        lengths = 10.0 ** rng.uniform(*_BRIDGE_LENGTH, (len(ends), 1))
        others = ends + lengths * rng.standard_normal(ends.shape) / self.weights
        others = np.clip(others, limits.lower, limits.upper)
        if not len(ends):
            return []
        middles = quantise_inside(0.5 * (ends + others)[~self.free(others)], limits)
        return [middle for middle in middles[self.free(middles)] for _ in range(2)] if len(middles) else []

    def slide(self, tree: _Tree, target: Floats) -> int:
        """Grow the tree from its nearest node towards a target in a narrow place, sliding along obstacles.

        Random steps are drawn about the direction to the target; the certified one that ends nearest to it is taken,
        until none ends nearer or the straight segment is free. Returns the node nearest to the target.
        """
        rng, weights = self.rng, self.weights
        near = tree.nearest(target, weights)
        for _ in range(_SLIDES):
            q = tree.q[near].copy()
            ahead = (target - q) * weights
            distance = float(np.linalg.norm(ahead))
            if distance == 0.0:
                break
            lengths = self.spacing * 2.0 ** rng.integers(0, 4, (_SLIDE_STEPS, 1))
            noise = rng.standard_normal((_SLIDE_STEPS, len(q))) * rng.uniform(0.0, 1.0, (_SLIDE_STEPS, 1))
            steps = ahead / distance + noise
            steps *= np.minimum(lengths, distance) / np.linalg.norm(steps, axis=1, keepdims=True)
            ends = quantise_inside(q + steps / weights, self.limits)
            left = np.linalg.norm((target - ends) * weights, axis=1)
            ends = ends[np.argsort(left, kind="stable")[: int((left < distance - 0.1 * self.spacing).sum())]]
            if not len(ends):
                break
            ends = ends[self.free(ends)]
            step = next((end for end in ends[:3] if self.certified(q[None], end[None])[0]), None)
            if step is None:
                break
            near = tree.add(step, near)
            if (tip := self.advance(tree, target)) >= 0:
                near = tip
        return near

    def advance(self, tree: _Tree, target: Floats) -> int:
        """Grow the tree from its nearest node straight towards the target until a step is blocked.

        Returns the last added node, or the node that is the target already; -1 if the first step is blocked.
        """
        near = tree.nearest(target, self.weights)
        q = tree.q[near].copy()
        if np.array_equal(q, target):
            return near
        travel = float(self.checker.travel(q[None], target[None])[0])
        steps = max(1, int(np.ceil(travel / (_STEP_CHECKS * self.spacing))))
        stops = self.stops(q, target, steps)
        tip, n_done, size = near, 0, 1
        while n_done < len(stops) - 1:
            batch = stops[n_done : n_done + size + 1]
            count = self.free_prefix(batch)
            for stop in batch[1 : count + 1]:
                tip = tree.add(stop, tip)
            if count < len(batch) - 1:
                self.remember_blocked(tree, batch[count + 1])
                break
            n_done, size = n_done + size, size * 2
        if tip == near:
            short = self.stops(q, target, max(steps, int(np.ceil(travel / (_FEWEST_CHECKS * self.spacing)))))[:2]
            if len(short) == 2 and not np.array_equal(short[1], stops[1]):
                if self.free_prefix(short):
                    return tree.add(short[1], near)
                self.remember_blocked(tree, short[1])
        return tip if tip != near else -1

    def remember_blocked(self, tree: _Tree, q: Floats) -> None:
        """Remember the end of a blocked step if it collides itself."""
        if not self.free(q[None])[0]:
            tree.blocked.append(q)

    def stops(self, q: Floats, target: Floats, steps: int) -> Floats:
        """Return (k, axes) quantised configurations from q to the target without repeats; k <= steps + 1."""
        stops = quantise_inside(q + np.arange(steps + 1)[:, None] / steps * (target - q), self.limits)
        stops[0], stops[-1] = q, target
        return stops[np.concatenate(([True], (np.diff(stops, axis=0) != 0).any(axis=1)))]

    def free_prefix(self, stops: Floats) -> int:
        """Return the number of certified edges at the beginning of a chain; stops[0] is free."""
        count = _n_leading(self.free(stops[1:]))
        return _n_leading(self.certified(stops[:count], stops[1 : count + 1])) if count else 0


def _n_leading(flags: Bools) -> int:
    """Return the number of True values before the first False."""
    return len(flags) if flags.all() else int(flags.argmin())
