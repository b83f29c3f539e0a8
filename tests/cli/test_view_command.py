"""`cell view` as a user meets it, and its page as a browser does."""

import base64
import json
import os
import re
import select
import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from PIL import Image

from cell.commands.terminal import Terminal
from cell.view import looking

Run = Callable[..., subprocess.CompletedProcess[str]]
BROWSER = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)

_TOUCH = """(async () => {
  const later = (ms) => new Promise((done) => setTimeout(done, ms)), found = {};
  const byData = (name) => document.querySelector(`[data-name=${name}]`);
  const look = async () => { await later(500); return canvas.toDataURL(); };
  const first = await look();
  byData("post").click(); found.hides = (await look()) !== first; byData("post").click();
  found.shows = (await look()) === first;
  const colour = byId("colour");
  colour.selectedIndex = colour.options.length - 1; colour.dispatchEvent(new Event("change"));
  found.recolours = (await look()) !== first;
  const [x, y] = onScreen(sources[1]);
  for (const kind of ["pointerdown", "pointerup"])
    canvas.dispatchEvent(new PointerEvent(kind, { clientX: x, clientY: y, pointerId: 1 }));
  await look();
  found.chosen = byId("selected").textContent; found.inset = !byId("inset").hidden;
  const before = Number(byId("time").value);
  byId("play").click(); await later(1500); byId("play").click();
  found.plays = Number(byId("time").value) > before;
  return found;
})()"""


def test_a_run_is_shown_and_never_changed(planned: Path, run_cell: Run, tmp_path: Path) -> None:
    """The page of a run is the one in its folder; drawn anew it goes elsewhere, and into the folder never."""
    before = sorted((path.name, path.stat().st_mtime_ns) for path in planned.rglob("*"))
    done = run_cell("view", planned, "--no-open", cwd=tmp_path)
    assert (done.returncode, done.stdout.strip()) == (0, str(planned / "view.html")), done.stderr
    assert f"next:\n  cell scan {planned}\n" in done.stderr
    done = run_cell("view", planned, "--no-open", "--out", "again.html", cwd=tmp_path)
    assert (done.returncode, done.stdout.strip()) == (0, "again.html"), done.stderr
    done = run_cell("view", planned, "--no-open", "--out", planned / "other.html", cwd=tmp_path)
    assert (done.returncode, "never changed" in done.stderr) == (2, True)
    assert sorted((path.name, path.stat().st_mtime_ns) for path in planned.rglob("*")) == before


@pytest.mark.usefixtures("drawn_pictures")
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
    with _Browser(tmp_path) as browser:
        found, asked, faults = browser.touch((planned / "view.html").as_uri(), _TOUCH)
        (tmp_path / "seen.png").write_bytes(browser.screenshot())
    assert faults == []
    assert [url for url in asked if not url.startswith("data:")] == [(planned / "view.html").as_uri()]
    assert found.pop("chosen").startswith("view2, candidate")
    assert found == {"hides": True, "shows": True, "recolours": True, "inset": True, "plays": True}
    with Image.open(tmp_path / "seen.png") as seen:
        assert len(seen.convert("RGB").getcolors(1 << 24) or []) > 1000


class _Browser:
    """Headless Chromium, spoken to through pipes in its DevTools protocol."""

    def __init__(self, folder: Path) -> None:
        listens, self._to = os.pipe()
        self._from, speaks = os.pipe()
        flags = (
            "--headless=new --no-sandbox --use-angle=swiftshader --enable-unsafe-swiftshader --remote-debugging-pipe "
            f"--window-size=1000,700 --user-data-dir={folder / 'profile'}"
        )
        self._process = subprocess.Popen(
            ["bash", "-c", f"exec {BROWSER} {flags} 3<&{listens} 4>&{speaks}"], pass_fds=(listens, speaks),
            stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
        )  # fmt: skip
        os.close(listens), os.close(speaks)
        self._number, self._rest, self._session = 0, b"", ""
        self._told: list[dict[str, Any]] = []

    def __enter__(self) -> "_Browser":
        return self

    def __exit__(self, *_: object) -> None:
        self._process.kill()
        self._process.wait(20)
        os.close(self._to), os.close(self._from)

    def touch(self, address: str, script: str) -> tuple[dict[str, Any], list[str], list[Any]]:
        """What a script returns on a page, what the page asked for, and what went wrong."""
        target = self._ask("Target.createTarget", url="about:blank")["targetId"]
        self._session = self._ask("Target.attachToTarget", targetId=target, flatten=True)["sessionId"]
        for domain in ("Network", "Runtime", "Log", "Page"):
            self._ask(f"{domain}.enable")
        self._ask("Page.navigate", url=address)
        while not any(told["method"] == "Page.loadEventFired" for told in self._told):
            self._told.append(self._read())
        result = self._ask("Runtime.evaluate", expression=script, awaitPromise=True, returnByValue=True)
        asked = [told["params"]["request"]["url"] for told in self._of("Network.requestWillBeSent")]
        faults = [*self._of("Runtime.exceptionThrown"), *self._of("Runtime.consoleAPICalled")]
        # A software renderer says that reading pixels is slow.
        logged = [told["params"]["entry"] for told in self._of("Log.entryAdded")]
        faults += [entry for entry in logged if "GPU stall due to ReadPixels" not in entry["text"]]
        assert "exceptionDetails" not in result, result
        return result["result"]["value"], asked, faults

    def screenshot(self) -> bytes:
        """PNG of the page."""
        return base64.b64decode(self._ask("Page.captureScreenshot")["data"])

    def _of(self, method: str) -> list[dict[str, Any]]:
        return [told for told in self._told if told["method"] == method]

    def _ask(self, method: str, **params: object) -> dict[str, Any]:
        self._number += 1
        said = {"id": self._number, "method": method, "params": params}
        os.write(self._to, json.dumps(said | ({"sessionId": self._session} if self._session else {})).encode() + b"\0")
        while (told := self._read()).get("id") != self._number:
            self._told.append(told)
        assert "error" not in told, told
        answer: dict[str, Any] = told["result"]
        return answer

    def _read(self) -> dict[str, Any]:
        while b"\0" not in self._rest:
            ready, _, _ = select.select([self._from], [], [], 120)
            content = os.read(self._from, 1 << 20) if ready else b""
            assert content, "the browser says nothing"
            self._rest += content
        message, _, self._rest = self._rest.partition(b"\0")
        told: dict[str, Any] = json.loads(message)
        return told
