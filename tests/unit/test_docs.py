"""Documentation agrees with the repository: links, commands, pictures, test command and versions."""

import re
from importlib.util import find_spec
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PAGES = sorted([*ROOT.glob("*.md"), *ROOT.glob("docs/**/*.md"), *ROOT.glob("models/*.md")])


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_links_lead_somewhere(page: Path) -> None:
    """Every relative link and picture of a page exists, and so does the heading that it names."""
    targets = re.findall(r"\]\(([^)#:]*)(?:#([^)]*))?\)", page.read_text(encoding="utf-8"))
    missing = [
        f"{target}#{heading}"
        for target, heading in targets
        if not (page.parent / target).exists()
        or (heading and heading not in headings(page.parent / target if target else page))
    ]
    assert missing == []


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_prose_is_narrow(page: Path) -> None:
    """Lines have less than 120 characters, except tables, code and pictures."""
    prose = re.sub(r"^```.*?^```", "", page.read_text(encoding="utf-8"), flags=re.MULTILINE | re.DOTALL)
    wide = [
        line
        for line in prose.splitlines()
        if len(line) >= 120 and not line.lstrip().startswith(("|", "![")) and line[:4] != "    "
    ]
    assert wide == []


def headings(page: Path) -> set[str]:
    """Return the anchors of a page's headings, as GitHub makes them."""
    found = re.findall(r"^#+ (.+)$", page.read_text(encoding="utf-8"), flags=re.MULTILINE)
    return {
        re.sub(r"[^\w\- ]", "", re.sub(r"\]\([^)]*\)", "", line)).strip().lower().replace(" ", "-") for line in found
    }


def test_every_picture_is_shown() -> None:
    """Every picture of docs/images is shown on a page."""
    text = "".join(page.read_text(encoding="utf-8") for page in PAGES)
    assert [path.name for path in (ROOT / "docs" / "images").glob("*.png") if path.name not in text] == []


def test_every_picture_is_drawn_by_a_command() -> None:
    """`python -m benchmarks pictures` makes every picture of docs/images."""
    from benchmarks.methods.pictures import GROUPS, IMAGES

    assert {path.name for path in IMAGES.iterdir()} == set(GROUPS)


def test_the_readme_has_the_one_test_command_that_ci_runs() -> None:
    """README.md contains exactly one test command, which CI reads."""
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    assert len(re.findall(r"^python3 -m venv .*pytest .*$", readme, flags=re.MULTILINE)) == 1


def test_every_command_that_the_readme_shows_exists() -> None:
    """`cell X` in a code block is a command of the command line."""
    from cell.cli import app

    known = {command.name or command.callback.__name__ for command in app.registered_commands if command.callback}
    known |= {str(group.name) for group in app.registered_groups}
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    blocks = "".join(re.findall(r"^```\n(.*?)^```", readme, flags=re.MULTILINE | re.DOTALL))
    assert set(re.findall(r"(?:^|/)cell (\w+)", blocks, flags=re.MULTILINE)) <= known


def test_the_map_of_the_architecture_is_the_tree() -> None:
    """Every path and module that the page names exists, and every member of the packages is on its map."""
    page = (ROOT / "docs" / "internals" / "architecture.md").read_text(encoding="utf-8")
    paths = re.findall(r"`((?:cell|planner|drivers|benchmarks|models)/[\w/.]*)`", page)
    assert [path for path in paths if not (ROOT / path).exists()] == []
    dotted = {
        name
        for name in re.findall(r"`((?:cell|planner|drivers)(?:\.\w+)+)`", page)
        if not name.endswith((".xml", ".py"))
    }
    assert [name for name in dotted if not _module_or_member(name)] == []
    of_cell = {path.name + "/" * path.is_dir() for path in _members("cell")} - {"__main__.py"}
    table = page.split("## Where things are in `cell`")[1].split("\n## ")[0]
    on_map = set(
        re.findall(r"`([\w]+(?:/|\.py))`", "".join(row.split("|")[1] for row in table.splitlines() if "|" in row))
    )
    assert of_cell - on_map == set()
    assert on_map - of_cell == set()
    rooms = page.split("## Rooms of `planner` and `drivers`")[1].split("\n## ")[0]
    for package in ("planner", "drivers"):
        assert [path.stem for path in _members(package) if not re.search(rf"\b{path.stem}\b", rooms)] == []


def _members(package: str) -> list[Path]:
    """Return the subfolders and files of a package."""
    found = (ROOT / package).iterdir()
    return [
        path for path in found if path.suffix == ".py" or (path / "__init__.py").exists() if path.stem != "__init__"
    ]


def _module_or_member(name: str) -> bool:
    """Return whether a dotted name is a module or a member of one."""
    package, *rest = name.split(".")
    path = ROOT / package
    for depth, word in enumerate(rest):
        if (path / word).is_dir():
            path /= word
        elif (path / f"{word}.py").exists():
            return depth == len(rest) - 1 or rest[depth + 1] in (path / f"{word}.py").read_text(encoding="utf-8")
        else:
            return word in (path / "__init__.py").read_text(encoding="utf-8")
    return True


def test_the_version_is_that_of_the_citation(capsys: pytest.CaptureFixture[str]) -> None:
    """`cell --version`, pyproject.toml and CITATION.cff name one version."""
    stated = re.search(r'^version = "(.+)"', (ROOT / "pyproject.toml").read_text(encoding="utf-8"), re.MULTILINE)
    cited = re.search(r"^version: (.+)", (ROOT / "CITATION.cff").read_text(encoding="utf-8"), re.MULTILINE)
    assert stated is not None
    assert cited is not None
    assert stated[1] == cited[1]
    from cell.cli import app

    app(args=["--version"], standalone_mode=False)
    assert capsys.readouterr().out.startswith("scan-cell ")


def test_the_modules_of_the_reference_exist() -> None:
    """`.ci/api_reference` names modules of the packages, `cell.api` among them."""
    script = (ROOT / ".ci" / "api_reference").read_text(encoding="utf-8")
    names = re.findall(r" ((?:cell|planner|drivers)(?:\.\w+)+)", script)
    assert "cell.api" in names
    assert [name for name in names if find_spec(name) is None] == []
