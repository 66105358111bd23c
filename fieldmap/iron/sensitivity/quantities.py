"""Quantities, numbers that depend on the field at points of the air and on flux linkages, and their derivatives.

A user's own quantity derives from `Quantity` and gives `points` and `of`; or it is any function of a field,
`FieldFunction`. The derivatives of a quantity by the field at its points are found by differences. These cost no solve
and are exact, up to rounding, for a quantity that is linear in the field.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike

from fieldmap.arguments import check_choice
from fieldmap.field import FieldAtCurrents
from fieldmap.iron.mesh.mesh import checked_points
from fieldmap.records import Record
from fieldmap.typing import Array


@dataclass(frozen=True, eq=False, repr=False)
class Spread(Record):
    """Standard deviation of a quantity, of its shape, and the share of each key in its square, from 0 to 1."""

    deviation: Array
    shares: Mapping[str, Array]


@dataclass(frozen=True, eq=False, repr=False)
class Derivatives(Record):
    """Derivatives of a quantity. value: its numbers, of any shape; by: key path -> derivative of that shape, per unit
    of the key; solves: linear solves that they took."""

    value: Array
    by: Mapping[str, Array]
    solves: int

    def __getitem__(self, key: str) -> Array:
        """The derivative by one key."""
        return self.by[key]

    def change(self, steps: Mapping[str, float]) -> Array:
        """Change of the quantity, to first order.

        Parameters
        ----------
        steps
            Changes of keys in their units.

        Returns
        -------
        Array
            The change, of the quantity's shape and unit.
        """
        return np.asarray(sum(self.by[key] * step for key, step in steps.items()))

    def spread(self, deviations: Mapping[str, float]) -> Spread:
        """Uncertainty of the quantity, to first order, from the uncertainties of keys.

        Parameters
        ----------
        deviations
            Standard deviations of independent numbers by key, in their units.

        Returns
        -------
        Spread
            The deviation, and the share of each key.

        Raises
        ------
        KeyError
            For a key without a derivative.

        Examples
        --------
        >>> found = Derivatives(np.array(5.0), {"a": np.array(3.0), "b": np.array(-2.0)}, 1)
        >>> spread = found.spread({"a": 1.0, "b": 2.0})
        >>> float(spread.deviation), {key: round(float(share), 2) for key, share in spread.shares.items()}
        (5.0, {'a': 0.36, 'b': 0.64})
        """
        parts = {key: (self.by[key] * deviation) ** 2 for key, deviation in deviations.items()}
        variance = np.asarray(sum(parts.values(), start=np.zeros(np.shape(self.value))))
        safe = np.where(variance > 0, variance, 1.0)
        return Spread(np.sqrt(variance), {key: part / safe for key, part in parts.items()})


# Step of differences, as a share of the largest sampled value; steps for samples that are all zero.
_STEP_OF_DIFFERENCES = 1e-5
_NOTHING = {"field": 1e-6, "gradient": 1e-4, "linkage": 1e-6}


@dataclass(frozen=True, eq=False, repr=False)
class Samples(Record):
    """The data that quantities depend on: flux density (n, 3), T, and gradient (n, 3, 3), T/m, at points, and the flux
    linkages (c,) of all coils, Wb, with the coils' names."""

    field: Array
    gradient: Array
    linkage: Array
    coil_names: tuple[str, ...]


@dataclass(frozen=True, eq=False, repr=False)
class Weights(Record):
    """Derivatives of k numbers by the samples: field (k, n, 3), gradient (k, n, 3, 3), linkage (k, c)."""

    field: Array
    gradient: Array
    linkage: Array


class Quantity(ABC):
    """One number, or several of any shape, of a solved state.

    uses: the samples that it depends on, of "field", "gradient", "linkage"; points (n, 3): where it samples, m.
    """

    uses: ClassVar[tuple[str, ...]] = ("field", "gradient")

    @property
    @abstractmethod
    def points(self) -> Array:
        """Points (n, 3) in the air, m; (0, 3) without."""

    @abstractmethod
    def of(self, samples: Samples) -> ArrayLike:
        """The numbers of the quantity.

        Parameters
        ----------
        samples
            Field and gradient at its points.

        Returns
        -------
        ArrayLike
            Numbers of any shape.
        """

    def weights(self, samples: Samples) -> Weights:
        """Derivatives of the numbers, flattened, by the samples, from central differences.

        Parameters
        ----------
        samples
            Field and gradient at its points.

        Returns
        -------
        Weights
            The derivatives.
        """
        parts = {}
        for name in ("field", "gradient", "linkage"):
            here = getattr(samples, name)
            if name not in self.uses:
                count = np.size(self.of(samples))
                parts[name] = np.zeros((count, *here.shape))
                continue
            step = _STEP_OF_DIFFERENCES * float(np.abs(here).max(initial=0.0)) or _NOTHING[name]
            columns = []
            for k in range(here.size):
                change = np.zeros(here.size)
                change[k] = step
                ahead, behind = (
                    np.ravel(self.of(replace(samples, **{name: here + s * change.reshape(here.shape)})))
                    for s in (1, -1)
                )
                columns.append((ahead - behind) / (2 * step))
            parts[name] = np.array(columns).T.reshape(-1, *here.shape)
        return Weights(**parts)


