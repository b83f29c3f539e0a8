"""The process of `rsi://` that answers the controller's telegrams: a controller whose arm is driven by corrections.

It holds the interpolator (`drivers.simulated_controller`): the path of a move is sampled once for each telegram, so
time passes with the telegrams, and a position of the arm is never skipped. Telegrams that wait while a newer one has
arrived would be answered late, and are left out. After one of them, or an answer that the controller counts as late,
the arm has stood still for a cycle. The last accepted correction is then repeated until the controller accepts it; the
path goes on from there, from rest to full speed within `RAMP` seconds.

Once the controller is silent for too long, has started RSI again, or must have ended it, nothing is answered any more:
corrections count from the axes at the beginning of RSI. It has started RSI again if its clock or its count of late
answers begins again, or if it does not count the answers that were missed, and the corrections that it reports are not
those of before. For the same reason a session that began with another client, whose telegrams count
late answers, is not answered until the controller has ended it.

Only the sender of the first telegram is answered. An arm that begins outside its limits is not driven: its corrections
stay as they are, and the answer to the client names the axis.

The client commands over a connection of its own; its end, also by a kill, is a stop: the arm brakes on its path, then
RSI is ended. A client that is silent during a move is a fault: the arm brakes on its path.
"""

import contextlib
import gc
import math
import os
import select
import socket
import sys
import time
from bisect import bisect_right
from dataclasses import replace
from multiprocessing.connection import Client, Connection
from operator import itemgetter
from typing import Any, Final

import numpy as np

from drivers.contract import Answer, Fault, Flag, Mode, Result, RobotState
from drivers.limits import Limits
from drivers.profile import TICK, Reference, resting
from drivers.setpoints import PER_DEGREE, Floats, axis_name, from_rad, to_rad
from drivers.simulated_controller import Controller
from drivers.wires import rsi

RAMP: Final = 0.1
"""Time [s] from rest to full speed after a cycle in which the arm stood still."""

HELD_AFTER: Final = 0.1
"""Silence of the controller [s] after which the arm is reported as held."""

_NEAR = math.radians(0.02)  # of an axis at its set-point
_LAST_ANSWERS = 50  # with the end of RSI
_MAX_WAIT = 0.05
_LONGEST_CYCLE_MS = 12
_ROUNDING = 1  # of reported axes at a limit [1e-4 deg]
_LAG = 2  # cycles by which the controller may count a missed answer later
_STEP = 1e-6  # rad; a new reference begins where the last one is
_AGAIN = f"start {rsi.NAME} at the controller again, then connect again"


class _TelegramClock:
    """Time of the path [s]; it passes with the telegrams."""

    simulated = False
    time = 0.0

    def now(self) -> float:
        return self.time

    def wait(self, seconds: float) -> None:
        raise NotImplementedError("the time of telegrams cannot be waited for")


class CorrectedArm:
    """The arm of a controller that adds corrections (`drivers.simulated_controller.Plant`).

    Args:
        axes: (6,) axes at the beginning of RSI [rad].
        clock: time of the path.

    Attributes:
        base: (6,) axes from which the corrections count [rad].
        actual: (6,) axes as reported [rad].
        failure: cause of the end of RSI; empty before it.
        sent: time of the path of the last answer [s].
        accepted: time of the path of the last accepted answer [s].
    """

    def __init__(self, axes: Floats, clock: _TelegramClock) -> None:
        self.base, self.actual, self.failure = axes, axes, ""
        self.sent = self.accepted = clock.time
        self._clock = clock
        self._references: list[tuple[float, Reference]] = [(clock.time, resting(axes))]  # with their begin

    @property
    def reported_axes(self) -> Floats:
        """(6,) axes [rad]: the set-points of an arm that has reached them, else as reported."""
        return self._references[-1][1].end if self.settled else self.actual

    @property
    def settled(self) -> bool:
        """Whether the controller has accepted the end of the reference, and the arm is there."""
        begin, reference = self._references[-1]
        is_near = bool((np.abs(self.actual - reference.end) < _NEAR).all())
        return self.accepted - begin >= reference.duration - TICK and is_near

    def explains(self, applied: Floats, actual: Floats) -> bool:
        """Return whether reported corrections and axes (6,) [rad] are those of the last answer or the one before it.

        A new session begins without corrections, so others prove the session. The axes, which are behind while the arm
        moves, are compared only without them.
        """
        off = min(np.abs(applied - self._correction_at(moment)).max() for moment in (self.sent, self.accepted))
        if np.abs(applied).max() < _NEAR:
            off = max(off, np.abs(actual - applied - self.base).max())
        return bool(off < _NEAR)

    def follow(self, reference: Reference) -> None:
        """Take a new reference; earlier ones are needed as long as their end is not accepted.

        A reset begins a reference at an arm that did not follow the last one. Its correction would be a step: the
        session fails instead.
        """
        begin, last = self._references[-1]
        step = np.abs(reference.sample(np.zeros(1))[0][0] - last.sample(np.array([self._clock.time - begin]))[0][0])
        if step.max() > _STEP:
            self.failure = f"the arm is up to {math.degrees(step.max()):.3f} deg off its set-point: {_AGAIN}"
            return
        self._references = [*self._references[self._active(self.accepted) :], (self._clock.time, reference)]

    def advance(self, seconds: float) -> None:
        """Do nothing: the arm follows its clock."""

    @property
    def correction(self) -> Floats:
        """(6,) correction of the last answer [rad]."""
        return self._correction_at(self.sent)

    def _correction_at(self, moment: float) -> Floats:
        begin, reference = self._references[self._active(moment)]
        return np.asarray(reference.sample(np.array([moment - begin]))[0][0] - self.base)

    def _active(self, moment: float) -> int:
        return max(bisect_right(self._references, moment, key=itemgetter(0)) - 1, 0)


