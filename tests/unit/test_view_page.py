"""Data of the page: equal to the run's files, no external requests, names are never markup."""

import base64
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cell.report.plan_report import markdown
from cell.robot.arm import kinematics_of
from cell.runs.cell import read_cell
from cell.runs.run import Run, open_run
from cell.view import run_pages
from cell.view.page import Layer, PageContents, PageScene, PageSurface, PageView, render_page
from cell.view.pieces import Piece, cell_of_run
from cell.view.surface import canvas_of, viewing_directions
from planner.geometry.mesh import TriangleMesh
from planner.geometry.sampling import draw_samples
from planner.kinematics.frames import pose_from_kuka_abc
from planner.measurability import coverage

DataOf = Callable[[str], dict[str, Any]]
_EVIL = "<script>alert(1)</script>"


@pytest.fixture(scope="module")
def run(planned: Path) -> Run:
    """Return the finished plan."""
    return open_run(planned)


@pytest.fixture(scope="module")
def page(planned: Path) -> str:
    """Return the page of the plan."""
    return (planned / "view.html").read_text(encoding="utf-8")


def unpacked(packed: dict[str, str]) -> np.ndarray:
    """Return an array of the page."""
    return np.frombuffer(base64.b64decode(packed["base64"]), dtype=f"<{packed['kind']}")


def places(packed: dict[str, Any]) -> np.ndarray:
    """Return (N, 3) points of the page."""
    return np.array(packed["low"]) + unpacked(packed["steps"]).reshape(-1, 3) * np.array(packed["step"])


def test_the_page_makes_no_requests(page: str) -> None:
    """No element or style has an address, and the content security policy forbids every request."""
    markup = re.sub(r"<script.*?</script>", "", page, flags=re.DOTALL)
    assert not re.search(r"\bsrc=|https?:|@import|url\(", markup)
    assert re.findall(r'href="([^"]*)"', markup) == ["data:,"]
    assert "default-src 'none'" in markup
    own = page.rpartition("<script>")[2]
    assert not re.search(r"https?:|fetch\(|XMLHttp|WebSocket|innerHTML|document\.write", own)


def test_the_page_shows_the_plan(page: str, run: Run, data_of: DataOf) -> None:
    """Views, motion and part equal those of the run's files, to the resolution of the quantisation."""
    data, plan, motion = data_of(page), run.plan, run.motion
    assert [view["number"] for view in data["views"]] == [str(k + 1) for k in range(len(plan.views))]
    for entry, view in zip(data["views"], plan.views, strict=True):
        np.testing.assert_allclose(entry["T_base_scanner"], view.T_base_scanner, atol=1e-8)
        at = np.array([np.interp(entry["time"], motion.t, motion.q[:, axis]) for axis in range(6)])
        np.testing.assert_allclose(at, view.q, atol=1e-4)
        (moved,) = (text.rpartition(":")[2] for text in entry["commands"] if "--move" in text)
        xyz, abc = np.split(np.array(moved.split(","), dtype=float), 2)
        same = pose_from_kuka_abc(xyz / 1000, np.radians(abc))
        np.testing.assert_allclose(same, view.T_base_scanner, atol=3e-5)  # the command to paste has the current pose
    t, q = unpacked(data["motion"]["t"]), unpacked(data["motion"]["q"]).reshape(-1, 6)
    assert t[-1] == pytest.approx(motion.duration, abs=1e-4)
    np.testing.assert_allclose(q[[0, -1]], motion.q[[0, -1]], atol=1e-6)
    (part,) = data["surfaces"]
    reference = run.mesh("reference.ply").vertices
    vertices = places(part["mesh"]["vertices"])
    np.testing.assert_allclose([vertices.min(0), vertices.max(0)], [reference.min(0), reference.max(0)], atol=1e-3)
    assert unpacked(part["mesh"]["faces"]).max() < len(vertices)


def test_the_colours_count_the_measuring_views(page: str, run: Run, data_of: DataOf) -> None:
    """The area share of faces that some view measures is the plan's visible coverage."""
    data = data_of(page)
    layer = data["surfaces"][0]["layers"][0]
    bits = unpacked(layer["values"]).reshape(-1, layer["width"])
    counts = np.unpackbits(bits, axis=1, bitorder="little").sum(axis=1)
    assert counts.max() <= len(data["views"])
    mesh = data["surfaces"][0]["mesh"]
    corners = places(mesh["vertices"])[unpacked(mesh["faces"]).reshape(-1, 3)]
    areas = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    seen = (counts > 0)[unpacked(mesh["faces"]).reshape(-1, 3)].mean(axis=1)
    share = float(np.sum(seen * areas) / areas.sum())
    assert share == pytest.approx(run.plan.coverage.visible, abs=0.02)


