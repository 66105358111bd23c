"""Small reduced models of saturating iron, and their equation in numpy."""

import numpy as np
from numba.core import config

from fieldmap.currents import CoilGroups, IndependentCurrents, LiftAndDirections
from fieldmap.store import ReducedModel

# Without compilation a model's expansion takes seconds for each ten points.
POINTS, MODES, FIELDS = (3, 3, 3) if config.DISABLE_JIT else (30, 5, 3)
DRAWN = 3 if config.DISABLE_JIT else 30  # currents whose equation is solved to the last digits
# b = 2000 h up to 1 mT, a parabola to slope 1 at 3 mT, then slope 1.
CURVE = np.array([[0.0, 0.0, 2000.0, 0.0], [0.0, -1999.0 / 4e-3, 2000.0, 2.0], [0.0, 0.0, 1.0, 4.001]])
KNOTS = np.array([0.0, 1e-3, 3e-3])


def law(h):
    inner = np.where(h < 1e-3, 2000.0 * h, 2.0 + 2000.0 * (h - 1e-3) - 1999.0 / 4e-3 * (h - 1e-3) ** 2)
    return np.where(h < 3e-3, inner, 4.001 + h - 3e-3)


def model(parametrisation, lower, upper, fixed=False):
    rng = np.random.default_rng(4)
    coils = parametrisation.coil_count
    square = rng.standard_normal((MODES, MODES))
    known = parametrisation.currents(0.5 * (np.array(lower) + np.array(upper)))[None]
    return ReducedModel(
        gradients=3e-3 * rng.standard_normal((3 * POINTS, MODES)),
        source=3e-3 * rng.standard_normal((3 * POINTS, coils)),
        weights=rng.random(POINTS) + 0.1,
        law=np.arange(POINTS) % 2,
        law_offset=[0, 3, 6],
        law_knots=np.tile(KNOTS, 2),
        law_coefficients=np.concatenate([CURVE, CURVE]),
        air=1e-4 * (square @ square.T + np.eye(MODES)),
        constant=1e-4 * rng.standard_normal(MODES) if fixed else np.zeros(MODES),
        output=rng.standard_normal((FIELDS, MODES)),
        known_currents=known,
        known_amplitudes=np.zeros((1, MODES)),
        lower=lower,
        upper=upper,
        parametrisation=parametrisation,
        reference_weights=np.zeros(FIELDS),
        fixed=1e-3 * rng.standard_normal(3 * POINTS) if fixed else np.zeros(0),
    )


def residual(of, amplitudes, currents):
    applied = of.source @ currents + (of.fixed if of.fixed.size else 0.0)
    gradients = of.gradients.astype(np.float32).astype(float)
    h = (applied - gradients @ amplitudes).reshape(POINTS, 3)
    size = np.linalg.norm(h, axis=1)
    share = of.weights * (law(size) / size - 1)
    return (share[:, None] * h).ravel() @ gradients + of.constant - of.air @ amplitudes


CASES = {
    "free": model(IndependentCurrents(3), [-1.0, -1.0, 0.0], [1.0, 1.0, 2.0]),
    "fixed": model(IndependentCurrents(3), [-1.0, -1.0, 0.0], [1.0, 1.0, 2.0], fixed=True),
    "groups": model(CoilGroups([[0, 2], [1, 3]]), [-1.0, 0.0], [1.0, 2.0]),
    "division": model(LiftAndDirections(1.25, 2.0), [0.5, -0.4, -0.4], [2.0, 0.4, 0.4]),
}


def drawn(of, count, seed=3):
    return of.domain.at(np.random.default_rng(seed).random((count, len(of.lower))))
