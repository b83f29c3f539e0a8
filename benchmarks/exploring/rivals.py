"""Rivals: predefined views (uniform, random), and views with the most unknown voxels along their rays.

Each is a function of a view space (`view_spaces`) that returns a policy. Each docstring lists the parts of the
publication that are omitted, because the laboratory has no use for them.
"""

from dataclasses import replace

import numpy as np
from numpy.random import Generator

from benchmarks.exploring.lab import Knowledge, Lab, NextView, Policy
from benchmarks.exploring.view_spaces import VIEW_SPACES
from planner.compiled import compiled
from planner.explore.space import FREE, OCCUPIED, UNKNOWN
from planner.geometry.rigid import rotation_matrices
from planner.values import Floats, Ints

_MANY, _CANDIDATES = 2000, 250
_EVERY = 6  # rays along both sides of the grid of the scanner: 1,600 are cast for each candidate


def uniform(space: str) -> Policy:
    """Return the policy of predefined views over the view space: each is the farthest from all before.

    Farthest points first: Gonzalez, "Clustering to minimize the maximum intercluster distance", Theoretical Computer
    Science 38 (1985); as the order of views Scott, Roth and Rivest call it the generic view sphere.
    """

    def start(lab: Lab, rng: Generator) -> NextView:
        poses = VIEW_SPACES[space](lab, _MANY)

        def next_view(known: Knowledge) -> Floats | None:
            usable = poses[lab.free(known.space)(poses)]
            positions = np.stack([T[:3, 3] for T in known.poses])
            away = np.linalg.norm(usable[:, None, :3, 3] - positions[None], axis=2).min(axis=1)
            return usable[int(np.argmax(away))]

        return next_view

    return start


def random(space: str) -> Policy:
    """Return the policy of random poses of the view space with random rolls."""

    def start(lab: Lab, rng: Generator) -> NextView:
        poses = VIEW_SPACES[space](lab, _MANY)

        def next_view(known: Knowledge) -> Floats | None:
            usable = poses[lab.free(known.space)(poses)]
            pose = usable[rng.integers(len(usable))].copy()
            pose[:3, :3] = pose[:3, :3] @ rotation_matrices(np.array([[0.0, 0.0, rng.uniform(0, 2 * np.pi)]]))[0]
            return pose

        return next_view

    return start


def volumetric(space: str) -> Policy:
    """Return the policy of the candidate whose rays cross the most unknown voxels.

    A ray ends at an occupied voxel or at the end of the range.

    C. I. Connolly, "The determination of next best views", ICRA 1985, counts unknown voxels in sight of candidates on a
    view sphere; J. I. Vasquez-Gomez and others, "Volumetric next-best-view planning for 3D object reconstruction with
    positioning error", International Journal of Advanced Robotic Systems 11 (2014), doi:10.5772/58759, casts rays
    through a voxel grid of candidates about the object. Rays pass through unknown voxels, as in the count of unobserved
    voxels by S. Isler and others, ICRA 2016; voxels along rays without a hit are free, as there. Omitted: overlap for
    registration (poses are known here), positioning errors and the path of the robot.
    """

    def start(lab: Lab, rng: Generator) -> NextView:
        poses = VIEW_SPACES[space](lab, _CANDIDATES)

        def next_view(known: Knowledge) -> Floats | None:
            return most_unknown(lab, known, poses)

        return next_view

    return start


def most_unknown(lab: Lab, known: Knowledge, poses: Floats) -> Floats | None:
    """Return the free one of (n, 4, 4) poses whose rays cross the most unknown voxels; None if none crosses any.

    Voxels along rays without a hit are free.
    """
    rows, columns = lab.scanner.grid_shape
    rays = lab.frustum.rays.reshape(rows, columns, 3)[_EVERY // 2 :: _EVERY, _EVERY // 2 :: _EVERY].reshape(-1, 3)
    usable, space = poses[lab.free(known.space)(poses)], known.space
    state = np.where((space.state == UNKNOWN) & (space.votes > 0), FREE, space.state).astype(np.uint8)
    free_space = replace(known, space=replace(space, state=state))
    gains = [_unknown_along(lab, free_space, T, rays) for T in usable]
    return usable[int(np.argmax(gains))] if max(gains, default=0) > 0 else None


def _unknown_along(lab: Lab, known: Knowledge, T: Floats, rays: Floats) -> int:
    space = known.space
    source = T[:3, :3] @ lab.frustum.source + T[:3, 3]
    return int(
        _crossed(
            source, rays @ T[:3, :3].T, lab.frustum.near, lab.frustum.far, np.array(space.low), space.edge, space.state
        )
    )


@compiled
def _crossed(
    source: Floats, directions: Floats, near: float, far: float, low: Floats, edge: float, state: Ints
) -> np.int64:
    """Return the number of unknown voxels along all rays, sampled at steps of one voxel edge."""
    found = np.int64(0)
    for ray in range(len(directions)):
        begin, end = near, far  # within the grid
        for axis in range(3):
            if directions[ray, axis] != 0.0:
                a = (low[axis] - source[axis]) / directions[ray, axis]
                b = (low[axis] + edge * state.shape[axis] - source[axis]) / directions[ray, axis]
                begin, end = max(begin, min(a, b)), min(end, max(a, b))
        at = begin + 0.5 * edge
        while at < end:
            i = np.int64(np.floor((source[0] + at * directions[ray, 0] - low[0]) / edge))
            j = np.int64(np.floor((source[1] + at * directions[ray, 1] - low[1]) / edge))
            k = np.int64(np.floor((source[2] + at * directions[ray, 2] - low[2]) / edge))
            if 0 <= i < state.shape[0] and 0 <= j < state.shape[1] and 0 <= k < state.shape[2]:
                if state[i, j, k] == OCCUPIED:
                    break
                if state[i, j, k] == UNKNOWN:
                    found += 1
            at += edge
    return found
