"""`cell replay --web`: MuJoCo Studio's web viewer, bound to this machine, for requests with its token only."""

import urllib.error
import urllib.request
from collections.abc import Mapping
from pathlib import Path

import pytest
from websockets.exceptions import InvalidStatus
from websockets.sync.client import connect

from cell.errors import UsageError
from cell.scene.options import parse_options
from cell.session import LoggedProgress
from cell.view.replay import replay
from cell.view.replay_options import ReplayOptions


class _EnoughError(Exception):
    pass


class _Reporter(LoggedProgress):
    address = ""

    def note(self, sentence: str) -> None:
        self.address = next((word for word in sentence.split() if word.startswith("http://")), self.address)


def _status(url: str, headers: Mapping[str, str]) -> int:
    try:
        with urllib.request.urlopen(urllib.request.Request(url, headers=dict(headers)), timeout=20) as answer:
            return int(answer.status)
    except urllib.error.HTTPError as error:
        return error.code


@pytest.mark.parametrize("_time", [1, 2])
def test_the_web_viewer_answers_only_its_own_page(_time: int, planned: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Page and model are served with the token or its cookie; other requests are refused, also the second time."""
    monkeypatch.delenv("DISPLAY", raising=False)
    reporter = _Reporter()

    def look(_: float) -> None:
        root, _, token = reporter.address.partition("?token=")
        port = root.rstrip("/").rpartition(":")[2]
        cookie = {"Cookie": f"cell-token-{port}={token}"}
        assert root == f"http://127.0.0.1:{port}/"
        assert _status(reporter.address, {}) == _status(f"{root}model?total_bytes", cookie) == 200
        assert {
            _status(root, {}), _status(f"{root}model", {}), _status(reporter.address, {"Host": "attacker.example"}),
            _status(reporter.address, {"Origin": "http://attacker.example"}),
        } == {403}  # fmt: skip
        with pytest.raises(InvalidStatus):
            connect(f"ws://127.0.0.1:{port}/state", origin=f"http://127.0.0.1:{port}")  # type: ignore[arg-type]
        with connect(f"ws://127.0.0.1:{port}/state", origin=f"http://127.0.0.1:{port}", additional_headers=cookie):  # type: ignore[arg-type]
            pass
        raise _EnoughError

    with pytest.raises(_EnoughError):
        replay(planned, ReplayOptions(web=True), reporter, wait=look)


def test_a_browser_excludes_pictures() -> None:
    """A replay in a browser draws no files."""
    with pytest.raises(UsageError, match="omit frames and picture"):
        parse_options(ReplayOptions, {"web": True, "picture": "tour.png"})
