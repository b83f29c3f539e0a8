"""Single changes of the scanner's limits and numbers, the same reachable candidates: part of `cell.why.changes`."""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from cell import scanners
from cell.runs.cell import RunCell
from cell.scene.regions import with_limits
from planner.measurability.quality import LimitedScanner
from planner.ports import RayCaster, Scanner
from planner.values import Floats
from planner.why.what_if import Kind, WhatIf

_FARTHER = (1.1, 1.25, 1.5, 2.0)
_NEARER = (0.9, 0.75, 0.5, 0.25)
_FOV_DEG = (10.0, 20.0, 30.0, 40.0, 60.0, 90.0)  # added to both axes
_BASELINES = (0.75, 0.5, 0.25)
_SIGMAS = (1.1, 1.25, 1.5, 2.0, 3.0, 5.0)  # of the limit, on spacing too
_FINER = (0.75, 0.5, 0.25)  # of the angle between rays
_LAST_GRAZING_DEG = 89


@dataclass(frozen=True, slots=True, eq=False)
class ScannerChanges:
    """What the changes start from.

    Attributes:
        cell: the cell as it is measured in.
        T_object_scanner: (n, K, 4, 4) candidates that are reachable and to which a path leads [m].
    """

    cell: RunCell
    T_object_scanner: Floats

    @property
    def casters(self) -> tuple[RayCaster, RayCaster]:
        """The part's and everything else's, as they were."""
        return self.cell.part_caster, self.cell.occluder_caster

    @property
    def max_sigma_mm(self) -> float | None:
        """The plan's limit on sigma [mm]; None where it has none."""
        return self.cell.scene.plan.max_sigma_mm

    def ladders(self) -> Iterator[list[WhatIf]]:
        """Changes of one kind each, the smallest first."""
        keys = self.cell.scanner_keys
        for name, last, of in (
            ("grazing_max_deg", _LAST_GRAZING_DEG, "grazing limit"),
            ("sensor_grazing_max_deg", 90, "sensor's grazing limit"),
        ):
            if (now := keys.number(name)) is not None:
                yield [
                    self._law(Kind.GRAZING, value - now, f"{of} {value} instead of {now:g} deg", name, float(value))
                    for value in range(int(np.floor(now)) + 1, last + 1)
                ]
        for name in ("range_mm", "depth_of_field_mm"):
            if (limits := keys.pair(name)) is not None:
                of = name.removesuffix("_mm").replace("_", " ")
                yield self._range_to(name, of, *limits)
                yield self._range_from(name, of, *limits)
        for name, of in (("fov_deg", "field of view"), ("sensor_fov_deg", "sensor's field of view")):
            if (fov := keys.pair(name)) is not None:
                h, v = fov
                yield [
                    self._law(
                        Kind.FOV, more, f"{of} {h + more:g} x {v + more:g} deg, not {h:g} x {v:g}",
                        name, (h + more, v + more),
                    )
                    for more in _FOV_DEG if max(fov) + more < 180
                ]  # fmt: skip
        if (now := keys.number("fan_deg")) is not None:
            yield [
                self._law(Kind.FOV, more, f"fan of {now + more:g} deg instead of {now:g}", "fan_deg", now + more)
                for more in _FOV_DEG if now + more < 180
            ]  # fmt: skip
        if (limit := keys.number("max_spacing_mm")) is not None:
            yield self._sparser(limit)
        if limit is not None or any(region.max_spacing_mm for region in self.cell.scene.regions or ()):
            yield from self._denser()
        if self.max_sigma_mm is not None:
            yield [self._sigma(factor, self.max_sigma_mm) for factor in _SIGMAS]
        if now := keys.number("baseline_mm"):
            yield [
                self._law(
                    Kind.BASELINE, 1 - share, f"baseline {share * now:.3g} instead of {now:g} mm",
                    "baseline_mm", share * now,
                )
                for share in _BASELINES
            ]  # fmt: skip

    def _sparser(self, limit: float) -> list[WhatIf]:
        """A greater spacing allowed."""
        return [
            self._law(
                Kind.SPACING, factor, f"points up to {factor * limit:.3g} instead of {limit:g} mm apart",
                "max_spacing_mm", factor * limit, f"--max-spacing {factor * limit:.3g}",
            )
            for factor in _SIGMAS
        ]  # fmt: skip

    def _denser(self) -> Iterator[list[WhatIf]]:
        """A finer grid; nearer views are among the standoffs."""
        if grid := self.cell.scanner_keys.pair("resolution_deg"):
            yield [
                self._law(
                    Kind.RESOLUTION, 1 - share, f"{share * max(grid):.3g} instead of {max(grid):g} deg between rays",
                    "resolution_deg", (share * grid[0], share * grid[1]),
                )
                for share in _FINER
            ]  # fmt: skip

    def _range_to(self, name: str, of: str, near: float, far: float) -> list[WhatIf]:
        return [
            self._law(Kind.RANGE, _apart(to, far), f"{of} to {to:g} instead of {far:g} mm", name, (near, to))
            for to in (round_mm(far * factor) for factor in _FARTHER) if to != far
        ]  # fmt: skip

    def _range_from(self, name: str, of: str, near: float, far: float) -> list[WhatIf]:
        return [
            self._law(Kind.RANGE, _apart(at, near), f"{of} from {at:g} instead of {near:g} mm", name, (at, far))
            for at in (round_mm(near * factor) for factor in _NEARER) if at != near
        ]  # fmt: skip

    def _law(
        self, kind: Kind, change: float, sentence: str, key: str, value: float | tuple[float, float], option: str = ""
    ) -> WhatIf:
        """Another value of one of the scanner's keys, the same reachable candidates."""
        keys = self.cell.scanner_keys
        scanner: Scanner = scanners.load(keys.type)(**{**keys.own, key: value})
        scanner = with_limits(scanner, self.max_sigma_mm, self.cell.scene.regions or ())
        numbers = f"{value:g}" if isinstance(value, float) else f"[{value[0]:g}, {value[1]:g}]"
        setting = option or f"scanner.{key} = {numbers}"
        return WhatIf(kind, change, sentence, setting, self.T_object_scanner, scanner, self.casters)

    def _sigma(self, factor: float, now: float) -> WhatIf:
        """Another limit on sigma, so many times the present one [mm]."""
        assert isinstance(self.cell.scanner, LimitedScanner)
        scanner = replace(self.cell.scanner, max_sigma=factor * (now / 1000))
        sentence = f"sigma up to {factor * now:.3g} instead of {now:g} mm"
        setting = f"--max-sigma {factor * now:.3g}"
        return WhatIf(Kind.SIGMA, factor, sentence, setting, self.T_object_scanner, scanner, self.casters)


def _apart(value: float, now: float) -> float:
    """How far a limit is opened, alike for large and small ones."""
    return float(abs(np.log(max(value, 1e-3) / max(now, 1e-3))))


def round_mm(length: float) -> float:
    """A length that a person would name: two digits, or whole tens above 100 mm."""
    if length >= 100:
        return float(round(length, -1))
    return float(f"{length:.2g}")
