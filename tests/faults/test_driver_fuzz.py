"""The codecs against mangled frames, in reduced forms; the full one is `python -m benchmarks fuzz`."""

import numpy as np
import pytest

from benchmarks import fuzz


@pytest.mark.parametrize("frames", [12_000, pytest.param(120_000, marks=pytest.mark.slow)])
def test_no_mangled_frame_crashes_a_codec_or_passes_for_another(frames: int) -> None:
    """Bits, bytes, bursts, cuts and joins."""
    for row in fuzz.run(frames, seed=4):
        assert row["crashes"] == 0, row
        assert row["false accepts"] == 0, row
        assert row["still whole"] < row["mangled"] / 4, row


def test_the_fuzz_would_see_a_codec_that_accepts_too_much() -> None:
    """A receiver that does not look at the CRC is found out."""
    rng = np.random.default_rng(0)

    def careless(data: bytes) -> set[bytes]:
        return {line[:-9] for line in data.splitlines() if len(line) > 10}

    assert fuzz.fuzz(fuzz.serial_frames(rng), careless, 500, rng)["false accepts"] > 100


def test_the_fuzz_would_see_a_crash() -> None:
    """A receiver that trusts the length is found out."""
    rng = np.random.default_rng(0)

    def trusting(data: bytes) -> set[bytes]:
        return {data[: int(data[7:11])]}

    assert fuzz.fuzz(fuzz.serial_frames(rng), trusting, 500, rng)["crashes"] > 10
