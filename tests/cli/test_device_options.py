"""Choice of the device on the command line."""

import json
import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest

Run = Callable[..., subprocess.CompletedProcess[str]]


def test_the_device_of_a_part_is_printed_with_the_rule(part_file: Path, tmp_path: Path, run_cell: Run) -> None:
    """The longest side of the part decides: in mm a large device is selected, in um a small one."""
    quick = ("--candidates", "optimal-scanning-zone")
    for units, device in (("mm", "generic-area-large"), ("um", "generic-area-small")):
        done = run_cell(
            "plan", part_file, "--units", units, "--faces", "40", "--place", "9000,0,0", *quick, cwd=tmp_path
        )
        assert done.returncode == 4
        assert f"the scanner is {device}, by the part's longest side of " in done.stderr
        assert "--sensor names another" in done.stderr


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (
            ("--sensor", "generic-area-medium", "--standoff", "300"),
            "300 mm is outside the scanner's range of 50 to 150 mm",
        ),
        (("--sensor", "generic-area"), "valid are: generic-area-large, generic-area-medium, generic-area-small"),
    ],
)
def test_an_unknown_device_and_an_unsuitable_standoff_are_refused(
    options: tuple[str, ...], words: str, tmp_path: Path, run_cell: Run
) -> None:
    """A standoff outside the range and an unknown name are refused, and no run is created."""
    done = run_cell("plan", "mug", *options, cwd=tmp_path)
    assert done.returncode == 2
    assert words in done.stderr
    assert not list(tmp_path.glob("**/manifest.json"))


def test_the_cell_has_the_device_s_body(tmp_path: Path, run_cell: Run) -> None:
    """`cell check` reports the scanner and its housing. Keys of the scene have priority."""
    (tmp_path / "cell.toml").write_text(
        '[part]\nname = "mug"\n[scanner]\nsensor = "generic-area-small"\n[housing]\nbracket_diameter_mm = 20.0\n'
    )
    done = run_cell("check", "cell.toml", "--json", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    said = json.loads(done.stdout)
    assert (said["sensor"], said["range_mm"], said["baseline_mm"]) == ("generic-area-small", [15.0, 45.0], 7.5)
    assert said["housing_size_mm"] == [16.0, 8.0, 6.0]
