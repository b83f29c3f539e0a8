"""Values of characteristics with expanded uncertainty, and their conformity.

A value is a function of components: offsets of an axis at its ends, distances of cells from a zone. Components are
linear in small errors of the fitted shapes and the cells, datums included. Errors of points and of the views' poses are
drawn and propagated (JCGM 101): the uncertainty includes correlations between features of one view. U is twice the
standard deviation of the draws. A zone or an offset, which cannot be negative, has at least the 95 % quantile of the
value that the errors alone make.

Conformity follows ISO 14253-1: pass if the value is inside the limits by more than U, fail if it is outside by more
than U, else undecided.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from cell.inspect.alignment import common_element, datum_frame, moved
from cell.inspect.features import Characteristic, InspectionPlan, distance_between
from cell.inspect.measured import Cells, MeasuredFeature, MeasuredPatch, off_surface
from planner.fitting.extremal import FULL_STEPS, Criterion, fit_extremal, surround
from planner.fitting.shapes import N_COMPONENTS, PARAMETERS, Shape, ShapeKind
from planner.geometry.closest import ClosestPointQuery
from planner.registration.rigid import motion_from_vector, transform_points
from planner.values import Floats, Ints

RULE = "ISO 14253-1, guard band U (k = 2)"
DRAWS = 2000
_LEVEL = 0.9545  # of two standard deviations of a normal distribution
_FORM_CELLS = {"form": 8, "roundness": 20, "straightness": 24}
_DIFFERENCE = 1e-7  # of a component of a shape, for derivatives [m, rad]
_SECTIONS = 5  # cross-sections of roundness and runout
_LINES = 8  # of the straightness of a cylinder or cone
_ZONES = 16  # drawn errors whose minimum zones are evaluated
_SHARE = 0.05  # smallest measured share of a feature with a value


class Verdict(StrEnum):
    """Conformity of a characteristic."""

    PASS = "pass"
    FAIL = "fail"
    UNDECIDED = "undecided"
    NO_TOLERANCE = "no tolerance"
    NOT_MEASURED = "not measured"


@dataclass(frozen=True, slots=True)
class Measurement:
    """Measured value of a characteristic [mm or deg]; None with the cause if there is none.

    Attributes:
        characteristic: measured.
        value: estimate.
        expanded_uncertainty: U, k = 2.
        verdict: conformity.
        method: of the evaluation, in words.
        cause: reason for a missing value.
        note: doubt about the value.
        contributions: share of each feature in the variance of the components from points.
        pose_share: share of the pose errors in the variance of the components.
    """

    characteristic: Characteristic
    value: float | None
    expanded_uncertainty: float | None
    verdict: Verdict
    method: str
    cause: str = ""
    note: str = ""
    contributions: Mapping[str, float] = field(default_factory=dict)
    pose_share: float = 0.0


def verdict_of(value: float, uncertainty: float, lower: float | None, upper: float | None) -> Verdict:
    """Return the conformity of a value with limits by ISO 14253-1."""
    if lower is None and upper is None:
        return Verdict.NO_TOLERANCE
    low, high = -np.inf if lower is None else lower, np.inf if upper is None else upper
    if low + uncertainty <= value <= high - uncertainty:
        return Verdict.PASS
    if value < low - uncertainty or value > high + uncertainty:
        return Verdict.FAIL
    return Verdict.UNDECIDED


Reduce = Callable[[Floats], Floats]
"""Value (...,) of components (..., m)."""


@dataclass(frozen=True, slots=True, eq=False)
class _Model:
    """Components of a characteristic.

    Attributes:
        components: (m,) for shapes by feature and patch.
        reduce: to a value [m or rad].
        cells: rows of the components that move with cells: the cells' patch, and the cells.
        estimate: value that replaces that of the components, such as a minimum zone; None without one.
        residual: (m, m) projection of the errors of the cells by a fit to them; None without one.
        zone: minimum zone of errors (m,) alone [m]; None if `reduce` has the value of errors.
        method: in words.
    """

    components: Callable[["Shapes"], Floats]
    reduce: Reduce
    method: str
    cells: tuple[tuple[str, int], ...] = ()
    estimate: float | None = None
    residual: Floats | None = None
    zone: Callable[[Floats], float] | None = None

    def value(self, g: Floats) -> float:
        """Return the value of the components [m or rad]."""
        return float(self.reduce(g)) if self.estimate is None else self.estimate


Shapes = Mapping[tuple[str, int], Shape]
"""Fitted shapes by name of the feature and number of the patch."""


def _range(g: Floats) -> Floats:
    return np.asarray(g.max(axis=-1) - g.min(axis=-1))


def _twice_largest(g: Floats) -> Floats:
    return np.asarray(2 * np.abs(g).max(axis=-1))


def _twice_longest(g: Floats) -> Floats:
    return np.asarray(2 * np.linalg.norm(g.reshape(*g.shape[:-1], -1, 3), axis=-1).max(axis=-1))


def _first(g: Floats) -> Floats:
    return np.asarray(g[..., 0])


def _largest_range(sections: Ints) -> Reduce:
    def reduce(g: Floats) -> Floats:
        return np.asarray(np.max([_range(g[..., sections == k]) for k in np.unique(sections)], axis=0))

    return reduce


@dataclass(slots=True)
class Evaluation:
    """Evaluation of the characteristics of a plan on measured features.

    Attributes:
        plan: features and characteristics.
        features: measured, by name.
        nearest: the reference.
        pose_sd: (V, 2) of the views: position [m] and rotation [rad].
        seed: of the drawn errors.
    """

    plan: InspectionPlan
    features: Mapping[str, MeasuredFeature]
    nearest: ClosestPointQuery
    pose_sd: Floats
    seed: int = 0
    _frames: dict[object, Floats] = field(default_factory=dict)

    def measure_all(self) -> list[Measurement]:
        """Return the measurements of all characteristics."""
        return [self.measure(each) for each in self.plan.characteristics]

    def measure(self, characteristic: Characteristic) -> Measurement:
        """Return the measurement of a characteristic."""
        if causes := self._causes(characteristic):
            return Measurement(characteristic, None, None, Verdict.NOT_MEASURED, "", "; ".join(causes))
        model, shapes = self._model(characteristic), self._shapes(characteristic)
        g = model.components(shapes)
        slopes = self._slopes(model, shapes, g)
        scale = 1000.0 if characteristic.unit == "mm" else float(np.degrees(1.0))
        gain, source = self._gain(model, slopes, g)
        value, uncertainty = scale * model.value(g), scale * self._uncertainty(model, gain, g)
        verdict = verdict_of(value, uncertainty, characteristic.lower, characteristic.upper)
        note = "; ".join(self._weak_features(characteristic, slopes))
        shares, pose_share = _shares(gain, source)
        return Measurement(
            characteristic, value, uncertainty, verdict, model.method, note=note, contributions=shares,
            pose_share=pose_share,
        )  # fmt: skip

    def values(self) -> list[float]:
        """Return the values of all characteristics without uncertainties [mm or deg]; NaN without a value."""
        numbers = []
        for each in self.plan.characteristics:
            value = np.nan
            if not self._causes(each):
                model = self._model(each)
                value = model.value(model.components(self._shapes(each)))
            numbers.append((1000.0 if each.unit == "mm" else float(np.degrees(1.0))) * value)
        return numbers

    def _causes(self, characteristic: Characteristic) -> list[str]:
        """Return the reasons why a characteristic has no value."""
        causes = []
        for feature in self.plan.features_of(characteristic):
            measured = self.features[feature.name]
            own = list(measured.doubts)
            if any(patch.cells is not None and patch.share < _SHARE for patch in measured.patches):
                own.append(f"less than {_SHARE:.0%} of its area has points")
            if not own and feature.name == characteristic.feature:
                count = int(self._cells((feature.name, 0)).is_dense.sum())
                if count < (least := _FORM_CELLS.get(characteristic.kind, 0)):
                    own.append(f"points for {count} means, and its form needs {least}")
                if characteristic.criterion != "least-squares":
                    points, shape = self._dense_points((feature.name, 0)), self._patch_shape((feature.name, 0))
                    if not surround(points, shape):
                        own.append(
                            f"its points lie on one side of it, or on opposite sides of its ends, and its "
                            f"{characteristic.criterion} diameter needs them all around"
                        )
            causes += [f"{feature.name}: {cause}" for cause in own]
        return causes

    # Errors

    def _slopes(self, model: _Model, shapes: Shapes, g: Floats) -> dict[tuple[str, int], Floats]:
        """Return the derivative (m, 7) of the components by the changes of each shape."""
        slopes = {}
        for key, shape in shapes.items():
            J = np.zeros((len(g), N_COMPONENTS))
            used = PARAMETERS[ShapeKind.CYLINDER if shape.kind is ShapeKind.CIRCLE else shape.kind]
            for component in used if self._cells(key).gain.any() else ():
                change = np.zeros(N_COMPONENTS)
                change[component] = _DIFFERENCE
                low, high = (model.components({**shapes, key: shape.changed(step)}) for step in (-change, change))
                J[:, component] = (high - low) / (2 * _DIFFERENCE)
            slopes[key] = J
        return slopes

    def _weak_features(self, c: Characteristic, slopes: Mapping[tuple[str, int], Floats]) -> Iterator[str]:
        """Yield a sentence for each feature whose points do not average in a value, but are amplified."""
        for key, J in slopes.items():
            extent = 1.0 if c.unit == "mm" else float(np.linalg.norm(np.ptp(self._patch(key).corners, axis=0))) / 2
            times = extent * float(np.linalg.norm(J @ self._cells(key).unit_noise, axis=1).max())
            if times > 1:
                yield f"nearly not determined: an error of the points on {key[0]} counts {times:.1f} times"

    def _uncertainty(self, model: _Model, gain: Floats, g: Floats) -> float:
        """Return the expanded uncertainty [m or rad] by the change (m, K) of the components by independent errors."""
        if model.reduce is _first or not gain.any():
            return 2 * float(np.linalg.norm(gain))
        # Draws of as few independent errors as there are components.
        root = np.linalg.qr(gain.T, mode="r")
        rng = np.random.default_rng([self.seed, len(root)])
        draws = rng.standard_normal((DRAWS, len(root))) @ root
        scale = 1.0
        if model.zone is not None:  # the minimum zone of errors is narrower than their range
            some = draws[:_ZONES]
            scale = float(np.mean([model.zone(each) for each in some]) / model.reduce(some).mean())
        spread = 2 * float(model.reduce(g + draws).std())
        # Errors alone make a zone or an offset from zero; the measured one contains its own already.
        return max(spread, scale * float(np.quantile(np.abs(model.reduce(draws)), _LEVEL)))

    def _gain(
        self, model: _Model, slopes: Mapping[tuple[str, int], Floats], g: Floats
    ) -> tuple[Floats, NDArray[np.str_]]:
        """Return the change (m, K) of the components by independent errors of unit variance, and their sources (K,).

        The errors are those of the means of all cells, and of the views' poses, which all patches have in common. The
        source is the name of the feature of the cells; of poses it is empty.
        """
        poses, start = np.zeros((len(g), 6 * len(self.pose_sd))), 0
        for key, J in slopes.items():
            cells = self._cells(key)
            poses += J @ cells.shape_lever.reshape(N_COMPONENTS, -1)
            if key in model.cells:
                lever = cells.lever[cells.is_dense]
                poses[start : start + len(lever)] += lever.reshape(len(lever), -1)
                start += len(lever)
        noise = self._noise(model, slopes)
        gain = np.hstack([*noise.values(), poses * np.repeat(self.pose_sd, 3, axis=1).ravel()])
        counts = [*(each.shape[1] for each in noise.values()), poses.shape[1]]
        source = np.repeat(np.array([*(name for name, _ in noise), ""]), counts)
        return gain if model.residual is None else model.residual @ gain, source

    def _noise(self, model: _Model, slopes: Mapping[tuple[str, int], Floats]) -> dict[tuple[str, int], Floats]:
        """Return the change (m, K) of the components by errors of unit variance of the points of each patch."""
        noise, start = {}, 0
        for key, J in slopes.items():
            cells = self._cells(key)
            if key not in model.cells:
                noise[key] = J @ cells.shape_noise
                continue
            # The errors of the cells and of the shape through them are the same.
            dense, own = np.flatnonzero(cells.is_dense), J @ cells.gain
            own[start + np.arange(len(dense)), dense] += 1.0
            noise[key] = own * cells.noise
            start += len(dense)
        return noise

    # Shapes

    def _patch(self, key: tuple[str, int]) -> MeasuredPatch:
        return self.features[key[0]].patches[key[1]]

    def _cells(self, key: tuple[str, int]) -> Cells:
        cells = self._patch(key).cells
        assert cells is not None, "a feature without points has no value"
        return cells

    def _shapes(self, characteristic: Characteristic) -> dict[tuple[str, int], Shape]:
        """Return the fitted shapes of the features of a characteristic."""
        names = [each.name for each in self.plan.features_of(characteristic)]
        return {
            (name, k): self._patch_shape((name, k)) for name in names for k in range(len(self.features[name].patches))
        }

    def _nominal(self, key: tuple[str, int]) -> Shape:
        patch = self._patch(key).patch
        shape = patch.shape
        return Shape(ShapeKind.PLANE, np.array(patch.point_mm) / 1000, np.array(patch.axis)) if shape is None else shape

    def _datum(self, datum: str, shapes: Shapes | None) -> Shape:
        """Return the measured (or, for None, nominal) plane, axis or point of a datum; A-B is a common one."""
        names = [feature.name for feature in self.plan.datum_features(datum)]
        elements = [self._element(name, shapes) for name in names]
        if len(elements) == 1:
            return elements[0]
        corners = [self._patch((name, 0)).corners for name in names]
        return common_element(self._nominal((names[0], 0)), elements, corners)

    def _element(self, name: str, shapes: Shapes | None) -> Shape:
        """Return the measured (or, for None, nominal) element of a feature: of a width the middle plane."""
        feature = self.features[name].feature
        first = self._nominal((name, 0)) if shapes is None else shapes[name, 0]
        if feature.kind == "circle":
            return Shape(ShapeKind.CIRCLE, first.point, first.axis, first.size)
        if feature.kind != "width":
            return first
        return self._middle(name, shapes)

    def _middle(self, name: str, shapes: Shapes | None) -> Shape:
        """Return the middle plane of a width, with the normal of its first plane."""
        nominal = [self._nominal((name, k)) for k in range(2)]
        planes = nominal if shapes is None else [shapes[name, k] for k in range(2)]
        sign = 1.0 if float(nominal[0].axis @ nominal[1].axis) >= 0 else -1.0
        axis = planes[0].axis + sign * planes[1].axis
        axis /= np.linalg.norm(axis)
        points = [each.at_foot(at.point).point for each, at in zip(planes, nominal, strict=True)]
        return Shape(ShapeKind.PLANE, (points[0] + points[1]) / 2, axis)

    def frame(self, datums: Sequence[str], shapes: Shapes) -> Floats:
        """Return the motion (4, 4) that moves measured datums to nominal ones."""
        if not datums:
            return np.eye(4)
        measured = [self._datum(datum, shapes) for datum in datums]
        key = (tuple(datums), b"".join(np.array([*each.point, *each.axis]).tobytes() for each in measured))
        if key not in self._frames:
            nominal = [self._datum(datum, None) for datum in datums]
            self._frames[key] = datum_frame(nominal, measured, self.nearest.mesh.diagonal / 2)
        return self._frames[key]

    # Models

    def _model(self, c: Characteristic) -> _Model:
        match c.kind:
            case "size" | "distance" | "angle":
                return self._dimension(c)
            case "form" | "roundness" | "straightness":
                return self._form(c)
            case "position" | "coaxiality":
                return self._position(c)
            case "profile":
                return self._profile(c)
            case "runout" | "total-runout":
                return self._runout(c)
        return self._orientation(c)

    def _dimension(self, c: Characteristic) -> _Model:
        own, kind = (c.feature, 0), self.features[c.feature].feature.kind
        if c.kind == "size" and kind == "cone":
            return _Model(lambda s: np.array([2 * s[own].half_angle]), _first, "least-squares cone")
        if c.kind == "size" and kind != "width":
            if c.criterion == "least-squares":
                return _Model(lambda s: np.array([2 * s[own].size]), _first, f"least-squares {kind}")
            criterion = Criterion.INSCRIBED if c.criterion == "inscribed" else Criterion.CIRCUMSCRIBED
            points, sign = self._dense_points(own), 1.0 if criterion is Criterion.CIRCUMSCRIBED else -1.0
            size = fit_extremal(criterion, points, self._patch_shape(own)).shape.size
            return _Model(
                lambda s: s[own].size + off_surface(s[own], points),
                lambda g: 2 * sign * (sign * g).max(axis=-1),
                f"{criterion.value} {kind}",
                (own,),
                2 * size,
            )
        other = (c.feature, 1) if c.to is None else (c.to, 0)
        one, two = self._nominal(own), self._nominal(other)
        if c.kind == "angle":
            nominal_deg = np.degrees(np.arccos(np.clip(one.axis @ two.axis, -1, 1)))
            sign = -1.0 if abs(180 - nominal_deg - c.nominal) < abs(nominal_deg - c.nominal) else 1.0

            def angle(s: Shapes) -> Floats:
                return np.array([np.arccos(np.clip(sign * s[own].axis @ s[other].axis, -1, 1))])

            return _Model(angle, _first, "angle of least-squares elements")
        kinds = [self._patch(key).patch.kind for key in (own, other)]

        def distance(s: Shapes) -> Floats:
            first, second = s[own].at_foot(one.point), s[other].at_foot(two.point)
            axis = second.axis
            if kind == "width":
                axis = self._middle(c.feature, s).axis
            return np.array([distance_between(second.point - first.point, kinds[0], first.axis, kinds[1], axis)])

        return _Model(distance, _first, "distance of least-squares elements at their middles")

    def _patch_shape(self, key: tuple[str, int]) -> Shape:
        shape = self._patch(key).shape
        assert shape is not None, "a feature without points has no value"
        return shape

    def _dense_points(self, key: tuple[str, int]) -> Floats:
        cells = self._cells(key)
        return np.asarray(cells.points[cells.is_dense])

    def _form(self, c: Characteristic) -> _Model:
        own = (c.feature, 0)
        points, shape = self._dense_points(own), self._patch_shape(own)

        def residuals(s: Shapes) -> Floats:
            return off_surface(s[own], points)

        local = (points - shape.point) @ shape.frame
        sections, method = np.zeros(len(points), np.int64), "minimum zone of cell means"
        if c.kind == "roundness":
            sections, method = _sections(local[:, 2]), f"{method} in {_SECTIONS} cross-sections"
        elif c.kind == "straightness":
            sections = np.floor(np.arctan2(local[:, 1], local[:, 0]) / (2 * np.pi / _LINES)).astype(np.int64)
            method = f"{method} in lines, {360 / _LINES:.0f} deg apart"

        def zone(points: Floats, steps: int) -> float:
            return max(_zone(c.kind, points[sections == k], shape, steps) for k in np.unique(sections))

        normals = self._cells(own).normals[self._cells(own).is_dense]
        feet = points - residuals({own: shape})[:, None] * normals

        def zone_of_errors(errors: Floats) -> float:
            return zone(feet + errors[:, None] * normals, 1)

        measured = zone(points, FULL_STEPS)
        return _Model(residuals, _largest_range(sections), method, (own,), measured, None, zone_of_errors)

    def _position(self, c: Characteristic) -> _Model:
        own, kind = (c.feature, 0), self.features[c.feature].feature.kind
        nominal, corners = self._nominal(own), self._patch(own).corners
        if kind in ("plane", "width"):
            middle = self._element(c.feature, None)
            if kind == "width":
                corners = np.concatenate([self._patch((c.feature, k)).corners for k in range(2)])
                corners = corners - ((corners - middle.point) @ middle.axis)[:, None] * middle.axis

            def offsets(s: Shapes) -> Floats:
                element = moved(self._element(c.feature, s), self.frame(c.datums, s))
                return np.asarray((element.point - corners) @ element.axis / (middle.axis @ element.axis))

            return _Model(offsets, _twice_largest, f"least-squares {'middle plane' if kind == 'width' else kind}")

        def ends(s: Shapes) -> Floats:
            element = moved(s[own], self.frame(c.datums, s))
            if kind in ("sphere", "circle"):
                off = element.point - nominal.point
                return np.asarray(off if kind == "sphere" else off - (off @ nominal.axis) * nominal.axis)
            off = element.point - corners
            along = (off @ nominal.axis) / (element.axis @ nominal.axis)
            return np.asarray((off - along[:, None] * element.axis).ravel())

        where = "centre" if kind in ("sphere", "circle") else "axis at its ends"
        return _Model(ends, _twice_longest, f"least-squares {kind}, {where}")

    def _orientation(self, c: Characteristic) -> _Model:
        own, datum = (c.feature, 0), c.datums[0]
        nominal, base = self._nominal(own), self._datum(datum, None)
        angle = float(np.arccos(np.clip(nominal.axis @ base.axis, -1, 1)))
        extents = np.ptp(self._patch(own).corners @ nominal.axis)

        def ideal(s: Shapes) -> Floats:
            """Return the direction nearest to the axis at the nominal angle to the datum, or fixed by several."""
            if len(c.datums) > 1:
                return np.asarray(self.frame(c.datums, s)[:3, :3].T @ nominal.axis)
            a, n = self._datum(datum, s).axis, s[own].axis
            across = n - (n @ a) * a
            length = float(np.linalg.norm(across))
            return np.asarray(np.cos(angle) * a + np.sin(angle) * across / max(length, 1e-300))

        if nominal.kind is ShapeKind.PLANE:
            points = self._dense_points(own)
            return _Model(lambda s: points @ ideal(s), _range, "zone of cell means", (own,))

        def deviation(s: Shapes) -> Floats:
            return np.asarray(extents * (s[own].axis - ideal(s)))

        return _Model(deviation, lambda g: _twice_longest(g) / 2, "least-squares axis over its length")

    def _profile(self, c: Characteristic) -> _Model:
        keys = [(c.feature, k) for k in range(len(self.features[c.feature].patches))]
        points = [self._dense_points(key) for key in keys]
        T_own, residual = np.eye(4), None
        if not c.datums:
            T_own, residual = self._own_fit(keys, points)

        def deviations(s: Shapes) -> Floats:
            T = self.frame(c.datums, s) if c.datums else T_own
            return np.concatenate(
                [self._deviation(key, transform_points(T, own)) for key, own in zip(keys, points, strict=True)]
            )

        how = "datums" if c.datums else "its best fit"
        return _Model(deviations, _twice_largest, f"cell means, aligned by {how}", tuple(keys), None, residual)

    def _deviation(self, key: tuple[str, int], points: Floats) -> Floats:
        """Return the distance (N,) of points (N, 3) from the nominal surface of a patch [m]."""
        shape = self._patch(key).patch.shape
        if shape is not None:
            return shape.distances(points)
        closest = self.nearest.closest(points)
        return np.asarray(np.einsum("nj,nj->n", points - closest.point, self.nearest.normals(closest)))

    def _own_fit(self, keys: Sequence[tuple[str, int]], points: Sequence[Floats]) -> tuple[Floats, Floats]:
        """Return the best fit (4, 4) of cells to their nominal surfaces, and the projection of their errors."""
        T, every = np.eye(4), np.concatenate(points)
        normals = np.concatenate([self._cells(key).normals[self._cells(key).is_dense] for key in keys])
        centre = every.mean(axis=0)
        length = float(np.sqrt(np.mean(((every - centre) ** 2).sum(axis=1)))) or 1.0
        J = np.hstack([normals, np.cross((every - centre) / length, normals)])
        inverse = np.linalg.pinv(J, rcond=1e-3)
        for _ in range(4):
            pairs = zip(keys, points, strict=True)
            off = np.concatenate([self._deviation(key, transform_points(T, own)) for key, own in pairs])
            change = -inverse @ off
            T = motion_from_vector(np.concatenate([change[:3], change[3:] / length]), centre) @ T
        return T, np.eye(len(every)) - J @ inverse

    def _runout(self, c: Characteristic) -> _Model:
        own, datum = (c.feature, 0), c.datums[0]
        points, nominal = self._dense_points(own), self._nominal(own)

        def radial(axis: Shape) -> Floats:
            off = points - axis.point
            return np.asarray(np.linalg.norm(off - (off @ axis.axis)[:, None] * axis.axis, axis=1))

        def deviations(s: Shapes) -> Floats:
            axis = self._datum(datum, s)
            if nominal.kind is ShapeKind.PLANE:
                return np.asarray((points - axis.point) @ axis.axis)
            return radial(axis)

        if c.kind == "total-runout":
            return _Model(deviations, _range, "range of cell means about the datum axis", (own,))
        axis = self._datum(datum, self._shapes(c))
        along = radial(axis) if nominal.kind is ShapeKind.PLANE else (points - axis.point) @ axis.axis
        method = f"range of cell means in {_SECTIONS} cross-sections about the datum axis"
        return _Model(deviations, _largest_range(_sections(along)), method, (own,))


def _shares(gain: Floats, source: NDArray[np.str_]) -> tuple[dict[str, float], float]:
    """Return the share of each feature in the variance from points, and that of pose errors in the whole variance.

    Args:
        gain: change (m, K) of the components by independent errors of unit variance.
        source: (K,) feature of each error; "" of pose errors.
    """
    variance = (gain**2).sum(axis=0)
    by_feature = {str(name): float(variance[source == name].sum()) for name in np.unique(source)}
    poses, points = by_feature.pop("", 0.0), sum(by_feature.values())
    shares = {name: each / points for name, each in by_feature.items()} if points > 0 else {}
    return shares, poses / (points + poses) if poses > 0 else 0.0


def _zone(kind: str, points: Floats, shape: Shape, steps: int) -> float:
    """Return the minimum zone of the points of a section, or of all for a form [m]."""
    if kind == "roundness":
        at = shape.at_foot(points.mean(axis=0))
        shape = Shape(ShapeKind.CIRCLE, at.point, at.axis, at.size / np.cos(at.half_angle))
        points = points - ((points - at.point) @ at.axis)[:, None] * at.axis
    elif kind == "straightness":
        along = (points - shape.point) @ shape.axis
        off, side = shape.distances(points), np.ptp(along)  # twice, side by side: a line then turns in one plane only
        points = np.concatenate([np.column_stack([along, np.full(len(along), y), off]) for y in (0.0, side)])
        shape = Shape(ShapeKind.PLANE, np.zeros(3), np.array([0.0, 0.0, 1.0]))
    return fit_extremal(Criterion.ZONE, points, shape, steps).zone


def _sections(heights: Floats) -> Ints:
    """Return the number of the cross-section of each height; all have about as many cells."""
    ends = np.quantile(heights, np.linspace(0, 1, _SECTIONS + 1)[1:-1])
    return np.searchsorted(ends, heights).astype(np.int64)
