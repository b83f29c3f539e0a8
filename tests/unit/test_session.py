"""Session of a command: streams, effort, stages."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field

import numpy as np

from cell.session import Effort, LoggedProgress, Session, Stream, default_effort, effort_of, random_stream
from cell.world import clearance

_PLAN = (
    "MATRIX_SAMPLES", "HELD_OUT_SAMPLES", "SELECTION", "MOTION", "POSE_ERRORS", "SIMULATED_EXECUTIONS",
    "COVERAGE_CURVE", "SCOUTS", "ATTAINABLE_SAMPLES", "FRESH_SAMPLES", "POSE_SEARCH", "POSE_COMPARISON",
    "BELIEF_SAMPLES", "BELIEF_SCOUTS",
)  # fmt: skip
_SCAN = ("POSE_DISTURBANCE", "RANGE_NOISE", "DEVIATION_SAMPLES", "PART_DISTURBANCE", "REGISTRATION_STARTS")
_ALONE = {
    "ADVICE_SAMPLES": "BELIEF_SAMPLES",
    "LOCALISATION_STARTS": "BELIEF_SCOUTS",
    "CANDIDATE_SUBSET": "SIMULATED_EXECUTIONS",
}


def test_streams_that_meet_in_one_run_have_numbers_of_their_own() -> None:
    """A plan, a batch of an exploration and a scan have different stream numbers. Commands without a plan share one."""
    members = Stream.__members__
    for names in (_PLAN, _SCAN):
        assert len({members[name].value for name in names}) == len(names)
    for alone, other in _ALONE.items():
        assert members[alone] is members[other]
    assert set(members) == {*_PLAN, *_SCAN, *_ALONE, "FEWEST_VIEWS"} or set(members) == {*_PLAN, *_SCAN, *_ALONE}


def test_a_stream_is_seeded_by_the_run_and_its_number() -> None:
    """Equal streams draw equally; another seed, stream or part of a stream draws differently."""
    session = Session(None, seed=7)
    numbers = session.rng(Stream.SCOUTS).random(4)
    np.testing.assert_array_equal(numbers, np.random.default_rng([7, 7]).random(4))
    for other in (random_stream(8, Stream.SCOUTS), random_stream(7, Stream.MOTION), random_stream(7, Stream.SCOUTS, 1)):
        assert not np.array_equal(other.random(4), numbers)


def test_the_default_effort_is_that_of_the_block() -> None:
    """A session takes the default effort at its creation."""
    before = default_effort()
    with effort_of(Effort(held_out_samples=10)):
        assert Session(None).effort.held_out_samples == 10
        assert before is not default_effort()
    assert default_effort() is before


@dataclass
class _Folder:
    stages: list[str] = field(default_factory=list)

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        self.stages.append(name)
        yield


def test_a_stage_is_reported_and_recorded() -> None:
    """The reporter receives the stage with its progress, and the folder records its name."""
    heard: list[tuple[str, int, int]] = []
    session = Session(None, LoggedProgress(lambda *message: heard.append(message)))
    with session.stage("reach") as progress:
        progress(1, 2)
    folder = _Folder()
    with session.opened(folder, 0).stage("measure"):
        pass
    assert heard == [("reach", 0, 0), ("reach", 1, 2), ("measure", 0, 0)]
    assert folder.stages == ["measure"]


def test_the_default_effort_has_the_tolerance_of_a_clearance() -> None:
    """The default of a session is that of a direct call."""
    assert Effort().clearance_share == clearance.SHARE
