"""Replay in MuJoCo's viewer: a clock drives the playback; keys pause it, change its speed and step between views.

The viewer calls back on its own thread, which puts keys into a queue; the loop here handles them.
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
from cell.runs.timeline import Timeline
from cell.view import rays
from cell.view.playback import Playback, set_visible_groups
from planner.values import Floats

if TYPE_CHECKING:
    import mujoco

REFRESH = 1 / 60
"""Pause between two pictures [s]."""

SPEEDS = (0.05, 20.0)
"""Slowest and fastest speed that the keys set."""

# GLFW's key codes. They differ from the keys of the viewer itself (letters, digits, F1 to F12, [ and ]).
_SPACE, _RIGHT, _LEFT, _DOWN, _UP, _HOME, _END = 32, 262, 263, 264, 265, 268, 269

_CLOSING_TIMEOUT = 10.0  # of the viewer's threads [s]

HELP = "space pause   left, right view   up, down speed   home start   end tightest moment"


class Player:
    """Position and speed of the playback."""

    def __init__(
        self, timeline: Timeline, speed: float = 1.0, start: float = 0.0, tightest: float | None = None
    ) -> None:
        """Start to play.

        Args:
            timeline: joint angles over time.
            speed: seconds of the playback per second of the clock.
            start: first moment [s].
            tightest: the moment of the smallest distance [s], if known.
        """
        self.tightest = tightest
        self.timeline, self.speed, self.t = timeline, speed, start
        self.playing = True

    @property
    def ended(self) -> bool:
        """Whether the playback is at its end."""
        return self.t >= self.timeline.duration

    def advance(self, seconds: float) -> None:
        """Advance by a time of the clock [s]."""
        if self.playing:
            self.t = min(self.t + self.speed * seconds, self.timeline.duration)

    def press(self, key: int) -> None:
        """Handle a key (GLFW code); other keys are ignored."""
        if key == _SPACE:
            self.toggle()
        elif key == _UP:
            self.speed = min(self.speed * 1.5, SPEEDS[1])
        elif key == _DOWN:
            self.speed = max(self.speed / 1.5, SPEEDS[0])
        elif key == _HOME:
            self.t = 0.0
        elif key == _END and self.tightest is not None:
            self._step_to(self.tightest)
        elif key in (_RIGHT, _LEFT):
            self.step(1 if key == _RIGHT else -1)

    def toggle(self) -> None:
        """Pause or continue; at the end, begin again."""
        self.playing = self.ended or not self.playing
        if self.ended:
            self.t = 0.0

    def step(self, by: int) -> None:
        """Go to the next view (1) or to the previous one (-1)."""
        stops = self.timeline.stops
        if by > 0:
            self._step_to(next((stop.begin for stop in stops if stop.begin > self.t), self.timeline.duration))
        else:
            self._step_to(next((stop.begin for stop in reversed(stops) if stop.begin < self.t), 0.0))

    def _step_to(self, t: float) -> None:
        """Go to a moment and pause there until space continues."""
        self.t, self.playing = t, False


def play(
    playback: Playback,
    player: Player,
    camera: rays.Camera,
    *,
    clock: Callable[[], float],
    wait: Callable[[float], None],
    once: bool = False,
) -> None:
    """Play in a window until it is closed.

    Args:
        playback: model, timeline and marks.
        player: at the start.
        camera: at the start, with MuJoCo's field of view.
        clock: monotonic [s].
        wait: sleeps for a number of seconds.
        once: close the window at the end.

    Raises:
        UsageError: if there is no display or no OpenGL on it.
    """
    require_display()
    import mujoco
    import mujoco.viewer

    keys: queue.SimpleQueue[int] = queue.SimpleQueue()
    model, data = playback.replay_model.model, playback.data
    playback.pose(player.t)
    threads_before = set(threading.enumerate())
    with mujoco.viewer.launch_passive(
        model, data, key_callback=keys.put, show_left_ui=False, show_right_ui=False
    ) as window:
        threads = [thread for thread in threading.enumerate() if thread not in threads_before]
        with window.lock():
            set_camera(window.cam, camera, playback.replay_model.centre)
            set_visible_groups(window.opt)
            playback.add_static_marks(window.user_scn)
        n_static = window.user_scn.ngeom
        before = clock()
        while window.is_running() and not (once and player.ended):
            with contextlib.suppress(queue.Empty):
                while True:
                    player.press(keys.get_nowait())
            now = clock()
            player.advance(now - before)
            before = now
            with window.lock():
                playback.pose(player.t)
                violations = playback.violations()
                window.user_scn.ngeom = n_static
                playback.add_moment_marks(window.user_scn, player.t, violations)
            window.set_texts(_captions(playback, player, violations))
            window.sync()
            wait(REFRESH)
    # The viewer's own threads close the window; if the program ended before them, it would abort.
    for thread in threads:
        thread.join(_CLOSING_TIMEOUT)


def set_camera(free: mujoco.MjvCamera, camera: rays.Camera, centre: Floats) -> None:
    """Set MuJoCo's free camera to a camera of pictures; it orbits a point at the distance of the part."""
    forward = camera.forward
    free.azimuth, free.elevation = np.degrees([np.arctan2(forward[1], forward[0]), np.arcsin(forward[2])])
    free.distance = float((centre - camera.eye) @ forward)
    free.lookat[:] = camera.eye + free.distance * forward


def require_display() -> None:
    """Open and close a hidden window; without a display the viewer's own thread would wait forever.

    Raises:
        UsageError: if there is no display, or the display has no OpenGL.
    """
    import glfw

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # the error below replaces glfw's warning
        opened = bool(glfw.init())
        window = None
        if opened:
            glfw.window_hint(glfw.VISIBLE, 0)
            window = glfw.create_window(64, 64, "scan-cell", None, None)
            if window:
                glfw.destroy_window(window)
            glfw.terminate()
    if not window:
        reason = "there is no display" if not opened else "the display has no OpenGL"
        raise UsageError(
            f"the viewer cannot open a window: {reason}; draw pictures with --frames DIR or --picture FILE.png"
        )


def _captions(playback: Playback, player: Player, violations: Any) -> list[tuple[Any, ...]]:
    import mujoco

    state = "" if player.playing else "   paused"
    where = mujoco.mjtGridPos
    caption = f"{playback.caption(player.t, violations)}   x {player.speed:.2g}{state}"
    return [
        (mujoco.mjtFontScale.mjFONTSCALE_150, where.mjGRID_TOPLEFT, caption, ""),
        (mujoco.mjtFontScale.mjFONTSCALE_100, where.mjGRID_BOTTOMLEFT, HELP, ""),
    ]
