"""Folder of several set-ups that were planned as one cover."""

from dataclasses import dataclass
from pathlib import Path
from typing import Self

from pydantic import JsonValue

from cell.files import file_errors
from cell.formatting import Summary, percent
from cell.runs.schema import Manifest, SetupsFile, parsed


@dataclass(frozen=True, slots=True, repr=False)
class SetupsRun(Summary):
    """Folder of `cell setups`.

    Attributes:
        folder: with setups.json, report.md, and a run folder for each set-up.
        file: setups.json.
        exit_code: 0, or 3 if a requested coverage is missed.
    """

    folder: Path
    file: SetupsFile
    exit_code: int

    def facts(self) -> list[tuple[str, str]]:
        """Return folder, numbers of set-ups and views with their bounds, and coverage."""
        file = self.file
        return [
            ("folder", str(self.folder)),
            ("set-ups", f"{len(file.selected)} (lower bound {file.setups_bound})"),
            ("views", f"{file.views} (lower bound {file.views_bound})"),
            ("coverage", percent(file.coverage.visible)),
        ]

    @classmethod
    def opened(cls, folder: Path) -> Self:
        """Open the folder.

        Raises:
            FileError: if a file is missing or damaged.
        """
        with file_errors(f"{folder} is not a folder of cell setups"):
            texts = {name: (folder / name).read_bytes() for name in ("setups.json", "manifest.json")}
        file = parsed(SetupsFile, texts["setups.json"], folder / "setups.json")
        manifest = parsed(Manifest, texts["manifest.json"], folder / "manifest.json")
        return cls(folder, file, manifest.exit_code or 0)

    @property
    def folders(self) -> list[Path]:
        """Run folder of each set-up."""
        return [self.folder / setup.folder for setup in self.file.selected]

    def as_json(self) -> dict[str, JsonValue]:
        """Return the object that `cell setups --json` prints: setups.json with folder and exit code."""
        ended: dict[str, JsonValue] = {"exit_code": self.exit_code, "folder": str(self.folder)}
        return ended | self.file.as_json()
