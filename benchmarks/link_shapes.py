"""Collision shapes of the KR 16 compared with an outline of its links: `python -m benchmarks link_shapes FILE`.

The outline (JSON) bounds the true surface of each link: slabs along `slab_axis`, each with the support in directions of
`plane_axes`, equally spaced from the first axis towards the second [mm, frame of the link]. A row has

- the largest support of a slab that exceeds the support of the shapes there: a link that is enclosed has 0;
- the excess, the largest distance of a point of the shapes' surface from the outline. An outline is convex in each
  slab, so that the excess over the link itself is larger in hollows;
- the volume of the union of the shapes, and its ratio to `volume_l` of the link, or to the outline without one.
"""

import json
from pathlib import Path
from typing import Annotated, Any

import mujoco
import numpy as np
import trimesh
import typer
from scipy.optimize import linprog
from scipy.spatial import HalfspaceIntersection, cKDTree

from cell.robot import model as robot
from cell.world.occluders import geom_triangles
from planner.values import Floats

MAX_EXCESS_MM = 40.0
"""Largest excess over an outline."""

_SIDES = 48  # of the prism around a cylinder
_MM2_PER_SAMPLE = 100.0
_VOLUME_SAMPLES = 50_000

app = typer.Typer(add_completion=False)


@app.command()
def main(outline: Annotated[Path, typer.Argument(help="JSON file of the links' outline")]) -> None:
    """Print one row per link; exit code 1 if a support or the excess exceeds its limit."""
    rows = [compare(name, link) for name, link in json.loads(outline.read_text(encoding="utf-8"))["links"].items()]
    for row in rows:
        typer.echo(", ".join(f"{key} {row[key]:.4g}" if key != "link" else row[key] for key in row))
    failed = [row for row in rows if row["support beyond the shapes mm"] > 0 or row["excess mm"] > MAX_EXCESS_MM]
    raise typer.Exit(1 if failed or not rows else 0)


def compare(name: str, link: dict[str, Any]) -> dict[str, Any]:
    """Return the figures of one link."""
    slabs = [_half_spaces(link, slab) for slab in link["slabs"]]
    solids = link_solids(name)
    shapes = [np.column_stack([each.face_normals, -_offsets(each)]) for each in solids]
    excess = max(_support_beyond(slab, len(link["slabs"][0]["support"]), solids) for slab in slabs)
    rng = np.random.default_rng(0)
    own = np.concatenate([_samples(each, rng) for each in solids])
    surface = np.concatenate([_samples(each, rng) for slab in slabs if (each := _solid(slab)) is not None])
    distance = cKDTree(surface).query(own[~_is_inside(slabs, own)])[0]
    low, high = (np.array([each.bounds[i] for each in solids]) for i in (0, 1))
    low, high = np.minimum(low.min(axis=0), link["aabb_min"]), np.maximum(high.max(axis=0), link["aabb_max"])
    points = rng.uniform(low, high, (_VOLUME_SAMPLES, 3))
    volume, outlined = (float(np.prod(high - low)) / 1e6 * _is_inside(each, points).mean() for each in (shapes, slabs))
    return {
        "link": name,
        "support beyond the shapes mm": excess,
        "excess mm": float(distance.max(initial=0.0)),
        "volume l": volume,
        "ratio": volume / float(link.get("volume_l", outlined)),
    }


def link_solids(name: str) -> list[trimesh.Trimesh]:
    """Return the shapes of a link in its frame [mm]."""
    model = robot.load()
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    body = model.body(name.removesuffix("_link")).id
    solids = []
    for geom in np.flatnonzero(model.geom_bodyid == body).tolist():
        vertices, faces = geom_triangles(model, data, geom, _SIDES)
        in_link = (vertices - data.xpos[body]) @ data.xmat[body].reshape(3, 3)
        solids.append(trimesh.Trimesh(1000.0 * in_link, faces, process=False))
    return solids


