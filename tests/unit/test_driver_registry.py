"""Drivers by URL: entry points, options and error messages."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from drivers.clock import SimulatedClock
from drivers.errors import DriverUrlError
from drivers.limits import Limits
from drivers.registry import Context, DriverUrl, open_driver, schemes
from drivers.setpoints import to_deg
from drivers.sim import SimDriver
from drivers.simulated_controller import IdealPlant
from drivers.wire import Timeouts
from planner.ports import JointLimits
from tests.support.driver_bench import KR16


def sim(url: str, context: Context | None = None) -> SimDriver:
    """Return the simulated controller of a URL."""
    return SimDriver.from_url(DriverUrl(url), context or Context(KR16))


@pytest.fixture
def distribution(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return a folder with third-party distributions of valid and broken drivers."""
    info = tmp_path / "acme_robots-2.1.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: acme-robots\nVersion: 2.1\n")
    (info / "entry_points.txt").write_text(
        "[cell.drivers]\nacme = acme_good:Acme\nacme-broken = acme_broken:Acme\nacme-absent = acme_good:Nothing\n"
        "acme-bare = acme_good:bare\nacme-half = acme_good:Half\nacme-two = acme_good:Acme\n"
    )
    other = tmp_path / "rival-1.0.dist-info"
    other.mkdir()
    (other / "METADATA").write_text("Metadata-Version: 2.1\nName: rival\nVersion: 1.0\n")
    (other / "entry_points.txt").write_text("[cell.drivers]\nacme-two = rival:Acme\n")
    (tmp_path / "acme_good.py").write_text(
        "from drivers.sim import SimDriver\n"
        "class Acme(SimDriver):\n    pass\n"
        "class Half:\n    @classmethod\n    def from_url(cls, url, context):\n        return cls()\n"
        "bare = 3\n"
    )
    (tmp_path / "acme_broken.py").write_text("import no_such_module_of_acme\n")
    monkeypatch.syspath_prepend(str(tmp_path))
    return tmp_path


def test_a_third_party_driver_opens_by_its_scheme(distribution: Path) -> None:
    """The scheme of a third-party driver selects its class, which receives the options of the URL."""
    assert {"acme", "acme-broken"} <= set(schemes())
    driver = open_driver("acme://?start=10,-90,90,0,90,0", Context(KR16))
    assert type(driver).__name__ == "Acme"
    with driver:
        assert to_deg(driver.state().axes).tolist() == [10, -90, 90, 0, 90, 0]


@pytest.mark.parametrize(
    ("scheme", "words"),
    [
        ("acme-broken", r"acme-robots 2\.1 cannot be imported from acme_broken:Acme: ModuleNotFoundError"),
        ("acme-absent", r"acme-robots 2\.1 cannot be imported"),
        ("acme-bare", r"acme-robots 2\.1 is acme_good:bare, which has no from_url"),
        ("acme-half", "gave a Half without connect, close"),
        ("acme-two", r"provided by .*acme-robots 2\.1 .* and .*|provided by rival 1\.0"),
        ("nobody", "valid are: .*acme://"),
    ],
)
def test_a_broken_plug_in_is_named(distribution: Path, scheme: str, words: str) -> None:
    """The message for a broken plug-in states the distribution and the error, or the valid schemes."""
    with pytest.raises(DriverUrlError, match=words):
        open_driver(f"{scheme}://", Context(KR16))


def test_listing_the_schemes_imports_nothing(distribution: Path) -> None:
    """In a fresh process, neither a plug-in nor the simulated controller is imported."""
    code = (
        f"import sys; sys.path.insert(0, {str(distribution)!r})\n"
        "import drivers.registry as registry\n"
        "assert 'acme' in registry.schemes()\n"
        "assert not {'acme_good', 'acme_broken', 'drivers.sim', 'drivers.client'} & set(sys.modules)"
    )
    subprocess.run([sys.executable, "-c", code], check=True, timeout=60)


