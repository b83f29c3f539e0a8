"""The list of faults, their effects on telegrams, and the lines of emulated controllers."""

import os
import socket
from collections import Counter
from pathlib import Path

import numpy as np
import pytest

from drivers.emulated.faults import NAMES, WIRE_FAULTS, Injector, RandomFault, ScheduledFault, parse_faults
from drivers.emulated.serve import LOOPBACK, PtyLine, TcpLine
from drivers.errors import DriverError, LinkError

TELEGRAM = bytes(range(40))


def injector(text: str, seed: int = 0) -> Injector:
    """Return the injector of a list of faults."""
    return Injector(parse_faults(text), np.random.default_rng(seed))


def test_a_list_of_faults_is_parsed() -> None:
    """Probabilities, durations, defaults and times are parsed, and scheduled faults are sorted."""
    faults = parse_faults("drop=0.01, delay=0.02:0.3,half-open=1,estop@12.5,reboot@3:1.5")
    assert faults.random == {
        "drop": RandomFault(0.01, 0.0),
        "delay": RandomFault(0.02, 0.3),
        "half-open": RandomFault(1.0, 1.5),
    }
    assert faults.scheduled == (ScheduledFault(3.0, "reboot", 1.5), ScheduledFault(12.5, "estop", NAMES["estop"]))
    assert parse_faults("").random == {}


@pytest.mark.parametrize(
    "text", ["drop", "drop=", "drop=x", "drop=nan", "drop=-0.1", "drop=1.1", "fire=0.1", "delay=0.1:-1", "delay@3",
             "drop=0.1,drop=0.2", "estop@-1", "estop@inf", "truncate=0.1:2", "delay=0.1:inf"],
)  # fmt: skip
def test_an_invalid_list_is_refused(text: str) -> None:
    """An invalid list gives a message of one line."""
    with pytest.raises(DriverError, match=r"fault") as error:
        parse_faults(text)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("name", WIRE_FAULTS)
def test_the_effect_of_each_fault_on_a_telegram(name: str) -> None:
    """A telegram is lost, late, repeated, reordered, changed or cut. Without faults it is unchanged and immediate."""
    assert injector("").transmit("request", TELEGRAM) == [(0.0, TELEGRAM)]
    wire = injector(f"{name}=1")
    first = wire.transmit("request", TELEGRAM)
    if name == "drop":
        assert first == []
    elif name == "delay":
        assert first == [(0.3, TELEGRAM)]
    elif name == "duplicate":
        assert first == [(0.0, TELEGRAM), (0.02, TELEGRAM)]
    elif name == "reorder":
        assert first == []
        assert wire.is_holding("request")
        assert not wire.is_holding("answer")
        assert wire.transmit("request", b"next") == [(0.0, b"next"), (0.0, TELEGRAM)]
    elif name == "corrupt":
        ((_, changed),) = first
        assert len(changed) == len(TELEGRAM)
        assert changed != TELEGRAM
    else:
        assert all(TELEGRAM.startswith(cut) and len(cut) < len(TELEGRAM) for _, cut in first)


def test_a_held_telegram_is_released_once_if_none_follows() -> None:
    """The release replaces the next telegram."""
    wire = injector("reorder=1")
    wire.transmit("answer", TELEGRAM)
    assert wire.release("answer") == TELEGRAM
    assert wire.release("answer") is None


def test_equal_seeds_disturb_equal_telegrams() -> None:
    """Equal seeds disturb the same telegrams, and another seed disturbs others."""
    text = ",".join(f"{name}=0.2" for name in WIRE_FAULTS)
    runs = [[injector_.transmit("request", TELEGRAM) for _ in range(200)]
            for injector_ in (injector(text, 1), injector(text, 1), injector(text, 2))]  # fmt: skip
    assert runs[0] == runs[1]
    assert runs[0] != runs[2]


def test_a_fault_occurs_at_its_rate() -> None:
    """The number of faults in 20,000 telegrams is within five standard deviations of its expectation."""
    wire = injector("drop=0.05")
    n_lost = Counter(not wire.transmit("request", TELEGRAM) for _ in range(20_000))[True]
    assert abs(n_lost - 1000) < 5 * np.sqrt(20_000 * 0.05 * 0.95)


def test_an_emulated_controller_listens_on_the_loopback_interface_only() -> None:
    """A port in use is an error; bytes pass in both directions; dropped connections are closed."""
    line = TcpLine()
    try:
        assert LOOPBACK == "127.0.0.1"
        assert line._listener.getsockname() == ("127.0.0.1", line.port)
        with pytest.raises(LinkError, match="is not available"):
            TcpLine(line.port)
        with socket.create_connection((LOOPBACK, line.port), timeout=5) as peer:
            received: list[tuple[int, bytes]] = []
            peer.sendall(b"question")
            for _ in range(100):
                received += line.receive(0.05)
                if received:
                    break
            ((number, data),) = received
            assert data == b"question"
            line.send(number, b"answer")
            assert peer.recv(64) == b"answer"
            line.drop_connections()
            assert peer.recv(64) == b""
            line.send(number, b"to nobody")
    finally:
        line.close()


def test_the_link_of_a_pseudo_terminal(tmp_path: Path) -> None:
    """A stale link is replaced, another file is not; unread bytes are lost and do not block."""
    link = tmp_path / "arm"
    link.symlink_to("/nowhere")
    line = PtyLine(link)
    assert os.readlink(link).startswith("/dev/")  # noqa: PTH115 # the target itself, not resolved
    for _ in range(50):
        line.send(0, b"x" * 1000)
    line.close()
    assert not link.is_symlink()
    link.write_text("a file")
    with pytest.raises(LinkError, match="exists and is no link"):
        PtyLine(link)
    assert link.read_text() == "a file"
