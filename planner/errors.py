"""The planner's errors.

    PlannerError            invalid input or cell: value, valid values, place

Failure that is data (unreachable, uncoverable, no path, budget spent) is returned, never raised.
"""


class PlannerError(ValueError):
    """Violation of a documented requirement of the input; the message names it and the valid values."""
