"""Calibration of a field against a rig: one field scale, the magnet's offset, gains of the currents; each by name.

What is fitted is said by name, with its covariance and the readings before and after; docs/theory/equilibrium.md (15).
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import ArrayLike, NDArray

from fieldmap.arguments import check_matrix, check_ordered, check_positive, check_signal
from fieldmap.device.model import Payload
from fieldmap.errors import InputError, NoEquilibrium, Problem
from fieldmap.field import AnyField, Bounds, Field, as_field, require_bounds
from fieldmap.levitation.balance import MagnetModel, magnet_balance, model_assumptions
from fieldmap.levitation.branches import equilibrium_at
from fieldmap.lookup.payload import check_payload
from fieldmap.records import Record
from fieldmap.typing import Array

PARAMETERS = ("field_scale", "magnet_offset", "current_scale")
_TYPICAL = {"field_scale": 1.0, "magnet_offset": 0.01}
_FAR = 3.0
"""What a place that does not exist counts, in measured places, and a hundred deviations besides."""
_RANK = 1e-6
"""Smallest singular value over the largest, the columns scaled to 1, at which parameters are told apart."""


@dataclass(frozen=True, eq=False, repr=False)
class LiftReadings(Record):
    """Currents that carried the magnet: sensed (n,), z of the point that the sensor reads, m; currents (n, n_coils), A;
    place (n, 2) of the magnet, m, the axis unless given; deviation: standard deviation of the currents over themselves.
    """

    sensed: ArrayLike
    currents: ArrayLike
    deviation: float = 0.01
    place: ArrayLike | None = None


@dataclass(frozen=True, eq=False, repr=False)
class PositionReadings(Record):
    """Places where the magnet came to rest.

    sensed (n,): z of the point that the sensor reads, m; currents (n, n_coils), A; places (n, 2), m, NaN where a
    coordinate was not read; deviation, m. height_held: a controller kept the height by scaling all currents alike, so
    that only their proportions are known, and the level is sought at which the magnet is carried. from_first: places
    count from where the magnet was at the first reading, as a sensor's do that was set to zero there.
    """

    sensed: ArrayLike
    currents: ArrayLike
    places: ArrayLike
    deviation: float = 1e-4
    height_held: bool = False
    from_first: bool = False


@dataclass(frozen=True, eq=False, repr=False)
class Reading(Record):
    """One compared number: what, measured, and computed with nothing fitted and with the fit. Lifts over the weight,
    places in m."""

    quantity: str
    measured: float
    before: float
    after: float


@dataclass(frozen=True, eq=False, repr=False)
class Calibration(Record):
    """A fit. values and before: every parameter by name; fitted: the names of those that were free, in the order of
    covariance (k, k), which takes the stated deviations at their word. misfit: root mean square of what is left, in
    deviations; misfit_before: with nothing fitted. table: every reading."""

    values: Mapping[str, float]
    before: Mapping[str, float]
    fitted: tuple[str, ...]
    covariance: Array
    misfit: float
    misfit_before: float
    table: tuple[Reading, ...]
    assumptions: tuple[str, ...]

    @property
    def deviations(self) -> dict[str, float]:
        """Standard deviation of each fitted parameter."""
        return dict(zip(self.fitted, np.sqrt(np.diag(self.covariance)).tolist(), strict=True))

    def currents(self, currents: ArrayLike) -> Array:
        """What the field is to be asked at for currents of the rig (..., n_coils): scaled by the fitted gains."""
        return np.asarray(currents, dtype=float) * _gains(self.values, np.asarray(currents).shape[-1])


@dataclass(frozen=True, eq=False)
class _Rig:
    source: Field
    payload: Payload
    lift: LiftReadings | None
    positions: PositionReadings | None
    moment: MagnetModel
    lever: float
    # Where each magnet was found last, so that the next search begins there.
    found: dict[int, tuple[Array, float]] = dataclasses.field(default_factory=dict)

    def computed(self, values: Mapping[str, float]) -> Array:
        """Lifts over the weight, then places (m), NaN where there is none."""
        gains = _gains(values, len(self.source.coil_names))
        parts = []
        if self.lift is not None:
            parts.append(self._lifts(values, gains))
        if self.positions is not None:
            parts.append(self._places(values, gains).ravel())
        return np.concatenate(parts)

    def _lifts(self, values: Mapping[str, float], gains: Array) -> Array:
        assert self.lift is not None
        sensed, currents = np.asarray(self.lift.sensed), np.asarray(self.lift.currents)
        places = np.zeros((len(sensed), 2)) if self.lift.place is None else np.asarray(self.lift.place)
        lifts = []
        for z, amperes, place in zip(sensed, currents, places, strict=True):
            point = np.append(place, z - values["magnet_offset"])
            about = (self.payload, point, self.moment, self.lever)
            balance = magnet_balance(self.source, amperes * gains, *about)
            lifts.append(balance.magnetic_force(point[None, :])[0, 2] / balance.weight)
        return values["field_scale"] * np.array(lifts)

    def _places(self, values: Mapping[str, float], gains: Array) -> Array:
        assert self.positions is not None
        read = self.positions
        rows = zip(np.asarray(read.sensed), np.asarray(read.currents), np.asarray(read.places), strict=True)
        places = np.array([self._place(k, values, gains, *row) for k, row in enumerate(rows)])
        return places - places[0] if read.from_first else places

    def _place(
        self, k: int, values: Mapping[str, float], gains: Array, z: float, currents: Array, place: Array
    ) -> Array:
        assert self.positions is not None
        mean = float(np.abs(currents).mean())
        begin, level = self.found.get(k, (np.nan_to_num(place), mean))
        height = z - values["magnet_offset"]
        for start in ((begin, level), (np.nan_to_num(place), mean)):
            try:
                point, carried = equilibrium_at(
                    self.source,
                    self.payload,
                    lambda u: (currents * (u / mean) * gains, height),
                    *start,
                    self.positions.height_held,
                    values["field_scale"],
                    self.moment,
                    self.lever,
                )
            except NoEquilibrium:
                continue
            self.found[k] = (point.position[:2], carried)
            return np.asarray(point.position[:2])
        return np.full(2, np.nan)


def calibrate(
    field: AnyField,
    payload: Payload | None,
    lift: LiftReadings | None = None,
    positions: PositionReadings | None = None,
    fit: Sequence[str] = ("field_scale", "magnet_offset"),
    given: Mapping[str, float] | None = None,
    limits: Mapping[str, tuple[float, float]] | None = None,
    moment: MagnetModel = "fixed",
    lever: float = 0.0,
) -> Calibration:
    """Fit a field to measured currents of levitation, measured places, or both, by least squares.

    fit: which parameters are free. "field_scale" multiplies every field and force; "magnet_offset" is the depth of the
    magnet's centre below the point that the sensor reads, m; "current_scale" multiplies all currents before the field
    is asked (turns, or an amplifier's gain; where iron saturates that is not the same as a field scale); "gains" stands
    for one such factor for each coil, called "gain NAME". given: values of parameters that are not free, or where the
    free ones begin; 1, the payload's magnet_offset, and 1 unless given. limits: lower and upper bound of free
    parameters, narrower than what is said below. moment, lever: `magnet_balance`. The field must
    hold at the currents and places that the fit tries.

    The scales are kept within 0.05 to 20, the offset so that no magnet leaves the field's box. Raises InputError where
    there are no readings, fewer than free parameters, or readings that cannot tell the free
    parameters apart (named).

    Example::

        readings = LiftReadings(sensed=-0.05 - depths, currents=np.outer(amperes, np.ones(coils)))
        found = calibrate(m, device.payload, lift=readings)
        print(found.values, found.deviations, found.misfit)
    """
    carried = check_payload(payload, "calibrate")
    source = as_field(field)
    names = _free(fit, source.coil_names)
    start = _start(source.coil_names, carried, given)
    rig = _Rig(source, carried, lift, positions, moment, lever)
    measured, deviation, rows = _readings(lift, positions, len(source.coil_names))
    if len(measured) < len(names):
        raise _too_few(len(measured), names)
    scale = np.array([_TYPICAL.get(name, 1.0) for name in names])

    def values_at(x: Array) -> dict[str, float]:
        return {**start, **dict(zip(names, (x * scale).tolist(), strict=True))}

    def residual(x: Array) -> Array:
        left = (rig.computed(values_at(x))[rows.read] - measured) / deviation
        # A place that does not exist counts as far off, so that the fit turns back.
        return np.where(np.isnan(left), _FAR * np.abs(measured / deviation) + 100.0, left)

    before = rig.computed(start)[rows.read]
    bounds = _bounds(names, require_bounds(source), lift, positions, limits or {}) / scale
    begin = np.array([start[name] for name in names]) / scale
    begin = np.clip(begin, *(bounds + np.outer([1e-6, -1e-6], bounds[1] - bounds[0])))
    answer = scipy.optimize.least_squares(
        residual, begin, x_scale="jac", diff_step=1e-4, xtol=1e-10, ftol=1e-12, bounds=tuple(bounds)
    )
    values = values_at(answer.x)
    after = rig.computed(values)[rows.read]
    columns = (rows.names, measured.tolist(), before.tolist(), after.tolist())
    return Calibration(
        values,
        start,
        names,
        _covariance(answer.jac, scale, names),
        _misfit((after - measured) / deviation),
        _misfit((before - measured) / deviation),
        tuple(Reading(*row) for row in zip(*columns, strict=True)),
        (*model_assumptions(moment, lever), *_fit_assumptions(names, answer.active_mask)),
    )


def _misfit(left: Array) -> float:
    return float(np.sqrt(np.mean(left**2)))


@dataclass(frozen=True, eq=False)
class _Rows:
    names: list[str]
    read: NDArray[np.bool_]


def _readings(
    lift: LiftReadings | None, positions: PositionReadings | None, coils: int
) -> tuple[Array, Array, _Rows]:
    """Measured numbers and their deviations (n,), and what they are called."""
    if lift is None and positions is None:
        must = "must have readings of lift, of positions, or both"
        raise InputError(Problem("calibrate", must, "none", "pass lift=LiftReadings(...) or positions=..."))
    measured, deviation, names = [], [], []
    if lift is not None:
        check_positive("calibrate(lift)", deviation=lift.deviation)
        count = len(check_signal("calibrate(lift.sensed)", lift.sensed))
        check_matrix("calibrate(lift.currents)", lift.currents, (count, coils))
        measured.append(np.ones(count))
        deviation.append(np.full(count, lift.deviation))
        names += [f"lift over weight at {1e3 * z:g} mm" for z in np.asarray(lift.sensed)]
    if positions is not None:
        check_positive("calibrate(positions)", deviation=positions.deviation)
        count = len(check_signal("calibrate(positions.sensed)", positions.sensed))
        check_matrix("calibrate(positions.currents)", positions.currents, (count, coils))
        places = np.asarray(positions.places, dtype=float).reshape(count, 2)
        places = places - places[0] if positions.from_first else places
        measured.append(places.ravel())
        deviation.append(np.full(2 * count, positions.deviation))
        names += [f"{axis} of reading {k}" for k in range(count) for axis in "xy"]
    values = np.concatenate(measured)
    read = np.isfinite(values)
    rows = _Rows([name for name, there in zip(names, read, strict=True) if there], read)
    return values[read], np.concatenate(deviation)[read], rows


def _free(fit: Sequence[str], coil_names: tuple[str, ...]) -> tuple[str, ...]:
    """Names of the free parameters."""
    wanted = [fit] if isinstance(fit, str) else list(fit)
    unknown = [name for name in wanted if name not in (*PARAMETERS, "gains")]
    if unknown or not wanted or len(set(wanted)) != len(wanted) or {"gains", "current_scale"} <= set(wanted):
        must = f"must name, each once, some of {', '.join(PARAMETERS)}, gains; not current_scale with gains"
        raise InputError(Problem("calibrate(fit)", must, f"{wanted}", "the gains hold the current scale"))
    gains = tuple(f"gain {name}" for name in coil_names)
    return tuple(n for name in wanted for n in (gains if name == "gains" else (name,)))


def _bounds(
    names: tuple[str, ...],
    box: Bounds,
    lift: LiftReadings | None,
    positions: PositionReadings | None,
    limits: Mapping[str, tuple[float, float]],
) -> Array:
    """Lower and upper bounds (2, k): scales are positive, and the magnet stays in the field's box."""
    for name, (least, most) in limits.items():
        check_ordered(f"calibrate(limits[{name!r}])", least, most)
    sensed = np.concatenate([np.ravel(read.sensed) for read in (lift, positions) if read is not None])
    low, high = float(box[0][2]), float(box[1][2])
    rim = 1e-3 * (high - low)
    offset = (sensed.max() - high + rim, sensed.min() - low - rim)
    scales = (0.05, 20.0)
    widest = [offset if name == "magnet_offset" else scales for name in names]
    asked = [limits.get(name, bound) for name, bound in zip(names, widest, strict=True)]
    return np.array([(max(a, c), min(b, d)) for (a, b), (c, d) in zip(widest, asked, strict=True)]).T


def _fit_assumptions(names: tuple[str, ...], active: NDArray[np.int_]) -> tuple[str, ...]:
    at_bound = [name for name, mask in zip(names, active, strict=True) if mask]
    stated = [f"fitted: {', '.join(names)}; all else as given"]
    if at_bound:
        stated.append(f"the fit ended at the bound of {' and '.join(at_bound)}")
    return tuple(stated)


def _start(
    coil_names: tuple[str, ...], payload: Payload, given: Mapping[str, float] | None
) -> dict[str, float]:
    start = {"field_scale": 1.0, "magnet_offset": payload.magnet_offset, "current_scale": 1.0}
    start |= {f"gain {name}": 1.0 for name in coil_names}
    for name, value in (given or {}).items():
        if name not in start or not np.isfinite(value):
            must = f"must be finite values of {', '.join(start)}"
            raise InputError(Problem("calibrate(given)", must, f"{name} = {value}", "choose from these"))
        start[name] = float(value)
    return start


def _gains(values: Mapping[str, float], count: int) -> Array:
    gains = [value for name, value in values.items() if name.startswith("gain ")]
    return values["current_scale"] * (np.array(gains) if gains else np.ones(count))


def _covariance(jacobian: Array, scale: Array, names: tuple[str, ...]) -> Array:
    size = np.linalg.norm(jacobian, axis=0)
    blind = [name for name, s in zip(names, size, strict=True) if s == 0.0]
    if not blind:
        _, values, directions = np.linalg.svd(jacobian / size, full_matrices=False)
        if values[-1] > _RANK * values[0]:
            return np.linalg.inv(jacobian.T @ jacobian) * np.outer(scale, scale)
        blind = [name for name, part in zip(names, directions[-1], strict=True) if abs(part) > 0.1]
    raise InputError(
        Problem(
            "calibrate(fit)",
            "the readings must tell the free parameters apart",
            f"readings that do not change with {' and '.join(blind)}, or with both at once",
            "hold one of them with given=..., or add readings of another kind",
        )
    )


def _too_few(count: int, names: tuple[str, ...]) -> InputError:
    return InputError(
        Problem(
            "calibrate(readings)",
            f"must be at least as many as the {len(names)} free parameters",
            f"{count} readings",
            "add readings, or fit fewer parameters",
        )
    )
