"""Error of the planner.

    PlannerError            invalid input or an inconsistent world: the value, the valid range, the location

A failure that is a result (unreachable, uncoverable, no path, budget spent) is returned, never raised.
"""


class PlannerError(ValueError):
    """The input violates a documented requirement; the message names it and the valid input."""