@dataclass(frozen=True, eq=False, repr=False)
class _AtPoints(Quantity, Record):
    """A quantity of the field at points (n, 3) or (3,) of the air, m."""

    at: ArrayLike

    @property
    def points(self) -> Array:
        """Points (n, 3), m."""
        return checked_points(self.at)[0]


@dataclass(frozen=True, eq=False, repr=False)
class FluxDensityAt(_AtPoints):
    """Flux density (n, 3) or (3,), T, at points (n, 3) or (3,) of the air, m."""

    uses = ("field",)

    def of(self, samples: Samples) -> Array:
        """B in the shape of the points."""
        return samples.field.reshape(np.shape(self.at))


@dataclass(frozen=True, eq=False, repr=False)
class GradientAt(_AtPoints):
    """Gradient dB_i/dx_j (n, 3, 3) or (3, 3), T/m, at points (n, 3) or (3,) of the air, m."""

    uses = ("gradient",)

    def of(self, samples: Samples) -> Array:
        """dB_i/dx_j."""
        return samples.gradient.reshape(*np.shape(self.at), 3)


@dataclass(frozen=True, eq=False, repr=False)
class DipoleForce(_AtPoints):
    """Force (n, 3) or (3,), N, on dipoles of fixed moment (3,), A m^2, at points (n, 3) or (3,) of the air, m."""

    uses = ("gradient",)
    moment: ArrayLike

    def of(self, samples: Samples) -> Array:
        """F_j = m_i dB_i/dx_j."""
        force = np.einsum("i,nij->nj", np.asarray(self.moment, dtype=float), samples.gradient)
        return force.reshape(np.shape(self.at))


@dataclass(frozen=True, eq=False, repr=False)
class FluxLinkage(Quantity, Record):
    """Flux linkage of a coil, Wb, by its name; of all coils (c,) without one."""

    uses = ("linkage",)
    coil: str | None = None

    @property
    def points(self) -> Array:
        """No points (0, 3)."""
        return np.zeros((0, 3))

    def of(self, samples: Samples) -> ArrayLike:
        """The linkages. Raises InputError for a coil that the device lacks."""
        if self.coil is None:
            return samples.linkage
        check_choice("FluxLinkage, coil", self.coil, samples.coil_names)
        return samples.linkage[samples.coil_names.index(self.coil)]


@dataclass(frozen=True, eq=False, repr=False)
class FieldFunction(Quantity, Record):
    """Anything that a function computes from the field at the currents of the state: function(field) -> numbers, where
    `field.field(points)` and `field.gradient(points)` are B (n, 3) and dB_i/dx_j (n, 3, 3), and `field.wrench(...)` is
    force and torque on a body, as of a state.

    The function must ask for the field at the same points, in the air, whatever the field is.

    >>> homogeneity = FieldFunction(lambda field: np.ptp(field.field(np.eye(3) * 1e-3)[:, 2]))
    >>> homogeneity.points.shape
    (3, 3)
    """

    function: Callable[[FieldAtCurrents], ArrayLike]

    @property
    def points(self) -> Array:
        """All points (n, 3) that the function asks for, m."""
        return np.concatenate([np.zeros((0, 3)), *self._recorder.asked])

    @property
    def uses(self) -> tuple[str, ...]:  # type: ignore[override]
        """The samples that the function asks for."""
        return tuple(name for name in ("field", "gradient") if name in self._recorder.kinds)

    @cached_property
    def _recorder(self) -> _SampledField:
        recorder = _SampledField(None, None)
        self.function(recorder)
        return recorder

    def of(self, samples: Samples) -> ArrayLike:
        """The function's numbers."""
        return np.asarray(self.function(_SampledField(samples.field, samples.gradient)), dtype=float)


class _SampledField(FieldAtCurrents):
    """A field with samples at the points where it will be asked for, in that order. Without samples it records the
    points."""

    currents = np.zeros(0)

    def __init__(self, field: Array | None, gradient: Array | None) -> None:
        self._field, self._gradient = field, gradient
        self.asked: list[Array] = []
        self.kinds: set[str] = set()
        self._count = 0

    @property
    def coil_names(self) -> tuple[str, ...]:
        """No names: the field is at the currents of the state."""
        return ()

    def field(self, points: ArrayLike) -> Array:
        """B (n, 3) or (3,)."""
        self.kinds.add("field")
        return self._next(points, self._field, (3,))

    def gradient(self, points: ArrayLike) -> Array:
        """dB_i/dx_j (n, 3, 3) or (3, 3)."""
        self.kinds.add("gradient")
        return self._next(points, self._gradient, (3, 3))

    def _next(self, points: ArrayLike, values: Array | None, shape: tuple[int, ...]) -> Array:
        x, single = checked_points(points)
        self.asked.append(x)
        here = slice(self._count, self._count + len(x))
        self._count += len(x)
        # Ones, because a function may divide by the field.
        found = np.ones((len(x), *shape)) if values is None else values[here]
        return found[0] if single else found
