"""`cell replay --web`: MuJoCo Studio's web viewer, bound to this machine, for requests with its token only."""

import re
import signal
import urllib.error
import urllib.request
from collections.abc import Mapping
from pathlib import Path

import pytest
from websockets.exceptions import InvalidStatus
from websockets.sync.client import connect

from cell.errors import UsageError
from cell.scene.options import parse_options
from cell.view.replay_options import ReplayOptions
from tests.support.fixture_types import StartCommand


def _status(url: str, headers: Mapping[str, str]) -> int:
    try:
        with urllib.request.urlopen(urllib.request.Request(url, headers=dict(headers)), timeout=20) as answer:
            return int(answer.status)
    except urllib.error.HTTPError as error:
        return error.code


def test_the_web_viewer_answers_only_its_own_page(planned: Path, start_cell: StartCommand, tmp_path: Path) -> None:
    """Page, model and state are served with the token or its cookie; other requests are refused. Ctrl-C ends it."""
    process = start_cell("replay", planned, "--web", "--rate", "0.001", cwd=tmp_path)
    try:
        assert process.stderr is not None
        address = next(found[0] for line in process.stderr if (found := re.search(r"http://\S+", line)))
        root, _, token = address.partition("?token=")
        port = root.rstrip("/").rpartition(":")[2]
        cookie, own = {"Cookie": f"cell-token-{port}={token}"}, f"http://127.0.0.1:{port}"
        assert root == f"{own}/"
        assert _status(address, {}) == _status(f"{root}model?total_bytes", cookie) == 200
        assert _status(root, {}) == _status(f"{root}model", {}) == 403
        assert _status(address, {"Host": f"attacker.example:{port}"}) == 403
        assert _status(address, {"Origin": "http://attacker.example"}) == 403
        for origin, headers in ((own, {}), ("http://attacker.example", cookie)):
            with pytest.raises(InvalidStatus):
                connect(f"ws://127.0.0.1:{port}/state", origin=origin, additional_headers=headers)  # type: ignore[arg-type]
        with connect(f"ws://127.0.0.1:{port}/state", origin=own, additional_headers=cookie):  # type: ignore[arg-type]
            pass
        process.send_signal(signal.SIGINT)
        process.communicate(timeout=60)
        assert process.returncode == 130
    finally:
        process.kill()
        process.communicate()


def test_a_browser_excludes_pictures() -> None:
    """A replay in a browser draws no files."""
    with pytest.raises(UsageError, match="omit frames and picture"):
        parse_options(ReplayOptions, {"web": True, "picture": "tour.png"})
