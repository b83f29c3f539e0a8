"""`cell export`: the motion of a finished run as a program for a controller, or as a table for another program."""

from collections.abc import Mapping, Sequence
from pathlib import Path

from pydantic import Field

from cell.errors import FileError
from cell.export import krl, program, tables
from cell.export.krl import KrlOptions
from cell.export.krl_names import LONGEST_NAME, check_name
from cell.export.options import ExportOptions
from cell.export.program import Program
from cell.files import atomic_write
from cell.runs.schema import JsonTable
from cell.session import ProgressReporter
from cell.setups.planned_setups import PlannedSetups

FOLDER = "export"
"""Below the run folder; not part of the plan, each call replaces its files."""

SPEED_PERCENT, ACCELERATION_PERCENT = 20, 30
"""Of the controller's axis speeds and accelerations where nothing is asked for; less where the plan is slower."""


class ExportOutcome(JsonTable):
    """What `cell export` leaves; its `--json`."""

    format: str = Field(description="of the files")
    name: str = Field(description="of the program")
    files: tuple[str, ...] = Field(description="that were written")
    via_points: int = Field(description="of the motion")
    views: int = Field(description="of the plan")
    speed_percent: int = Field(description="of the axis speeds")
    acceleration_percent: int = Field(description="of the axis accelerations")


def export(run_folder: Path, wanted: ExportOptions, reporter: ProgressReporter | None = None) -> ExportOutcome:
    """Write the program of a finished run.

    Args:
        run_folder: of a finished plan.
        wanted: what was asked for.
        reporter: is told which files of the plan are gone; None: nobody.

    Raises:
        UsageError: if the name is none in KRL, or KRL cannot drive it.
        FileError: if the run has no finished motion, a file of it is damaged, or the files cannot be written.
    """
    loaded = program.load(run_folder, wanted.name, wanted, reporter)
    return _exported(run_folder, [loaded], loaded.told.name, wanted, {})


def export_setups(folder: Path, wanted: ExportOptions, reporter: ProgressReporter | None = None) -> ExportOutcome:
    """Write the programs of all set-ups of a folder; of KRL a main program too, which halts before each of them.

    Args:
        folder: of `cell setups`.
        wanted: what was asked for.
        reporter: is told which files of the plans are gone; None: nobody.

    Raises:
        UsageError, FileError: as `export`.
    """
    planned = PlannedSetups.opened(folder)
    name = wanted.name or program.name_of(folder.resolve().name, planned.file.chosen[0].digest)
    if len(name) > LONGEST_NAME - 3:  # what the names of the set-ups' programs have behind it
        name = f"scan_{planned.file.chosen[0].digest[:8]}"
    check_name(name)
    programs = [
        program.load(run, f"{name}_{number}", wanted, reporter) for number, run in enumerate(planned.folders, start=1)
    ]
    main = {f"{name}.src": krl.main_source(name, programs)} if wanted.kind == "krl" else {}
    return _exported(folder, programs, name, wanted, main)


def _exported(
    of: Path, programs: Sequence[Program], name: str, wanted: ExportOptions, beside: Mapping[str, bytes]
) -> ExportOutcome:
    """Write programs, and what stands beside them, to the folder that is wanted, or below the one that they are of."""
    options = [_krl_options(loaded, wanted) for loaded in programs]
    contents: dict[str, bytes] = {}
    for loaded, own in zip(programs, options, strict=True):
        contents |= _contents(loaded, own, wanted.kind)
    contents |= beside
    files = _write(of / FOLDER if wanted.out is None else wanted.out, contents, replace=wanted.out is None)
    return ExportOutcome(
        format=wanted.kind,
        name=name,
        files=tuple(str(path) for path in files),
        via_points=sum(len(loaded.q) for loaded in programs),
        views=sum(loaded.views for loaded in programs),
        speed_percent=min(each.speed_percent for each in options),
        acceleration_percent=min(each.acceleration_percent for each in options),
    )


def _krl_options(loaded: Program, wanted: ExportOptions) -> KrlOptions:
    return KrlOptions(
        percent(wanted.speed_percent, SPEED_PERCENT, loaded.told.speed),
        percent(wanted.acceleration_percent, ACCELERATION_PERCENT, loaded.told.acceleration),
        wanted,
    )


def _contents(loaded: Program, options: KrlOptions, kind: str) -> dict[str, bytes]:
    """Content by file name."""
    name = loaded.told.name
    if kind == "krl":
        return {f"{name}.src": krl.source(loaded, options), f"{name}.dat": krl.data(loaded, options)}
    if kind == "csv":
        return {f"{name}.csv": tables.csv(loaded)}
    return {f"{name}.json": tables.as_json(loaded)}


def percent(given: int | None, default: int, planned: float) -> int:
    """What was given, else the default, or the plan's fraction in whole percent, rounded down, where it is less."""
    return given if given is not None else min(default, max(1, int(planned * 100 + 1e-9)))


def _write(folder: Path, contents: dict[str, bytes], *, replace: bool) -> tuple[Path, ...]:
    """Write the files, each whole or not at all; in a folder of the user's nothing that differs is replaced."""
    files = {folder / name: content for name, content in contents.items()}
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for path, content in files.items():
            if not replace and path.exists() and path.read_bytes() != content:
                raise FileError(
                    f"{path} exists already and differs; it is not replaced: remove it, or choose another --out or "
                    "--name"
                )
        for path, content in files.items():
            with atomic_write(path) as part:
                part.write_bytes(content)
    except OSError as error:
        reason = (error.strerror or str(error)).lower()
        raise FileError(f"{folder} cannot be written: {reason}; choose a writable --out") from error
    return tuple(files)
