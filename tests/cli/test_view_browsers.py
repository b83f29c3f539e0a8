"""Pages in browsers: every control works, without requests and without errors."""

import io
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from PIL import Image

from cell.runs.run import open_run
from cell.view.packed import quantised_layer
from cell.view.page import PageContents, PageScene, PageSurface, PageView, render_page
from cell.view.pieces import cell_of_run
from cell.view.run_pages import part_surface
from cell.view.surface import MeasuredSamples, canvas_of
from planner.geometry.mesh import TriangleMesh
from planner.geometry.sampling import draw_samples
from tests.support.fixture_types import RunCommand

_LATER = "const later = (ms) => new Promise((done) => setTimeout(done, ms));"
_TOUCH = f"""(async () => {{ {_LATER}
  const found = {{}}, byData = (name) => document.querySelector(`[data-name=${{name}}]`);
  const look = async () => {{ await later(500); return canvas.toDataURL(); }};
  const first = await look();
  byData("post").click(); found.hides = (await look()) !== first; byData("post").click();
  found.shows = (await look()) === first;
  const colour = byId("colour");
  colour.selectedIndex = colour.options.length - 1; colour.dispatchEvent(new Event("change"));
  found.recolours = (await look()) !== first;
  KEYS.c(); await look();
  found.at = onScreen(sources[1]).slice(0, 2);
  return found;
}})()"""
_PLAY = f"""(async () => {{ {_LATER}
  const before = Number(byId("time").value), found = {{ inset: !byId("inset").hidden }};
  for (const name of ["selected", "commands"]) found[name] = byId(name).textContent;
  byId("play").click(); await later(1500); byId("play").click();
  found.plays = Number(byId("time").value) > before;
  return found;
}})()"""
_FIRST_FRAME = f"""(async () => {{ {_LATER}
  while (!document.body.dataset.frames) await later(10);
  renderer.getContext().readPixels(0, 0, 1, 1, 6408, 5121, new Uint8Array(4));
}})()"""
_EVERY_COLOUR = f"""(async () => {{ {_LATER}
  const colour = byId("colour");
  for (let k = colour.options.length - 1; k >= 0; k--) {{
    colour.selectedIndex = k; colour.dispatchEvent(new Event("change")); await later(200);
  }}
  return [...colour.options].map((each) => each.text);
}})()"""


def coloured(browser: Any) -> int:
    """Return the number of colours on the screen."""
    with Image.open(io.BytesIO(browser.screenshot())) as seen:
        return len(seen.convert("RGB").getcolors(1 << 24) or [])


def test_the_controls_of_a_page_work(browser: Any, planned: Path) -> None:
    """Hide, show, colour, select and play work, without requests and without errors."""
    browser.open((planned / "view.html").as_uri())
    found = browser.run(_TOUCH)
    browser.click(*found.pop("at"))
    found |= browser.run(_PLAY)
    assert browser.faults() == []
    assert browser.requests() == []
    assert found.pop("selected").startswith("view2, candidate")
    assert f"cell edit {planned} --drop 2 --repair" in found.pop("commands")
    assert found == {"hides": True, "shows": True, "recolours": True, "inset": True, "plays": True}
    assert coloured(browser) > 1000


@pytest.fixture(scope="module")
def pages(
    planned: Path, executed: Path, run_cell: RunCommand, drawing: Callable[[], Any], tmp_path_factory: Any
) -> list[Path]:
    """Return pages of an execution, a scene, `cell why` and `cell diff`."""
    folder = tmp_path_factory.mktemp("pages")
    shutil.copytree(planned, folder / "run")
    for words in (("view", "--no-open", "--out", "scene.html"), ("why", "run", "--samples", "2000"),
                  ("diff", "run", executed, "--out", "diff.html")):  # fmt: skip
        with drawing():
            process = run_cell(*words, cwd=folder)
        assert process.returncode == 0, process.stderr
    scan = executed / "executions" / "0001" / "view.html"
    return [scan, *(folder / name for name in ("scene.html", "run/why/view.html", "diff.html"))]


