"""Texts of the options of studies: ranges, spans and pairs."""

import pytest

from cell.errors import UsageError
from cell.scene.options import flag, parse_options
from cell.study.options import PlaceRange, parse_pairs, parse_range


def test_a_range_holds_its_first_and_last_value() -> None:
    """1000 to 1600 in steps of 50 are 13 values; steps of 0.1 do not accumulate rounding."""
    assert parse_range("--x", "1000:1600:50") == tuple(range(1000, 1601, 50))
    assert parse_range("--x", "0:0.3:0.1") == (0.0, 0.1, 0.2, 0.3)
    assert parse_range("--x", "300:0:-100") == (300.0, 200.0, 100.0, 0.0)
    assert parse_range("--x", "7:7:1") == (7.0,)


def test_numbers_with_commas_are_used_once() -> None:
    """Repeated numbers are dropped, and the given order is kept."""
    assert parse_range("--z", "5,-3,5") == (5.0, -3.0)


@pytest.mark.parametrize(
    "text", ["", "a", "1:2", "1:2:0", "1:2:-1", "2:1:1", "0:nan:1", "0:inf:1", "1:2:3:4", "0:1e9:1"]
)
def test_an_invalid_range_is_refused_with_the_name_of_the_option(text: str) -> None:
    """One sentence, with an example or the limit."""
    with pytest.raises(UsageError, match="--x"):
        parse_range("--x", text)


def test_a_span_is_two_values_or_one_twice() -> None:
    """A span may be negative; an axis without a span has its full range."""
    where = parse_options(PlaceRange, {"y": "-600:600", "z": "5"})
    assert (where.y_mm, where.z_mm) == ((-600.0, 600.0), (5.0, 5.0))
    assert where.x_mm == (700.0, 1600.0)


@pytest.mark.parametrize("text", ["2:1", "a:1", "1:2:3", "", "nan", "0:inf"])
def test_an_invalid_span_is_refused(text: str) -> None:
    """The message has the name of the option."""
    with pytest.raises(UsageError, match="--y"):
        parse_options(PlaceRange, {"y": text}, flag)


def test_pairs_are_near_and_far_limits() -> None:
    """Pairs keep the given order."""
    assert parse_pairs("--range", "50-150,100-300") == [(50.0, 150.0), (100.0, 300.0)]


@pytest.mark.parametrize("text", ["", "50", "150-50", "0-10", "a-b", "10-inf"])
def test_an_invalid_pair_is_refused(text: str) -> None:
    """The message has the name of the option and an example."""
    with pytest.raises(UsageError, match="--range"):
        parse_pairs("--range", text)
