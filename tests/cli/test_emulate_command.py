"""`cell emulate` and the URLs of drivers: refusals, and imports on demand."""

import subprocess
import sys
from pathlib import Path
from xml.etree import ElementTree

import pytest

from drivers.errors import DriverUrlError
from drivers.registry import Context, open_driver
from tests.support.arms import KR16


@pytest.mark.parametrize(
    ("arguments", "words", "code"),
    [
        (("smoke",), "valid are: serial, modbus, modbus-rtu", 2),
        (("serial", "--port", "5020"), "--port is for cell emulate modbus, ur", 2),
        (("kvp", "--time-scale", "2"), "cell emulate kvp has no --time-scale", 2),
        (("rsi", "--log", "x"), "cell emulate rsi has no --log", 2),
        (("rsi", "--cycle-ms", "5"), "it must be 4 or 12", 2),
        (("rsi", "--faults", "drop=0.1,estop@3"), "cell emulate rsi has no fault estop; valid are: drop, delay", 2),
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


def test_the_files_of_a_controller(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Programs in the form of the controller, without a complaint of krllint; the configuration names this computer."""
    from cell.cli import main

    for protocol in ("kvp", "rsi"):
        with pytest.raises(SystemExit) as end:
            main(["controller", protocol, "--out", str(tmp_path), "--address", "10.0.0.7", "--cycle-ms", "12"])
        assert not end.value.code
    names = {"sc_kvp.src", "sc_kvp.dat", "sc_rsi.src", "sc_rsi.rsi.xml", "sc_rsi_ethernet.xml"}
    assert {path.name for path in tmp_path.iterdir()} == names
    assert set(capsys.readouterr().out.split()) == {str(tmp_path / name) for name in names}
    linted = subprocess.run(
        [sys.executable, "-m", "krllint", str(tmp_path)], capture_output=True, text=True, check=True
    )
    assert all(f"0 {kind}" in linted.stdout for kind in ("violated", "possible", "found warnings", "found errors"))
    configuration = ElementTree.parse(tmp_path / "sc_rsi_ethernet.xml").getroot()
    assert configuration.findtext("CONFIG/IP_NUMBER") == "10.0.0.7"
    assert "#IPO)" in (tmp_path / "sc_rsi.src").read_text()
    flow = ElementTree.parse(tmp_path / "sc_rsi.rsi.xml").getroot()
    assert [each.get("ObjType") for each in flow] == ["AXISCORR", "STOP", "ETHERNET", "AXISCORRMON"]
    spans = {each.get("Name"): each.get("ParamValue") for each in flow[0].iter("Parameter")}
    assert (spans["UpperLimA1"], spans["LowerLimA2"]) == ("370.0000", "-190.0000")


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("ur",), "valid are: kvp, rsi"),
        (("rsi", "--cycle-ms", "5"), "it must be 4 or 12"),
        (("rsi", "--address", "<x>"), "is no address"),
    ],
)
def test_files_that_no_controller_needs(
    arguments: tuple[str, ...], words: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """One sentence each; nothing is written."""
    from cell.cli import main

    with pytest.raises(SystemExit) as end:
        main(["controller", *arguments, "--out", str(tmp_path)])
    assert words in capsys.readouterr().err.replace("\n", " ")
    assert (end.value.code, list(tmp_path.iterdir())) == (2, [])
