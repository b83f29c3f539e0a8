"""Server of `cell live` on 127.0.0.1: one page, and a WebSocket that moves objects and reports reach and jobs.

Messages are JSON objects with one key each. While something is dragged only the latest pose counts. A released object
is a new state: its scene file is written, reach is evaluated exactly, and `cell plan` is started on that file.
"""

from __future__ import annotations

import asyncio
import json
import shlex
from collections import deque
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from http import HTTPStatus
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import BaseModel, Field, ValidationError
from websockets.asyncio.server import ServerConnection, broadcast, serve
from websockets.datastructures import Headers
from websockets.exceptions import ConnectionClosed
from websockets.http11 import Request, Response

from cell.errors import CellError
from cell.live import states
from cell.live.jobs import Job
from cell.live.live_cell import LiveCell
from cell.live.live_page import live_page, reach_json
from cell.live.states import Box, Pose, States
from cell.runs.run import open_finished
from cell.scene.fields import Table
from cell.scene.model import Scene
from cell.session import ProgressReporter
from cell.view import loopback
from planner.errors import PlannerError
from planner.values import Floats

_EVENTS = "executions/*/events.jsonl"  # in a run folder
_POLL_S = 0.05  # between two readings of the events of an execution
_EPHEMERAL = ("drag", "jog")  # messages of which only the latest counts
_MAX_MESSAGE = 1 << 16


class Size(Table):
    """New size of a fixture."""

    name: str
    size_mm: tuple[float, ...]


class Jog(Table):
    """Joint angles."""

    axes_deg: tuple[float, ...]


class Changes(Table):
    """Changes of the views of a plan, in the form of the options of `cell edit`."""

    drop: str = ""
    move: str = ""
    turn: str = ""


class Pin(Table):
    """A candidate that is pinned, or no longer."""

    candidate: int = Field(ge=0)


@dataclass(frozen=True, slots=True)
class Address:
    """Address of a server; `port` and `token` are those of its socket and page."""

    port: int
    token: str

    @property
    def url(self) -> str:
        """Address of the page."""
        return f"http://{loopback.HOST}:{self.port}/{self.token}/"


