"""`cell live`: reach while a part moves, states as files, the server by its WebSocket, the page in Chromium."""

import asyncio
import json
import shutil
import threading
import urllib.request
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from websockets.exceptions import InvalidStatus
from websockets.sync.client import ClientConnection, connect

from cell import api
from cell.live.live_cell import LiveCell
from cell.live.server import Address, LiveServer
from cell.live.states import States, scene_of
from cell.runs.run import open_run
from cell.scene.file import load_scene
from cell.scene.model import BoxFixture, Placement, Scene, pose
from cell.scene.writer import scene_text
from cell.session import LoggedProgress
from cell.study.placement_trial import COVERAGE_ONLY, evaluate_placement
from cell.study.prepared_part import scene_settings

_PATIENCE_S = 120.0
_BOX = BoxFixture(name="guard", shape="box", position_mm=(1250.0, 250.0, 150.0), size_mm=(500.0, 20.0, 500.0))


@pytest.fixture(scope="module")
def scene(planned: Path) -> Scene:
    """Return the scene of the small plan."""
    return scene_of(open_run(planned))


@pytest.fixture(scope="module")
def cell(scene: Scene) -> LiveCell:
    """Return its cell with a guard that hides a part of the surface."""
    return LiveCell(scene.model_copy(update={"fixtures": (_BOX,)}))


@contextmanager
def _served(scene: Scene, folder: Path, run: Path | None = None) -> Iterator[tuple[LiveServer, Address]]:
    """Serve a scene without automatic plans in a thread."""
    folder.mkdir(parents=True)
    server = LiveServer(States(scene, folder, run), LoggedProgress(), is_planning=False)
    loop, ready, found = asyncio.new_event_loop(), threading.Event(), list[Address]()

    def on_ready(address: Address) -> None:
        found.append(address)
        ready.set()

    task = loop.create_task(server.run(on_ready))

    def serve() -> None:
        with pytest.raises(asyncio.CancelledError):
            loop.run_until_complete(task)
        loop.run_until_complete(loop.shutdown_default_executor())
        loop.close()

    thread = threading.Thread(target=serve)
    thread.start()
    assert ready.wait(_PATIENCE_S)
    try:
        yield server, found[0]
    finally:
        loop.call_soon_threadsafe(task.cancel)
        thread.join(_PATIENCE_S)


@pytest.fixture(scope="module")
def served(
    scene: Scene, planned: Path, tmp_path_factory: pytest.TempPathFactory
) -> Iterator[tuple[LiveServer, Address]]:
    """Serve a copy of the small plan."""
    folder = tmp_path_factory.mktemp("live")
    shutil.copytree(planned, folder / "run")
    with _served(scene, folder / "states", folder / "run") as server:
        yield server


@contextmanager
def _connected(address: Address) -> Iterator[ClientConnection]:
    own = f"http://127.0.0.1:{address.port}"
    with connect(f"{own.replace('http', 'ws')}/{address.token}/socket", origin=own, max_size=None) as socket:
        assert set(json.loads(socket.recv(_PATIENCE_S))) == {"state", "reach"}
        yield socket


def _ask(socket: ClientConnection, name: str, content: object, until: Callable[[Mapping[str, Any]], bool]) -> Any:
    """Send a message and return the first answer that is the expected one."""
    socket.send(json.dumps({name: content}))
    while True:
        message = json.loads(socket.recv(_PATIENCE_S))
        if until(message):
            return message


def _at(x: float, name: str = "part", yaw: float = 0.0) -> dict[str, object]:
    return {"name": name, "position_mm": [x, 400.0, 100.0], "abc_deg": [yaw, 0.0, 0.0]}


@pytest.mark.parametrize("kind", ["built-in", "every key", "fixtures", "run"])
def test_a_scene_is_equal_to_that_of_its_text(kind: str, scene: Scene, tmp_path: Path) -> None:
    """The text of a scene, read as a scene file, is the scene."""
    scenes = {
        "built-in": load_scene(None),
        "every key": load_scene(Path(__file__).parents[2] / "models" / "scene.toml"),
        "fixtures": Scene.model_validate(
            {
                "part": {"name": "mug"}, "mount": {"quaternion": (1.0, 0.0, 0.0, 0.0)}, "table": {"post_mm": 200.0},
                "fixtures": [_BOX.model_dump(), {"name": "a b", "shape": "cylinder", "size_mm": (20.0, 30.0)}],
                "region": [{"name": 'quoted "name"\\', "box_mm": (0.0, 0.0, 0.0, 1.0, 2.0, 3.0), "coverage": 0.9}],
                "robot": {"jerk_deg_s3": (float("inf"),) * 6, "base": {"position_mm": (1.0, 2.0, 3.0)}},
            }
        ),
        "run": scene,
    }  # fmt: skip
    file = tmp_path / "scene.toml"
    file.write_text(scene_text(scenes[kind]), encoding="utf-8")
    assert load_scene(file) == scenes[kind]


