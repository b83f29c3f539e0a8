"""Replay in MuJoCo's viewer: the clock drives the show, keys pause it, change its speed and step from view to view.

The viewer calls back on its own thread; a key is put in a queue there and obeyed by the loop here.
"""

from __future__ import annotations

import contextlib
import queue
import threading
import warnings
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np

from cell.errors import UsageError
from cell.replay.show import Show, show_what_is_seen
from cell.runs.timeline import Timeline
from cell.view import rays
from planner.values import Floats

if TYPE_CHECKING:
    import mujoco

REFRESH = 1 / 60
"""Pause between two pictures [s]."""

SPEEDS = (0.05, 20.0)
"""Slowest and fastest show that the keys go to."""

# GLFW's key codes. They differ from the keys that the viewer takes for itself (letters, digits, F1 to F12, [ and ]).
_SPACE, _RIGHT, _LEFT, _DOWN, _UP, _HOME, _END = 32, 262, 263, 264, 265, 268, 269

_CLOSING = 10.0  # patience with a window that closes [s]

HELP = "space pause   left, right view   up, down speed   home start   end tightest moment"


class Player:
    """Where the show is and how fast it runs."""

    def __init__(
        self, timeline: Timeline, speed: float = 1.0, start: float = 0.0, tightest: float | None = None
    ) -> None:
        """Begin to play.

        Args:
            timeline: the show.
            speed: seconds of the show for each second of the clock.
            start: first moment [s].
            tightest: the tightest moment [s]; None where it is not known.
        """
        self.tightest = tightest
        self.timeline, self.speed, self.t = timeline, speed, start
        self.playing = True

    @property
    def ended(self) -> bool:
        """Whether the show stands at its end."""
        return self.t >= self.timeline.duration

    def advance(self, seconds: float) -> None:
        """Let a span of the clock pass [s]."""
        if self.playing:
            self.t = min(self.t + self.speed * seconds, self.timeline.duration)

    def press(self, key: int) -> None:
        """Obey a key (GLFW code); others are left to the viewer."""
        stops = self.timeline.stops
        if key == _SPACE:
            if self.ended:
                self.t, self.playing = 0.0, True
            else:
                self.playing = not self.playing
        elif key == _UP:
            self.speed = min(self.speed * 1.5, SPEEDS[1])
        elif key == _DOWN:
            self.speed = max(self.speed / 1.5, SPEEDS[0])
        elif key == _HOME:
            self.t = 0.0
        elif key == _END and self.tightest is not None:
            self._step_to(self.tightest)
        elif key == _RIGHT:
            self._step_to(next((stop.begin for stop in stops if stop.begin > self.t), self.timeline.duration))
        elif key == _LEFT:
            self._step_to(next((stop.begin for stop in reversed(stops) if stop.begin < self.t), 0.0))

    def _step_to(self, t: float) -> None:
        """Stepping is looking: the show stands at the view until space lets it go on."""
        self.t, self.playing = t, False


def play(
    show: Show,
    camera: rays.Camera,
    *,
    clock: Callable[[], float],
    wait: Callable[[float], None],
    speed: float = 1.0,
    start: float = 0.0,
    once: bool = False,
) -> None:
    """Play the show in a window until it is closed.

    Args:
        show: what is played.
        camera: where the eye is first; its openings are MuJoCo's.
        clock: seconds, rising.
        wait: lets seconds pass.
        speed: seconds of the show for each second of the clock.
        start: first moment [s].
        once: close the window at the end of the show.

    Raises:
        UsageError: if there is no display or no OpenGL on it.
    """
    require_display()
    import mujoco
    import mujoco.viewer

    keys: queue.SimpleQueue[int] = queue.SimpleQueue()
    model, data = show.theatre.model, show.data
    player = Player(show.timeline, speed, start, None if show.closest is None else show.closest.time)
    show.pose(start)
    others = set(threading.enumerate())
    with mujoco.viewer.launch_passive(
        model, data, key_callback=keys.put, show_left_ui=False, show_right_ui=False
    ) as window:
        threads = [thread for thread in threading.enumerate() if thread not in others]
        with window.lock():
            place(window.cam, camera, show.theatre.centre)
            show_what_is_seen(window.opt)
            show.draw_still(window.user_scn)
        still = window.user_scn.ngeom
        before = clock()
        while window.is_running() and not (once and player.ended):
            with contextlib.suppress(queue.Empty):
                while True:
                    player.press(keys.get_nowait())
            now = clock()
            player.advance(now - before)
            before = now
            with window.lock():
                show.pose(player.t)
                touching = show.touches()
                window.user_scn.ngeom = still
                show.draw_moment(window.user_scn, player.t, touching)
            window.set_texts(_captions(show, player, touching))
            window.sync()
            wait(REFRESH)
    # The window is taken down on the viewer's own threads; the program ending under them would abort.
    for thread in threads:
        thread.join(_CLOSING)


def place(free: mujoco.MjvCamera, camera: rays.Camera, centre: Floats) -> None:
    """Put MuJoCo's free camera where a camera of pictures stands; it turns about a point as far away as the part."""
    forward = camera.forward
    free.azimuth, free.elevation = np.degrees([np.arctan2(forward[1], forward[0]), np.arcsin(forward[2])])
    free.distance = float((centre - camera.eye) @ forward)
    free.lookat[:] = camera.eye + free.distance * forward


def require_display() -> None:
    """Open and close a hidden window: the viewer's own thread would wait for ever where none can be opened.

    Raises:
        UsageError: if there is no display, or no OpenGL on it.
    """
    import glfw

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # glfw says as a warning what is said below as a sentence
        opened = bool(glfw.init())
        window = None
        if opened:
            glfw.window_hint(glfw.VISIBLE, 0)
            window = glfw.create_window(64, 64, "scan-cell", None, None)
            if window:
                glfw.destroy_window(window)
            glfw.terminate()
    if not window:
        lacking = "there is no display" if not opened else "the display has no OpenGL"
        raise UsageError(
            f"the viewer cannot open a window: {lacking}; draw pictures with --frames DIR or --picture FILE.png"
        )


def _captions(show: Show, player: Player, touching: Any) -> list[tuple[Any, ...]]:
    import mujoco

    state = "" if player.playing else "   paused"
    where = mujoco.mjtGridPos
    caption = f"{show.caption(player.t, touching)}   x {player.speed:.2g}{state}"
    return [
        (mujoco.mjtFontScale.mjFONTSCALE_150, where.mjGRID_TOPLEFT, caption, ""),
        (mujoco.mjtFontScale.mjFONTSCALE_100, where.mjGRID_BOTTOMLEFT, HELP, ""),
    ]
