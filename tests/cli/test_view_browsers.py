"""Pages as browsers show them: everything does what it says, nothing is asked for, nothing goes wrong."""

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
from cell.view.contents import part_of
from cell.view.packed import stepped
from cell.view.page import Play, Shown, Stage, View, html_of
from cell.view.pieces import cell_of_run
from cell.view.surface import Surface, canvas_of
from planner.geometry.mesh import TriangleMesh
from planner.geometry.sampling import draw_samples

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
    """How many colours the browser shows."""
    with Image.open(io.BytesIO(browser.screenshot())) as seen:
        return len(seen.convert("RGB").getcolors(1 << 24) or [])


def test_a_page_plays_clicks_hides_and_recolours(browser: Any, planned: Path) -> None:
    """Everything does what it says, nothing is asked for, nothing goes wrong."""
    browser.open((planned / "view.html").as_uri())
    found = browser.run(_TOUCH)
    browser.click(*found.pop("at"))
    found |= browser.run(_PLAY)
    assert browser.faults() == []
    assert browser.asked() == []
    assert found.pop("selected").startswith("view2, candidate")
    assert f"cell edit {planned} --drop 2 --repair" in found.pop("commands")
    assert found == {"hides": True, "shows": True, "recolours": True, "inset": True, "plays": True}
    assert coloured(browser) > 1000


@pytest.fixture(scope="module")
def pages(
    planned: Path, executed: Path, run_cell: Callable[..., Any], drawn: Callable[[], Any], tmp_path_factory: Any
) -> list[Path]:
    """Of an execution, a scene, why and a difference."""
    folder = tmp_path_factory.mktemp("pages")
    shutil.copytree(planned, folder / "run")
    for words in (("view", "--no-open", "--out", "scene.html"), ("why", "run", "--samples", "2000"),
                  ("diff", "run", executed, "--out", "diff.html")):  # fmt: skip
        with drawn():
            done = run_cell(*words, cwd=folder)
        assert done.returncode == 0, done.stderr
    scan = executed / "executions" / "0001" / "view.html"
    return [scan, *(folder / name for name in ("scene.html", "run/why/view.html", "diff.html"))]


def test_every_page_is_shown(browser: Any, pages: list[Path]) -> None:
    """A scene, an execution in each of its colours, why, a difference; without a request or a fault."""
    for page in pages:
        browser.open(page.as_uri())
        titles = browser.run(_EVERY_COLOUR)
        assert (browser.faults(), browser.asked()) == ([], []), page
        assert coloured(browser) > 500, page
        if page == pages[0]:
            assert {"Number of views", "Spacing of points", "Deviation"} <= set(titles)


@pytest.mark.parametrize("chromium", [("--disable-3d-apis",)], indirect=True)
def test_without_webgl_a_page_says_so_and_keeps_its_numbers(chromium: Any, planned: Path) -> None:
    """A sentence, the list of views and what is said of each."""
    chromium.open((planned / "view.html").as_uri())
    told = chromium.run("Promise.resolve((select(0), document.body.textContent))")
    assert "nothing in three dimensions" in told
    assert "view1, candidate" in told


@pytest.mark.parametrize("chromium", [("--window-size=400,300",)], indirect=True)  # each pixel takes its time
@pytest.mark.parametrize(
    ("subdivisions", "views", "points"), [(5, 20, 30_000), pytest.param(8, 200, 1_000_000, marks=pytest.mark.slow)]
)
def test_a_large_page_is_soon_there(
    subdivisions: int, views: int, points: int, chromium: Any, planned: Path, tmp_path: Path
) -> None:
    """1.3 million faces twice, 200 views, a million points: 25 MB, the first frame after 5 s of processor time.

    In the software renderer; what is not drawn is told.
    """
    rng, ball = np.random.default_rng(0), trimesh.creation.icosphere(subdivisions=subdivisions, radius=0.1)
    mesh = TriangleMesh(ball.vertices, ball.faces.astype(np.int32))
    samples = draw_samples(mesh, mesh, 20_000, rng)
    away = rng.normal(size=(views, 3))
    away /= np.linalg.norm(away, axis=1, keepdims=True)
    layers = {name: rng.random(len(samples)) for name in ("sigma", "spacing")}
    canvas = canvas_of(mesh, samples)
    part = part_of(canvas, Surface(samples, samples.normals @ away.T > 0.5, layers))
    surface = Shown("surface", canvas.mesh, [stepped(canvas.mesh.vertices[:, 0], "Deviation", "signed", (-1, 1), "")])
    run = open_run(planned)
    cell = cell_of_run(run, run.scene)
    poses = np.tile(np.eye(4), (views, 1, 1))
    poses[:, :3, 3] = 0.4 * away
    said = [View(str(k), cell.T_base_object @ T, 0.1 * k, [("view", str(k))]) for k, T in enumerate(poses, 1)]
    t = np.linspace(0, 0.1 * views, 20_000)
    play = Play(said, (t, cell.arm.home + np.sin(t)[:, None]), cloud=0.05 * rng.normal(size=(points, 3)))
    page = tmp_path / "large.html"
    page.write_text(html_of(Stage("large", cell, [part, surface]), play), encoding="utf-8")
    assert page.stat().st_size <= 25e6
    if len(mesh.faces) > len(canvas.mesh.faces):
        assert part.layers[0].note == f"drawn with {len(canvas.mesh.faces):,} of {len(mesh.faces):,} faces"
    chromium.open("about:blank")
    before = chromium.busy()
    chromium.open(page.as_uri())
    chromium.run(_FIRST_FRAME)
    assert chromium.busy() - before <= 5.0
    assert (chromium.faults(), chromium.asked()) == ([], [])