def test_an_exact_evaluation_is_that_of_a_placement_study(cell: LiveCell) -> None:
    """Reach and coverable share are equal to those of the trial of `cell study placement`."""
    for x, yaw in ((1100.0, 0.0), (1150.0, 40.0)):
        trial = {**scene_settings(cell.scene), "position_mm": (x, 400.0, 100.0), "abc_deg": (yaw, 0.0, 0.0)}
        expected = evaluate_placement({**trial, "what": COVERAGE_ONLY, "candidates": None})
        found = cell.evaluate(pose((x, 400.0, 100.0), (yaw, 0.0, 0.0)))
        assert found.n_reachable / len(found.verdict) == expected["reachable"]
        assert found.share == expected["coverable"]


def test_an_evaluation_during_a_drag_knows_the_occluders(cell: LiveCell) -> None:
    """It equals the exact one while the part is shifted, and the guard hides samples."""
    free = LiveCell(cell.scene.model_copy(update={"fixtures": ()}), cell)
    assert free.data is cell.data
    hidden = 0
    for x in (1050.0, 1100.0, 1150.0):
        T = pose((x, 400.0, 100.0), (0.0, 0.0, 0.0))
        found, exact = cell.evaluate(T, exact=False), cell.evaluate(T)
        assert (found.coverable == exact.coverable).all()
        assert (found.verdict == exact.verdict).all()
        hidden += int((free.evaluate(T).coverable & ~exact.coverable).sum())
    assert hidden > 0


def test_contacts_name_the_objects(cell: LiveCell) -> None:
    """A part inside a fixture and an arm inside the part are contacts with their names."""
    inside = cell.evaluate(pose((1250.0, 250.0, 100.0), (0.0, 0.0, 0.0)))
    assert "part with guard" in inside.contacts
    assert not inside.is_feasible
    T, home = cell.settled.scene.placement.T, cell.world.home
    assert cell.contacts(T, home) == []
    folded = np.radians([0.0, -20.0, 150.0, 0.0, 90.0, 0.0])
    assert any("link_1" in name for name, _ in cell.contacts(T, folded))


def test_only_the_page_with_the_token_is_served(served: tuple[LiveServer, Address]) -> None:
    """Another path, Host or Origin is refused, and so is a WebSocket without Origin."""
    _, address = served
    root = f"http://127.0.0.1:{address.port}"

    def status(url: str, headers: Mapping[str, str]) -> int:
        try:
            with urllib.request.urlopen(urllib.request.Request(url, headers=dict(headers))) as answer:
                return int(answer.status)
        except urllib.error.HTTPError as error:
            return error.code

    assert status(address.url, {}) == 200
    assert status(f"{address.url}other", {}) == 404
    assert status(f"{root}/", {}) == status(f"{root}/{address.token[:-1]}/", {}) == 403
    assert status(address.url, {"Host": f"attacker.example:{address.port}"}) == 403
    assert status(address.url, {"Origin": "http://attacker.example"}) == 403
    for origin in ("http://attacker.example", None):
        with pytest.raises(InvalidStatus):
            connect(f"{address.url.replace('http', 'ws')}socket", origin=origin)  # type: ignore[arg-type]


def test_states_are_files_and_can_be_undone(scene: Scene, tmp_path: Path) -> None:
    """A dragged part changes nothing; released objects are scene files that load as the present state."""
    with _served(scene, tmp_path / "live") as (server, address), _connected(address) as socket:
        first = server.scene
        dragged = _ask(socket, "drag", _at(1150.0), lambda message: "reach" in message)["reach"]
        expected = server.cell.evaluate(pose((1150.0, 400.0, 100.0), (0.0, 0.0, 0.0)))
        assert (dragged["reachable"], dragged["share"]) == (expected.n_reachable, round(expected.share, 6))
        assert server.scene == first
        moved = _ask(socket, "set", _at(1150.0, yaw=30.0), lambda message: "state" in message)["state"]
        assert load_scene(Path(moved["file"])).placement == Placement.model_validate(
            {"position_mm": (1150.0, 400.0, 100.0), "abc_deg": (30.0, 0.0, 0.0)}
        )
        assert moved["command"] == f"cell plan --scene {moved['file']}"
        box = {"position_mm": [1500.0, -400.0, 0.0], "size_mm": [100.0, 100.0, 300.0]}
        _ask(socket, "box", box, lambda message: "reload" in message)
        (fixture,) = load_scene(server.history.state.file).fixtures
        assert (fixture.name, fixture.position_mm, fixture.occludes) == ("keep-out 1", (1500.0, -400.0, 0.0), False)
        _ask(socket, "remove", "keep-out 1", lambda message: "reload" in message)
        assert server.scene.fixtures == ()
        for _ in range(3):
            _ask(socket, "undo", None, lambda message: "reload" in message)
        assert server.scene == first
        assert not server.history.can_undo


