"""Direction table: free directions of surface samples, so that a pose is evaluated without casting rays.

Seen from a sample, whether a position beyond all occluders is visible depends on its direction only. The table has two
bits per sample and direction: whether it is free, and whether a neighbouring direction differs. Directions are the
nodes of an octahedral grid of the hemisphere about the normal (Cigolle et al. 2014,
https://jcgt.org/published/0003/02/01/): a look-up needs two sums and a division. Both lines of sight of a pose, of the
source and of the sensor, are looked up at the nearest node.

The grid is turned about the normal by another angle for each sample. Otherwise parallel faces would round the same
direction to the same side, and views along an axis would be wrong on all of them together.

The table is built from coarse to fine. Of a sample that is free in all directions of the first level, no more nodes are
cast. Of the others, all nodes of the second level are, and finer ones whose coarser neighbours differ. An occluder
between these nodes may be missed. Sensors are outside the convex hull of the part, but may be between the part and a
post, floor or fixture. Samples near such an occluder have further tables, one for each of `N_RANGES` ranges of
distance. Views often look just past an edge, which is too fine for the grid. Sums of weights use the tables all the
same, but `measured` casts exact rays where a node has a neighbour that differs from it. Object frame, metres.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from planner.compiled import compiled
from planner.interrupts import raise_interrupt
from planner.ports import AreaLimits, DirectionCaster, RayCaster, Scanner
from planner.threads import run_in_threads
from planner.values import Bools, Floats, Ints, Ints32, Value
from planner.viewpoints.lines_of_sight import RayTargets, in_view_matrix

N_NODES = 33
"""Nodes along each axis of the grid: 5.6 degrees between neighbours."""

N_RANGES = 4
"""Ranges of distance between sample and source or sensor, each with its own table of occluders."""

_COARSEST = 4  # nodes between two nodes of the first level; a power of two
_GOLDEN = (np.sqrt(5.0) - 1) / 2
_TOGETHER = 2048  # samples whose nodes are cast together: arrays of 30 MB
_IN_ONE_THREAD = 20_000  # pairs of a pose and a sample; a few tenths of a millisecond
_PAIRS = 200_000  # of a pose and a sample that are evaluated together where the scanner has no compiled limits
_UNKNOWN, _TO_CAST = 2, 3  # besides 0, occluded, and 1, free
_FREE, _EDGE = 1, 2  # bits of a node
# Marks of a pose and a row besides 0, not measured, and 1, measured: lines of sight near an edge of the part or of
# occluders.
_SOURCE_PART, _SENSOR_PART, _SOURCE_OTHERS, _SENSOR_OTHERS = 2, 4, 8, 16
_BLOCK = 64  # rows that are evaluated together

Floats32 = NDArray[np.float32]
Bytes = NDArray[np.uint8]


@dataclass(frozen=True, slots=True, eq=False)
class DirectionTable(Value):
    """Free directions of S samples, with the scanner whose poses are evaluated.

    Attributes:
        targets: the S samples.
        frames: (S, 12) point [m], normal, tangent and bitangent of each sample.
        nodes: (S, B) packed nodes: whether the part leaves them free, and whether they have a neighbour that differs.
        casters: of the part and of everything else.
        near: (S,) row of each sample in `near_nodes`; -1: no occluder is near.
        near_nodes: (M, N_RANGES, B) the same for occluders, for each range of distance; the next range is a neighbour.
        ranges: (2,) beginning [m] of the first range, and number of ranges for each metre.
        scanner: sensor model.
        limits: (13,) compiled limits of the scanner; None: its `reject` is called.
    """

    targets: RayTargets
    frames: Annotated[Floats32, "S 12"]
    nodes: Annotated[Bytes, "S B"]
    casters: Sequence[RayCaster]
    near: Annotated[Ints, "S"]
    near_nodes: Annotated[Bytes, "M R B"]
    ranges: Annotated[Floats32, "2"]
    scanner: Scanner
    limits: Annotated[Floats32, "13"] | None

    @classmethod
    def build(
        cls,
        targets: RayTargets,
        scanner: Scanner,
        part: DirectionCaster,
        occluders: Sequence[DirectionCaster],
        distances: tuple[float, float],
    ) -> "DirectionTable":
        """Cast the nodes of all samples.

        Args:
            targets: S samples.
            scanner: sensor model.
            part: caster of the part.
            occluders: casters of everything else.
            distances: smallest and largest distance of source and sensor from a measured point [m].
        """
        near, far = distances
        points, normals = targets.points.T, targets.normals.T
        tangent, bitangent = _tangents(normals, 2 * np.pi * (_GOLDEN * np.arange(len(targets)) % 1.0))
        frames = np.concatenate([points, normals, tangent, bitangent], axis=1).astype(np.float32)
        lifted = np.ascontiguousarray(targets.lifted)
        nodes = pack_nodes(_cast(lifted, frames, (part,), far)[:, None])[:, 0]
        lengths = near + (far - near) * (np.arange(N_RANGES) + 0.5) / N_RANGES
        free = _cast(lifted, frames, occluders, float(lengths[-1]))
        partly_free = np.flatnonzero((free == 0).any(axis=(1, 2)))
        by_range = [free[partly_free]]
        for length in reversed(lengths[:-1]):  # a direction that is free at one length is free at shorter ones
            by_range.append(_cast(lifted[partly_free], frames[partly_free], occluders, float(length), by_range[-1]))
        row_of = np.full(len(targets), -1)
        row_of[partly_free] = np.arange(len(partly_free))
        limits = scanner.area_limits if isinstance(scanner, AreaLimits) else None
        ranges = np.array([near, N_RANGES / (far - near)], dtype=np.float32)
        compiled_limits = None if limits is None else np.array(limits, dtype=np.float32)
        return cls(
            targets, frames, nodes, (part, *occluders), row_of, pack_nodes(np.stack(by_range[::-1], axis=1)), ranges,
            scanner, compiled_limits,
        )  # fmt: skip

    def __len__(self) -> int:
        return len(self.frames)

    def pick(self, rows: Ints) -> "DirectionTable":
        """Return the table of some of the samples."""
        targets = self.targets
        region = None if targets.region is None else targets.region[rows]
        ray_targets = RayTargets(targets.points[:, rows], targets.normals[:, rows], targets.lifted[rows], region)
        return replace(
            self, targets=ray_targets, frames=self.frames[rows], nodes=self.nodes[rows], near=self.near[rows]
        )

    def without(self, rows: Bools) -> "DirectionTable":
        """Return the table with (S,) selected samples occluded in all directions."""
        return replace(self, nodes=np.where(rows[:, None], np.uint8(0), self.nodes))

    def weights_measured(
        self, T_object_scanner: Floats, rows: Ints, starts: Ints, weights: Floats, thresholds: Floats
    ) -> Floats:
        """Return (n, P) the sum of weights that each pose measures; a sum below its threshold may be partial.

        Args:
            T_object_scanner: (n, P, 4, 4) poses, P for each of n sets of rows [m].
            rows: (m,) samples of all sets; the order of a set should be spread over the surface, to show losses early.
            starts: (n + 1,) first row of each set.
            weights: (S,) of all samples.
            thresholds: (n,) smallest sum of interest for each set; -inf evaluates all.
        """
        n, P = T_object_scanner.shape[:2]
        sums = np.empty((n, P))
        if self.limits is None:
            for k, T in enumerate(T_object_scanner):
                row_block = rows[starts[k] : starts[k + 1]]
                sums[k] = self.measured(T, row_block) @ weights[row_block]
            return sums
        poses, limits = self._packed(T_object_scanner.reshape(-1, 4, 4)).reshape(n, P, -1), self.limits
        row_weights = weights[rows]

        def add(sets: slice) -> None:
            sum_weights(
                self.frames, self.nodes, self.near, self.near_nodes, self.ranges, rows,
                starts[sets.start : sets.stop + 1], row_weights, poses[sets], limits, thresholds[sets], sums[sets],
            )  # fmt: skip

        run_in_threads(add, n, _IN_ONE_THREAD * n // max(1, len(rows) * P))
        return sums

    def measured(self, T_object_scanner: Floats, rows: Ints | None = None) -> Bools:
        """Return (n, m) whether each of n poses (n, 4, 4) [m] measures each of (m,) rows; None: all samples.

        Exact rays decide where a node has a neighbour that differs from it.
        """
        rows = np.arange(len(self)) if rows is None else rows
        poses, result = self._packed(T_object_scanner), np.zeros((len(T_object_scanner), len(rows)), dtype=np.uint8)
        if (limits := self.limits) is not None:

            def mark(block: slice) -> None:
                mark_rows(
                    self.frames, self.nodes, self.near, self.near_nodes, self.ranges, rows, poses[block], limits,
                    result[block],
                )  # fmt: skip
                self._decide_edges(T_object_scanner[block], rows, result[block])

            run_in_threads(mark, len(poses), _IN_ONE_THREAD // max(1, len(rows)))
        else:
            together = max(1, _PAIRS // max(len(rows), 1))
            for first in range(0, len(poses), together):
                block = slice(first, first + together)
                result[block] = in_view_matrix(self.targets, T_object_scanner[block], self.scanner, rows)
            result *= 1 + _SOURCE_PART + _SENSOR_PART + _SOURCE_OTHERS + _SENSOR_OTHERS
            result[:, ~self.nodes[rows].any(axis=1)] = 0
            self._decide_edges(T_object_scanner, rows, result)
        return np.asarray(result > 0)

    def _decide_edges(self, T_object_scanner: Floats, rows: Ints, result: Bytes) -> None:
        """Decide `result` (n, m) by exact rays where a line of sight is near an edge."""
        source, sensor = (
            T_object_scanner[:, :3, :3] @ end + T_object_scanner[:, :3, 3]
            for end in (self.scanner.source, self.scanner.sensor)
        )
        part, *others = self.casters
        pose, column, mark = list_uncertain(result)
        for bit, ends, casters in (
            (_SOURCE_PART, source, (part,)), (_SENSOR_PART, sensor, (part,)),
            (_SOURCE_OTHERS, source, others), (_SENSOR_OTHERS, sensor, others),
        ):  # fmt: skip
            for caster in casters:
                rays = np.flatnonzero(mark & bit)
                is_blocked = caster.blocked(self.targets.lifted[rows[column[rays]]], ends[pose[rays]])
                mark[rays[is_blocked]] = 0
        result[pose, column] = mark

    def _packed(self, T_object_scanner: Floats) -> Floats32:
        """Return (n, 18): rotation by columns, position, source and sensor of each pose."""
        R, t = T_object_scanner[:, :3, :3], T_object_scanner[:, :3, 3]
        columns = R.transpose(0, 2, 1).reshape(-1, 9)
        return np.concatenate(
            [columns, t, R @ self.scanner.source + t, R @ self.scanner.sensor + t], axis=1, dtype=np.float32,
            casting="same_kind",
        )  # fmt: skip


def _tangents(normals: Floats, angles: Floats) -> tuple[Floats, Floats]:
    """Return two unit vectors (S, 3) perpendicular to normals and to each other, turned by angles (S,) [rad]."""
    sign = np.where(normals[:, 2] >= 0, 1.0, -1.0)
    x, y, z = normals.T
    a = -1.0 / (sign + z)
    b = x * y * a
    first = np.stack([1.0 + sign * x * x * a, sign * b, -sign * x], axis=1)
    second = np.stack([b, sign + y * y * a, -y], axis=1)
    cos, sin = np.cos(angles)[:, None], np.sin(angles)[:, None]
    return cos * first + sin * second, cos * second - sin * first


def _node_directions() -> Floats32:
    """Return (N * N, 3) unit directions of the nodes in the frame of a sample; those on the rim point a little up."""
    u, v = np.meshgrid(*(np.linspace(-1.0, 1.0, N_NODES),) * 2, indexing="ij")
    a, b = (u + v) / 2, (u - v) / 2
    c = np.maximum(1.0 - np.abs(a) - np.abs(b), 0.02)
    directions = np.stack([a, b, c], axis=-1).reshape(-1, 3)
    return np.asarray(directions / np.linalg.norm(directions, axis=1, keepdims=True), dtype=np.float32)


def _cast(
    lifted: Floats, frames: Floats32, casters: Sequence[DirectionCaster], length: float, known: Bytes | None = None
) -> Bytes:
    """Return (s, N, N) whether each node of s samples is free up to a length [m].

    Args:
        lifted: (s, 3) origins [m].
        frames: (s, 12) of the samples.
        casters: of what may occlude.
        length: of the rays [m].
        known: (s, N, N) nodes that are free at a greater length.
    """
    nodes = _node_directions()
    free = np.full((len(lifted), N_NODES, N_NODES), _UNKNOWN, dtype=np.uint8)
    free[:, ::_COARSEST, ::_COARSEST] = _TO_CAST
    known = free[:0] if known is None else known
    for first in range(0, len(lifted), _TOGETHER):
        raise_interrupt()
        block = slice(first, first + _TOGETHER)
        step = _COARSEST
        while True:
            sample, node, directions = list_casts(free[block], known[block], step, nodes, frames[block])
            is_free = np.ones(len(sample), dtype=np.bool_)
            for caster in casters:
                alive = slice(None) if is_free.all() else np.flatnonzero(is_free)
                is_free[alive] = ~caster.blocked_along(lifted[block], sample[alive], directions[alive], length)
            set_nodes(free[block], sample, node, is_free)
            if step == 1:
                break
            step //= 2
            subdivide(free[block], step, 1 < step == _COARSEST // 2)
    return free


@compiled
def list_casts(free: Bytes, known: Bytes, step: int, nodes: Floats32, frames: Floats32) -> tuple[Ints, Ints, Floats32]:
    """List the nodes of a level that are to be cast; those that are known to be free are set.

    Args:
        free: (s, N, N) states, changed in place.
        known: (s, N, N) nodes that are free at a greater length, or none.
        step: nodes between two nodes of the level.
        nodes: (N * N, 3) directions of the nodes in the frame of a sample.
        frames: (s, 12) of the samples.

    Returns:
        Sample, node and (n, 3) direction in the object frame of each ray.
    """
    count = 0
    for s in range(len(free)):
        for i in range(0, N_NODES, step):
            for j in range(0, N_NODES, step):
                if free[s, i, j] == _TO_CAST:
                    if len(known) and known[s, i, j] == 1:
                        free[s, i, j] = 1
                    else:
                        count += 1
    sample, node = np.empty(count, dtype=np.int64), np.empty(count, dtype=np.int64)
    directions = np.empty((count, 3), dtype=np.float32)
    k = 0
    for s in range(len(free)):
        frame = frames[s]
        for i in range(0, N_NODES, step):
            for j in range(0, N_NODES, step):
                if free[s, i, j] == _TO_CAST:
                    sample[k], node[k] = s, i * N_NODES + j
                    a, b, c = nodes[node[k], 0], nodes[node[k], 1], nodes[node[k], 2]
                    for axis in range(3):
                        directions[k, axis] = a * frame[6 + axis] + b * frame[9 + axis] + c * frame[3 + axis]
                    k += 1
    return sample, node, directions


@compiled
def set_nodes(free: Bytes, sample: Ints, node: Ints, is_free: Bools) -> None:
    """Set the states of nodes after their rays were cast."""
    for k in range(len(sample)):
        free[sample[k], node[k] // N_NODES, node[k] % N_NODES] = is_free[k]


@compiled
def subdivide(free: Bytes, step: int, is_cast_if_occluded: bool) -> None:
    """Set the nodes of the next finer level: the value of their coarser neighbours, or `_TO_CAST` if these differ.

    Args:
        free: (s, N, N) states, changed in place.
        step: nodes between two nodes of the finer level.
        is_cast_if_occluded: whether all nodes of this level are cast where any of the coarser level is occluded, since
            thin occluders are between these.
    """
    to_cast, last = np.uint8(_TO_CAST), N_NODES - 1
    for s in range(len(free)):
        nodes, is_occluded = free[s], False
        if is_cast_if_occluded:
            for i in range(0, N_NODES, 2 * step):
                for j in range(0, N_NODES, 2 * step):
                    is_occluded |= nodes[i, j] == 0
        for i in range(0, N_NODES, 2 * step):
            below = min(i + 2 * step, last)
            for j in range(0, N_NODES, 2 * step):
                beside = min(j + 2 * step, last)
                a, b, c, d = nodes[i, j], nodes[below, j], nodes[i, beside], nodes[below, beside]
                if i < last:
                    nodes[i + step, j] = to_cast if is_occluded or a != b else a
                if j < last:
                    nodes[i, j + step] = to_cast if is_occluded or a != c else a
                if i < last and j < last:
                    nodes[i + step, j + step] = to_cast if is_occluded or a != b or a != c or a != d else a


@compiled
def pack_nodes(free: Bytes) -> Bytes:
    """Return the packed nodes (M, R, B) of free ones (M, R, N, N): `_FREE`, and `_EDGE` where a neighbour differs."""
    M, R = free.shape[:2]
    packed = np.zeros((M, R, (N_NODES * N_NODES + 3) // 4), dtype=np.uint8)
    edges = np.empty((N_NODES, N_NODES), dtype=np.uint8)
    last = N_NODES - 1
    for m in range(M):
        for r in range(R):
            here, shorter, longer = free[m, r], free[m, max(r - 1, 0)], free[m, min(r + 1, R - 1)]
            for i in range(N_NODES):
                row, above, below = here[i], here[max(i - 1, 0)], here[min(i + 1, last)]
                for j in range(N_NODES):
                    edges[i, j] = (row[j] ^ above[j]) | (row[j] ^ below[j]) | (row[j] ^ shorter[i, j])
                    edges[i, j] |= row[j] ^ longer[i, j]
                for j in range(last):
                    edges[i, j] |= (row[j] ^ row[j + 1]) | (row[j] ^ above[j + 1]) | (row[j] ^ below[j + 1])
                for j in range(1, N_NODES):
                    edges[i, j] |= (row[j] ^ row[j - 1]) | (row[j] ^ above[j - 1]) | (row[j] ^ below[j - 1])
            for i in range(N_NODES):
                for j in range(N_NODES):
                    node = i * N_NODES + j
                    packed[m, r, node >> 2] |= (here[i, j] * _FREE + edges[i, j] * _EDGE) << (2 * (node & 3))
    return packed


@compiled
def gather_blocks(frames: Floats32, rows: Ints) -> Floats32:
    """Return the frames of rows in blocks (B, 12, `_BLOCK`), filled up with zeros, which no pose measures."""
    blocks = np.zeros(((len(rows) + _BLOCK - 1) // _BLOCK, 12, _BLOCK), dtype=np.float32)
    for m in range(len(rows)):
        for k in range(12):
            blocks[m // _BLOCK, k, m % _BLOCK] = frames[rows[m], k]
    return blocks


@compiled
def find_nodes(block: Floats32, pose: Floats32, limits: Floats32, nodes: Ints32, squared: Floats32) -> None:
    """Find the nodes in which source and sensor are seen from the rows of a block; branch-free, so that it vectorises.

    Args:
        block: (12, _BLOCK) frames.
        pose: (18,) from `_packed`.
        limits: (13,) of the scanner, by `planner.ports.AreaLimits`.
        nodes: (2, _BLOCK), overwritten; the first is -1 for rows that the scanner rejects.
        squared: (2, _BLOCK), overwritten with the squared distances [m^2].
    """
    baseline, tan_h, tan_v, tan_u, tan_w = limits[0], limits[1], limits[2], limits[3], limits[4]
    nearest, farthest = limits[5] * limits[5], limits[6] * limits[6]
    front, back, cos_t, sin_t = limits[7], limits[8], limits[11], limits[12]
    cos_source, cos_sensor = limits[9] * abs(limits[9]), limits[10] * abs(limits[10])
    x_x, x_y, x_z, y_x, y_y, y_z, z_x, z_y, z_z = pose[0:9]
    o_x, o_y, o_z, s_x, s_y, s_z, q_x, q_y, q_z = pose[9:18]
    zero, half, size = np.float32(0), np.float32((N_NODES - 1) // 2), np.int32(N_NODES)
    middle, has_sensor_limits = half + np.float32(0.5), tan_u > zero
    points, normals, tangents, bitangents = block[0:3], block[3:6], block[6:9], block[9:12]
    for m in range(_BLOCK):
        p_x, p_y, p_z = points[0, m], points[1, m], points[2, m]
        n_x, n_y, n_z = normals[0, m], normals[1, m], normals[2, m]
        t_x, t_y, t_z = tangents[0, m], tangents[1, m], tangents[2, m]
        b_x, b_y, b_z = bitangents[0, m], bitangents[1, m], bitangents[2, m]
        l_x, l_y, l_z = s_x - p_x, s_y - p_y, s_z - p_z
        e_x, e_y, e_z = q_x - p_x, q_y - p_y, q_z - p_z
        d_x, d_y, d_z = p_x - o_x, p_y - o_y, p_z - o_z
        c = n_x * l_x + n_y * l_y + n_z * l_z
        g = n_x * e_x + n_y * e_y + n_z * e_z
        x = x_x * d_x + x_y * d_y + x_z * d_z
        y = y_x * d_x + y_y * d_y + y_z * d_z
        z = z_x * d_x + z_y * d_y + z_z * d_z
        u, across = x - baseline, y * y + z * z
        to_source, to_sensor = x * x + across, u * u + across
        is_good = (c > zero) & (g > zero) & (z > zero) & (z >= front) & (z <= back)
        is_good &= (abs(x) <= tan_h * z) & (abs(y) <= tan_v * z) & (to_source >= nearest) & (to_source <= farthest)
        is_good &= (c * c >= cos_source * to_source) & (g * g >= cos_sensor * to_sensor)
        along, beside = cos_t * z - sin_t * u, cos_t * u + sin_t * z
        is_seen = (along > zero) & (abs(beside) <= tan_u * along) & (abs(y) <= tan_w * along)
        is_good &= is_seen | (not has_sensor_limits)
        a, b = t_x * l_x + t_y * l_y + t_z * l_z, b_x * l_x + b_y * l_y + b_z * l_z
        scale = np.divide(half, abs(a) + abs(b) + abs(c))
        node = np.int32((a + b) * scale + middle) * size + np.int32((a - b) * scale + middle)
        nodes[0, m] = node if is_good else np.int32(-1)
        a, b = t_x * e_x + t_y * e_y + t_z * e_z, b_x * e_x + b_y * e_y + b_z * e_z
        scale = np.divide(half, abs(a) + abs(b) + abs(g))
        nodes[1, m] = np.int32((a + b) * scale + middle) * size + np.int32((a - b) * scale + middle)
        squared[0, m], squared[1, m] = to_source, to_sensor


@compiled
def list_uncertain(result: Bytes) -> tuple[Ints, Ints, Bytes]:
    """Return pose, column and mark of the pairs in (n, m) marks whose lines of sight are near an edge."""
    count = 0
    for k in range(len(result)):
        for m in range(result.shape[1]):
            count += result[k, m] > 1
    pose, column = np.empty(count, dtype=np.int64), np.empty(count, dtype=np.int64)
    mark, i = np.empty(count, dtype=np.uint8), 0
    for k in range(len(result)):
        for m in range(result.shape[1]):
            if result[k, m] > 1:
                pose[i], column[i], mark[i] = k, m, result[k, m]
                i += 1
    return pose, column, mark


@compiled
def state_of(nodes: Bytes, node: int) -> int:
    """Return the bits of a node in a packed row (B,)."""
    return int((nodes[node >> 2] >> (2 * (node & 3))) & 3)


@compiled
def range_of(squared: float, ranges: Floats32) -> int:
    """Return the range of a squared distance [m^2]."""
    return min(max(int((np.sqrt(squared) - ranges[0]) * ranges[1]), 0), N_RANGES - 1)


@compiled
def sum_weights(
    frames: Floats32, table: Bytes, near: Ints, near_table: Bytes, ranges: Floats32, rows: Ints, starts: Ints,
    weights: Floats, poses: Floats32, limits: Floats32, thresholds: Floats, sums: Floats,
) -> None:  # fmt: skip
    """Sum the weights of the rows that poses measure by the table alone.

    Args:
        frames: of the samples.
        table: packed nodes of the samples.
        near: of the samples.
        near_table: packed nodes of samples near occluders.
        ranges: of distance.
        rows: (m,) samples of all n sets.
        starts: (n + 1,) first row of each set.
        weights: (m,) of the rows.
        poses: (n, P, 18) from `_packed`.
        limits: (13,) of the scanner.
        thresholds: (n,) the rest of a pose is skipped once its sum cannot reach it.
        sums: (n, P), overwritten.
    """
    nodes, squared = np.empty((2, _BLOCK), dtype=np.int32), np.empty((2, _BLOCK), dtype=np.float32)
    for k in range(len(poses)):
        begin, end, weight_of_all = starts[k], starts[k + 1], 0.0
        for m in range(begin, end):
            weight_of_all += weights[m]
        blocks = gather_blocks(frames, rows[begin:end])
        for p in range(poses.shape[1]):
            total, left = 0.0, weight_of_all
            for block in range(len(blocks)):
                find_nodes(blocks[block], poses[k, p], limits, nodes, squared)
                first = begin + block * _BLOCK
                for m in range(min(_BLOCK, end - first)):
                    left -= weights[first + m]
                    if nodes[0, m] < 0:
                        continue
                    row, source, sensor = rows[first + m], nodes[0, m], nodes[1, m]
                    if not state_of(table[row], source) & state_of(table[row], sensor) & _FREE:
                        continue
                    if near[row] >= 0:
                        others = near_table[near[row]]
                        if not state_of(others[range_of(squared[0, m], ranges)], source) & _FREE:
                            continue
                        if not state_of(others[range_of(squared[1, m], ranges)], sensor) & _FREE:
                            continue
                    total += weights[first + m]
                if total + left < thresholds[k]:
                    break
            sums[k, p] = total


@compiled
def mark_rows(
    frames: Floats32, table: Bytes, near: Ints, near_table: Bytes, ranges: Floats32, rows: Ints, poses: Floats32,
    limits: Floats32, result: Bytes,
) -> None:  # fmt: skip
    """Mark the rows that poses measure, with further marks where that is uncertain.

    Args:
        frames: of the samples.
        table: packed nodes of the samples.
        near: of the samples.
        near_table: packed nodes of samples near occluders.
        ranges: of distance.
        rows: (m,) samples.
        poses: (n, 18) from `_packed`.
        limits: (13,) of the scanner.
        result: (n, m), zeros, set to a mark where a pose measures a row.
    """
    nodes, squared = np.empty((2, _BLOCK), dtype=np.int32), np.empty((2, _BLOCK), dtype=np.float32)
    blocks = gather_blocks(frames, rows)
    for k in range(len(poses)):
        for block in range(len(blocks)):
            find_nodes(blocks[block], poses[k], limits, nodes, squared)
            first = block * _BLOCK
            for m in range(min(_BLOCK, len(rows) - first)):
                if nodes[0, m] < 0:
                    continue
                row, mark = rows[first + m], 1
                for end in range(2):
                    node = nodes[end, m]
                    state = state_of(table[row], node)
                    if state & _EDGE:
                        mark |= _SENSOR_PART if end else _SOURCE_PART
                    elif not state:
                        mark = 0
                        break
                    if near[row] >= 0:
                        state = state_of(near_table[near[row], range_of(squared[end, m], ranges)], node)
                        if state & _EDGE:
                            mark |= _SENSOR_OTHERS if end else _SOURCE_OTHERS
                        elif not state:
                            mark = 0
                            break
                result[k, first + m] = mark
