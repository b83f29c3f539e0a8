"""The planner's errors.

    PlannerError            a broken input or a broken world: fact, what would be valid, where

Failure that is data (unreachable, uncoverable, no path, budget spent) is returned, never raised.
"""


class PlannerError(ValueError):
    """The input breaks a documented requirement; the message names it and says what would be valid."""
