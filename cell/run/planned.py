"""A finished plan as one value: what `cell.api.plan` returns, and what `cell.api.open_run` makes of its folder."""

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from pydantic import JsonValue

from cell.run import reader
from cell.run.folder import SCHEMA
from cell.run.plan_json import Coverage, PlanFile
from cell.run.record import RunRecord, open_finished
from cell.run.report_json import Report
from planner.geometry.mesh import TriangleMesh
from planner.timing.motion import Motion
from planner.values import Floats, Ints, readonly


@dataclass(frozen=True, eq=False)  # no slots: what is read later is kept
class PlannedRun:
    """A finished plan; views in visiting order, arrays in metres and radians.

    Attributes:
        record: the run folder.
        plan: plan.json.
        report: report.json.
    """

    record: RunRecord
    plan: PlanFile
    report: Report

    @property
    def folder(self) -> Path:
        """The run folder."""
        return self.record.folder

    @property
    def digest(self) -> str:
        """Of all that drives; what `scan(run, driver=URL, confirm=run.digest)` confirms on a wire."""
        return self.record.digest

    @property
    def exit_code(self) -> int:
        """0, or 3 where the plan stays below a coverage that was asked for."""
        return self.record.manifest.exit_code or 0

    @property
    def of_several(self) -> bool:
        """Whether it is one of several set-ups that one cover was planned for, or edited from one."""
        return bool(self.report.of_several) or self.record.of_several  # older folders say it by where they lie

    @property
    def asked_alone(self) -> bool:
        """Whether its coverage was asked of it alone, so that a repair can restore it."""
        return self.report.alone and not self.of_several

    @property
    def coverage(self) -> Coverage:
        """What the views measure; `visible` and `coverable` are fractions of the surface."""
        return self.plan.coverage

    @property
    def bound(self) -> int:
        """No plan of these candidates and samples needs fewer views."""
        return self.plan.lower_bound

    @cached_property
    def candidate(self) -> Ints:
        """(n,) candidate of each view, row of viewpoints.npz."""
        return readonly("id", [view.id for view in self.plan.views], (None,), np.int64)

    @cached_property
    def q(self) -> Floats:
        """(n, axes) joint set-points of the views [rad], KUKA signs; a rotary table's angle behind the arm's."""
        return readonly("q", [view.q for view in self.plan.views], (None, None))

    @cached_property
    def T_base_scanner(self) -> Floats:
        """(n, 4, 4) scanner in the base frame [m]; of a sweep its middle pose."""
        return readonly("T_base_scanner", [view.T_base_scanner for view in self.plan.views], (None, 4, 4))

    @cached_property
    def T_object_scanner(self) -> Floats:
        """(n, 4, 4) scanner in the part's own frame [m]; of a sweep its middle pose."""
        return readonly("T_object_scanner", [view.T_object_scanner for view in self.plan.views], (None, 4, 4))

    @cached_property
    def T_base_object(self) -> Floats:
        """(4, 4) the placement: the part's file in base [m]."""
        return readonly("T_base_object", reader.scene(self.record).T_base_object, (4, 4))

    @cached_property
    def motion(self) -> Motion:
        """The timed motion from home to home."""
        return reader.motion(self.record)

    @cached_property
    def reference(self) -> TriangleMesh:
        """The part [m], in the axes of its file."""
        return reader.mesh(self.record, "reference.ply")

    def as_json(self) -> dict[str, JsonValue]:
        """The object that `cell plan --json` prints: report.json, and where and how the run ended."""
        ended: dict[str, JsonValue] = {
            "schema": SCHEMA, "exit_code": self.exit_code, "run_folder": str(self.folder), "digest": self.digest
        }  # fmt: skip
        return ended | self.report.as_json()


def open_run(folder: Path) -> PlannedRun:
    """A run folder of `cell plan`.

    Raises:
        FileError: if it is missing, damaged, not a run folder, or its plan did not finish.
    """
    record = open_finished(folder)
    return PlannedRun(record, reader.plan(record), reader.report(record))