@pytest.mark.slow
def test_every_page_is_shown(browser: Any, pages: list[Path]) -> None:
    """Each page is drawn in each of its colours, without requests and without errors."""
    for page in pages:
        browser.open(page.as_uri())
        titles = browser.run(_EVERY_COLOUR)
        assert (browser.faults(), browser.requests()) == ([], []), page
        assert coloured(browser) > 500, page
        if page == pages[0]:
            assert {"Number of views", "Spacing of points", "Deviation"} <= set(titles)


@pytest.mark.slow
@pytest.mark.parametrize("chromium", [("--disable-3d-apis",)], indirect=True)
def test_without_webgl_a_page_reports_it_and_shows_its_numbers(chromium: Any, planned: Path) -> None:
    """The page has a sentence about WebGL and the list of views."""
    chromium.open((planned / "view.html").as_uri())
    text = chromium.run("Promise.resolve((select(0), document.body.textContent))")
    assert "cannot draw in three dimensions" in text
    assert "view1, candidate" in text


@pytest.mark.slow
@pytest.mark.parametrize(
    "chromium", [("--window-size=400,300",)], indirect=True
)  # software rendering takes time for each pixel
@pytest.mark.parametrize(("subdivisions", "views", "points"), [(5, 20, 30_000), (8, 200, 1_000_000)])
def test_a_large_page_is_drawn_quickly(
    subdivisions: int, views: int, points: int, chromium: Any, planned: Path, tmp_path: Path
) -> None:
    """Two surfaces of 1.3 million faces, 200 views and a million points fit in 25 MB. Drawing takes at most 5 s of CPU.

    The renderer is the software renderer. A note reports a reduced number of faces.
    """
    rng, ball = np.random.default_rng(0), trimesh.creation.icosphere(subdivisions=subdivisions, radius=0.1)
    mesh = TriangleMesh(ball.vertices, ball.faces.astype(np.int32))
    samples = draw_samples(mesh, mesh, 20_000, rng)
    away = rng.normal(size=(views, 3))
    away /= np.linalg.norm(away, axis=1, keepdims=True)
    layers = {name: rng.random(len(samples)) for name in ("sigma", "spacing")}
    canvas = canvas_of(mesh, samples)
    part = part_surface(canvas, MeasuredSamples(samples, samples.normals @ away.T > 0.5, layers))
    layer = quantised_layer(canvas.mesh.vertices[:, 0], "Deviation", "signed", (-1, 1), "")
    surface = PageSurface("surface", canvas.mesh, [layer])
    run = open_run(planned)
    cell = cell_of_run(run, run.scene)
    poses = np.tile(np.eye(4), (views, 1, 1))
    poses[:, :3, 3] = 0.4 * away
    page_views = [PageView(str(k), cell.T_base_object @ T, 0.1 * k, [("view", str(k))]) for k, T in enumerate(poses, 1)]
    t = np.linspace(0, 0.1 * views, 20_000)
    contents = PageContents(
        page_views, (t, cell.arm.home + np.sin(t)[:, None]), cloud=0.05 * rng.normal(size=(points, 3))
    )
    page = tmp_path / "large.html"
    page.write_text(render_page(PageScene("large", cell, [part, surface]), contents), encoding="utf-8")
    assert page.stat().st_size <= 25e6
    if len(mesh.faces) > len(canvas.mesh.faces):
        assert part.layers[0].note == f"drawn with {len(canvas.mesh.faces):,} of {len(mesh.faces):,} faces"
    chromium.open("about:blank")
    before = chromium.busy()
    chromium.open(page.as_uri())
    chromium.run(_FIRST_FRAME)
    assert chromium.busy() - before <= 5.0
    assert (chromium.faults(), chromium.requests()) == ([], [])
