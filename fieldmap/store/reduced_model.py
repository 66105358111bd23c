"""The reduced model of saturating iron as data: a map computes the weights of its fields from it."""

from __future__ import annotations

from dataclasses import dataclass, field, fields

import numpy as np
from numpy.typing import NDArray

from fieldmap.arguments import check
from fieldmap.currents import CurrentDomain, CurrentParametrisation, IndependentCurrents, LiftAndDirections
from fieldmap.records import Record
from fieldmap.typing import Array

INTEGER = ("law", "law_offset")


@dataclass(frozen=True, eq=False, repr=False)
class ReducedModel(Record):
    """Reduced model with r modes, p sample points, c coils and k fields of the iron: docs/theory/current_dependence.md.

    Attributes
    ----------
    gradients : (3 p, r), gradients of the modes at the sample points, T.
    source : (3 p, c), fields of the coils per ampere at the sample points, T.
    weights : (p,), of the sample points, m^3.
    law : (p,), index of the B(H) law of each sample point.
    law_offset, law_knots, law_coefficients : the laws, as in `fieldmap.kernels.iron.magnetisation_law`.
    air, constant : (r, r) and (r,), A and r0 of the theory.
    output : (k, r), weights of the map's iron fields per amplitude.
    known_currents, known_amplitudes : (s, c) and (s, r), of the training states; solves begin at the nearest one. With
        hysteresis there is one state, after the history "shaken"; the paths of the training lie about its currents.
    lower, upper : (d,), domain of the signals of `parametrisation`.
    parametrisation : of the currents.
    reference_weights : (k,), of the iron fields at the map's reference currents.
    fixed : (3 p,), field of the background at the sample points, T; empty if there is none.
    pinning : (l, n), pinning fields of the play cells of each law, T, ascending; empty for iron without hysteresis.
    shares : (n,), of the cells in the polarisation; their sum is 1.

    Raises
    ------
    InputError
        If shapes do not fit together or numbers are not finite.
    """

    gradients: Array
    source: Array
    weights: Array
    law: NDArray[np.int64]
    law_offset: NDArray[np.int64]
    law_knots: Array
    law_coefficients: Array
    air: Array
    constant: Array
    output: Array
    known_currents: Array
    known_amplitudes: Array
    lower: Array
    upper: Array
    parametrisation: CurrentParametrisation
    reference_weights: Array
    fixed: Array = field(default_factory=lambda: np.zeros(0))
    pinning: Array = field(default_factory=lambda: np.zeros((0, 0)))
    shares: Array = field(default_factory=lambda: np.zeros(0))

    def __post_init__(self) -> None:
        flat = (self.weights, self.constant, self.output)
        fits = np.ndim(self.source) == 2 and all(map(np.ndim, flat))
        _check(fits, "source", "coils' fields at points", "arrays of other dimensions")
        p, r, c, k = len(self.weights), len(self.constant), self.coil_count, len(self.output)
        # This check comes before `signal_count` is used: a file may name any number of coils.
        coils = self.parametrisation.coil_count
        _check(coils == c, "parametrisation", f"one of {c} coils", f"one of {coils} coils")
        laws, knots = len(self.law_offset) - 1, len(self.law_knots)
        wanted = {
            "gradients": (3 * p, r),
            "source": (3 * p, c),
            "law": (p,),
            "law_coefficients": (knots, 4),
            "air": (r, r),
            "known_currents": (len(self.known_currents), c),
            "known_amplitudes": (len(self.known_currents), r),
            "output": (k, r),
            "lower": (self.parametrisation.signal_count,),
            "upper": (self.parametrisation.signal_count,),
            "reference_weights": (k,),
            "fixed": (3 * p,) if np.size(self.fixed) else (0,),
            "pinning": (laws, len(self.shares)) if np.size(self.pinning) else (0, 0),
            "shares": (np.shape(self.pinning)[-1],) if np.size(self.pinning) else (0,),
        }
        for name in ARRAYS:
            kind = np.int64 if name in INTEGER else np.float64
            values = np.array(getattr(self, name), dtype=kind)
            shape = wanted.get(name, values.shape)
            _check(values.shape == shape, name, f"shape {shape}", f"shape {values.shape}")
            _check(np.isfinite(values).all(), name, "finite numbers", "NaN or infinity")
            values.flags.writeable = False
            object.__setattr__(self, name, values)
        offset = self.law_offset
        rises = laws >= 1 and offset[0] == 0 and offset[-1] == knots and (np.diff(offset) >= 1).all()
        _check(rises, "law_offset", "rising from 0 to the number of knots", offset.tolist())
        others = np.setdiff1d(self.law, range(laws))
        _check(not others.size, "law", f"numbers of {laws} laws", others.tolist())
        _check(len(self.known_currents), "known_currents", "at least one state", "none")
        _check((self.weights > 0).all(), "weights", "positive", self.weights.min(initial=np.inf))
        rises = (np.diff(self.pinning, axis=1) >= 0.0).all() and (self.pinning >= 0.0).all()
        _check(rises, "pinning", "not negative and ascending", self.pinning.tolist())
        whole = not self.remembers or ((self.shares > 0.0).all() and abs(self.shares.sum() - 1.0) < 1e-9)
        _check(whole, "shares", "positive, with the sum 1", self.shares.tolist())

    @property
    def remembers(self) -> bool:
        """Whether the iron has hysteresis, so that the field depends on earlier currents too."""
        return bool(self.shares.size)

    @property
    def arrays(self) -> dict[str, Array]:
        """All arrays by name."""
        return {name: getattr(self, name) for name in ARRAYS}

    @property
    def domain(self) -> CurrentDomain:
        """Domain of the currents."""
        return CurrentDomain(self.parametrisation, self.lower, self.upper)

    @property
    def division_exponent(self) -> Array:
        """(1,): n of `LiftAndDirections`; (0,) for any other parametrisation."""
        of = self.parametrisation
        return np.array([of.n] if isinstance(of, LiftAndDirections) else [])

    @property
    def coil_count(self) -> int:
        """Number of coils."""
        return int(self.source.shape[1])

    @property
    def field_count(self) -> int:
        """Number of iron fields."""
        return len(self.output)

    @property
    def laws(self) -> tuple[NDArray[np.int64], Array, Array]:
        """The tables of the B(H) laws, in the order of the kernels' arguments."""
        return self.law_offset, self.law_knots, self.law_coefficients


ARRAYS = tuple(one.name for one in fields(ReducedModel) if one.name != "parametrisation")
OPTIONAL = ("fixed", "pinning", "shares")
"""Names of arrays that a file leaves out if they are empty."""


def parametrisation_of(division_exponent: Array, coils: int) -> CurrentParametrisation:
    """The parametrisation that `ReducedModel.division_exponent` states, the only statement in older map files."""
    exponents = np.ravel(division_exponent)
    received = f"{exponents.size} numbers"
    _check(exponents.size <= 1, "division_exponent", "one number or none", received)
    return LiftAndDirections(*exponents.tolist()) if exponents.size else IndependentCurrents(coils)


def _check(holds: object, name: str, must_hold: str, received: object) -> None:
    check(bool(holds), f"reduced model, {name}", must_hold, received, "make the map again")
