"""Laws that no iron follows are refused before they are used: a device made in Python has passed no reader."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.constants import mu_0
from scipy.interpolate import CubicHermiteSpline, PchipInterpolator

from fieldmap.device.marrocco import marrocco_end, marrocco_field
from fieldmap.device.model import (
    Arctangent,
    BHTable,
    FluxBarrier,
    Froehlich,
    Marrocco,
    Material,
    SaturatingMaterial,
)
from fieldmap.errors import InputError, Problem
from fieldmap.kernels.iron.magnetisation_law import flux_densities
from fieldmap.typing import Array

# Device files are held to the slope of free space. Here stands what the solver bears: formulas in B, such as the law of
# tests/reference/axisymmetric_saturated.csv, dip to 0.62 of it.
_SMALLEST_SLOPE = 0.5 * mu_0


def require_physical(material: SaturatingMaterial) -> None:
    """Raise InputError unless dB/dH is nowhere below that of free space and the polarisation ends somewhere."""
    if isinstance(material, BHTable):
        fault = _table_fault(material)
    elif isinstance(material, Marrocco):
        constants = material.eps, material.c, material.alpha, material.tau
        positive = 0 < material.eps < 1 and material.alpha >= 1 and material.tau > 0
        finite = positive and np.isfinite(marrocco_end(*constants))
        text = "the slope dB/dH must be positive and fall to that of free space"
        fault = None if finite else (text, f"eps, c, alpha, tau = {constants}")
    else:
        sound = material.mu_r > 1 and 0 < material.saturation < np.inf
        text = "mu_r must be above 1 and the saturation polarisation a finite number above 0"
        fault = None if sound else (text, f"mu_r = {material.mu_r}, saturation = {material.saturation}")
    if fault is not None:
        where = f"material '{material.name}'"
        raise InputError(Problem(where, *fault, "correct the law; docs/device_files.md describes them"))


def _table_fault(material: BHTable) -> tuple[str, str] | None:
    h, b = (np.asarray(values, dtype=float) for values in (material.h, material.b))
    if h.ndim != 1 or h.shape != b.shape or len(h) < 2 or not np.isfinite([h, b]).all():
        return "H and B must be as many finite numbers, two at least", f"shapes {h.shape} and {b.shape}"
    steps = np.diff(h, prepend=0.0)
    if (steps <= 0).any():
        return "H must be strictly increasing from above 0", f"{h[np.argmax(steps <= 0)]:g} A/m out of order"
    slope = np.diff(b, prepend=0.0) / steps
    if (slope < _SMALLEST_SLOPE).any():
        k = int(np.argmax(slope < _SMALLEST_SLOPE))
        text = "the slope dB/dH must nowhere be below that of free space, mu0 = 1.2566e-6 T m/A"
        return text, f"{slope[k]:.4g} T m/A up to point {k + 1}"
    if material.saturation is not None:
        polarisation = b[-2:] - mu_0 * h[-2:]
        if not polarisation[0] < polarisation[1] < material.saturation:
            text = "B - mu0 H must rise at the table's end and end below the saturation polarisation"
            return text, f"{polarisation[0]:.4g} and {polarisation[1]:.4g} T before {material.saturation:g} T"
    return None


Pieces = tuple[Array, Array]
# Analytic laws are sampled where chi mu0 H / saturation has these values: at the last, J is saturated to 1e-7.
_SAMPLES = np.concatenate([[0.0], np.geomspace(1e-3, 1e7, 240)])
_MARROCCO_SAMPLES = 600


@dataclass(frozen=True, eq=False)
class LawTables:
    """Piecewise cubics of several laws, see `fieldmap.kernels.iron.magnetisation_law`; h and b in tesla.

    offset (l + 1,), knots (k,), coefficients (k, 4); range_h (2, l): mu0 H of the first and last point of the table.
    For a formula the first is infinite, and the last is where it ends; infinite where it holds everywhere.
    """

    offset: NDArray[np.int64]
    knots: Array
    coefficients: Array
    range_h: Array

    @property
    def arrays(self) -> tuple[NDArray[np.int64], Array, Array]:
        """The tables in the order in which the kernels take them."""
        return self.offset, self.knots, self.coefficients

    def flux_density(self, h: Array, law: NDArray[np.int64]) -> Array:
        """b (n,) at h (n,) >= 0 for the laws (n,)."""
        return flux_densities(h, law, *self.arrays)


def law_tables(materials: Sequence[Material], mu_r: float | None = None) -> LawTables:
    """Tables of the laws of materials, in their order. `mu_r` replaces the law of soft iron by a constant."""
    pieces = [_law(material, mu_r) for material in materials]
    offset = np.concatenate([[0], np.cumsum([len(knots) for knots, _, _ in pieces])]).astype(np.int64)
    return LawTables(
        offset,
        np.concatenate([knots for knots, _, _ in pieces]),
        np.ascontiguousarray(np.concatenate([c for _, c, _ in pieces])),
        np.array([limits for _, _, limits in pieces]).T,
    )


def _law(material: Material, mu_r: float | None) -> tuple[Array, Array, tuple[float, float]]:
    if isinstance(material, FluxBarrier):
        raise TypeError("a flux barrier has no B(H) law")
    if isinstance(material, SaturatingMaterial) and mu_r is None:
        knots, coefficients = saturating_law(material)
        return knots, coefficients, law_range(material)
    slope = mu_r if isinstance(material, SaturatingMaterial) or mu_r is not None else material.mu_r
    return np.zeros(1), np.array([[0.0, 0.0, slope, 0.0]]), (np.inf, np.inf)


def law_range(material: SaturatingMaterial) -> tuple[float, float]:
    """mu0 H in T where the law's own points or formula begin and end; see `LawTables.range_h`."""
    if isinstance(material, BHTable):
        return mu_0 * float(material.h[0]), mu_0 * float(material.h[-1])
    if isinstance(material, Marrocco):
        constants = material.eps, material.c, material.alpha, material.tau
        return np.inf, marrocco_field(marrocco_end(*constants), *constants)
    return np.inf, np.inf


