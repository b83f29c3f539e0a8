"""Fixtures of the tests of commands: few readings of a simulated arm, and browsers, each in its own protocol."""

import base64
import contextlib
import json
import os
import select
import shutil
import socket
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from drivers import sim

_PATIENCE_S = 120.0


@pytest.fixture(autouse=True)
def _few_readings(monkeypatch: pytest.MonkeyPatch) -> None:
    """Read a simulated moving arm every 0.1 s; tests of drivers read it every 0.02 s, as executions do."""
    monkeypatch.setattr(sim, "POLL", 0.1)


class Chromium:
    """Headless Chromium with SwiftShader. It is driven through pipes in the DevTools protocol."""

    program = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
    missing = "" if program else "no Chromium: install chromium"

    def __init__(self, folder: Path, *more: str) -> None:
        listens, self._to = os.pipe()
        self._from, speaks = os.pipe()
        flags = (
            "--headless=new --no-sandbox --use-angle=swiftshader --enable-unsafe-swiftshader --remote-debugging-pipe "
            f"--window-size=1000,700 --user-data-dir={folder / 'chromium'} {' '.join(more)}"
        )
        self._process = subprocess.Popen(
            ["bash", "-c", f"exec {self.program} {flags} 3<&{listens} 4>&{speaks}"], pass_fds=(listens, speaks),
            stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
        )  # fmt: skip
        os.close(listens), os.close(speaks)
        self._number, self._rest, self._session, self._address = 0, b"", "", ""
        self._messages: list[dict[str, Any]] = []

    def open(self, address: str) -> None:
        """Load a page."""
        if not self._session:
            target = self._ask("Target.createTarget", url="about:blank")["targetId"]
            self._session = self._ask("Target.attachToTarget", targetId=target, flatten=True)["sessionId"]
            for domain in ("Network", "Runtime", "Log", "Page"):
                self._ask(f"{domain}.enable")
        self._messages, self._address = [], address
        self._ask("Page.navigate", url=address)
        while not self._of("Page.loadEventFired"):
            self._messages.append(self._read())

    def run(self, script: str) -> Any:
        """Return the value with which the promise of a script is fulfilled."""
        result = self._ask("Runtime.evaluate", expression=script, awaitPromise=True, returnByValue=True)
        assert "exceptionDetails" not in result, result
        return result["result"].get("value")

    def screenshot(self) -> bytes:
        """Return a PNG of the page."""
        return base64.b64decode(self._ask("Page.captureScreenshot")["data"])

    def busy(self) -> float:
        """Return the processor time of all processes of the browser [s]. Other load hardly changes it."""
        session, self._session = self._session, ""
        processes = self._ask("SystemInfo.getProcessInfo")["processInfo"]
        self._session = session
        return sum(each["cpuTime"] for each in processes)

    def click(self, x: float, y: float) -> None:
        """Click with the left mouse button."""
        for kind in ("mousePressed", "mouseReleased"):
            self._ask("Input.dispatchMouseEvent", type=kind, x=x, y=y, button="left", clickCount=1)

    def requests(self) -> list[str]:
        """Return the addresses that the page requested."""
        urls = [words["request"]["url"] for words in self._of("Network.requestWillBeSent")]
        return [url for url in urls if url != self._address and not url.startswith("data:")]

    def faults(self) -> list[str]:
        """Return the errors and console messages of the page."""
        found = [
            str(words) for name in ("exceptionThrown", "consoleAPICalled") for words in self._of(f"Runtime.{name}")
        ]
        # A software renderer warns that reading pixels is slow.
        logged = [words["entry"]["text"] for words in self._of("Log.entryAdded")]
        return found + [text for text in logged if "GPU stall due to ReadPixels" not in text]

    def close(self) -> None:
        """End the process."""
        self._process.kill()
        self._process.wait(20)
        os.close(self._to), os.close(self._from)

    def _of(self, method: str) -> list[dict[str, Any]]:
        return [words["params"] for words in self._messages if words["method"] == method]

    def _ask(self, method: str, **params: object) -> dict[str, Any]:
        self._number += 1
        output = {"id": self._number, "method": method, "params": params}
        os.write(
            self._to, json.dumps(output | ({"sessionId": self._session} if self._session else {})).encode() + b"\0"
        )
        while (words := self._read()).get("id") != self._number:
            self._messages.append(words)
        assert "error" not in words, words
        answer: dict[str, Any] = words["result"]
        return answer

    def _read(self) -> dict[str, Any]:
        while b"\0" not in self._rest:
            ready, _, _ = select.select([self._from], [], [], _PATIENCE_S)
            content = os.read(self._from, 1 << 20) if ready else b""
            assert content, "Chromium says nothing"
            self._rest += content
        message, _, self._rest = self._rest.partition(b"\0")
        words: dict[str, Any] = json.loads(message)
        return words


