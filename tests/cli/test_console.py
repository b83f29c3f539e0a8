"""Consoles and names that cannot show or hold every character; a reader that closes the output."""

import os
import subprocess
import sys
from pathlib import Path

import pytest
import trimesh

ENVIRONMENT = os.environ | {"PYTHONPATH": str(Path(__file__).parents[2])}


def cell(*words: str | bytes, **environment: str) -> subprocess.CompletedProcess[bytes]:
    """Run the command in a process of its own."""
    command = [sys.executable, "-m", "cell", *words]
    return subprocess.run(command, capture_output=True, env=ENVIRONMENT | environment, check=False)


@pytest.mark.parametrize("encoding", ["cp1250", "gbk", "ascii"])
def test_characters_that_a_console_lacks_are_replaced(tmp_path: Path, encoding: str) -> None:
    """Superscripts become digits; the command succeeds."""
    trimesh.creation.box((0.1, 0.1, 0.1)).export(tmp_path / "box.glb")
    process = cell("part", str(tmp_path / "box.glb"), PYTHONIOENCODING=encoding)
    assert process.returncode == 0, process.stderr
    text = process.stdout.decode(encoding)
    assert "60,000.0 mm2" in text.replace("²", "2")
    assert "1,000,000.0 mm3" in text.replace("³", "3")


@pytest.mark.skipif(sys.platform == "win32", reason="names are text on Windows")
def test_names_that_are_not_text_are_refused_before_any_work(tmp_path: Path) -> None:
    """A name with a Latin-1 byte ends with exit code 2, as input and as result."""
    name = os.fsencode(tmp_path) + b"/Geh\xe4use.stl"
    for words in (("part", name, "--units", "mm"), ("plan", "--out", name)):
        process = cell(*words)
        assert process.returncode == 2
        assert b"is not valid UTF-8 text; rename it" in process.stderr


@pytest.mark.skipif(sys.platform == "win32", reason="a closed pipe is another error on Windows")
@pytest.mark.parametrize("words", [("part", "--help"), ("sensors",)])
def test_a_reader_that_closes_the_output_is_no_failure(words: tuple[str, ...]) -> None:
    """The exit code is 0, and nothing is printed about it."""
    reader, writer = os.pipe()
    os.close(reader)
    command = [sys.executable, "-m", "cell", *words]
    process = subprocess.run(command, stdout=writer, stderr=subprocess.PIPE, env=ENVIRONMENT, check=False)
    os.close(writer)
    assert (process.returncode, process.stderr) == (0, b"")