def saturating_law(material: SaturatingMaterial) -> Pieces:
    """Knots (k,) and coefficients (k, 4) of b(h), in T. Raises InputError for a law that no iron follows."""
    require_physical(material)
    if isinstance(material, BHTable):
        return _table_law(material)
    if isinstance(material, Marrocco):
        return _marrocco_law(material)
    field = _SAMPLES * material.saturation / (material.mu_r - 1)
    if isinstance(material, Froehlich):
        polarisation = material.saturation * _SAMPLES / (1 + _SAMPLES)
        slope = (material.mu_r - 1) / (1 + _SAMPLES) ** 2
    else:
        assert isinstance(material, Arctangent)
        polarisation = material.saturation * 2 / np.pi * np.arctan(0.5 * np.pi * _SAMPLES)
        slope = (material.mu_r - 1) / (1 + (0.5 * np.pi * _SAMPLES) ** 2)
    return _pieces(field, polarisation, slope)


def _pieces(field: Array, polarisation: Array, slope: Array) -> Pieces:
    """Cubics through points of J with given slopes dJ/dh, limited so that J never falls; beyond the last, J stays."""
    secant = np.diff(polarisation) / np.diff(field)
    slope = np.maximum(slope, 0.0)
    # Fritsch and Carlson: monotone if no end slope of a piece exceeds three times its secant.
    slope[:-1] = np.minimum(slope[:-1], 3 * np.maximum(secant, 0.0))
    slope[1:] = np.minimum(slope[1:], 3 * np.maximum(secant, 0.0))
    coefficients = np.zeros((len(field), 4))
    coefficients[:-1] = CubicHermiteSpline(field, polarisation, slope).c.T
    coefficients[-1, 3] = polarisation[-1]
    coefficients[:, 2] += 1.0
    coefficients[:, 3] += field
    return field, coefficients


def _marrocco_law(material: Marrocco) -> Pieces:
    constants = material.eps, material.c, material.alpha, material.tau
    b = np.linspace(0.0, marrocco_end(*constants), _MARROCCO_SAMPLES)
    power = b ** (2 * material.alpha)
    s = power / (power + material.tau)
    span = material.c - material.eps
    field = (material.eps + span * s) * b
    reluctivity = material.eps + span * s * (1 + 2 * material.alpha * (1 - s))
    return _pieces(field, b - field, 1 / reluctivity - 1)


def _table_law(material: BHTable) -> Pieces:
    """A table begins with a straight line from the origin, and ends saturated or on its way there."""
    field = mu_0 * np.concatenate([[0.0], material.h])
    polarisation = np.concatenate([[0.0], material.b]) - field
    secant = np.diff(polarisation) / np.diff(field)
    tail = _tail(field, polarisation, material.saturation)
    # With the continuation the slope at the last point is known: dB/dH has no jump there.
    beyond = np.append(field, 2 * field[-1]), np.append(polarisation, _tail_value(2 * field[-1], tail))
    slope = PchipInterpolator(*beyond).derivative()(field)
    # The stated straight line to the origin, as far as monotony of the next piece allows (Fritsch and Carlson).
    slope[0] = secant[0]
    slope[1] = min(secant[0], 3 * secant[1]) if len(secant) > 1 else secant[0]
    if tail.slope == 0:
        return _pieces(field, polarisation, slope)
    slope[-1] = tail.slope
    x = _SAMPLES[1:] * tail.rest / tail.slope
    return _pieces(
        np.concatenate([field, field[-1] + x]),
        np.concatenate([polarisation, _tail_value(field[-1] + x, tail)]),
        np.concatenate([slope, tail.slope / (1 + tail.slope * x / tail.rest) ** 2]),
    )


