"""Fixtures of the driver test bench."""

import pytest

from tests.support.driver_bench import WIRES, Bench, make_bench


@pytest.fixture(params=WIRES)
def backend(request: pytest.FixtureRequest) -> str:
    """Return each wire in turn."""
    return str(request.param)


@pytest.fixture
def wire(backend: str) -> Bench:
    """Yield a connected bench without faults that owns the arm, on each wire."""
    bench = make_bench(backend)
    bench.driver.connect()
    bench.driver.take()
    return bench
