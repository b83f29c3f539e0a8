"""Text of numbers, equal in every report."""

from collections.abc import Iterable


def percent(share: float) -> str:
    """Format a share of 1 as a percentage."""
    return f"{100 * share:.2f} %"


def comma_list(values: Iterable[float]) -> str:
    """Join numbers by commas."""
    return ", ".join(f"{value:g}" for value in values)