class LiveServer:
    """State of a live cell and its connections.

    Args:
        history: states, the first of which is loaded.
        reporter: shows the progress of loading.
        is_planning: whether each new state is planned.
    """

    def __init__(self, history: States, reporter: ProgressReporter, *, is_planning: bool = True) -> None:
        self.history, self.is_planning = history, is_planning
        with reporter.stage("load the cell"):
            self.cell = LiveCell(history.state.scene)
            self.reach = self.cell.evaluate(self.centre)
        self.job: Job | None = None
        self._following: asyncio.Task[None] | None = None
        self._connections: set[ServerConnection] = set()
        self._commands: deque[tuple[str, Any]] = deque()
        self._latest: dict[str, Any] = {}
        self._wake = asyncio.Event()
        self._loop: asyncio.AbstractEventLoop | None = None
        self._page: tuple[object, bytes] | None = None
        self._page_lock = asyncio.Lock()
        self._handlers: dict[str, Callable[[Any], None]] = {
            "drag": self._drag, "set": self._set, "jog": self._jog, "box": self._box, "size": self._size,
            "remove": self._remove, "undo": self._undo, "plan": self._plan, "automatic": self._automatic,
            "cancel": self._cancel, "edit": self._edit, "pin": self._pin, "scan": self._scan,
        }  # fmt: skip

    @property
    def scene(self) -> Scene:
        """The present scene with the placement by the part's centre."""
        scene = self.history.state.scene
        placement = scene.placement.by_centre(self.cell.settled.part.T_object_centre)
        return scene.model_copy(update={"placement": placement})

    @property
    def centre(self) -> Floats:
        """Pose (4, 4) of the part's centre [m]."""
        return self.scene.placement.T

    async def run(self, on_ready: Callable[[Address], None]) -> None:
        """Serve until the task is cancelled; `on_ready` receives the address."""
        self._loop = asyncio.get_running_loop()
        sock, port = loopback.open_socket()
        address = Address(port, loopback.make_token())

        async def answer(connection: ServerConnection, request: Request) -> Response | None:
            if reason := loopback.refusal(request, port, address.token):
                return connection.respond(HTTPStatus.FORBIDDEN, f"{reason}\n")
            path = request.path.partition("?")[0]
            if path == f"/{address.token}/socket":
                return None
            if path != f"/{address.token}/":
                return connection.respond(HTTPStatus.NOT_FOUND, "no such page\n")
            body = await self._page_bytes()
            headers = {"Content-Type": "text/html; charset=utf-8", "Content-Length": str(len(body)),
                       "Cache-Control": "no-store", "Referrer-Policy": "no-referrer", "X-Frame-Options": "DENY",
                       "Connection": "close"}  # fmt: skip
            return Response(HTTPStatus.OK, "OK", Headers(headers), body)

        try:
            async with serve(self._connect, sock=sock, process_request=answer, max_size=_MAX_MESSAGE):
                on_ready(address)
                await self._work()
        finally:
            if self._following is not None:
                self._following.cancel()
            await asyncio.to_thread(self._stop_job)

    async def _page_bytes(self) -> bytes:
        async with self._page_lock:
            key = (self.history.state, self.reach)
            if self._page is None or self._page[0] != key:
                self._page = key, (await asyncio.to_thread(self._render)).encode()
            return self._page[1]

    def _render(self) -> str:
        run = self.history.state.run
        return live_page(self.cell, self.centre, self.reach, self._state(), None if run is None else open_finished(run))

    async def _connect(self, connection: ServerConnection) -> None:
        self._connections.add(connection)
        try:
            await connection.send(json.dumps({"state": self._state(), "reach": reach_json(self.reach)}))
            async for text in connection:
                self._receive(text)
        except ConnectionClosed:
            pass
        finally:
            self._connections.discard(connection)

    def _receive(self, text: str | bytes) -> None:
        """Queue a message; a message that is not one of the page is reported."""
        try:
            ((name, content),) = json.loads(text).items()
            if name not in self._handlers:
                raise ValueError
        except (ValueError, AttributeError):
            self._send({"error": "a message is an object with one key: " + ", ".join(self._handlers)})
            return
        if name in _EPHEMERAL:
            self._latest[name] = content
        else:
            self._latest.clear()
            self._commands.append((name, content))
        self._wake.set()

    async def _work(self) -> None:
        while True:
            await self._wake.wait()
            self._wake.clear()
            while self._commands or self._latest:
                name, content = self._commands.popleft() if self._commands else self._latest.popitem()
                try:
                    await asyncio.to_thread(self._handlers[name], content)
                except (CellError, PlannerError) as error:
                    self._send({"error": str(error)})
                    if name == "drag":
                        continue
                    self._send({"reload": True})  # the page shows the present state again

    def _send(self, message: Mapping[str, Any]) -> None:
        """Send to all pages; may be called in any thread."""
        assert self._loop is not None
        text = json.dumps(message, allow_nan=False)
        self._loop.call_soon_threadsafe(lambda: broadcast(self._connections, text))

    def _state(self) -> dict[str, Any]:
        state, scene = self.history.state, self.scene
        sizes = {each.name: getattr(each, "size_mm", None) for each in scene.fixtures}
        attached = {each.name for each in scene.fixtures if each.attached_to == "object"}
        return {
            "targets": [
                {**each.model_dump(), "size_mm": sizes.get(each.name), "attached": each.name in attached}
                for each in states.targets(scene)
            ],
            "file": str(state.file), "command": state.command, "can_undo": self.history.can_undo,
            "run": None if state.run is None else str(state.run), "automatic": self.is_planning,
            "pinned": list(scene.plan.pinned),
        }  # fmt: skip

    # ---- messages, in the thread of the worker --------------------------------------------------------------------
    def _drag(self, content: Any) -> None:
        pose = _parsed(Pose, content)
        if pose.name == states.PART:
            new_reach = self.cell.evaluate(pose.T, exact=False)
        else:
            cell = LiveCell(states.moved(self.scene, pose), self.cell)
            new_reach = cell.evaluate(cell.settled.scene.placement.T, exact=False)
        self._send({"reach": reach_json(new_reach)})

    def _set(self, content: Any) -> None:
        pose = _parsed(Pose, content)
        scene = states.moved(self.scene, pose)
        if pose.name == states.PART and scene.plan.pinned:  # grown candidates have other numbers elsewhere
            scene = states.pinned(scene, ())
        self._push(scene, is_drawn=pose.name not in (states.ROBOT, states.TABLE))  # pedestal and post change as well

    def _push(self, scene: Scene, *, is_drawn: bool = True) -> None:
        """Make a scene the present state, evaluate it and plan it; draw the page again unless it shows the scene."""
        self._stop_job()
        known = self.cell.scene.model_copy(update={"placement": scene.placement, "plan": scene.plan})
        cell = self.cell if known == scene else LiveCell(scene, self.cell)
        new_reach = cell.evaluate(scene.placement.by_centre(cell.settled.part.T_object_centre).T)
        self.history.push(scene)
        self.cell, self.reach = cell, new_reach
        self._changed(is_drawn=is_drawn)
        if self.is_planning and new_reach.is_feasible:
            self._plan(None)

    def _changed(self, *, is_drawn: bool) -> None:
        self._send({"state": self._state(), "reach": reach_json(self.reach)})
        if not is_drawn:
            self._send({"reload": True})

    def _jog(self, content: Any) -> None:
        angles = _parsed(Jog, content).axes_deg
        q = self.cell.world.home.copy()
        q[: min(len(angles), len(q))] = np.radians(angles[: len(q)])
        pairs = self.cell.contacts(self.centre, q)
        self._send({"contacts": [[name, round(1000 * distance, 2)] for name, distance in pairs]})

    def _box(self, content: Any) -> None:
        scene, _ = states.with_box(self.scene, _parsed(Box, content))
        self._push(scene, is_drawn=False)

    def _size(self, content: Any) -> None:
        size = _parsed(Size, content)
        self._push(states.resized(self.scene, size.name, size.size_mm), is_drawn=False)

    def _remove(self, content: Any) -> None:
        self._push(states.without(self.scene, str(content)), is_drawn=False)

    def _undo(self, _: Any) -> None:
        self._stop_job()
        self.history.undo()
        self.cell = LiveCell(self.history.state.scene, self.cell)
        self.reach = self.cell.evaluate(self.centre)
        self._changed(is_drawn=False)

    def _automatic(self, content: Any) -> None:
        self.is_planning = bool(content)
        self._send({"state": self._state()})

    def _plan(self, _: Any) -> None:
        state, out = self.history.state, self.history.new_run()
        words = ["plan", "--scene", str(state.file), "--out", str(out)]
        self._start({"command": "plan", "source": str(state.file), "out": str(out), "argv": words}, self._planned)

    def _edit(self, content: Any) -> None:
        """Repair a plan after `drop`, `move` or `turn` of views."""
        state, out = self.history.state, self.history.new_run()
        if state.run is None:
            self._send({"error": "there is no plan to change; plan first"})
            return
        changes = {key: text for key, text in _parsed(Changes, content).model_dump().items() if text}
        options, flags = {**changes, "repair": True}, [f"--{key}={text}" for key, text in changes.items()]
        words = ["edit", str(state.run), *flags, "--repair", "--out", str(out)]
        task = {"command": "edit", "source": str(state.run), "out": str(out), "options": options, "argv": words}
        self._send({"command": shlex.join(["cell", *words])})
        self._start(task, self._edited)

    def _pin(self, content: Any) -> None:
        pinned, candidate = list(self.scene.plan.pinned), _parsed(Pin, {"candidate": content}).candidate
        pinned = [each for each in pinned if each != candidate] if candidate in pinned else [*pinned, candidate]
        run = self.history.state.run
        self._push(states.pinned(self.scene, pinned))
        if not self.is_planning:  # the page still shows the plan
            self.history.with_run(run)
            self._send({"state": self._state()})

    def _scan(self, _: Any) -> None:
        """Execute the plan on the simulated controller."""
        run = self.history.state.run
        if run is None:
            self._send({"error": "there is no plan to execute; plan first"})
            return
        self._send({"command": f"cell scan {shlex.quote(str(run))} --realtime"})
        before = set(run.glob(_EVENTS))
        self._start({"command": "scan", "source": str(run)}, self._scanned)
        assert self._loop is not None
        self._loop.call_soon_threadsafe(self._follow, run, before)

    def _cancel(self, _: Any) -> None:
        self._stop_job()
        self._send({"job": {"failed": "cancelled"}})

    # ---- jobs ------------------------------------------------------------------------------------------------------
    def _start(self, task: Mapping[str, Any], on_end: Callable[[Path], None]) -> None:
        self._stop_job()
        state = self.history.state

        def report(message: Mapping[str, Any]) -> None:
            if "folder" in message and self.history.state is state:
                on_end(Path(message["folder"]))
            self._send({"job": {"command": task["command"], **message}})
            if "folder" in message and task["command"] != "scan":
                self._send({"reload": True})

        self.job = Job(task, report)

    def _stop_job(self) -> None:
        if self.job is not None:
            self.job.cancel()
        self.job = None

    def _planned(self, run: Path) -> None:
        self.history.with_run(run)

    def _edited(self, run: Path) -> None:
        self.history.push_run(run)

    def _scanned(self, _: Path) -> None:
        self._send({"follow": {"event": "done"}})

    def _follow(self, run: Path, before: set[Path]) -> None:
        if self._following is not None:
            self._following.cancel()
        self._following = asyncio.create_task(self._send_events(run, self.job, before))

    async def _send_events(self, run: Path, job: Job | None, before: set[Path]) -> None:
        """Send the events of the new execution of a run until its job ends; `before` are the files of earlier ones."""
        sent, is_running = 0, True
        while is_running:
            is_running = job is not None and job.is_running  # events that precede the end are read after it
            for path in set(run.glob(_EVENTS)) - before:
                with path.open("rb") as file:
                    file.seek(sent)
                    complete, _, _ = file.read().rpartition(b"\n")  # the last line may be incomplete
                for line in complete.splitlines():
                    with suppress(ValueError):
                        self._send({"follow": json.loads(line)})
                sent += len(complete) + 1 if complete else 0
            await asyncio.sleep(_POLL_S)


def _parsed(model: Any, content: Any) -> Any:
    """Return the checked content of a message.

    Raises:
        CellError: if it is not valid.
    """
    assert issubclass(model, BaseModel)
    try:
        return model.model_validate_json(json.dumps(content))
    except ValidationError as error:
        raise CellError(f"the message is not a {model.__name__.lower()}: {error.errors()[0]['msg']}") from error
