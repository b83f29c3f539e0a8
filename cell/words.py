"""Numbers in words, the same in every report."""

from collections.abc import Iterable


def percent(share: float) -> str:
    """A share of 1."""
    return f"{100 * share:.2f} %"


def listed(values: Iterable[float]) -> str:
    """Numbers beside each other."""
    return ", ".join(f"{value:g}" for value in values)