@dataclass(frozen=True)
class _Tail:
    """Past a table's end, at field h0 and polarisation saturation - rest: J = saturation - rest/(1 + slope x/rest)."""

    start: float
    saturation: float
    rest: float
    slope: float


def _tail(field: Array, polarisation: Array, saturation: float | None) -> _Tail:
    """The hyperbola through the last two points that ends at the saturation; a constant where none is given."""
    end = float(polarisation[-1])
    if saturation is None:
        return _Tail(float(field[-1]), end, 0.0, 0.0)
    rest = saturation - end
    secant = (end - polarisation[-2]) / (field[-1] - field[-2])
    return _Tail(float(field[-1]), saturation, rest, float(secant * rest / (saturation - polarisation[-2])))


def _tail_value(h: Array, tail: _Tail) -> Array:
    if tail.slope == 0:
        return np.full(np.shape(h), tail.saturation)
    return tail.saturation - tail.rest / (1 + tail.slope * (h - tail.start) / tail.rest)


def _by_law(tables: LawTables, law: NDArray[np.int64], h: Array) -> Iterator[tuple[Any, ...]]:
    """For each law: which h are its own, its knots and coefficients, and in which piece these h lie."""
    for number in np.unique(law):
        mine = law == number
        piece = slice(tables.offset[number], tables.offset[number + 1])
        knots = tables.knots[piece]
        j = np.clip(np.searchsorted(knots, h[mine], side="right") - 1, 0, len(knots) - 1)
        yield mine, knots, tables.coefficients[piece], j


def law_values(tables: LawTables, law: NDArray[np.int64], h: Array) -> tuple[Array, Array]:
    """Flux density b (e,) in T and int_0^h b dh (e,) in T^2 at mu0 H = h (e,) for laws with these numbers (e,)."""
    b, stored = np.empty_like(h), np.empty_like(h)
    for mine, knots, c, j in _by_law(tables, law, h):
        at_knots = np.concatenate([[0.0], np.cumsum(_integral(c[:-1], np.diff(knots)))])
        t = h[mine] - knots[j]
        b[mine] = ((c[j, 0] * t + c[j, 1]) * t + c[j, 2]) * t + c[j, 3]
        stored[mine] = at_knots[j] + _integral(c[j], t)
    return b, stored


def law_slopes(tables: LawTables, law: NDArray[np.int64], h: Array) -> tuple[Array, Array]:
    """Chord b/h and slope db/dh (e,) at mu0 H = h (e,); at h = 0 both are the initial slope."""
    chord, slope = np.empty_like(h), np.empty_like(h)
    for mine, knots, c, j in _by_law(tables, law, h):
        t = h[mine] - knots[j]
        slope[mine] = (3 * c[j, 0] * t + 2 * c[j, 1]) * t + c[j, 2]
        b = ((c[j, 0] * t + c[j, 1]) * t + c[j, 2]) * t + c[j, 3]
        chord[mine] = np.divide(b, h[mine], out=slope[mine], where=h[mine] > 1e-30)
    return chord, slope


def _integral(c: Array, t: Array) -> Array:
    """Integral from 0 to t of the cubics c (k, 4)."""
    return (((c[:, 0] / 4 * t + c[:, 1] / 3) * t + c[:, 2] / 2) * t + c[:, 3]) * t


def initial_mu_r(material: SaturatingMaterial) -> float:
    """Relative permeability at H = 0."""
    return (
        1 / material.eps
        if isinstance(material, Marrocco)
        else (material.initial_mu_r if isinstance(material, BHTable) else material.mu_r)
    )


def law_words(material: SaturatingMaterial) -> str:
    """The law in words: its kind, the range in which it holds, and what holds outside."""
    if isinstance(material, BHTable):
        rises = "" if material.saturation is None else f" ({material.saturation:g} T)"
        return (
            f"single-valued B-H table, {material.below} below {material.b[0]:g} T, "
            f"{material.above}{rises} above {material.b[-1]:g} T"
        )
    if isinstance(material, Marrocco):
        end = marrocco_end(material.eps, material.c, material.alpha, material.tau)
        return f"Marrocco's formula, initial mu_r {1 / material.eps:g}, up to {end:.3g} T, slope mu0 above"
    kind = "Froehlich-Kennelly" if isinstance(material, Froehlich) else "arctangent"
    return f"{kind} law, initial mu_r {material.mu_r:g}, saturation polarisation {material.saturation:g} T"
