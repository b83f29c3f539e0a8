"""Pages as browsers show them: everything does what it says, nothing is asked for, nothing goes wrong."""

import io
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

from PIL import Image

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


def test_every_page_is_shown(
    browser: Any, planned: Path, executed: Path, run_cell: Callable[..., Any], tmp_path: Path
) -> None:
    """A scene, an execution in each of its colours, why, a difference; without a request or a fault."""
    shutil.copytree(planned, tmp_path / "run")
    for words in (("view", "--no-open", "--out", "scene.html"), ("why", "run", "--samples", "2000"),
                  ("diff", "run", executed, "--out", "diff.html")):  # fmt: skip
        done = run_cell(*words, cwd=tmp_path)
        assert done.returncode == 0, done.stderr
    scan = executed / "executions" / "0001" / "view.html"
    shown = [scan, *(tmp_path / name for name in ("scene.html", "run/why/view.html", "diff.html"))]
    for page in shown:
        browser.open(page.as_uri())
        titles = browser.run(_EVERY_COLOUR)
        assert (browser.faults(), browser.asked()) == ([], []), page
        assert coloured(browser) > 500, page
        if page == scan:
            assert {"Number of views", "Spacing of points", "Deviation"} <= set(titles)


def test_without_webgl_a_page_says_so_and_keeps_its_numbers(chromium_without_webgl: Any, planned: Path) -> None:
    """A sentence, the list of views and what is said of each."""
    chromium_without_webgl.open((planned / "view.html").as_uri())
    told = chromium_without_webgl.run("Promise.resolve((select(0), document.body.textContent))")
    assert "nothing in three dimensions" in told
    assert "view1, candidate" in told
