"""`cell export`: write the motion of a finished run as a controller program or as a table."""

from collections.abc import Sequence
from pathlib import Path

from pydantic import Field

from cell.errors import FileError, UsageError
from cell.export import fanuc, krl, rapid, ros, tables, urscript
from cell.export.names import MAX_NAME_LENGTH, check_name
from cell.export.options import ExportOptions
from cell.export.program import Program, ProgramSettings, load_program, program_name
from cell.files import atomic_write, file_errors
from cell.runs.run import open_finished
from cell.runs.schema import JsonTable
from cell.runs.setups import SetupsRun
from cell.session import ProgressReporter

_SUFFIX_LENGTH = 3  # of `_` and the number of a set-up

FOLDER = "export"
"""Folder below the run folder. It is not part of the plan; each call replaces its files."""

SPEED_PERCENT, ACCELERATION_PERCENT = 20, 30
"""Default shares of the controller's axis speeds and accelerations; a slower plan lowers them."""


class ExportOutcome(JsonTable):
    """The result of `cell export`; printed by `--json`."""

    format: str = Field(description="of the files")
    name: str = Field(description="of the program")
    files: tuple[str, ...] = Field(description="that were written")
    via_points: int = Field(description="of the motion")
    views: int = Field(description="of the plan")
    speed_percent: int = Field(description="of the axis speeds")
    acceleration_percent: int = Field(description="of the axis accelerations")


def export(run_folder: Path, options: ExportOptions, reporter: ProgressReporter | None = None) -> ExportOutcome:
    """Write the program of a finished run.

    Args:
        run_folder: of a finished plan.
        options: format, folder, name, speeds and signals.
        reporter: reports which files of the plan are missing.

    Raises:
        UsageError: if the language does not accept the name or cannot express the motion.
        FileError: if the run has no finished motion, a file is damaged, or the output cannot be written.
    """
    program = load_program(run_folder, options.name, options, reporter)
    return _write_programs(run_folder, [program], program.info.name, options)


def export_setups(folder: Path, options: ExportOptions, reporter: ProgressReporter | None = None) -> ExportOutcome:
    """Write the programs of all set-ups and a main program, which halts before each of them.

    Args:
        folder: of `cell setups`.
        options: as in `export`.
        reporter: as in `export`.

    Raises:
        UsageError, FileError: as `export`.
    """
    planned = SetupsRun.opened(folder)
    if options.kind == "ros":
        raise UsageError(f"--format ros is for one set-up; give one of: {', '.join(map(str, planned.folders))}")
    digest, longest = planned.file.selected[0].digest, MAX_NAME_LENGTH - _SUFFIX_LENGTH
    name = program_name(folder.resolve().name, digest, options.kind or "krl") if options.name is None else options.name
    if len(name) > longest:
        if options.name is not None:
            raise UsageError(
                f"--name {name} has {len(name)} characters; a name for several set-ups has at most {longest}, because "
                "_ and a number follow it"
            )
        name = f"scan_{digest[:8]}"
    programs = [
        load_program(run, f"{name}_{number}", options, reporter) for number, run in enumerate(planned.folders, start=1)
    ]
    check_name(name, programs[0].info.language)
    return _write_programs(folder, programs, name, options)


def percent(requested: float | None, default: int, planned: float) -> int:
    """Return the requested share in percent, else the smaller of the default and the plan's share; rounded down."""
    share = max(1, int((planned if requested is None else requested) * 100 + 1e-9))
    return share if requested is not None else min(default, share)


def _contents(
    folder: Path, name: str, programs: Sequence[Program], settings: Sequence[ProgramSettings]
) -> dict[str, bytes]:
    """Return the files of the program of a run folder, or of one program per set-up."""
    match programs[0].info.language:
        case "krl":
            return krl.files(name, programs, settings)
        case "rapid":
            return rapid.files(name, programs, settings)
        case "urscript":
            return urscript.files(name, programs, settings)
        case "ls":
            return fanuc.files(name, programs, settings)
        case "csv":
            return {f"{program.info.name}.csv": tables.csv(program) for program in programs}
        case "json":
            return {f"{program.info.name}.json": tables.as_json(program) for program in programs}
        case "ros":
            return ros.files(programs[0], open_finished(folder))


def _write_programs(folder: Path, programs: Sequence[Program], name: str, options: ExportOptions) -> ExportOutcome:
    """Write programs, for several also a main program, to `options.out` or below the run folder."""
    settings = [
        ProgramSettings(
            percent(options.speed, SPEED_PERCENT, program.info.speed),
            percent(options.acceleration, ACCELERATION_PERCENT, program.info.acceleration),
            options,
        )
        for program in programs
    ]
    contents = _contents(folder, name, programs, settings)
    files = _write(folder / FOLDER if options.out is None else options.out, contents, replace=options.out is None)
    return ExportOutcome(
        format=programs[0].info.language,
        name=name,
        files=tuple(str(path) for path in files),
        via_points=sum(len(program.q) for program in programs),
        views=sum(program.n_views for program in programs),
        speed_percent=min(each.speed_percent for each in settings),
        acceleration_percent=min(each.acceleration_percent for each in settings),
    )


def _write(folder: Path, contents: dict[str, bytes], *, replace: bool) -> tuple[Path, ...]:
    """Write each file atomically. Without `replace`, a file with other content is an error."""
    files = {folder / name: content for name, content in contents.items()}
    with file_errors(f"{folder} cannot be written", "choose a writable --out"):
        folder.mkdir(parents=True, exist_ok=True)
        for path, content in files.items():
            if not replace and path.exists() and path.read_bytes() != content:
                raise FileError(
                    f"{path} exists already with other content and is not replaced; remove it, or choose another "
                    "--out or --name"
                )
        for path, content in files.items():
            with atomic_write(path) as part:
                part.write_bytes(content)
    return tuple(files)
