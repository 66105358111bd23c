"""Convergence of errors with the mesh of the iron and with the spacing of a map: errors and observed orders."""

from collections.abc import Iterator

import numpy as np

import fieldmap as fm
from fieldmap.lookup import FieldMap, interpolate
from fieldmap.store import Grid, MapData
from validation.row import Array, Row, timed

REFINEMENTS = (0.7, 1.0, 1.4, 2.0)
SPACINGS = (0.01, 0.005, 0.0025)
QUANTITIES = ("B", "gradient")


def mesh() -> Iterator[Row]:
    """The shipped sphere under a coil at mesh sizes from 1.4 to 0.5 times those of its file."""
    device = fm.read_device("loop_and_sphere")
    source = f"{device.references[0].source} (geometry/loop_and_sphere.toml)"
    errors: dict[str, list[float]] = {name: [] for name in QUANTITIES}
    for refinement in REFINEMENTS:
        unit, wall, cpu = timed(lambda refinement=refinement: fm.solve_linear(device, refinement=refinement))
        worst = dict.fromkeys(QUANTITIES, 0.0)
        for known in device.references:
            what = "gradient" if known.quantity.startswith("d") else "B"
            ours = (unit.gradient if what == "gradient" else unit.field)(known.at, known.currents)
            place = tuple("xyz".index(letter) for letter in known.quantity if letter in "xyz")
            worst[what] = max(worst[what], abs(float(ours[place]) / known.value - 1))
        report = unit.report
        for what, value in worst.items():
            errors[what].append(value)
            case, cost = (
                f"sphere and coil, mesh size / {refinement:g}",
                (report.surface_faces, report.iterations),
            )
            yield Row(case, f"error of {what}", value, None, source, *cost, wall, cpu)
    for what, values in errors.items():
        order = -np.polyfit(np.log(REFINEMENTS), np.log(values), 1)[0]
        yield Row("sphere and coil", f"order of {what} in the mesh size", float(order), None, source)


def spacing() -> Iterator[Row]:
    """A dipole of 8 A m^2, 70 to 110 mm above the box: map and lookup without a solver."""
    source = "dipole, Jackson 5.56"
    points = np.random.default_rng(1).uniform([-0.01, -0.01, -0.11], [0.01, 0.01, -0.07], (2000, 3))
    exact = _dipole(points)
    for kind in ("harmonic", "hermite"):
        errors: dict[str, list[float]] = {name: [] for name in QUANTITIES}
        for step in SPACINGS:
            opened = _map(step, kind)
            ours = opened.field(points, [1.0]), opened.gradient(points, [1.0])
            for what, mine, true in zip(QUANTITIES, ours, exact, strict=True):
                axes = tuple(range(1, true.ndim))
                size = np.sqrt((true**2).sum(axis=axes))
                value = float((np.sqrt(((mine - true) ** 2).sum(axis=axes)) / size).max())
                errors[what].append(value)
                yield Row(
                    f"map of a dipole, {kind} form, {1e3 * step:g} mm",
                    f"error of {what}",
                    value,
                    None,
                    source,
                )
        for what, values in errors.items():
            order = np.polyfit(np.log(SPACINGS), np.log(values), 1)[0]
            yield Row(
                f"map of a dipole, {kind} form", f"order of {what} in the spacing", float(order), None, source
            )


def _dipole(points: Array) -> tuple[Array, Array]:
    d2, z = np.sum(points**2, axis=1)[:, None, None], points[:, 2, None]
    up = np.array([0.0, 0.0, 1.0])
    flux = 8e-7 * (3 * z * points / d2[:, :, 0] ** 2.5 - up / d2[:, :, 0] ** 1.5)
    outer = points[:, :, None] * up + up[:, None] * points[:, None, :] + z[:, :, None] * np.eye(3)
    slope = outer - 5 * z[:, :, None] * points[:, :, None] * points[:, None, :] / d2
    return flux, 24e-7 * slope / d2**2.5


def _map(step: float, kind: str) -> FieldMap:
    shape = tuple(int(n) for n in np.round(np.array([0.02, 0.02, 0.04]) / step) + 1)
    # The forms need five nodes along an axis, so the box is larger than the region of the comparison.
    shape = tuple(max(n, 5) for n in shape)
    lower = np.array([0.0, 0.0, -0.09]) - step * (np.array(shape) - 1) / 2
    grid = Grid(lower, [step] * 3, shape)
    flux, slope = _dipole(grid.points())
    data = MapData(
        grid,
        ("dipole",),
        np.ones(1),
        flux_density=flux.reshape(1, *shape, 3),
        gradient=slope.reshape(1, *shape, 3, 3),
    )
    return interpolate(data, kind=kind)