def test_the_chain_of_the_page_agrees_with_the_kinematics(run: Run) -> None:
    """At random angles the scanner has the pose of the closed-form kinematics with the mount."""
    scene = run.scene
    arm = cell_of_run(run, scene).arm
    kinematics = kinematics_of(run.cell_model())
    for q in np.random.default_rng(0).uniform(-1.5, 1.5, (20, 6)):
        expected = kinematics.forward(q[None])[0] @ scene.T_flange_scanner
        np.testing.assert_allclose(arm.link_poses(q)[-1] @ arm.T_link_scanner, expected, atol=1e-9)


def test_a_name_is_never_markup(run: Run, data_of: DataOf) -> None:
    """Names, numbers, sentences and commands that look like markup stay text."""
    cell = cell_of_run(run, run.scene)
    mesh = TriangleMesh(np.eye(3), np.array([[0, 1, 2]]))
    cell = replace(cell, pieces=(*cell.pieces, Piece(_EVIL, 0, mesh.vertices, np.array(mesh.faces), np.ones(3))))
    layer = Layer(_EVIL, "named", np.zeros(3, dtype=np.uint8), _EVIL, named=[(_EVIL, "#000000")])
    contents = PageContents(
        [PageView(_EVIL, np.eye(4), 0.0, [(_EVIL, _EVIL)], [_EVIL])], rows=[(_EVIL, _EVIL)], problems=[_EVIL],
        notes=[_EVIL], next_commands=[_EVIL],
    )  # fmt: skip
    page_text = render_page(PageScene(_EVIL, cell, [PageSurface(_EVIL, mesh, [layer])]), contents)
    assert _EVIL not in page_text
    assert page_text.lower().count("<script") == page_text.lower().count("</script") == 4
    data = data_of(page_text)
    report = run.report
    renamed = report.model_copy(update={"part": report.part.model_copy(update={"name": _EVIL})})
    assert "<script" not in markdown(renamed)
    assert data["title"] == data["pieces"][-1]["name"] == data["surfaces"][0]["layers"][0]["named"][0][0] == _EVIL


def test_large_faces_are_split_for_colours(run: Run) -> None:
    """The drawn mesh of a half-measured cube of twelve faces shows the half."""
    corners = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)]) * 0.1
    faces = np.array([[0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1],
                      [2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3]])  # fmt: skip
    cube = TriangleMesh(corners, faces)
    canvas = canvas_of(cube, draw_samples(cube, cube, 5000, np.random.default_rng(0)))
    half = canvas.samples.points[:, 0] < 0.05
    assert len(canvas.mesh.faces) > 1000
    centres = canvas.mesh.vertices[canvas.mesh.faces].mean(axis=1)
    clear = np.abs(centres[:, 0] - 0.05) > 0.005
    np.testing.assert_array_equal(half[canvas.face_samples][clear], (centres[:, 0] < 0.05)[clear])
    below = canvas.samples.normals[:, 2] < -0.9  # uncovered surface below is seen from below
    assert viewing_directions(canvas, below, 1)[0][2] < 0


def test_seen_samples_are_the_visible_coverage(run: Run) -> None:
    """The samples that some view measures equal those of the definition of coverage."""
    cell, plan = read_cell(run), run.plan
    poses = [view.T_object_poses for view in plan.views]
    _, surface = run_pages.measure_run(run, cell, poses)
    casters = (cell.part_caster, cell.occluder_caster)
    expected = coverage.visible_coverage(np.stack(poses), surface.samples, cell.scanner, casters)
    np.testing.assert_array_equal(surface.seen.any(axis=1), expected.covered)
    assert expected.fraction == pytest.approx(plan.coverage.visible, abs=1e-12)
    for values in surface.layers.values():
        np.testing.assert_array_equal(np.isfinite(values), expected.covered)


def test_a_layer_has_many_classes(run: Run) -> None:
    """Each of 300 regions has a code of its own."""
    reference = run.mesh("reference.ply")
    canvas = canvas_of(reference, draw_samples(reference, run.mesh("planning.ply"), 1000, np.random.default_rng(0)))
    which = np.arange(1000) % 300
    layer = run_pages.named_layer("Regions", which, [(f"region {k}", "#000000") for k in range(300)], canvas)
    np.testing.assert_array_equal(layer.values, which[canvas.vertex_samples()])
    assert len(layer.named) == 300