class Firefox:
    """Firefox on a virtual screen with Mesa's software GL: headless Firefox has no WebGL. The protocol: Marionette."""

    program = next(filter(None, map(shutil.which, ("firefox-esr", "firefox"))), None)
    missing = "" if program and shutil.which("Xvfb") else "no Firefox on a virtual screen: install firefox-esr and xvfb"

    def __init__(self, folder: Path) -> None:
        profile = folder / "firefox"
        profile.mkdir()
        with socket.socket() as free:
            free.bind(("127.0.0.1", 0))
            port = free.getsockname()[1]
        preferences = {"marionette.port": port, "network.proxy.type": 1, "network.proxy.ssl": "127.0.0.1"}
        preferences |= {"network.proxy.ssl_port": 9}  # a port without a listener: no request to the vendor succeeds
        lines = (f'user_pref("{name}", {json.dumps(value)});\n' for name, value in preferences.items())
        (profile / "user.js").write_text("".join(lines))
        display_output, screen = os.pipe()
        self._screen = subprocess.Popen(
            ["Xvfb", "-displayfd", str(screen), "-screen", "0", "1000x700x24", "-nolisten", "tcp"], pass_fds=(screen,),
            stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
        )  # fmt: skip
        os.close(screen)
        with os.fdopen(display_output) as words:
            display = f":{words.readline().strip()}"
        self._process = subprocess.Popen(
            [str(self.program), "--marionette", "--remote-allow-system-access", "--no-remote", "--profile",
             str(profile)],
            env={**os.environ, "DISPLAY": display, "HOME": str(folder), "LIBGL_ALWAYS_SOFTWARE": "1"},
            stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
        )  # fmt: skip
        self._line, self._rest, self._number = self._called(port), b"", 0
        self._read()  # the greeting
        self._ask("WebDriver:NewSession")
        self._ask("WebDriver:SetTimeouts", script=int(1000 * _PATIENCE_S))
        self._in_chrome(
            "window.requests = []; Services.obs.addObserver((request) => { request.QueryInterface(Ci.nsIChannel);"
            "if (!request.loadInfo.triggeringPrincipal.isSystemPrincipal) window.requests.push(request.URI.spec); },"
            "'http-on-modify-request');"
        )

    def open(self, address: str) -> None:
        """Load a page."""
        self._in_chrome("window.requests.length = 0; Services.console.reset();")
        self._ask("WebDriver:Navigate", url=address)

    def run(self, script: str) -> Any:
        """Return the value with which the promise of a script is fulfilled."""
        output = (  # run as an element of the page: the constants of the page are not visible otherwise
            "const [text, done] = arguments, made = document.createElement('script');"
            "made.textContent = `answer = ${text}`; document.head.append(made);"
            "window.answer.then((found) => done([found]), (error) => done(`${error}`));"
        )
        answer = self._ask("WebDriver:ExecuteAsyncScript", script=output, args=[script], sandbox=None)
        assert isinstance(answer["value"], list), answer
        return answer["value"][0]

    def screenshot(self) -> bytes:
        """Return a PNG of the page."""
        return base64.b64decode(self._ask("WebDriver:TakeScreenshot", full=False)["value"])

    def click(self, x: float, y: float) -> None:
        """Click with the left mouse button."""
        moves = [{"type": "pointerMove", "x": round(x), "y": round(y)}, {"type": "pointerDown", "button": 0},
                 {"type": "pointerUp", "button": 0}]  # fmt: skip
        self._ask("WebDriver:PerformActions", actions=[{"type": "pointer", "id": "mouse", "actions": moves}])

    def requests(self) -> list[str]:
        """Return the addresses that the page requested."""
        requests: list[str] = self._in_chrome("return window.requests;")
        return requests

    def faults(self) -> list[str]:
        """Return the messages about pages. Messages about the scripts of the browser are left out."""
        words = self._in_chrome(
            "return Services.console.getMessageArray().map((each) => [each.sourceName, `${each}`]);"
        )
        return [text for source, text in words if source and source.startswith("file:")]

    def close(self) -> None:
        """End the processes of the browser and of the screen."""
        for process in (self._process, self._screen):
            process.kill()
            process.wait(20)
        self._line.close()

    def _called(self, port: int) -> socket.socket:
        until = time.monotonic() + _PATIENCE_S
        while True:
            try:
                return socket.create_connection(("127.0.0.1", port), _PATIENCE_S)
            except ConnectionRefusedError:
                assert self._process.poll() is None, "Firefox ended"
                assert time.monotonic() < until, "Firefox does not listen"
                time.sleep(0.1)

    def _in_chrome(self, script: str) -> Any:
        """Return the value of a script that runs with the privileges of the browser."""
        self._ask("Marionette:SetContext", value="chrome")
        value = self._ask("WebDriver:ExecuteScript", script=script, args=[])["value"]
        self._ask("Marionette:SetContext", value="content")
        return value

    def _ask(self, method: str, **params: object) -> dict[str, Any]:
        self._number += 1
        output = json.dumps([0, self._number, method, params]).encode()
        self._line.sendall(b"%d:%b" % (len(output), output))
        _, number, error, result = self._read()
        assert (number, error) == (self._number, None), error
        answer: dict[str, Any] = result
        return answer

    def _read(self) -> Any:
        while b":" not in self._rest:
            self._receive()
        length, _, self._rest = self._rest.partition(b":")
        while len(self._rest) < int(length):
            self._receive()
        message, self._rest = self._rest[: int(length)], self._rest[int(length) :]
        return json.loads(message)

    def _receive(self) -> None:
        content = self._line.recv(1 << 20)
        assert content, "Firefox says nothing"
        self._rest += content


@pytest.fixture(scope="module", params=[Chromium, pytest.param(Firefox, marks=pytest.mark.slow)])
def browser(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Chromium | Firefox]:
    """Yield each installed browser."""
    if request.param.missing:
        pytest.skip(request.param.missing)
    browser_process: Chromium | Firefox = request.param(tmp_path_factory.mktemp("browser"))
    yield browser_process
    browser_process.close()


@pytest.fixture(params=[()])
def chromium(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[Chromium]:
    """Yield Chromium with further flags."""
    if Chromium.missing:
        pytest.skip(Chromium.missing)
    with contextlib.closing(Chromium(tmp_path, *request.param)) as browser_process:
        yield browser_process
