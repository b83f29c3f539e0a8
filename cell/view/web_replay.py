"""Replay in MuJoCo Studio's web viewer: in a browser of this machine, also without a display for MuJoCo's own viewer.

The viewer of MuJoCo 4.0 binds to all interfaces and has neither authentication nor checks of Host and Origin. Here it
is bound to 127.0.0.1, and every request is checked (`cell.view.loopback`) before its own server sees it.
"""

import queue
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

from cell.errors import UsageError
from cell.view import loopback, rays
from cell.view.playback import Playback, set_visible_groups
from cell.view.viewer import REFRESH, SPEEDS, Player, set_camera

_PATIENCE_S = 30.0  # until the viewer listens
_MAX_GEOMS = 2000  # of marks; the viewer sends the first 1024


def play_web(
    playback: Playback,
    player: Player,
    camera: rays.Camera,
    on_ready: Callable[[str], None],
    *,
    clock: Callable[[], float],
    wait: Callable[[float], None],
    once: bool = False,
) -> None:
    """Play in a browser until the command is interrupted.

    Args:
        playback: model, timeline and marks.
        player: at the start.
        camera: at the start.
        on_ready: receives the address.
        clock: monotonic [s].
        wait: sleeps for a number of seconds.
        once: end at the end of the motion.

    Raises:
        UsageError: if this MuJoCo has no web viewer, or another one.
    """
    _require_viewer()
    from mujoco.studio import launch_web, viewer_protocol

    token, lock = loopback.make_token(), threading.Lock()
    playback.pose(player.t)
    panel = _panel_type()(playback, player, camera, lock)
    config = viewer_protocol.ViewerConfig(title="scan-cell", gfx="web")
    with _confined(token) as port, launch_web.launch(config, plugins=[panel]) as handle:
        handle.set_model(playback.replay_model.model, data=playback.data)
        on_ready(f"http://{loopback.HOST}:{port()}/?token={token}")
        before = clock()
        while handle.is_running and not (once and player.ended):
            now = clock()
            with lock:
                player.advance(now - before)
                playback.pose(player.t)
            before = now
            handle.sync()
            wait(REFRESH)


def _require_viewer() -> None:
    """Check that everything that is replaced or used below exists.

    Raises:
        UsageError: if this MuJoCo has no web viewer, or another one.
    """
    try:
        from mujoco.studio import launch_web, messages, plugin, viewer_protocol, web_viewer  # noqa: F401
        from mujoco.studio.dear_imgui import dear_imgui  # noqa: F401
        from mujoco.studio.web import web_server

        _ = web_server.bind_public_socket, web_server.serve, web_viewer._print_url_banner
    except (ImportError, AttributeError) as error:
        raise UsageError(
            f"this MuJoCo has no web viewer that can be confined to this machine ({error}); install mujoco 4.0, or "
            "draw pictures with --frames DIR or --picture FILE.png"
        ) from error


@contextmanager
def _confined(token: str) -> Iterator[Callable[[], int]]:
    """Bind the viewer to this machine and check its requests inside the block; yield a function of its port."""
    from mujoco.studio import web_viewer
    from mujoco.studio.web import web_server

    bind, serve, banner = web_server.bind_public_socket, web_server.serve, web_viewer._print_url_banner
    ports: queue.SimpleQueue[int] = queue.SimpleQueue()  # the viewer serves in a thread of its own

    async def serve_checked(handler: Any, *, process_request: Any, **keywords: Any) -> Any:
        port = keywords["sock"].getsockname()[1]

        def check(connection: Any, request: Any) -> Any:
            if reason := loopback.refusal(request, port, token):
                return connection.respond(403, f"{reason}\n")
            response = process_request(connection, request)
            if response is not None:
                response.headers.pop("Access-Control-Allow-Origin", None)
                response.headers["Set-Cookie"] = loopback.cookie(port, token)
            return response

        server = await serve(handler, process_request=check, **keywords)
        ports.put(port)
        return server

    web_server.bind_public_socket = lambda host, port=0: bind(loopback.HOST, port)
    web_server.serve = serve_checked
    web_viewer._print_url_banner = lambda host, port: None  # it names the address of all interfaces
    try:
        yield lambda: ports.get(timeout=_PATIENCE_S)
    finally:
        web_server.bind_public_socket, web_server.serve = bind, serve
        web_viewer._print_url_banner = banner


def _panel_type() -> type[Any]:
    """Return the type of the panel."""
    from mujoco.studio import messages, plugin
    from mujoco.studio.dear_imgui import dear_imgui as imgui

    class Panel(plugin.ViewerPlugin):  # type: ignore[misc]  # mujoco has no types
        """Marks of the moment, and the controls of the playback."""

        def __init__(self, playback: Playback, player: Player, camera: rays.Camera, lock: threading.Lock) -> None:
            self._playback, self._player, self._camera, self._lock = playback, player, camera, lock
            self._is_placed, self._caption = False, ""

        @messages.handler  # type: ignore[untyped-decorator]
        def on_update(self, _: messages.UpdateEvent) -> None:
            import mujoco

            if not self._is_placed:
                set_camera(self.viewer.camera, self._camera, self._playback.replay_model.centre)
                set_visible_groups(self.viewer.vis_options)
                self._is_placed = True
            marks = mujoco.MjvScene(self._playback.replay_model.model, maxgeom=_MAX_GEOMS)
            with self._lock:
                self._playback.add_static_marks(marks)
                violations = self._playback.violations()
                self._playback.add_moment_marks(marks, self._player.t, violations)
                self._caption = self._playback.caption(self._player.t, violations)
            mesh = mujoco.mjtGeom.mjGEOM_MESH  # the web viewer stops at a mark that is a mesh
            self.viewer.extra_geoms[:] = [geom for geom in marks.geoms[: marks.ngeom] if geom.type != mesh]

        @messages.handler  # type: ignore[untyped-decorator]
        def on_gui(self, _: messages.BuildGuiEvent) -> None:
            player = self._player
            if imgui.Begin("Replay")[0]:
                imgui.Text(self._caption)
                with self._lock:
                    if imgui.Button("Pause" if player.playing and not player.ended else "Play"):
                        player.toggle()
                    imgui.SameLine()
                    if imgui.Button("< view"):
                        player.step(-1)
                    imgui.SameLine()
                    if imgui.Button("view >"):
                        player.step(1)
                    is_moved, t = imgui.SliderFloat("s", player.t, 0.0, player.timeline.duration)
                    if is_moved:
                        player.t, player.playing = t, False
                    _, player.speed = imgui.SliderFloat("speed", player.speed, *SPEEDS)
            imgui.End()

    return Panel
