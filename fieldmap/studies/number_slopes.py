"""Exact derivatives of the numbers of a study by the variables of a design, from the adjoint of the solved state.

A number Q of an operating point depends on a variable p through the field at fixed places, through the currents, and
through the place of the equilibrium. With the common current i, F_z the lift at the place where the payload is carried,
F and K force and stiffness at the equilibrium x,

    di/dp = -F_z,p / F_z,i,      dx/dp = K^-1 (F_p + F_i di/dp),      dQ/dp = Q_p + Q_i di/dp + Q_x dx/dp,

where the subscripts p and i are derivatives at fixed places, one adjoint for each number (`SolvedState.derivative`),
and Q_x is a difference in the solved field. The equilibrium area, half the integral of r^2 over the angle with
|F_h(x + r e)| = f m g, changes by the integral of r dr, dr = -d|F_h| / (d|F_h|/dr).
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Any

import numpy as np

from fieldmap.device.changes import changed
from fieldmap.device.model import Device
from fieldmap.device.reader import device_of
from fieldmap.errors import InputError
from fieldmap.field import STEP, as_field
from fieldmap.inputs.document import Document
from fieldmap.iron import LinearSolution
from fieldmap.iron.sensitivity.changes import Change, Parameters
from fieldmap.iron.sensitivity.quantities import (
    DipoleForce,
    FieldFunction,
    FluxDensityAt,
    FluxLinkage,
    GradientAt,
    Quantity,
    Samples,
    Weights,
)
from fieldmap.levitation.balance import dipole_force
from fieldmap.records import Record
from fieldmap.studies.design import CURRENT, Number, Variable, settings_at
from fieldmap.studies.equilibrium_area import area_outline
from fieldmap.studies.quantities import NEED_PAYLOAD, Places
from fieldmap.studies.variant_result import OperatingPoint, box_grid, inhomogeneities, winding_resistances
from fieldmap.typing import Array

# Step of central differences in the solved field, m.
_APART = 2e-5
# Largest step on the outline of the equilibrium area, as a share of its radius.
_SHARE = 1e-2


class VariedParameters(Parameters):
    """The variables of a design at their values, with the keys that depend on them, as parameters of `derivatives`."""

    def __init__(
        self, device: Device, document: Document, variables: tuple[Variable, ...], values: Mapping[str, float]
    ) -> None:
        super().__init__(device)
        self._base, self._variables, self._values = document, variables, dict(values)
        self._changes: dict[tuple[str, float | None], Change] = {}

    def value(self, key: str) -> float:
        """The value of a variable."""
        return self._values[key]

    def change(self, key: str, step: float | None = None) -> Change:
        """The changes of the device with a variable, cached."""
        if (key, step) not in self._changes:
            self._changes[key, step] = super().change(key, step)
        return self._changes[key, step]

    def _with(self, key: str, value: float) -> Device:
        settings = settings_at(self._variables, self._values | {key: value})
        return device_of(changed(self._base, settings), written=False)


@dataclass(frozen=True, repr=False)
class Slopes(Record):
    """by: derivatives by label of the number and key of the variable. refused: keys without an exact one, and why."""

    by: Mapping[str, Mapping[str, float]]
    refused: Mapping[str, str]


def exact_slopes(
    point: OperatingPoint,
    numbers: Iterable[Number],
    places: Places,
    parameters: VariedParameters,
    keys: tuple[str, ...],
) -> Slopes:
    """Exact derivatives of those numbers at this point that have them. places: of all numbers by name. Raises
    FieldmapError if the state has no derivatives."""
    work = _Slopes(point, parameters)
    found = {number.label: _rule(work, number, places) for number in numbers}
    rules = {label: rule for label, rule in found.items() if rule is not None}
    if not rules:
        return Slopes({}, {})
    work.take(keys)
    by = {label: dict(zip(work.keys, map(float, rule()), strict=True)) for label, rule in rules.items()}
    return Slopes(by, work.refused)


def _rule(work: _Slopes, number: Number, places: Places) -> Callable[[], Array] | None:
    """The function that gives the derivatives (k,) of a number after `take`; None for a number without exact ones."""
    payload = work.point.device.payload
    pieces = payload is not None and bool(payload.pieces)
    if pieces and work.carries:
        return None
    if number.of is not None:
        if not isinstance(number.of, Quantity):
            return None
        part = number.label
        work.need(part, number.of)
        return lambda: work.total(part)[0]
    quantity, at = places[number.name]
    if pieces and quantity.group in NEED_PAYLOAD:
        return None
    make = _RULES.get(quantity.name)
    return None if make is None else make(work, at)


class _Stacked(Quantity):
    """Several quantities as one. sizes: numbers of values of each of them, known after a call of `weights`."""

    def __init__(self, parts: tuple[Quantity, ...]) -> None:
        self._parts = parts
        self.sizes: list[int] = []
        # Only what the parts use: linkages in air take a second for each pair of coils.
        self.uses = tuple(dict.fromkeys(use for part in parts for use in part.uses))  # type: ignore[misc]
        ends = np.cumsum([0, *(len(part.points) for part in parts)]).tolist()
        self._where = [slice(a, b) for a, b in itertools.pairwise(ends)]

    @property
    def points(self) -> Array:
        """Points (n, 3) of all, m."""
        return np.concatenate([np.zeros((0, 3)), *(part.points for part in self._parts)])

    def of(self, samples: Samples) -> Array:
        """Values (k,) of all."""
        return np.concatenate([np.ravel(part.of(own)) for part, own, _ in self._each(samples)])

    def weights(self, samples: Samples) -> Weights:
        """Derivatives by the samples; each quantity depends only on the samples at its own points."""
        found = []
        for part, samples_of_part, where in self._each(samples):
            own = part.weights(samples_of_part)
            field = np.zeros((len(own.field), *samples.field.shape))
            gradient = np.zeros((len(own.field), *samples.gradient.shape))
            field[:, where], gradient[:, where] = own.field, own.gradient
            found.append(Weights(field, gradient, own.linkage))
        self.sizes = [len(one.field) for one in found]
        names = ("field", "gradient", "linkage")
        return Weights(*(np.concatenate([getattr(one, name) for one in found]) for name in names))

    def _each(self, samples: Samples) -> Iterator[tuple[Quantity, Samples, slice]]:
        for part, where in zip(self._parts, self._where, strict=True):
            field, gradient = samples.field[where], samples.gradient[where]
            yield part, replace(samples, field=field, gradient=gradient), where


class _Slopes:
    """Derivatives at an operating point: quantities are noted first (`need`), then derived in one call (`take`)."""

    def __init__(self, point: OperatingPoint, parameters: VariedParameters) -> None:
        self.point, self.parameters = point, parameters
        self.keys: tuple[str, ...] = ()
        self.refused: dict[str, str] = {}
        self._parts: dict[str, Quantity] = {}
        self._by_key: dict[str, Array] = {}
        self._by_level: dict[str, Array] = {}
        self._by_place: dict[str, Array] = {}
        if self.carries and not point.payload.pieces:
            self.need("lift", DipoleForce(np.array(point.entry.carried_at), point.payload.moment_vector))

    @property
    def carries(self) -> bool:
        """Whether the currents are computed to carry the payload."""
        return self.point.entry.common is None

    def need(self, name: str, quantity: Quantity, by_place: Callable[[], Array] | None = None) -> None:
        """Note a quantity. by_place: its derivative (n, 3) by the place of the equilibrium, if it depends on that."""
        self._parts.setdefault(name, quantity)
        if by_place is not None and name not in self._by_place:
            self._by_place[name] = by_place()

    def need_place(self) -> None:
        """Note the force at the equilibrium, from which the motion of the equilibrium follows."""
        found = self.point.equilibrium()
        self.need("balance", DipoleForce(found.position, found.moment))

    def take(self, keys: tuple[str, ...]) -> None:
        """Derivatives of all noted quantities by these keys. Keys without exact ones are refused with the reason."""
        point = self.point
        state: Any = point.iron.field.at(point.currents)
        self._refuse_other_changes(keys)
        self.keys = tuple(key for key in keys if key not in self.refused)
        if not self._parts:
            return
        coils = [f"{CURRENT}{name}" for name in point.device.coil_names]
        stacked = _Stacked(tuple(self._parts.values()))
        while True:
            left = tuple(key for key in keys if key not in self.refused)
            asked = tuple(dict.fromkeys((*left, *coils)))
            try:
                found = state.origin.derivative(state, stacked, asked, self.parameters)
                break
            except InputError as error:
                refused = {f"derivative, {key}": key for key in left}
                named = [one for one in error.problems if one.where in refused]
                if not named:
                    raise
                self.refused |= {refused[one.where]: f"{one.must_hold}: {one.received}" for one in named}
        self.keys = left
        every = np.array([found[key].ravel() for key in asked])
        by_key = every[: len(left)].T * self._followed
        by_level = point.entry.shares @ every[[asked.index(coil) for coil in coils]]
        ends = np.cumsum(stacked.sizes)[:-1]
        self._by_key = dict(zip(self._parts, np.split(by_key, ends), strict=True))
        self._by_level = dict(zip(self._parts, np.split(by_level, ends), strict=True))

    def _refuse_other_changes(self, keys: tuple[str, ...]) -> None:
        """Refuse variables that change payload, workspace or driver, on which the derivatives do not depend."""
        for key in keys:
            change = self.parameters.change(key)
            other = [name for name in ("payload", "workspace", "driver") if change.has(name)]
            if other:
                self.refused[key] = f"it changes the {' and the '.join(other)}"

    @property
    def _followed(self) -> Array:
        """1 for each key (k,); 0 for a current, if the currents are computed to carry the payload."""
        return np.array([not (self.carries and key.startswith(CURRENT)) for key in self.keys], dtype=float)

    @cached_property
    def level(self) -> Array:
        """Derivatives (k,) of the common current."""
        if not self.carries:
            return np.zeros(len(self.keys))
        lift = self._by_key["lift"][2]
        return -lift / self._by_level["lift"][2]

    @cached_property
    def currents(self) -> Array:
        """Derivatives (c, k) of the currents."""
        changes = [self.parameters.change(key).currents for key in self.keys]
        varied = np.array(changes).reshape(-1, len(self.point.currents))
        return varied.T * self._followed + np.outer(self.point.entry.shares, self.level)

    @cached_property
    def place(self) -> Array:
        """Derivatives (3, k) of the place of the equilibrium."""
        force = self._by_key["balance"] + np.outer(self._by_level["balance"], self.level)
        return np.asarray(np.linalg.solve(self._stiffness(), force), dtype=float)

    def _stiffness(self) -> Array:
        """-dF/dx (3, 3) at the equilibrium, with a shorter step of differences than the recorded stiffness."""
        found = self.point.equilibrium()
        steps = _APART * np.eye(3)
        where = np.concatenate([found.position + steps, found.position - steps])
        force = dipole_force(found.moment, self.point.iron.field.gradient(where, self.point.currents))
        return -(force[:3] - force[3:]).T / (2 * _APART)

    def total(self, name: str) -> Array:
        """Total derivatives (n, k) of a quantity, with the changes of currents and place."""
        out = self._by_key[name] + np.outer(self._by_level[name], self.level)
        return out + self._by_place[name] @ self.place if name in self._by_place else out

    def resistances(self) -> Array:
        """Derivatives (c, k) of the resistances of the windings."""
        columns = [self.parameters.change(key).slope(winding_resistances) for key in self.keys]
        return np.array(columns).reshape(-1, len(self.point.currents)).T


Rule = Callable[[], Array]


def _common_current(work: _Slopes, at: tuple[int, ...]) -> Rule:
    signs = np.sign(work.point.currents)
    return lambda: signs @ work.currents / len(signs)


def _current(work: _Slopes, at: tuple[int, ...]) -> Rule:
    return lambda: work.currents[at[0]]


def _power(work: _Slopes, at: tuple[int, ...]) -> Rule:
    i, r = work.point.currents, winding_resistances(work.point.device)
    return lambda: 2 * (r * i) @ work.currents + i**2 @ work.resistances()


def _at_point(work: _Slopes, at: tuple[int, ...], kind: Callable[[Array], Quantity]) -> Rule:
    name, entry = f"{kind} {at[0]}", np.ravel_multi_index(at[1:], (3,) * len(at[1:]))
    work.need(name, kind(work.point.record.points[at[0]]))
    return lambda: work.total(name)[entry]


def _force_per_ampere(work: _Slopes, at: tuple[int, ...]) -> Rule | None:
    """F / i, for fields that are proportional to the currents."""
    point = work.point
    if not as_field(point.iron.field).proportional:
        return None
    name, k = f"force {at[0]}", at[1]
    force = DipoleForce(point.record.points[at[0]], point.payload.moment_vector)
    work.need(name, force)
    gradient = point.iron.field.gradient(force.points, point.currents)
    value = dipole_force(np.array(force.moment), gradient)[0, k]
    signs = np.sign(point.currents) / len(point.currents)
    return lambda: (work.total(name)[k] - value / point.common * (signs @ work.currents)) / point.common


class _Inhomogeneities(Quantity):
    """`inhomogeneities` of the field at hundreds of points, for each of which differences would take two calls."""

    uses = ("field",)

    def __init__(self, points: Array) -> None:
        self._points = points

    @property
    def points(self) -> Array:
        """Points (n, 3), m."""
        return self._points

    def of(self, samples: Samples) -> Array:
        """Root mean square and largest inhomogeneity."""
        return np.array(inhomogeneities(samples.field))

    def weights(self, samples: Samples) -> Weights:
        """In closed form; zero for a uniform field, at which both have a kink."""
        count, mean = len(samples.field), samples.field.mean(axis=0)
        apart = samples.field - mean
        sizes = np.linalg.norm(apart, axis=1)
        level, rms, far = np.linalg.norm(mean), np.sqrt(np.mean(sizes**2)), int(np.argmax(sizes))
        field = np.zeros((2, count, 3))
        if rms > 0.0:
            field[0] = apart / (count * rms * level) - rms * mean / (count * level**3)
            towards = apart[far] / (sizes[far] * level)
            field[1] = -towards / count - sizes[far] * mean / (count * level**3)
            field[1, far] += towards
        return Weights(field, np.zeros((2, count, 3, 3)), np.zeros((2, len(samples.linkage))))


def _homogeneity(work: _Slopes, at: tuple[int, ...], place: int) -> Rule:
    corners = work.point.record.box
    assert corners is not None
    work.need("homogeneity", _Inhomogeneities(box_grid(corners)))
    return lambda: work.total("homogeneity")[place]


def _equilibrium(work: _Slopes, at: tuple[int, ...], axis: int) -> Rule:
    work.need_place()
    return lambda: work.place[axis]


def _stiffness(work: _Slopes, at: tuple[int, ...], axis: int) -> Rule:
    work.need_place()
    found = work.point.equilibrium()
    about = STEP * np.concatenate([np.eye(3), -np.eye(3)])

    def diagonal(field: Any, position: Array) -> Array:
        force = dipole_force(found.moment, field.gradient(position + about))
        return -(force[range(3), range(3)] - force[range(3, 6), range(3)]) / (2 * STEP)

    def by_place() -> Array:
        state = work.point.iron.field.at(work.point.currents)
        ahead, behind = (
            [diagonal(state, found.position + side * step) for step in _APART * np.eye(3)] for side in (1, -1)
        )
        return (np.array(ahead) - np.array(behind)).T / (2 * _APART)

    work.need("stiffness", FieldFunction(lambda field: diagonal(field, found.position)), by_place)
    return lambda: work.total("stiffness")[axis]


def _area(work: _Slopes, at: tuple[int, ...]) -> Rule:
    point = work.point
    work.need_place()
    found = point.equilibrium()
    radii, rays = area_outline(point.field, found, point.payload, point.record.force_share)
    outline = np.tile(found.position, (len(radii), 1))
    outline[:, :2] += radii[:, None] * rays
    state = point.iron.field.at(point.currents)

    def sizes(field: Any, points: Array) -> Array:
        return np.linalg.norm(dipole_force(found.moment, field.gradient(points))[:, :2], axis=1)

    # The steps stay away from the equilibrium, where the magnitude of the force has no derivative.
    apart = min(_APART, _SHARE * float(radii.min()))
    steps = apart * np.eye(3)
    by_step = np.array([sizes(state, outline + step) - sizes(state, outline - step) for step in steps]).T
    by_step /= 2 * apart
    outward = np.einsum("nd,nd->n", by_step[:, :2], rays)
    share = -2 * np.pi / len(radii) * radii / outward
    summed = FieldFunction(lambda field: np.array([share @ sizes(field, outline)]))
    work.need("area", summed, lambda: (share @ by_step)[None])
    return lambda: work.total("area")[0]


def _inductance(work: _Slopes, at: tuple[int, ...]) -> Rule | None:
    """For linear iron: the linkage of one coil at one ampere in the other."""
    field, names = work.point.iron.field, work.point.device.coil_names
    if not isinstance(field, LinearSolution) or not field.proportional:
        return None
    linkage = FluxLinkage(names[at[0]])
    work.need(f"linkage {at[0]}", linkage)
    state: Any = field.at(np.eye(len(names))[at[1]])

    def slopes() -> Array:
        keys = [key for key in work.keys if not key.startswith(CURRENT)]
        found = state.origin.derivative(state, linkage, keys, work.parameters)
        return np.array([float(found[key]) if key in keys else 0.0 for key in work.keys])

    return slopes


_RULES: dict[str, Callable[[_Slopes, tuple[int, ...]], Rule | None]] = {
    "common_current": _common_current,
    "current": _current,
    "power": _power,
    "flux_density": partial(_at_point, kind=FluxDensityAt),
    "gradient": partial(_at_point, kind=GradientAt),
    "force_per_ampere": _force_per_ampere,
    "inhomogeneity": partial(_homogeneity, place=0),
    "largest_inhomogeneity": partial(_homogeneity, place=1),
    **{f"equilibrium_{axis}": partial(_equilibrium, axis=k) for k, axis in enumerate("xyz")},
    **{f"stiffness_{axis}": partial(_stiffness, axis=k) for k, axis in enumerate("xyz")},
    "equilibrium_area": _area,
    "inductance": _inductance,
}
