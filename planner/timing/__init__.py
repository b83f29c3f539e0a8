"""Motion over time: jerk-limited profiles through via points."""
