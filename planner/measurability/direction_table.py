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
from planner.values import Bools, Floats, Ints, Ints32, Value
from planner.viewpoints.lines_of_sight import RayTargets, in_view_matrix

N_NODES = 33
"""Nodes along each axis of the grid: 5.6 degrees between neighbours."""

N_RANGES = 4
"""Ranges of distance between sample and source or sensor, each with its own table of occluders."""

_COARSEST = 4  # nodes between two nodes of the first level; a power of two
_GOLDEN = (np.sqrt(5.0) - 1) / 2
_PACKED = 64  # samples whose nodes are packed together: arrays that stay in the cache
_TOGETHER = 2048  # samples whose nodes are cast together: arrays of 30 MB
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
        nodes = _pack(_cast(lifted, frames, (part,), far)[:, None])[:, 0]
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
            targets, frames, nodes, (part, *occluders), row_of, _pack(np.stack(by_range[::-1], axis=1)), ranges,
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
        poses = self._packed(T_object_scanner.reshape(-1, 4, 4)).reshape(n, P, -1)
        sum_weights(
            self.frames, self.nodes, self.near, self.near_nodes, self.ranges, rows, starts, weights[rows], poses,
            self.limits, thresholds, sums,
        )  # fmt: skip
        return sums

    def measured(self, T_object_scanner: Floats, rows: Ints | None = None) -> Bools:
        """Return (n, m) whether each of n poses (n, 4, 4) [m] measures each of (m,) rows; None: all samples.

        Exact rays decide where a node has a neighbour that differs from it.
        """
        rows = np.arange(len(self)) if rows is None else rows
        poses, result = self._packed(T_object_scanner), np.zeros((len(T_object_scanner), len(rows)), dtype=np.uint8)
        if self.limits is not None:
            mark_rows(
                self.frames, self.nodes, self.near, self.near_nodes, self.ranges, rows, poses, self.limits, result
            )  # fmt: skip
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
        pose, column = np.nonzero(result > 1)
        mark = result[pose, column]
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


def _pack(free: Bytes) -> Bytes:
    """Return the packed nodes (M, R, B) of free ones (M, R, N, N); edges have a neighbour that differs from them."""
    M, R = free.shape[:2]
    packed = np.empty((M, R, (N_NODES * N_NODES + 3) // 4), dtype=np.uint8)
    states = np.zeros((_PACKED, R, 4 * packed.shape[2]), dtype=np.uint8)
    for first in range(0, M, _PACKED):
        block = free[first : first + _PACKED]
        n = len(block)
        states[:n, :, : N_NODES * N_NODES] = (_FREE * block + _EDGE * _edges(block)).reshape(n, R, N_NODES * N_NODES)
        quarters = [states[:n, :, k::4] << 2 * k for k in range(4)]
        packed[first : first + n] = quarters[0] | quarters[1] | quarters[2] | quarters[3]
    return packed


def _edges(free: Bytes) -> Bools:
    """Return which nodes of (M, R, N, N) have a neighbour, in direction or range, that differs from them."""
    is_edge = np.zeros(free.shape, dtype=np.bool_)
    every, ahead, behind = slice(None), slice(1, None), slice(None, -1)
    for one, two in (
        ((every, ahead, every, every), (every, behind, every, every)),
        ((every, every, ahead, every), (every, every, behind, every)),
        ((every, every, every, ahead), (every, every, every, behind)),
        ((every, every, ahead, ahead), (every, every, behind, behind)),
        ((every, every, ahead, behind), (every, every, behind, ahead)),
    ):
        differs = free[one] != free[two]
        is_edge[one] |= differs
        is_edge[two] |= differs
    return is_edge


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
    directions_of_nodes = _node_directions()
    free = np.full((len(lifted), N_NODES, N_NODES), _UNKNOWN, dtype=np.uint8)
    free[:, ::_COARSEST, ::_COARSEST] = _TO_CAST
    for first in range(0, len(lifted), _TOGETHER):
        raise_interrupt()
        block = slice(first, first + _TOGETHER)
        origins, local, part = lifted[block], frames[block], free[block]
        step = _COARSEST
        while True:
            if known is not None:
                part[(part == _TO_CAST) & (known[block] == 1)] = 1
            is_cast = part[:, ::step, ::step] == _TO_CAST
            sample, i, j = np.unravel_index(np.flatnonzero(is_cast), is_cast.shape)
            node = step * (i * N_NODES + j)
            directions = turn_nodes(directions_of_nodes, local, sample, node)
            is_free = np.ones(len(sample), dtype=np.bool_)
            for caster in casters:
                alive = np.flatnonzero(is_free)
                is_free[alive] = ~caster.blocked_along(origins[sample[alive]], directions[alive], length)
            part.reshape(len(origins), -1)[sample, node] = is_free
            if step == 1:
                break
            step //= 2
            _subdivide(part, step)
            if 1 < step == _COARSEST // 2:  # thin occluders are between the nodes of the first level
                is_occluded = (part[:, ::_COARSEST, ::_COARSEST] == 0).any(axis=(1, 2))
                level = part[:, ::step, ::step]
                is_new = np.ones(level.shape[1:], dtype=np.bool_)
                is_new[::2, ::2] = False
                level[is_occluded[:, None, None] & is_new] = _TO_CAST
    return free


def _subdivide(free: Bytes, step: int) -> None:
    """Set the nodes of the next finer level: the value of their coarser neighbours, or `_TO_CAST` if these differ."""
    coarse = free[:, :: 2 * step, :: 2 * step]
    a, b, c, d = coarse[:, :-1, :-1], coarse[:, 1:, :-1], coarse[:, :-1, 1:], coarse[:, 1:, 1:]
    to_cast = np.uint8(_TO_CAST)
    free[:, step :: 2 * step, :: 2 * step] = np.where(coarse[:, :-1] == coarse[:, 1:], coarse[:, :-1], to_cast)
    free[:, :: 2 * step, step :: 2 * step] = np.where(coarse[:, :, :-1] == coarse[:, :, 1:], coarse[:, :, :-1], to_cast)
    free[:, step :: 2 * step, step :: 2 * step] = np.where((a == b) & (a == c) & (a == d), a, to_cast)


@compiled
def turn_nodes(nodes: Floats32, frames: Floats32, sample: Ints, node: Ints) -> Floats32:
    """Return the (n, 3) directions of nodes of samples in the object frame."""
    directions = np.empty((len(sample), 3), dtype=np.float32)
    for k in range(len(sample)):
        a, b, c = nodes[node[k], 0], nodes[node[k], 1], nodes[node[k], 2]
        frame = frames[sample[k]]
        for axis in range(3):
            directions[k, axis] = a * frame[6 + axis] + b * frame[9 + axis] + c * frame[3 + axis]
    return directions


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
        begin, end = starts[k], starts[k + 1]
        blocks, weight_of_all = gather_blocks(frames, rows[begin:end]), weights[begin:end].sum()
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