class Stream:
    """Answers telegrams and executes commands.

    Args:
        port: of the telegrams, bound.
        client: the connection of the client.
        limits: limits of the arm.
        silence: longest silence of the controller, and of the client during a move [s].
    """

    def __init__(self, port: socket.socket, client: Connection, limits: Limits, silence: float) -> None:
        self._port, self._client, self._limits, self._silence = port, client, limits, silence
        self._clock = _TelegramClock()
        self._controller: Controller | None = None
        self._arm: CorrectedArm | None = None
        self._session = self._late = self._counted = 0
        self._rate, self._last, self._heard = 1.0, 0, 0.0
        self._cycle_ms = _LONGEST_CYCLE_MS  # shortest time between two telegrams
        self._ending = 0  # remaining answers with the end of RSI
        self._sender: Any = None
        self._refusal = ""  # why the arm is not driven
        self._commanded = time.monotonic()
        self._has_client = True

    def run(self) -> None:
        """Serve until the client has ended, the arm is at rest and the controller has ended RSI."""
        while self._has_client or self._ending:
            sources: list[Any] = [self._port, *([self._client] if self._has_client else [])]
            ready, _, _ = select.select(sources, [], [], _MAX_WAIT)
            if self._port in ready:
                self._answer_newest()
            elif self._client in ready:  # the telegrams come first
                self._serve_client()
            self._check_silence()
            self._check_client()
            if 0 < self._ending < _LAST_ANSWERS and self._silent_for() > HELD_AFTER:
                break  # the controller sends no more: it has received an answer that ends RSI, or is gone

    def _answer_newest(self) -> None:
        """Answer the newest telegram; older ones that wait are late already."""
        newest = self._receive_newest()
        if newest is None:
            return
        telegram, sender = newest
        axes = np.radians(telegram.axes_deg)
        if self._sender is None:
            if telegram.late:  # a session that another client has left: its corrections count from other axes
                return
            self._sender = sender
            self._begin(telegram, axes)
        if self._refusal:
            self._heard = time.monotonic()
            self._send(telegram.ipoc, telegram.applied_deg, end=not self._has_client)
            return
        assert self._arm is not None
        assert self._controller is not None
        passed = telegram.ipoc - self._last
        if -rsi.TIMEOUT_CYCLES * self._cycle_ms < passed < 0 or (passed == 0 and self._heard):
            return  # an old telegram that was delayed
        self._cycle_ms = min(self._cycle_ms, passed) if passed > 0 else self._cycle_ms
        missed = max(passed // self._cycle_ms - 1, 0)
        counted = telegram.late - self._counted
        self._late += missed
        if missed >= rsi.TIMEOUT_CYCLES:
            self._fail(f"the controller was not answered for {passed / 1000:.1f} s and has ended RSI")
        is_explained = abs(counted - missed) <= _LAG or self._arm.explains(np.radians(telegram.applied_deg), axes)
        if passed < 0 or counted < 0 or not is_explained:
            self._fail("the controller has started RSI again")
        self._last, self._arm.actual = telegram.ipoc, axes
        if self._arm.failure:  # corrections of an ended session would be wrong in a new one
            return
        self._counted, self._heard = telegram.late, time.monotonic()
        self._pass_cycle(self._arm, is_accepted=counted <= missed, has_missed=missed > 0)
        self._controller.time_to_wait()  # lets the time pass
        has_ended = not self._has_client and self._is_at_rest()
        self._send(telegram.ipoc, np.degrees(self._arm.correction), end=has_ended)

    def _receive_newest(self) -> tuple[rsi.Telegram, Any] | None:
        """Return the newest waiting telegram of the controller and its sender; None if none waits."""
        newest: tuple[rsi.Telegram, Any] | None = None
        while True:
            try:
                data, sender = self._port.recvfrom(65535)
            except (BlockingIOError, ConnectionError):
                return newest
            if self._sender not in (None, sender):
                continue
            with contextlib.suppress(ValueError):
                received = rsi.parse_telegram(data)
                if newest is None or received.ipoc > newest[0].ipoc:
                    newest = received, sender

    def _pass_cycle(self, arm: CorrectedArm, *, is_accepted: bool, has_missed: bool) -> None:
        """Advance the time of the path by a cycle if the last answer was accepted; else repeat its correction.

        Args:
            arm: the arm.
            is_accepted: whether the controller accepted the last answer.
            has_missed: whether telegrams were left out since then, so that the arm stood still.
        """
        if has_missed or not is_accepted:
            self._rate = 0.0
        if is_accepted:
            cycle = self._cycle_ms / 1000.0
            self._rate = min(self._rate + cycle / RAMP, 1.0)
            arm.accepted = arm.sent
            arm.sent += self._rate * cycle
            self._clock.time = max(self._clock.time, arm.sent)
        else:
            arm.sent = arm.accepted

    def _send(self, ipoc: int, corrections_deg: Floats, *, end: bool) -> None:
        self._ending -= int(end)
        self._port.sendto(rsi.answer(ipoc, corrections_deg, end=end), self._sender)

    def _begin(self, telegram: rsi.Telegram, axes: Floats) -> None:
        """Start the controller at the axes of the first telegram, unless they are outside the limits."""
        lower, upper = self._limits.lower, self._limits.upper
        counts = from_rad(axes)
        outside = np.flatnonzero((counts < lower - _ROUNDING) | (counts > upper + _ROUNDING))
        if len(outside):
            axis = int(outside[0])
            low, at, high = (float(count) / PER_DEGREE for count in (lower[axis], counts[axis], upper[axis]))
            self._refusal = (
                f"axis {axis_name(axis)} is at {at:.4f} deg, outside its limits of {low:.4f} to {high:.4f} deg; drive "
                f"it inside at the pendant, start {rsi.NAME} again, then connect again"
            )
            return
        self._arm = CorrectedArm(np.clip(axes, to_rad(lower), to_rad(upper)), self._clock)  # a rounding error at most
        self._arm.base = axes - np.radians(telegram.applied_deg)  # an earlier client may have begun the session
        self._controller = Controller(self._arm, self._limits, self._clock)
        self._last = telegram.ipoc

    def _check_silence(self) -> None:
        if self._silent_for() > self._silence:
            self._fail(f"the controller has sent no telegram for {self._silence:g} s")

    def _silent_for(self) -> float:
        """Return the time [s] since the last telegram; 0 before the first, or if one waits: this process paused."""
        silent = time.monotonic() - self._heard if self._heard else 0.0
        return 0.0 if select.select([self._port], [], [], 0.0)[0] else silent

    def _check_client(self) -> None:
        is_silent = self._has_client and time.monotonic() - self._commanded > self._silence
        if is_silent and self._controller is not None and not self._is_at_rest() and not self._client.poll():
            self._controller.latch(Fault.WATCHDOG)

    def _fail(self, cause: str) -> None:
        if self._arm is not None and self._controller is not None and not self._arm.failure:
            self._arm.failure = f"{cause}: {_AGAIN}"
            self._controller.time_to_wait()
        self._ending = 0

    def _is_at_rest(self) -> bool:
        return self._controller is None or self._controller.state().at_rest

    def _serve_client(self) -> None:
        try:
            number, name, *arguments = self._client.recv()
            self._commanded = time.monotonic()
            self._client.send((number, self._execute(name, arguments)))
        except (EOFError, OSError):
            self._has_client = False
            if self._refusal:
                self._ending = _LAST_ANSWERS
            elif self._controller is not None and self._arm is not None and not self._arm.failure:
                self._controller.halt()
                self._ending = _LAST_ANSWERS

    def _execute(self, name: str, arguments: list[Any]) -> Any:
        if name == "is ready":
            return self._controller is not None, self._refusal
        assert self._controller is not None
        if name == "state":
            return self._state()
        if name == "late":
            return self._late, self._counted
        if name == "session":
            self._session = arguments[0]
            return Result.OK
        sequence, command = arguments
        answer: Answer = self._controller.command(sequence, command)
        return answer

    def _state(self) -> RobotState:
        assert self._controller is not None
        state = self._controller.state()
        state = replace(state, owner=self._session, heartbeat=int(time.monotonic() * 1000.0) % 65536)
        if state.mode is Mode.MOVING and time.monotonic() - self._heard > HELD_AFTER:
            flags = int(Flag.AT_REST | Flag.HELD)
            state = replace(state, mode=Mode.IDLE, at_rest=True, flags=flags)
        return state


def main() -> None:
    """Connect to the client and serve it; the key of the connection is on stdin."""
    address, number = sys.argv[1].rsplit(":", 1)
    connection = Client((address, int(number)), authkey=bytes.fromhex(sys.stdin.readline().strip()))
    host, port, limits, silence = connection.recv()
    udp = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    try:
        udp.bind((host, port))
    except OSError as error:
        connection.send(f"{error.strerror or error}")
        return
    udp.setblocking(False)
    connection.send("")
    gc.disable()
    with contextlib.suppress(OSError, AttributeError):  # without the right to it, or on another system
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(20))
    Stream(udp, connection, limits, silence).run()
