"""Maps of saturating iron made without a solver: models drawn at random, with and without memory."""

import numpy as np

from fieldmap.currents import CoilGroups, IndependentCurrents, LiftAndDirections
from fieldmap.lookup import interpolate
from fieldmap.store import MapData, ReducedModel

POINTS, MODES = 22, 5
CELLS = {"pinning": [[0.0, 2e-4, 5e-4, 8e-4], [0.0, 0.0, 0.0, 0.0]], "shares": [0.1, 0.3, 0.4, 0.2]}
"""Of the first law; iron of the second has no hysteresis."""


def saturating(ring, *kind, outside_currents="raise", **more):
    """`saturating_data`, opened."""
    return interpolate(saturating_data(ring, *kind, **more), outside_currents=outside_currents)


def saturating_data(ring, coils, of, lower, upper, fixed=False, cells=None):
    """Map data with fields of the ring's loops: those of `coils` coils, of the iron, and of a background if `fixed`.
    cells: those of iron with hysteresis."""
    rng = np.random.default_rng(7)
    used = np.resize(np.arange(6), coils + 2 + fixed)
    iron = {
        "constant": np.zeros(MODES),
        "fixed": 1e-3 * rng.standard_normal(3 * POINTS) if fixed else np.zeros(0),
    }
    model = ReducedModel(
        gradients=3e-3 * rng.standard_normal((3 * POINTS, MODES)),
        source=3e-3 * rng.standard_normal((3 * POINTS, coils)),
        weights=rng.random(POINTS) + 0.1,
        law=np.arange(POINTS) % 2,
        law_offset=[0, 3, 6],
        law_knots=[0, 1e-3, 3e-3] * 2,
        law_coefficients=[
            *([0, 0, 2e3, 0], [0, -1999 / 4e-3, 2e3, 2], [0, 0, 1, 4.001]),
            *([0, 0, 1e3, 0], [0, -999 / 4e-3, 1e3, 1], [0, 0, 1, 2.001]),
        ],
        air=1e-4 * np.eye(MODES),
        output=rng.standard_normal((2, MODES)),
        known_currents=of.currents(0.5 * (np.array(lower) + upper))[None],
        known_amplitudes=np.zeros((1, MODES)),
        lower=lower,
        upper=upper,
        parametrisation=of,
        reference_weights=np.zeros(2),
        **iron,
        **({} if cells is None else cells),
    )
    data = ring.data
    return MapData(
        data.grid,
        tuple("abcdef"[:coils]),
        np.ones(coils),
        flux_density=np.array(data.flux_density)[used],
        gradient=np.array(data.gradient)[used],
        reduced_model=model,
        constant_field=fixed,
        fixed_sources=("background",) if fixed else (),
    )


KINDS = {
    "free": (4, IndependentCurrents(4), [-1.0] * 4, [1.0] * 4),
    "background": (3, IndependentCurrents(3), [-1.0] * 3, [1.0] * 3, True),
    "groups": (4, CoilGroups([[0, 2], [1, 3]]), [-1.0, 0.0], [1.0, 2.0]),
    "division": (6, LiftAndDirections(1.25, 2.0), [0.5, -0.4, -0.4], [2.0, 0.4, 0.4]),
}
