"""Benchmarks of executions drive the plan of a small part."""

from pathlib import Path

from benchmarks import plant, scan
from cell.runs.run import open_run


def test_the_dynamic_arm_settles_at_each_view(planned: Path) -> None:
    """At rest the scanner's origin is within 0.05 mm of its reference, in motion farther from it than at rest."""
    row = plant.default_plan(open_run(planned), 1.0)
    assert row["at rest mm"] <= 0.05
    assert row["at rest mm"] < row["error mm"] < 1.0
    assert row["off the path mm"] <= row["error mm"]


def test_the_simulated_controller_is_faster_than_the_arm(planned: Path) -> None:
    """The controller skips the time in which the ideal arm moves."""
    assert scan._controller(planned)["faster than real time"] > 1.0