def _half_spaces(link: dict[str, Any], slab: dict[str, Any]) -> Floats:
    """Return the half spaces (n, 4) of a slab, a x + b <= 0, those of its supports first."""
    angles = 2 * np.pi * np.arange(count := len(slab["support"])) / count
    normals = np.zeros((count, 3))
    for axis, values in zip(link["plane_axes"], (np.cos(angles), np.sin(angles)), strict=True):
        normals[:, "xyz".index(axis)] = values
    along = np.eye(3)["xyz".index(link["slab_axis"])]
    planes = np.concatenate([normals, [along, -along], np.eye(3), -np.eye(3)])
    limits = [slab["support"], [slab["to"], -slab["from"]], link["aabb_max"], -np.array(link["aabb_min"])]
    return np.column_stack([planes, -np.concatenate(limits)])


def _offsets(solid: trimesh.Trimesh) -> Floats:
    return np.asarray((solid.face_normals * solid.triangles[:, 0]).sum(axis=1))


def _corners(half_spaces: Floats) -> Floats:
    """Return the corners (n, 3) of an intersection of half spaces; none if it has no interior."""
    scale = np.linalg.norm(half_spaces[:, :3], axis=1)
    largest_ball = linprog(
        [0, 0, 0, -1], np.column_stack([half_spaces[:, :3], scale]), -half_spaces[:, 3], bounds=[(None, None)] * 4
    )
    if not largest_ball.success or largest_ball.x[3] < 1e-6:
        return np.empty((0, 3))
    return np.asarray(HalfspaceIntersection(half_spaces, largest_ball.x[:3]).intersections)


def _solid(half_spaces: Floats) -> trimesh.Trimesh | None:
    """Return an intersection of half spaces as a solid; None if it is empty."""
    corners = _corners(half_spaces)
    return trimesh.convex.convex_hull(corners) if len(corners) else None


def _support_beyond(slab: Floats, count: int, solids: list[trimesh.Trimesh]) -> float:
    """Return by how much the first `count` supports of a slab exceed those of the shapes in it, at least 0 [mm]."""
    axis, high, low = int(np.argmax(slab[count, :3])), -slab[count, 3], slab[count + 1, 3]
    corners = np.concatenate([_corners_between(each, axis, low, high) for each in solids])
    return float(np.max(-slab[:count, 3] - (corners @ slab[:count, :3].T).max(axis=0, initial=-np.inf), initial=0.0))


def _corners_between(solid: trimesh.Trimesh, axis: int, low: float, high: float) -> Floats:
    """Return the corners (n, 3) of the part of a convex solid between two planes across an axis."""
    ends = solid.vertices[solid.edges_unique]
    found = [solid.vertices[(solid.vertices[:, axis] >= low) & (solid.vertices[:, axis] <= high)]]
    for plane in (low, high):
        start, step = ends[:, 0], ends[:, 1] - ends[:, 0]
        with np.errstate(divide="ignore", invalid="ignore"):
            share = (plane - start[:, axis]) / step[:, axis]
        crossing = (share >= 0) & (share <= 1)
        found.append(start[crossing] + share[crossing, None] * step[crossing])
    return np.concatenate(found)


def _samples(solid: trimesh.Trimesh, rng: np.random.Generator) -> Floats:
    """Return random points (n, 3) of a surface, and its corners."""
    count = 100 + int(solid.area / _MM2_PER_SAMPLE)
    return np.concatenate([trimesh.sample.sample_surface(solid, count, seed=rng)[0], solid.vertices])


def _is_inside(solids: list[Floats], points: Floats) -> np.ndarray[Any, np.dtype[np.bool_]]:
    """Return whether points (n, 3) are inside any of the convex solids, given as half spaces."""
    inside = np.zeros(len(points), dtype=np.bool_)
    for half_spaces in solids:
        rest = np.flatnonzero(~inside)
        inside[rest] = (points[rest] @ half_spaces[:, :3].T + half_spaces[:, 3] <= 0).all(axis=1)
    return inside
