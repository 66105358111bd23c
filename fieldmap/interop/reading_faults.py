"""Faults of measured readings that a fit detects, because no field can have them.

The flux density of coils has neither curl nor divergence. Readings with exchanged components, a wrong sign or an
error of the instrument do not fit harmonic polynomials of any degree.
"""

from collections.abc import Callable
from itertools import permutations, product

import numpy as np

from fieldmap.errors import InputError, Problem
from fieldmap.interop.readings import Measurements
from fieldmap.typing import Array, Index

THINNEST = 1e-3
"""Thickness of the readings, as a share of their width, below which they lie in a plane."""
MOST_WILD = 20
_FAR, _FAR_FROM_OTHERS, _FAR_IN_FIELD = 20.0, 5.0, 0.2
"""Conditions for an outlier: its error exceeds these multiples of the standard error, of the largest other error, and
of the root mean square of all readings."""
_COMPARED = 3000
"""Largest number of readings for comparing orders of the components."""
WORTHLESS = 0.5
"""Share of the readings, by root mean square, that the others do not predict, above which they are not a field."""


def require_volume(measurements: Measurements) -> None:
    """Raise InputError for readings in one plane, which do not determine the field outside this plane."""
    points = measurements.points - measurements.points.mean(axis=0)
    if len(points) < 2:
        return
    _, extent, axes = np.linalg.svd(points, full_matrices=False)
    if extent[-1] > THINNEST * extent[1]:
        return
    k = int(np.argmax(np.abs(axes[-1])))
    flat = np.abs(axes[-1][k]) > 1 - 1e-6
    plane = (
        f"{'xyz'[k]} = {measurements.points[:, k].mean():g} m"
        if flat
        else f"one across {axes[-1].round(4).tolist()}"
    )
    remedy = "measure at least one more plane"
    must_hold, received = "readings that fill a volume", f"{len(points)} readings in the plane {plane}"
    raise InputError.of(measurements.source or "fit_map", must_hold, received, remedy)


def refuse_faults(
    measurements: Measurements, design: Array, missed: Array, finer: Callable[[Index], Array]
) -> None:
    """Raise InputError for outliers, with their lines, for exchanged components, and for readings of no field.

    design (3 n, m): equations of the readings, columns of length 1. missed (n, 3): errors of readings predicted by
    fits without them, T. finer: equations of some of the readings for a field of higher degree than the fit.
    """
    wild = _wild(design, measurements.flux_density, missed)
    if wild.size:
        rest = np.delete(missed, wild, axis=0)
        raise InputError(
            *(
                Problem(
                    measurements.where(k),
                    f"a reading that the others predict, to about {np.sqrt(np.mean(rest**2)):.2g} T",
                    f"{measurements.flux_density[k].tolist()} T, {np.abs(missed[k]).max():.2g} T from it",
                    "correct or remove the line; a source so near that no other reading sees it cannot be fitted",
                )
                for k in wild.tolist()
            )
        )
    size = float(np.sqrt(np.mean(measurements.flux_density**2)))
    share = float(np.sqrt(np.mean(missed**2))) / max(size, 1e-300)
    some = np.random.default_rng(0).permutation(len(missed))[:_COMPARED]
    cause = _exchanged(finer(some), measurements.flux_density[some])
    if cause or share > WORTHLESS:
        worst = int(np.argmax(np.abs(missed).max(axis=1)))
        must_hold = "readings of a field without curl and divergence, which the others predict"
        received = f"{100 * share:.3g} % of them are not predicted, most at {measurements.where(worst)}"
        remedy = "check the columns, their units, and that every current is listed"
        raise InputError.of(measurements.source or "fit_map", must_hold, received, cause or remedy)


def _wild(design: Array, flux_density: Array, missed: Array) -> Index:
    """The outliers: the smallest set of readings that all differ strongly from the fit to the other readings."""
    order = np.argsort(-np.linalg.norm(missed, axis=1))
    values, squares, sides = flux_density.ravel(), design.T @ design, design.T @ flux_density.ravel()
    ridge = 1e-13 * np.eye(len(squares))
    floor = _FAR_IN_FIELD * float(np.sqrt(np.mean(flux_density**2)))
    for count in range(1, min(MOST_WILD, max(1, len(missed) // 20)) + 1):
        rows = 3 * order[count - 1] + np.arange(3)
        squares = squares - design[rows].T @ design[rows]
        sides = sides - design[rows].T @ values[rows]
        inverse = np.linalg.inv(squares + ridge)
        left = np.abs((values - design @ (inverse @ sides)).reshape(-1, 3)).max(axis=1)
        out, others = order[:count], order[count:]
        free = max(3 * len(others) - len(squares), 1)
        scatter = np.sqrt(np.sum(left[others] ** 2) / free)
        of_out = design.reshape(len(missed), 3, -1)[out]
        spread = 1 + np.einsum("nik,kl,nil->ni", of_out, inverse, of_out).max(axis=1)
        far = left[out] > _FAR * scatter * np.sqrt(spread)
        if (far & (left[out] > _FAR_FROM_OTHERS * left[others].max()) & (left[out] > floor)).all():
            return np.sort(out)
    return np.zeros(0, dtype=np.int64)


def _exchanged(design: Array, flux_density: Array) -> str:
    """A text about the order and signs of the columns of B that make them a field; empty if there are none."""
    basis = np.linalg.qr(design)[0]

    def left(order: tuple[int, ...], signs: tuple[float, ...]) -> float:
        values = (flux_density[:, order] * signs).ravel()
        return float(np.linalg.norm(values - basis @ (basis.T @ values)))

    # A field times -1 is a field too.
    ways = [
        (order, (1.0, *signs)) for order in permutations(range(3)) for signs in product((1.0, -1.0), repeat=2)
    ]
    found = {way: left(*way) for way in ways}
    order, signs = min(found, key=lambda way: found[way])
    if found[order, signs] > 0.2 * found[(0, 1, 2), (1.0, 1.0, 1.0)]:
        return ""
    fewest = -1.0 if sum(signs) < 0 else 1.0
    names = ", ".join(f"{'-' * (fewest * sign < 0)}B{'xyz'[k]}" for k, sign in zip(order, signs, strict=True))
    rest = 100 * found[order, signs] / float(np.linalg.norm(flux_density))
    return f"the columns are a field in the order {names}, which leaves {rest:.2g} % over: correct the header"
