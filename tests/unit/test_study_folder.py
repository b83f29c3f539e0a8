"""The folder of a study: rows, failures, pictures and sentences; equal trials give equal bytes."""

import base64
import csv
import hashlib
import json
import re
import shlex
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import pytest
from matplotlib.figure import Figure

from cell.cli.terminal import Terminal
from cell.errors import FileError
from cell.scene.file import option_tables
from cell.study import study as studies
from cell.study.scanner_study import PARAMETERS, select_views
from cell.study.study import Study, StudyResult, markdown_table, plan_options, run_study
from cell.study.trials import Outcome, Trial
from cell.view.study_page import colour_limits, format_value, study_page

_TRIALS = [Trial.of(select_views, {"part": "mug", "faces": faces}) for faces in (8, 9, 10)]


class _Workers:
    """Workers with fixed outcomes; the second trial fails."""

    def __init__(self) -> None:
        self.computed = 0

    def compute(self, trials: Sequence[Trial]) -> Iterator[Outcome]:
        for trial in reversed(trials):  # not in the order of the trials
            self.computed += 1
            faces = json.loads(trial.settings)["faces"]
            failed = "too few faces" if faces == 9 else ""
            yield Outcome(trial, {} if failed else {"views": faces / 3}, failed, {"total": 0.1 * self.computed})

    def __enter__(self) -> "_Workers":
        return self

    def __exit__(self, *_: object) -> None:
        return None


def _study() -> Study:
    def rows(outcomes: Sequence[Outcome]) -> list[dict[str, Any]]:
        return [{"faces": json.loads(each.trial.settings)["faces"], **each.values} for each in outcomes]

    def pictures(rows: Sequence[dict[str, Any]]) -> Iterator[tuple[str, Figure]]:
        figure = Figure()
        figure.add_subplot().plot([row["faces"] for row in rows], [row["views"] for row in rows])
        yield "views", figure

    return Study(
        "faces", "Views over faces", _TRIALS, rows, pictures, lambda rows: [f"{len(rows)} rows."],
        options=lambda row: f"--faces {row['faces']}", best=lambda rows: rows[1],
    )  # fmt: skip


@pytest.fixture
def conducted(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, drawn_pictures: None) -> Path:
    """Return the folder of a study of three trials, one of which fails."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    result = run_study(_study(), _Workers(), out=tmp_path / "out", reporter=Terminal(quiet_stdout=True))
    assert result.computed == 3
    return result.folder


def test_rows_are_in_the_order_of_the_trials_without_failures(conducted: Path) -> None:
    """The order of completion has no effect; report and JSON have the reason."""
    rows = list(csv.DictReader((conducted / "rows.csv").read_text().splitlines()))
    assert [row["faces"] for row in rows] == ["8", "10"]
    content = json.loads((conducted / "study.json").read_text())
    assert [(each["faces"], each["reason"]) for each in content["failed"]] == [(9, "too few faces")]
    report = (conducted / "report.md").read_text()
    assert "too few faces" in report
    assert "2 rows." in report
    assert "(views.png)" in report


def test_the_page_has_pictures_and_a_command_for_each_row(conducted: Path, tmp_path: Path) -> None:
    """The page repeats the command of the best row at the top. Studies of earlier versions have a page too."""
    page = (conducted / "view.html").read_text(encoding="utf-8")
    (picture,) = re.findall(r'src="data:image/svg\+xml;base64,([^"]+)"', page)
    image, file = base64.b64decode(picture).decode(), (conducted / "views.svg").read_text(encoding="utf-8")
    assert image.count("<path") == file.count("<path") > 0
    assert ("prefers-color-scheme:dark" in image, "#000000" in image) == (True, False)
    assert re.findall(r"<code>([^<]*)</code>", page) == [f"cell plan --faces {n}" for n in (10, 8, 10)]
    assert page.count(" class=best>") == 1
    assert page.count("<script") == 2
    script = page.rpartition("<script>")[2].partition("</script>")[0]
    digest = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
    assert f"script-src 'sha256-{digest}'" in page  # no other script runs
    study = json.loads((conducted / "study.json").read_text())
    for key in ("title", "pictures", "commands", "best"):
        del study[key]
    (conducted / "study.json").write_text(json.dumps({**study, "name": "<script>alert(1)</script>"}))
    older = study_page(conducted)
    assert picture in older
    assert older.count("<script") == 2
    (conducted / "study.json").write_text("{}")
    with pytest.raises(FileError, match=r"study\.json is damaged"):
        study_page(conducted)


@pytest.mark.parametrize(("knob", "value"), [("standoff", 250.0), ("baseline", 30.0), ("sensors", "gocator-2340")])
def test_the_options_of_a_row_are_the_settings_of_its_trial(knob: str, value: object) -> None:
    """The options of a row, parsed by the command line, give the keys of the study."""
    _, keys_of = PARAMETERS[knob]
    keys = keys_of(value)
    words = (word.removeprefix("--").partition("=") for word in shlex.split(plan_options(keys)))
    assert option_tables({name: text for name, _, text in words}) == keys
    text = plan_options({"part": {"name": "mug"}, "plan": {"faces": 75}, "scanner": {"fov_deg": [20.0, 20.0]}})
    assert text == "mug --faces=75  # with fov_deg = [20.0, 20.0] under [scanner] in the scene file"


def test_a_repeated_study_gives_equal_bytes_and_computes_only_failures(
    conducted: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """All files of a repeated study are equal, and only the failed trial is computed again."""
    workers = _Workers()
    result = run_study(_study(), workers, out=tmp_path / "again", reporter=Terminal(quiet_stdout=True))
    assert workers.computed == 1
    assert result.computed == 1
    for name in ("rows.csv", "study.json", "report.md", "view.html", "views.png", "views.svg"):
        assert (result.folder / name).read_bytes() == (conducted / name).read_bytes(), name


def test_a_foreign_folder_is_not_written_into(tmp_path: Path) -> None:
    """A folder with foreign files and a file are refused before anything is computed."""
    (tmp_path / "notes.txt").write_text("mine")
    for out in (tmp_path, tmp_path / "notes.txt"):
        with pytest.raises(FileError, match="not the folder of a study"):
            run_study(_study(), _Workers(), out=out, reporter=Terminal(quiet_stdout=True))


def test_a_folder_that_cannot_be_made_is_one_sentence(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A full disk gives one sentence."""

    def full(path: Path, content: str) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(studies, "_write", full)
    result = StudyResult(tmp_path / "out", [], [], [], 0, [])
    with pytest.raises(FileError, match="No space left"):
        studies.write_folder("faces", "Views", result, (), ())


def test_a_table_shows_numbers_shortly_and_nothing_as_nothing() -> None:
    """Numbers have four digits, a missing value is an empty field, and no rows give no table."""
    assert [format_value(value) for value in (3, 1 / 3, None, "x", True)] == ["3", "0.3333", "", "x", "True"]
    assert markdown_table([{"a": 1, "b": None}, {"a": 2.5}]) == ["| a | b |", "|---|---|", "| 1 |  |", "| 2.5 |  |"]
    assert markdown_table([]) == []


def test_a_colour_scale_is_not_finer_than_its_values() -> None:
    """A range below the accuracy of a column is widened about its middle."""
    assert colour_limits([91.0, 91.08], "coverable %") == pytest.approx((90.54, 91.54))
    assert colour_limits([40.0, 90.0], "coverable %") == (40.0, 90.0)
    assert colour_limits([7, 7], "views") == (6.5, 7.5)
