"""A finished plan that can be edited: what `cell.api.plan` and `cell.api.open_run` return."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Self

from cell.edit.edit import edit
from cell.edit.options import Edit
from cell.runs.run import Run
from cell.scene.options import parse_options
from cell.session import LoggedProgress, Origin, ProgressReporter, Session
from planner.values import Floats


@dataclass(frozen=True, eq=False)  # no slots: what is read later is kept
class EditableRun(Run):
    """A finished plan; `edited` makes a new one of it."""

    @classmethod
    def opened(cls, folder: Path) -> Self:
        """A run folder of `cell plan`.

        Raises:
            FileError: if it is missing, damaged, not a run folder, or its plan did not finish.
        """
        run = cls.open_finished(folder)
        run.plan, run.report  # noqa: B018  # damaged files are reported here
        return run

    def edited(
        self,
        wanted: Edit | None = None,
        *,
        out: str | Path | None = None,
        use_cache: bool = True,
        progress: ProgressReporter | None = None,
        argv: Sequence[str] = (),
        T_base_object: Floats | None = None,
        **wishes: object,
    ) -> "EditableRun":
        """A new run with views dropped, moved, turned, added or in another order; everything is checked again.

        Args:
            wanted: as one value; None makes it of the wishes.
            out: run folder to make; None makes one below sim_runs/.
            use_cache: whether measurability matrices are taken from and left in the user's cache.
            progress: told how far the work is; None works in silence.
            argv: kept in the manifest.
            T_base_object: (4, 4) where the part stands now, in place of where it was planned [m]: its views move with
                it, and `repair` leaves out those that the arm cannot take there (`cell.api.locate` finds it).
            **wishes: options of `cell edit` by name: `drop=[4]`, `turn={7: 90}`, `add_candidate=533`, `repair=True`,
                `move={7: (x, y, z, a, b, c)}` (mm and deg, KUKA ABC, scanner in base).

        Raises:
            CellError: in one sentence; where the arm cannot, with the condition and what is in the way.
        """
        asked = parse_options(Edit, wishes) if wanted is None else wanted
        session = Session(
            None, LoggedProgress() if progress is None else progress, None if out is None else Path(out),
            use_cache=use_cache, origin=Origin(tuple(argv)),
        )  # fmt: skip
        made = edit(session, self, asked, T_base_object=T_base_object)
        return EditableRun.opened(made)