@pytest.mark.parametrize(
    ("url", "words"),
    [
        ("sim://?plnt=ideal", "no option 'plnt'; did you mean 'plant'"),
        ("sim://?zzz", "no option 'zzz'; valid are: plant, realtime"),
        ("sim://?plant=idael", "must be one of: ideal .did you mean 'ideal'"),
        ("sim://?plant=mujoco", "must be one of: ideal"),
        ("sim://?realtime=perhaps", "realtime=perhaps; it must be given alone"),
        ("sim://?realtime&time_scale=0", "time_scale=0; it must be a number above 0"),
        ("sim://?realtime&time_scale=nan", "time_scale=nan; it must be"),
        ("sim://?realtime&time_scale=inf", "time_scale=inf; it must be"),
        ("sim://?time_scale=2", "without realtime"),
        ("sim://?start=1,2,3", "6 numbers joined by commas"),
        ("sim://?start=1,2,3,4,5,x", "6 numbers joined by commas"),
        ("sim://?start=0,-90,90,0,130.0001,0", "outside the axis limits"),
        ("sim://?start=0,-90,90,0,1e9,0", "A5"),
        ("sim://?plant=ideal&plant=ideal", "twice"),
        ("sim://robot", "host or a path"),
        ("sim:///dev/tty", "host or a path"),
        ("sim://#x", "#"),
        ("sim", "no scheme"),
        ("sim:", "no scheme"),
        ("", "no scheme"),
        ("sim://[", "is invalid"),
        ("sim://h:99999", "is invalid"),
    ],
)
def test_an_invalid_url_is_refused(url: str, words: str) -> None:
    """An invalid URL is refused with a message of one line."""
    with pytest.raises(Exception, match=words) as error:
        sim(url)
    assert "DriverUrlError" in type(error.value).__name__ or "SetPointError" in type(error.value).__name__
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("url", "words"),
    [
        ("ur://127.0.0.1?rtde_port=70000", "rtde_port=70000; it must be a whole number from 1 to 65535"),
        ("ur://127.0.0.1?script_port=70000", "from 1 to 65535"),
        ("kvp://127.0.0.1?timer=33", "from 1 to 32"),
        ("serial:///dev/x?baud=99999999999", "from 50 to 12000000"),
        ("modbus://127.0.0.1?unit=256", "from 0 to 255"),
        ("ur://127.0.0.1?watchdog_ms=99.2", "from 100 to 5000"),
        ("ur://a..b", "is invalid"),
        ("kvp://a..b", "is invalid"),
        ("modbus://127.0.0.1:0", "port 0"),
    ],
)
def test_numbers_and_names_that_no_connection_takes_are_refused(url: str, words: str) -> None:
    """They are refused with the URL, not by the library or the system that would open the connection."""
    with pytest.raises(DriverUrlError, match=words):
        open_driver(url, Context(KR16))


def test_options_reach_the_controller() -> None:
    """The URL sets the start position and real time. The limits are those of the arm."""
    with sim("sim://?start=1,-80,70,5,50,9.1234") as driver:
        assert to_deg(driver.state().axes).tolist() == [1, -80, 70, 5, 50, 9.1234]
        assert driver.capabilities.simulated_time
        assert not driver.capabilities.hardware
    with sim("sim://") as driver:
        assert driver.capabilities.lower.tolist() == KR16.lower.tolist()
        assert driver.capabilities.max_step.tolist() == (KR16.upper - KR16.lower).tolist()
    with sim("sim://?realtime") as driver:
        assert not driver.capabilities.simulated_time


def test_the_caller_injects_clock_limits_and_plants() -> None:
    """Clock, limits and plants of the caller replace the defaults. An injected clock excludes real time."""
    narrow = np.radians([10.0] * 6)
    limits = Limits.from_rad(JointLimits(-narrow, narrow, narrow, narrow))
    clock = SimulatedClock(100.0)
    plants: list[IdealPlant] = []

    def plant(start: np.ndarray) -> IdealPlant:
        plants.append(IdealPlant(start))
        return plants[-1]

    context = Context(limits, clock=clock, plants={"ideal": plant, "other": IdealPlant})
    with sim("sim://?start=0,0,0,0,0,0", context) as driver:
        assert driver.controller.plant is plants[0]
        target = np.full((1, 6), 50_000, dtype=np.int32)
        state = driver.move(target, 1.0)
        assert state.axes.tolist() == target[0].tolist()
        assert clock.now() > 100.0
    sim("sim://?plant=other&start=0,0,0,0,0,0", context)
    assert len(plants) == 1
    with pytest.raises(DriverUrlError, match="injected a clock"):
        sim("sim://?realtime&start=0,0,0,0,0,0", context)


def test_timeouts_are_options_in_milliseconds() -> None:
    """Timeouts have defaults and accept values [ms] within their ranges. Others are refused."""
    assert Timeouts.from_url(DriverUrl("serial:///dev/x")) == Timeouts()
    assert (Timeouts().answer, Timeouts().watchdog, Timeouts().watchdog_ms, Timeouts().poll) == (0.25, 1.0, 1000, 0.02)
    url = DriverUrl("serial:///dev/x?timeout_ms=30&watchdog_ms=100&poll_ms=50")
    assert Timeouts.from_url(url) == Timeouts(answer=0.03, watchdog=0.1, poll=0.05)
    assert Timeouts.from_url(DriverUrl("serial:///dev/x?watchdog_ms=5000")).watchdog == 5.0
    for options in ("watchdog_ms=99", "watchdog_ms=5001", "timeout_ms=0", "poll_ms=501", "timeout_ms=334"):
        with pytest.raises(DriverUrlError):
            Timeouts.from_url(DriverUrl(f"serial:///dev/x?{options}"))
    assert DriverUrl("x://?unit=1").integer("unit", 5, at_least=1) == 1
    with pytest.raises(DriverUrlError, match="at least 1"):
        DriverUrl("x://?unit=0").integer("unit", 5, at_least=1)
