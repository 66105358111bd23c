"""Interpolants of other libraries on the same grid and field, with one common interface.

Libraries of the extra `bench` that are not installed are reported as missing.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fieldmap.store import Grid

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Peer:
    """field(points) -> B (n, 3); both(points) -> B and G (n, 3, 3), if there is a gradient; one(point): B at one."""

    name: str
    field: Callable[[Array], Array]
    both: Callable[[Array], tuple[Array, Array]] | None
    one: Callable[[Array], object]


def scipy_cubic(grid: Grid, flux: Array, _: Callable[[Array], Array]) -> Peer:
    """RegularGridInterpolator, cubic; with its default iterative solver it is 200 times less accurate."""
    from scipy.interpolate import RegularGridInterpolator
    from scipy.sparse.linalg import spsolve

    found = RegularGridInterpolator(grid.axes, flux, method="cubic", bounds_error=False, solver=spsolve)
    return Peer("scipy RegularGridInterpolator cubic", found, None, found)


def interpn_bspline(grid: Grid, flux: Array, _: Callable[[Array], Array]) -> Peer:
    """interpn's cubic B-spline (Rust), one per component."""
    from interpn import MultiBsplineRegular

    start, step = np.array(grid.lower), np.array(grid.spacing)
    parts = [
        MultiBsplineRegular.new(list(grid.shape), start, step, np.ascontiguousarray(flux[..., c]).ravel())
        for c in range(3)
    ]

    def columns(points: Array) -> list[Array]:
        return [np.ascontiguousarray(points[:, a]) for a in range(3)]

    def field(points: Array) -> Array:
        at = columns(points)
        return np.stack([part.eval(at) for part in parts], axis=1)

    def both(points: Array) -> tuple[Array, Array]:
        at = columns(points)
        slope = np.stack([part.eval_grad(at) for part in parts], axis=0)
        return np.stack([part.eval(at) for part in parts], axis=1), slope.transpose(2, 0, 1)

    return Peer("interpn B-spline", field, both, lambda point: field(point[None]))


def econforge_cubic(grid: Grid, flux: Array, _: Callable[[Array], Array]) -> Peer:
    """econforge interpolation.py, cubic splines in numba."""
    from interpolation.splines import CubicSplines
    from interpolation.splines.eval_splines import eval_cubic

    spline = CubicSplines(grid.lower, grid.upper, grid.shape, flux.reshape(-1, 3))
    coefficients = spline.__mcoeffs__
    axes = tuple(zip(grid.lower.tolist(), grid.upper.tolist(), grid.shape, strict=True))

    def both(points: Array) -> tuple[Array, Array]:
        values, slopes = spline.interpolate(points, diff=True)
        return values, slopes.transpose(0, 2, 1)

    return Peer(
        "econforge interpolation cubic",
        spline.interpolate,
        both,
        lambda point: eval_cubic(axes, coefficients, point),
    )


def ndsplines_cubic(grid: Grid, flux: Array, _: Callable[[Array], Array]) -> Peer:
    """ndsplines, cubic."""
    import ndsplines

    spline = ndsplines.make_interp_spline(grid.axes, flux, degrees=3)

    def both(points: Array) -> tuple[Array, Array]:
        slopes = [spline(points, nus=np.eye(3, dtype=int)[a]) for a in range(3)]
        return spline(points), np.stack(slopes, axis=-1)

    return Peer("ndsplines cubic", spline, both, lambda point: spline(point[None]))


def simsopt_quartic(grid: Grid, _: Array, exact: Callable[[Array], Array]) -> Peer:
    """simsopt's piecewise polynomials of degree 4 (C++), cells of four spacings: the same number of nodes."""
    import simsoptpp

    ranges = [(float(grid.lower[a]), float(grid.upper[a]), (grid.shape[a] - 1) // 4) for a in range(3)]
    found = simsoptpp.RegularGridInterpolant3D(simsoptpp.UniformInterpolationRule(4), *ranges, 3, True)

    def sample(x: list[float], y: list[float], z: list[float]) -> list[float]:
        return exact(np.stack([x, y, z], axis=1)).ravel().tolist()

    found.interpolate_batch(sample)

    def field(points: Array) -> Array:
        out = np.empty((len(points), 3))
        found.evaluate_batch(points, out)
        return out

    return Peer("simsopt degree 4", field, None, lambda point: field(point[None]))


MAKERS = {
    "scipy": scipy_cubic,
    "interpn": interpn_bspline,
    "interpolation": econforge_cubic,
    "ndsplines": ndsplines_cubic,
    "simsopt": simsopt_quartic,
}


def peers(grid: Grid, flux: Array, exact: Callable[[Array], Array]) -> tuple[list[Peer], dict[str, str]]:
    """The usable libraries, and why the others are not usable."""
    found, missing = [], {}
    for name, make in MAKERS.items():
        try:
            found.append(make(grid, flux, exact))
        except (ImportError, AttributeError, TypeError) as reason:
            missing[name] = f"{type(reason).__name__}: {reason}"
    return found, missing