def test_wrong_messages_are_refused(served: tuple[LiveServer, Address]) -> None:
    """A message that is not one of the page, or moves nothing that exists, is an error; the server goes on."""
    server, address = served
    before = server.scene
    with _connected(address) as socket:
        for name, content in (
            ("shell", 1), ("drag", {"name": "part"}), ("set", _at(1e9)), ("set", _at(1.0, "x")), ("pin", "x"),
            ("pin", -1), ("edit", 1), ("edit", {"drop": 1}),
        ):  # fmt: skip
            assert _ask(socket, name, content, lambda message: "error" in message)["error"]
        assert _ask(socket, "jog", {"axes_deg": [0.0] * 6}, lambda message: "contacts" in message)
    assert server.scene == before


def test_a_job_is_cancelled_and_an_execution_is_followed(served: tuple[LiveServer, Address]) -> None:
    """A cancelled plan leaves no folder. On sim:// the arm arrives at every view and at home."""
    server, address = served
    run = server.history.state.run
    assert run is not None
    with _connected(address) as socket:
        _ask(socket, "plan", None, lambda message: "stage" in message.get("job", {}))
        _ask(socket, "cancel", None, lambda message: message.get("job") == {"failed": "cancelled"})
        assert list((server.history.folder / "plans").glob("*")) == []
        socket.send(json.dumps({"scan": None}))
        arrived = list[int]()
        while not arrived or arrived[-1]:
            event = json.loads(socket.recv(_PATIENCE_S)).get("follow", {})
            arrived += [event["number"]] if event.get("event") == "arrival" else []
        assert arrived == [*range(1, open_run(run).report.n_views + 1), 0]
        _ask(socket, "cancel", None, lambda message: message.get("job") == {"failed": "cancelled"})


@pytest.mark.slow
@pytest.mark.usefixtures("full_effort")
def test_a_plan_of_the_page_is_that_of_the_command(scene: Scene, tmp_path: Path) -> None:
    """The plan after a release has the digest of `cell plan` of the saved scene."""
    with _served(scene, tmp_path / "live") as (server, address), _connected(address) as socket:
        _ask(socket, "plan", None, lambda message: "reload" in message)
        found = open_run(server.history.state.run or Path())
        expected = api.plan(scene=server.history.state.file, out=tmp_path / "expected")
        assert found.digest == expected.digest
        assert found.report.coverage == expected.report.coverage


def test_the_page_is_dragged_in_a_browser(browser: Any, served: tuple[LiveServer, Address]) -> None:
    """The tip of an arrow is dragged by pixels; the numbers are those of the evaluation at the shown place."""
    server, address = served
    browser.open(address.url)
    found = browser.run(
        """(async () => {
          const later = (ms) => new Promise((done) => setTimeout(done, ms));
          while (socket.readyState !== 1) await later(50);
          KEYS.f(); await later(400);
          const [a, b] = [gizmoPoint(new THREE.Vector3()), gizmoPoint(unit(0))], rect = canvas.getBoundingClientRect();
          const at = [a[0] + 0.7 * (b[0] - a[0]), a[1] + 0.7 * (b[1] - a[1])];
          const sent = (type, x, y) => canvas.dispatchEvent(new PointerEvent(type, {
            clientX: rect.left + x, clientY: rect.top + y, pointerId: 1, button: 0, buttons: 1, bubbles: true }));
          canvas.setPointerCapture = () => {};
          const before = updates, start = poseNow.position_mm[0];
          sent("pointerdown", ...at);
          for (let k = 1; k <= 5; k++) { sent("pointermove", at[0] + 4 * k, at[1]); await later(150); }
          while (waiting) await later(50);
          return { updates: updates - before, moved: Math.abs(poseNow.position_mm[0] - start), pose: poseNow, reach,
                   text: byId("live-reach").textContent };
        })()"""
    )
    assert browser.faults() == []
    assert [each for each in browser.requests() if not each.startswith(address.url)] == []
    assert found["updates"] >= 2
    assert found["moved"] > 0.5
    position, angles = found["pose"]["position_mm"], found["pose"]["abc_deg"]
    expected = server.cell.evaluate(pose(tuple(position), tuple(angles)), exact=False)
    assert found["reach"]["reachable"] == expected.n_reachable
    assert f"{expected.n_reachable} of {len(expected.verdict)} candidates reached" in found["text"]
    assert f"{100 * expected.share:.2f} % of the surface coverable" in found["text"]
