"""Calibration of a field against a rig: field scale, the magnet's offset, and gains of the currents.

The result has the fitted parameters by name, their covariance, and the readings before and after;
docs/theory/equilibrium.md (15).
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import ArrayLike

from fieldmap.arguments import check, check_matrix, check_ordered, check_positive, check_signal
from fieldmap.device.model import Payload
from fieldmap.errors import NoEquilibrium
from fieldmap.field import AnyField, Bounds, Field, as_field, require_bounds
from fieldmap.levitation.balance import (
    MagnetBalance,
    MagnetModel,
    force_stated,
    magnet_balance,
    model_assumptions,
    modelled,
    reaction_stated,
)
from fieldmap.levitation.branches import equilibrium_at
from fieldmap.levitation.places import box_of_centres
from fieldmap.levitation.unknowns import Unknown, find_unknowns
from fieldmap.lookup.payload import check_payload, magnetic_body
from fieldmap.records import Record
from fieldmap.typing import Array

PARAMETERS = ("field_scale", "magnet_offset", "current_scale")
_TYPICAL = {"field_scale": 1.0, "magnet_offset": 0.01}
_STEP = 1e-4
"""Step of derivatives, as a share of a typical value."""


@dataclass(frozen=True, eq=False, repr=False)
class LiftReadings(Record):
    """Currents that carried the magnet: sensed (n,), z of the point that the sensor reads, m; currents (n, n_coils), A;
    place (n, 2) of the magnet, m, the axis unless given; deviation: relative standard deviation of the currents."""

    sensed: ArrayLike
    currents: ArrayLike
    deviation: float = 0.01
    place: ArrayLike | None = None


@dataclass(frozen=True, eq=False, repr=False)
class PositionReadings(Record):
    """Equilibrium positions of the magnet.

    sensed (n,): z of the point that the sensor reads, m; currents (n, n_coils), A; places (n, 2), m, NaN where a
    coordinate was not read; deviation, m. height_held: a controller kept the height by scaling all currents alike; only
    their ratios are used, and the scale that carries the magnet is computed. from_first: places are relative to the
    first reading, as from a sensor that was set to zero there.
    """

    sensed: ArrayLike
    currents: ArrayLike
    places: ArrayLike
    deviation: float = 1e-4
    height_held: bool = False
    from_first: bool = False


@dataclass(frozen=True, eq=False, repr=False)
class Reading(Record):
    """One reading: quantity, measured value, and values computed before and after the fit. Lifts are stated over the
    weight, places in m."""

    quantity: str
    measured: float
    before: float
    after: float


@dataclass(frozen=True, eq=False, repr=False)
class Calibration(Record):
    """A fit. values and before: all parameters by name, after and before it; fitted: names of the free parameters, in
    the order of covariance (k, k), which assumes the stated deviations. misfit and misfit_before: root mean square of
    the residuals over their deviations. table: all readings."""

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
        """Currents of the field for currents of the rig, scaled by the fitted gains.

        Parameters
        ----------
        currents
            Currents of the rig (..., n_coils), A.

        Returns
        -------
        Array
            Currents of the field (..., n_coils), A.
        """
        return np.asarray(currents, dtype=float) * _gains(self.values, np.asarray(currents).shape[-1])


@dataclass(frozen=True, eq=False)
class _Table:
    """Readings of one kind. rows: names of those that are not NaN. compute: all of them from the parameters' values."""

    name: str
    measured: Array
    deviation: float
    rows: tuple[str, ...]
    compute: Callable[[Mapping[str, float]], Array]


