"""`cell explore` on a wire: each batch is confirmed by its own digest, or all by one option, before any motion."""

import re
from pathlib import Path

from cell.runs import schema
from tests.support.fixture_types import Emulate, RunCommand

OPTIONS = (
    "--place", "1100,400,100", "--faces", "120", "--samples", "2", "--standoff", "250", "--seed", "3",
    "--candidates", "optimal-scanning-zone", "--resolution", "1", "--ring", "1", "--batch", "1", "--max-views", "2",
    "--accept-time-scale", "20",
)  # fmt: skip


def test_every_batch_waits_for_a_word(tmp_path: Path, part_file: Path, emulate: Emulate, run_cell: RunCommand) -> None:
    """Without confirmation no motion starts."""
    emulated, out = emulate("modbus", "--time-scale", "20"), tmp_path / "out"
    command = ("explore", part_file, "--units", "mm", *OPTIONS, "--driver", emulated.url, "--out", out)
    refused = run_cell(*command, cwd=tmp_path, code=2)
    assert emulated.entries("move") == []
    first = re.search(r"--confirm-motion ([0-9a-f]{8})", refused.stderr)
    assert first, refused.stderr
    run_cell(*command, "--confirm-motion", first[1], cwd=tmp_path, code=2)
    moved = len(emulated.entries("move"))
    assert moved > 0
    known = schema.read_explore_file(out / "explore.json")
    assert [stage.digest[:8] for stage in known.batches] == [first[1]]
    run_cell(*command, "--confirm-motion", "explore", cwd=tmp_path, code=0)
    assert len(emulated.entries("move")) > moved
    assert schema.read_explore_file(out / "explore.json").views == 2
