"""The pages tell the truth about the tree: links lead somewhere, commands exist, the README's test command is CI's."""

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PAGES = sorted([*ROOT.glob("*.md"), *ROOT.glob("docs/*.md"), *ROOT.glob("models/*.md")])


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_links_lead_somewhere(page: Path) -> None:
    """Every relative link and picture of a page exists."""
    targets = re.findall(r"\]\(([^)#:]+)(?:#[^)]*)?\)", page.read_text(encoding="utf-8"))
    missing = [target for target in targets if not (page.parent / target).exists()]
    assert missing == []


def test_every_picture_is_shown() -> None:
    """No picture lies about that no page shows."""
    text = "".join(page.read_text(encoding="utf-8") for page in PAGES)
    assert [path.name for path in (ROOT / "docs" / "images").glob("*.png") if path.name not in text] == []


def test_the_readme_has_the_one_test_command_that_ci_runs() -> None:
    """CI takes its test command out of the README: there must be exactly one."""
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