@dataclass(frozen=True, eq=False)
class _Rig:
    source: Field
    payload: Payload
    moment: MagnetModel
    lever: float
    # Place and level that were found last for each reading: the start of the next search.
    found: dict[int, tuple[Array, float]] = dataclasses.field(default_factory=dict)
    # As computed last: balance and centre of each lift; error of the magnets' volume rule at each place; vertical force
    # of the iron's reaction at each place.
    lifted: dict[int, tuple[MagnetBalance, Array]] = dataclasses.field(default_factory=dict)
    errors: dict[int, float] = dataclasses.field(default_factory=dict)
    drawn: dict[int, float] = dataclasses.field(default_factory=dict)

    def lifts(self, read: LiftReadings, values: Mapping[str, float]) -> Array:
        """Lifts (n,) over the weight."""
        sensed, currents = np.asarray(read.sensed), np.asarray(read.currents)
        places = np.zeros((len(sensed), 2)) if read.place is None else np.asarray(read.place)
        lifts = []
        for k, (z, amperes, place) in enumerate(zip(sensed, currents, places, strict=True)):
            point = np.append(place, z - values["magnet_offset"])
            given = amperes * _gains(values, len(amperes))
            balance = magnet_balance(self.source, given, self.payload, point, self.moment, self.lever)
            force = balance.scaled_force(point[None, :], values["field_scale"])
            lifts.append(force[0, 2] / balance.weight)
            self.lifted[k] = balance, point
        return np.array(lifts)

    def places(self, read: PositionReadings, values: Mapping[str, float]) -> Array:
        """Places (2 n,), m, NaN where no equilibrium is found."""
        rows = zip(np.asarray(read.sensed), np.asarray(read.currents), np.asarray(read.places), strict=True)
        places = np.array([self._place(k, read.height_held, values, *row) for k, row in enumerate(rows)])
        return np.ravel(places - places[0] if read.from_first else places)

    def _place(
        self, k: int, held: bool, values: Mapping[str, float], z: float, currents: Array, place: Array
    ) -> Array:
        mean, gains = float(np.abs(currents).mean()), _gains(values, len(currents))
        begin, level = self.found.get(k, (np.nan_to_num(place), mean))
        height = z - values["magnet_offset"]
        for start in ((begin, level), (np.nan_to_num(place), mean)):
            try:
                point, carried = equilibrium_at(
                    self.source,
                    self.payload,
                    lambda u: (currents * (u / mean) * gains, height),
                    *start,
                    held,
                    values["field_scale"],
                    self.moment,
                    self.lever,
                )
            except NoEquilibrium:
                continue
            self.found[k] = (point.position[:2], carried)
            self.errors[k], self.drawn[k] = point.volume_error, point.reaction
            return np.asarray(point.position[:2])
        return np.full(2, np.nan)

    def stated(self) -> tuple[str, ...]:
        """The models of the magnets with the largest error of the force, and the largest reaction of the iron, in
        words."""
        lifted = list(self.lifted.values())
        of_lifts = [float(np.linalg.norm(balance.rule_error(at))) for balance, at in lifted]
        drawn = [float(balance.reaction_force(at[None, :])[0, 2]) for balance, at in lifted]
        return (
            *force_stated(self.payload, self.moment, [*of_lifts, *self.errors.values()]),
            *reaction_stated(self.source, self.payload, [*drawn, *self.drawn.values()], "at most"),
        )


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

    The scales are kept within 0.05 to 20, the offset so that no upright magnet leaves the field's box. The field must
    hold at the currents and places that the fit tries.

    Parameters
    ----------
    field
        Any field with a box.
    payload
        The levitated body.
    lift, positions
        The readings; one kind or both.
    fit
        The free parameters. "field_scale" multiplies every force except the iron's reaction to the magnets.
        "magnet_offset" is the depth of the magnet's centre below the point that the sensor reads, m.
        "current_scale" multiplies all currents before the field is evaluated (turns, or an amplifier's gain;
        with saturating iron this differs from a field scale). "gains" stands for one such factor for each
        coil, called "gain NAME".
    given
        Values of fixed parameters and start values of free ones; by default 1, the payload's magnet_offset,
        and 1.
    limits
        Lower and upper bounds of free parameters, within the bounds above.
    moment, lever
        As in `magnet_balance`.

    Returns
    -------
    Calibration
        The fit, with its covariance and every reading.

    Raises
    ------
    InputError
        For no readings, fewer readings than free parameters, or readings that do not distinguish the free parameters
        (named).

    Examples
    --------
    >>> readings = LiftReadings(sensed=-0.05 - depths, currents=np.outer(amperes, np.ones(coils)))  # doctest: +SKIP
    >>> found = calibrate(m, device.payload, lift=readings)  # doctest: +SKIP
    >>> print(found.values, found.deviations, found.misfit)  # doctest: +SKIP
    """
    carried = check_payload(payload, "calibrate", pieces=True)
    source = as_field(field)
    gains = tuple(f"gain {name}" for name in source.coil_names)
    names = _free(fit, gains)
    start = _start(gains, carried, given)
    rig = _Rig(source, carried, moment, lever)
    tables = _tables(rig, lift, positions)
    box = box_of_centres(require_bounds(source), magnetic_body(modelled(carried, moment)).all_points)
    bounds = _bounds(names, box, lift, positions, limits or {})
    inside = bounds + np.outer([1e-6, -1e-6], bounds[1] - bounds[0])
    unknowns = [
        Unknown(name, float(np.clip(start[name], *near)), low, high, step=_STEP * _TYPICAL.get(name, 1.0))
        for name, near, (low, high) in zip(names, inside.T, bounds.T.tolist(), strict=True)
    ]
    found = find_unknowns(
        "calibrate",
        unknowns,
        tables,
        len(tables),
        lambda values, asked: [table.compute(start | values) for table in asked],
        x_scale="jac",
        xtol=1e-10,
        ftol=1e-12,
    )
    must = "the readings must tell the free parameters apart"
    received = f"readings that do not change with {' and '.join(found.alike)}, or with both at once"
    remedy = "hold one of them with given=..., or add readings of another kind"
    check(not found.alike, "calibrate(fit)", must, received, remedy)
    begun = start | {one.key: one.start for one in unknowns}
    rows = [
        Reading(name, *map(float, numbers))
        for table, one in zip(tables, found.tables, strict=True)
        for name, *numbers in zip(table.rows, one.measured, one.before, one.after, strict=True)
    ]
    fitted = f"fitted: {', '.join(names)}; all else as given"
    return Calibration(
        start | found.values,
        begun,
        names,
        found.covariance,
        found.misfit,
        found.misfit_before,
        tuple(rows),
        (*rig.stated(), *model_assumptions(moment, lever), fitted, *found.notes),
    )


def _tables(rig: _Rig, lift: LiftReadings | None, positions: PositionReadings | None) -> list[_Table]:
    """The given readings as tables."""
    coils = len(rig.source.coil_names)
    there = [(name, read) for name, read in (("lift", lift), ("positions", positions)) if read is not None]
    must = "must have readings of lift, of positions, or both"
    check(bool(there), "calibrate", must, "none", "pass lift=LiftReadings(...) or positions=...")
    for name, read in there:
        check_positive(f"calibrate({name})", deviation=read.deviation)
        count = len(check_signal(f"calibrate({name}.sensed)", read.sensed))
        check_matrix(f"calibrate({name}.currents)", read.currents, (count, coils))
    tables = []
    if lift is not None:
        rows = tuple(f"lift over weight at {1e3 * z:g} mm" for z in np.asarray(lift.sensed))
        tables.append(_Table("lift", np.ones(len(rows)), lift.deviation, rows, partial(rig.lifts, lift)))
    if positions is not None:
        places = np.asarray(positions.places, dtype=float).reshape(-1, 2)
        if positions.from_first:
            # The first place is 0 by definition, and not a reading.
            places = np.vstack([np.full(2, np.nan), places[1:] - places[0]])
        rows = tuple(f"{'xy'[axis]} of reading {k}" for k, axis in np.argwhere(np.isfinite(places)))
        compute = partial(rig.places, positions)
        tables.append(_Table("positions", places.ravel(), positions.deviation, rows, compute))
    return tables


def _free(fit: Sequence[str], gains: tuple[str, ...]) -> tuple[str, ...]:
    """Names of the free parameters."""
    wanted = [fit] if isinstance(fit, str) else list(fit)
    unknown = [name for name in wanted if name not in (*PARAMETERS, "gains")]
    each_once = bool(wanted) and not unknown and len(set(wanted)) == len(wanted)
    fits = each_once and not {"gains", "current_scale"} <= set(wanted)
    must = f"must name, each once, some of {', '.join(PARAMETERS)}, gains; not current_scale with gains"
    check(fits, "calibrate(fit)", must, wanted, "the gains hold the current scale")
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
    widest = np.array([offset if name == "magnet_offset" else (0.05, 20.0) for name in names])
    asked = np.array([limits.get(name, (-np.inf, np.inf)) for name in names])
    return np.array([np.maximum(widest, asked)[:, 0], np.minimum(widest, asked)[:, 1]])


def _start(gains: tuple[str, ...], payload: Payload, given: Mapping[str, float] | None) -> dict[str, float]:
    start = {"field_scale": 1.0, "magnet_offset": payload.magnet_offset, "current_scale": 1.0}
    start |= dict.fromkeys(gains, 1.0)
    must = f"must be finite values of {', '.join(start)}"
    for name, value in (given or {}).items():
        fits = name in start and bool(np.isfinite(value))
        check(fits, "calibrate(given)", must, f"{name} = {value}", "choose from these")
        start[name] = float(value)
    return start


def _gains(values: Mapping[str, float], count: int) -> Array:
    gains = [value for name, value in values.items() if name.startswith("gain ")]
    return values["current_scale"] * (np.array(gains) if gains else np.ones(count))
