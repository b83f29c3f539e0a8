"""Cache folder on each operating system."""

import sys
from pathlib import Path

import pytest

from cell.files import cache_folder


@pytest.mark.parametrize(
    ("platform", "environment", "below"),
    [
        ("linux", {}, ".cache/scan-cell/matrices"),
        ("darwin", {}, "Library/Caches/scan-cell/matrices"),
        ("win32", {}, "AppData/Local/scan-cell/matrices"),
        ("win32", {"LOCALAPPDATA": "{home}/elsewhere"}, "elsewhere/scan-cell/matrices"),
        ("linux", {"XDG_CACHE_HOME": "{home}/named"}, "named/scan-cell/matrices"),
        ("win32", {"XDG_CACHE_HOME": "{home}/named"}, "named/scan-cell/matrices"),
    ],
)
def test_the_folder_is_where_the_system_keeps_caches_unless_named(platform, environment, below, tmp_path, monkeypatch):
    """The cache is in the system's folder. XDG_CACHE_HOME has precedence on every system."""
    monkeypatch.setattr(sys, "platform", platform)
    monkeypatch.setattr(Path, "home", lambda: tmp_path)
    for name in ("XDG_CACHE_HOME", "LOCALAPPDATA"):
        monkeypatch.delenv(name, raising=False)
    for name, value in environment.items():
        monkeypatch.setenv(name, value.format(home=tmp_path))
    assert cache_folder("matrices") == tmp_path / below
