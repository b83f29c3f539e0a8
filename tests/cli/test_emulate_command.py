"""`cell emulate` and the URLs of drivers: refusals, and imports on demand."""

import subprocess
import sys

import pytest

from drivers.errors import DriverUrlError
from drivers.registry import Context, open_driver
from tests.support.arms import KR16


@pytest.mark.parametrize(
    ("arguments", "words", "code"),
    [
        (("smoke",), "valid are: serial, modbus, modbus-rtu", 2),
        (("serial", "--port", "5020"), "--port is for cell emulate modbus and ur", 2),
        (("modbus", "--link", "x"), "--link is for pseudo-terminals", 2),
        (("modbus", "--faults", "dorp=0.1"), "there is no fault 'dorp'; did you mean 'drop'", 2),
        (("modbus", "--faults", "drop=2"), "a number from 0 to 1", 2),
        (("modbus", "--faults", "drop@3"), "has a time", 2),
        (("modbus", "--faults", "drop=0.1:3"), "takes none", 2),
        (("modbus", "--start", "1,2,3"), "six numbers", 2),
        (("modbus", "--start", "0,90,90,0,90,0"), "outside the controller's limits", 5),
        (("modbus", "--time-scale", "0"), "at least 0.001", 2),
        (("serial", "--baud", "12345"), "no speed of 12345 baud", 5),
        (("modbus", "--plant", "rubber"), "must be one of: ideal, mujoco", 2),
    ],
)
def test_invalid_options_are_refused(
    arguments: tuple[str, ...], words: str, code: int, capsys: pytest.CaptureFixture[str]
) -> None:
    """An invalid option has a message and an exit code."""
    from cell.cli import main

    with pytest.raises(SystemExit) as end:
        main(["emulate", *arguments, "--seconds", "0"])
    captured = capsys.readouterr().err
    assert words in captured.replace("\n", " ")
    assert end.value.code == code


def test_libraries_are_imported_only_when_needed() -> None:
    """In a fresh process `sim://` imports neither pyserial nor pymodbus, and `serial://` does not import pymodbus."""
    code = (
        "import sys; from cell.robot.model import limits, load; from drivers.limits import Limits\n"
        "from drivers.registry import Context, open_driver; arm = Context(Limits.from_rad(limits(load())))\n"
        "open_driver('sim://', arm)\n"
        "assert not {'serial', 'pymodbus'} & set(sys.modules)\n"
        "open_driver('serial:///dev/ttyUSB0', arm)\n"
        "assert 'serial' in sys.modules and 'pymodbus' not in sys.modules\n"
        "import drivers.emulated.serve\n"
        "assert 'pymodbus' not in sys.modules"
    )
    subprocess.run([sys.executable, "-c", code], check=True, timeout=60)


@pytest.mark.parametrize(
    ("url", "words"),
    [
        ("serial://?baud=9600", "names no port"),
        ("serial://host/dev/x", "names no port"),
        ("serial:///dev/x?baud=fast", "baud=fast"),
        ("serial:///dev/x?unit=1", "no option 'unit'"),
        ("serial:///dev/x?watchdog_ms=50", "watchdog_ms=50"),
        ("serial:///dev/x?timeout_ms=500", "at least 3 times the timeout"),
        ("modbus://", "must name a host"),
        ("modbus://host/path", "no path"),
        ("modbus://host?unit=300", "0 to 255"),
        ("modbus://host?baud=9600", "no option 'baud'"),
        ("modbus+rtu://?unit=1", "names no port"),
        ("modbus+rtu:///dev/x?poll_ms=900", "twice the poll"),
    ],
)
def test_invalid_urls_of_wires_are_refused(url: str, words: str) -> None:
    """An invalid URL is refused before anything is opened."""
    with pytest.raises(DriverUrlError, match=words):
        open_driver(url, Context(KR16))
