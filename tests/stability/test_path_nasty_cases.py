"""Nasty cases of path search in a compiled cell, by name: narrow gaps, full workspaces, bad ends."""

from functools import lru_cache

import numpy as np

from cell.robot.arm import kinematics_of
from cell.scene.model import Scene
from cell.world.collision import MujocoCollisionChecker
from cell.world.model import World, compile_world
from planner.kinematics.closed_form import KukaKinematics
from planner.path.certified_edge import STEP, certify, quantise
from planner.path.path import PathStatus, connect
from planner.tour.tour import DropReason, plan_tour
from planner.tour.visits import Visits

BALL = 0.02 * np.array([[1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1.0]])  # a part that is out of the way
FORWARD = np.array([[0, 0, 1], [0, 1, 0], [-1, 0, 0.0]])  # the flange points along the base's x
FLANGE, ASIDE = np.array([1.1, 0.0, 0.8]), np.array([-0.2, 0.35, 0.1])


@lru_cache
def cell(beyond_mm: float) -> tuple[World, MujocoCollisionChecker, KukaKinematics]:
    """Return a cell with two plates; their gap is the housing's width plus clearance and `beyond_mm` on both sides."""
    middle = 40.0 + 10.0 + beyond_mm + 10.0
    plates = [
        {"name": name, "shape": "box", "size_mm": [100, 20, 500], "position_mm": [1190, y, 800]}
        for name, y in (("left plate", middle), ("right plate", -middle))
    ]
    scene = Scene.model_validate(
        {"fixtures": plates, "placement": {"position_mm": [0, 1500, 0]}, "post": {"enabled": False}}
    )
    world = compile_world(scene, BALL, baseline_mm=75.0)
    return world, MujocoCollisionChecker(world), kinematics_of(world.model)


def at(kinematics: KukaKinematics, checker: MujocoCollisionChecker, position: np.ndarray, turn: float) -> np.ndarray:
    """Return the first free set-point with the flange at a position, turned about its axis."""
    T = np.eye(4)
    spin = np.array([[np.cos(turn), -np.sin(turn), 0], [np.sin(turn), np.cos(turn), 0], [0, 0, 1]])
    T[:3, :3], T[:3, 3] = FORWARD @ spin, position
    q = quantise(kinematics.inverse(T[None])[0])
    limits = kinematics.limits
    inside = np.isfinite(q).all(axis=1) & (q >= limits.lower).all(axis=1) & (q <= limits.upper).all(axis=1)
    found = q[inside][checker.free(q[inside])]
    assert len(found), "precondition: the place can be reached"
    return np.asarray(found[0])


def test_the_housing_enters_a_gap_5_mm_beyond_the_clearance() -> None:
    """A detour leads into the gap from a turned pose outside, and the tool keeps the certified clearance."""
    world, checker, kinematics = cell(5.0)
    inside = at(kinematics, checker, FLANGE, 0.0)
    outside = at(kinematics, checker, FLANGE + ASIDE, np.radians(60))
    assert not certify(outside, inside, checker)[0], "precondition: the straight move collides"
    found = connect(outside, inside, checker, world.limits, np.random.default_rng(0))
    assert found.status is PathStatus.DETOUR
    assert found.via is not None
    shares = np.linspace(0, 1, 300)[:, None]
    moves = zip(found.via[:-1], found.via[1:], strict=True)
    distance, _ = checker.distance(np.concatenate([a + shares * (b - a) for a, b in moves]))
    assert distance.min() >= (1 - STEP) * checker.clearance
    assert distance.min() < 0.016  # inside the gap


def test_a_gap_narrower_than_the_clearance_has_no_place_inside() -> None:
    """The goal is refused without a search."""
    _, wide, kinematics = cell(5.0)
    world, narrow, _ = cell(-1.0)
    inside = at(kinematics, wide, FLANGE, 0.0)
    outside = at(kinematics, wide, FLANGE + ASIDE, np.radians(60))
    found = connect(outside, inside, narrow, world.limits, np.random.default_rng(0))
    assert (found.status, found.via, found.checks) == (PathStatus.GOAL_IN_COLLISION, None, 2)
    back = connect(inside, outside, narrow, world.limits, np.random.default_rng(0))
    assert back.status is PathStatus.START_IN_COLLISION


def test_a_part_that_fills_the_workspace() -> None:
    """With a block as high and wide as the reach, no path passes it and no view near it is reachable."""
    corners = np.stack(np.meshgrid(*[[-1.0, 1.0]] * 3), axis=-1).reshape(-1, 3) * [1.2, 1.4, 1.5]
    scene = Scene.model_validate(
        {
            "robot": {"home_deg": [130, -90, 90, 0, 90, 0]},
            "placement": {"position_mm": [1620, 0, 900]},
            "post": {"enabled": False},
        }
    )
    world = compile_world(scene, corners, baseline_mm=75.0)
    checker = MujocoCollisionChecker(world)
    left, right = world.home, world.home * [-1, 1, 1, 1, 1, 1]
    assert checker.free(np.stack([left, right])).all(), "precondition: both sides are free"
    found = connect(left, right, checker, world.limits, np.random.default_rng(0), 3000)
    assert (found.status, found.via) == (PathStatus.NO_PATH_FOUND, None)
    assert 3000 <= found.checks < 10_000
    ahead = quantise(np.radians([[a, -60.0, 80, 0, 60, 0] for a in (-20.0, -10, 0, 10, 20)]))
    tour = plan_tour(
        Visits([ahead[:3], ahead[3:]], left, np.tile(np.eye(4), (2, 1, 1))),
        checker,
        world.limits,
        np.random.default_rng(0),
    )
    assert [(exclusion.view, exclusion.reason) for exclusion in tour.dropped] == [
        (0, DropReason.IN_COLLISION),
        (1, DropReason.IN_COLLISION),
    ]
    assert all("part" in exclusion.blocker for exclusion in tour.dropped)
    assert len(tour.via) == 1
