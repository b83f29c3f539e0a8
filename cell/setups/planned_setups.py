"""Several set-ups that were planned as one cover, as one value: what `cell.api.plan_setups` returns."""

from dataclasses import dataclass
from pathlib import Path
from typing import Self

from pydantic import JsonValue

from cell.errors import FileError
from cell.runs.schema import Manifest, SetupsFile, parsed


@dataclass(frozen=True, slots=True)
class PlannedSetups:
    """The folder of `cell setups`.

    Attributes:
        folder: it holds setups.json, report.md, and a run folder for each set-up.
        file: setups.json.
        exit_code: 0, or 3 where the set-ups stay below a coverage that was asked for.
    """

    folder: Path
    file: SetupsFile
    exit_code: int

    @classmethod
    def opened(cls, folder: Path) -> Self:
        """Read the folder.

        Raises:
            FileError: if a file is missing or damaged.
        """
        try:
            texts = {name: (folder / name).read_bytes() for name in ("setups.json", "manifest.json")}
        except OSError as error:
            raise FileError(f"{folder} is no folder that cell setups made: {error.strerror or error}") from error
        file = parsed(SetupsFile, texts["setups.json"], folder / "setups.json")
        manifest = parsed(Manifest, texts["manifest.json"], folder / "manifest.json")
        return cls(folder, file, manifest.exit_code or 0)

    @property
    def folders(self) -> list[Path]:
        """The run folder of each set-up."""
        return [self.folder / setup.folder for setup in self.file.chosen]

    def as_json(self) -> dict[str, JsonValue]:
        """The object that `cell setups --json` prints: setups.json, and where and how it ended."""
        ended: dict[str, JsonValue] = {"exit_code": self.exit_code, "folder": str(self.folder)}
        return ended | self.file.as_json()
