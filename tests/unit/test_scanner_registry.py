"""Scanners by name: entry points and error messages."""

from importlib.metadata import EntryPoint

import pytest

import cell.scanners
from cell.errors import SceneError
from cell.scanners.laser_area import LaserArea


class _Distribution:
    name, version = "foreign-scanners", "1.2"


def _offer(monkeypatch, *points):
    made = []
    for name, value in points:
        point = EntryPoint(name, value, cell.scanners.GROUP)
        made.append(point._for(_Distribution()))
    monkeypatch.setattr(cell.scanners, "entry_points", lambda group: made if group == cell.scanners.GROUP else [])


def test_the_installed_project_offers_laser_area():
    """The entry point of this distribution loads the class."""
    assert "laser-area" in cell.scanners.names()
    assert cell.scanners.load("laser-area") is LaserArea


def test_an_unknown_name_lists_the_valid_ones():
    """The error names the unknown and the installed scanners."""
    with pytest.raises(SceneError, match=r"'laser-aera' is not installed; valid are:.*laser-area"):
        cell.scanners.load("laser-aera")


def test_names_does_not_import(monkeypatch):
    """The names are listed even if a module does not exist."""
    _offer(monkeypatch, ("b", "does_not_exist:B"), ("a", "does_not_exist:A"))
    assert cell.scanners.names() == ("a", "b")


def test_a_broken_plug_in_names_its_distribution(monkeypatch):
    """The message names the distribution to uninstall."""
    _offer(monkeypatch, ("a", "does_not_exist:A"))
    with pytest.raises(SceneError, match=r"foreign-scanners 1\.2 cannot be imported from does_not_exist:A"):
        cell.scanners.load("a")


def test_two_distributions_with_one_name_are_refused(monkeypatch):
    """Two distributions with the same name of a scanner are refused."""
    _offer(monkeypatch, ("a", "json:JSONDecoder"), ("a", "json:JSONEncoder"))
    with pytest.raises(SceneError, match=r"offered by .*JSONDecoder.* and .*JSONEncoder"):
        cell.scanners.load("a")


def test_a_plug_in_that_is_no_class_is_refused(monkeypatch):
    """The message names the distribution of the function."""
    _offer(monkeypatch, ("a", "json:dumps"))
    with pytest.raises(SceneError, match=r"foreign-scanners 1\.2 is json:dumps, which is no class"):
        cell.scanners.load("a")
