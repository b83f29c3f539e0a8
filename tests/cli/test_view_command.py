"""`cell view` as a user meets it, and its page as a browser does."""

import json
import re
import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from cell.commands.terminal import Terminal
from cell.view import looking

Run = Callable[..., subprocess.CompletedProcess[str]]
BROWSER = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)

_WATCH_ERRORS = """<script>
globalThis.faults = [];
addEventListener("error", (event) => faults.push(String(event.message)));
addEventListener("securitypolicyviolation", (event) => faults.push("asks for " + event.blockedURI));
console.error = console.warn = (...words) => faults.push(words.join(" "));
</script>"""
_TOUCH = """<script>
(async () => {
  const later = (ms) => new Promise((done) => setTimeout(done, ms)), found = {};
  const byData = (name) => document.querySelector(`[data-name=${name}]`);
  await later(800);
  const look = async () => { await later(250); return canvas.toDataURL(); };
  const first = await look();
  byData("post").click(); found.hides = (await look()) !== first; byData("post").click();
  found.shows = (await look()) === first;
  const colour = byId("colour");
  colour.selectedIndex = colour.options.length - 1; colour.dispatchEvent(new Event("change"));
  found.recolours = (await look()) !== first;
  const [x, y] = onScreen(sources[1]);
  for (const kind of ["pointerdown", "pointerup"])
    canvas.dispatchEvent(new PointerEvent(kind, { clientX: x, clientY: y, pointerId: 1 }));
  await later(250);
  found.chosen = byId("selected").textContent; found.inset = !byId("inset").hidden;
  const before = Number(byId("time").value);
  byId("play").click();
  for (let k = 0; k < 4; k++) { await later(150); await new Promise(requestAnimationFrame); }
  byId("play").click();
  found.plays = Number(byId("time").value) > before;
  found.requests = performance.getEntriesByType("resource").length;
  found.faults = faults;
  document.body.dataset.found = JSON.stringify(found);
})().catch((error) => { document.body.dataset.found = JSON.stringify({ faults: [String(error)] }); });
</script>"""


def test_a_run_is_shown_and_never_changed(planned: Path, run_cell: Run, tmp_path: Path) -> None:
    """The page of a run is the one in its folder; drawn anew it goes elsewhere, and into the folder never."""
    before = sorted((path.name, path.stat().st_mtime_ns) for path in planned.rglob("*"))
    done = run_cell("view", planned, "--no-open", cwd=tmp_path)
    assert (done.returncode, done.stdout.strip()) == (0, str(planned / "view.html")), done.stderr
    done = run_cell("view", planned, "--no-open", "--out", "again.html", cwd=tmp_path)
    assert (done.returncode, done.stdout.strip()) == (0, "again.html"), done.stderr
    done = run_cell("view", planned, "--no-open", "--out", planned / "other.html", cwd=tmp_path)
    assert (done.returncode, "never changed" in done.stderr) == (2, True)
    assert sorted((path.name, path.stat().st_mtime_ns) for path in planned.rglob("*")) == before


def test_an_execution_has_its_surface_and_points(executed: Path, run_cell: Run, tmp_path: Path) -> None:
    """Deviation with limits in mm, the cloud, and the arm where it was reported; drawn again it is the same page."""
    folder = executed / "executions" / "0001"
    page = (folder / "view.html").read_text(encoding="utf-8")
    assert '"name":"surface"' in page
    assert '"kind":"signed"' in page
    assert '"cloud":{"low"' in page
    assert (folder / "report.md").read_text().splitlines()[0].endswith("([look at it](view.html))")
    done = run_cell("view", folder, "--no-open", "--out", "again.html", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "again.html").read_text(encoding="utf-8") == page


def test_a_scene_is_drawn_beside_what_check_says(run_cell: Run, tmp_path: Path) -> None:
    """The built-in scene; one whose part stands in the pedestal says so in the page; a failed run shows its cell."""
    done = run_cell("view", "--no-open", "--out", "a.html", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert "contacts at home" in (tmp_path / "a.html").read_text()
    (tmp_path / "mine.toml").write_text("[placement]\nposition_mm = [0, 0, 0]\n")
    assert run_cell("view", "mine.toml", "--no-open", "--out", "b.html", cwd=tmp_path).returncode == 0
    assert re.search(r'"problems":\["[^"]+', (tmp_path / "b.html").read_text())
    done = run_cell("view", "--watch", "--no-open", cwd=tmp_path)
    assert (done.returncode, "cell view my_cell.toml --watch" in done.stderr) == (2, True)


def test_a_watched_scene_is_drawn_again_when_it_is_saved(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A good scene, a broken one whose fault stands in the page beside the last cell, and a good one again."""
    scene, page = tmp_path / "mine.toml", tmp_path / "p.html"
    texts = iter(["[placement\n", "[placement]\nposition_mm = [1000, 0, 0]\n"])
    scene.write_text("[placement]\nposition_mm = [1100, 0, 0]\n")
    seen: list[tuple[str, str]] = []

    def wait(_: float) -> None:
        seen.append((page.read_text(), page.with_name("p.html.stamp.js").read_text()))
        text = next(texts, None)
        if text is None:
            raise KeyboardInterrupt
        scene.write_text(text)

    opened: list[Path] = []
    with pytest.raises(KeyboardInterrupt):
        looking.watch(scene, page, Terminal(), opened.append, wait)
    assert opened == [page]
    stamps = [re.search(r'"watched":"([^"]+)"', text) for text, _ in seen]
    assert [f"drawn({stamp[1]!r});\n" if stamp else "" for stamp in stamps] == [told for _, told in seen]
    assert len({told for _, told in seen}) == 3
    assert ['"problems":[]' in text for text, _ in seen] == [True, False, True]
    assert "mine.toml" in capsys.readouterr().err


@pytest.mark.skipif(BROWSER is None, reason="no browser: install chromium")
def test_a_browser_opens_plays_clicks_hides_and_recolours(planned: Path, tmp_path: Path) -> None:
    """Headless Chromium with software GL: everything does what it says, nothing is asked for, nothing goes wrong."""
    found = _browsed((planned / "view.html").read_text(encoding="utf-8"), tmp_path)
    assert found.pop("chosen").startswith("view2, candidate")
    assert found == {
        "hides": True, "shows": True, "recolours": True, "inset": True, "plays": True, "requests": 0, "faults": [],
    }  # fmt: skip


def _browsed(page: str, folder: Path) -> dict[str, Any]:
    """What happens when the page is opened and touched."""
    touched = page.replace("<body>", "<body>" + _WATCH_ERRORS).replace("</body>", _TOUCH + "</body>")
    (folder / "touched.html").write_text(touched, encoding="utf-8")
    done = subprocess.run(
        [str(BROWSER), "--headless=new", "--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader",
         f"--user-data-dir={folder / 'profile'}", "--window-size=1000,700", "--virtual-time-budget=9000", "--dump-dom",
         (folder / "touched.html").as_uri()],
        capture_output=True, text=True, timeout=180, check=False,
    )  # fmt: skip
    told = re.search(r'data-found="([^"]*)"', done.stdout)
    assert told, done.stderr[-2000:]
    found: dict[str, Any] = json.loads(told[1].replace("&quot;", '"'))
    return found
