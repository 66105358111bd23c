"""Sensor frames against the printed transform, its inverse, and a simulation of (7-1)."""

import numpy as np
import pytest

from fieldmap.errors import InputError
from fieldmap.instruments import SensorFrame

RADIUS = 0.0059
FRAME = SensorFrame(np.pi / 4, offset=0.026, radius=RADIUS, bias=(0.001, 0.005))


def test_printed_transform():
    """(3-3a), (3-3b), with the numbers in mm as printed."""
    rng = np.random.default_rng(1)
    local = rng.uniform(0, 40, (20, 3))
    x = (local[:, 0] - local[:, 1]) / np.sqrt(2) + 1.0
    y = (local[:, 0] + local[:, 1] - 52 + 2 * 1e3 * RADIUS) / np.sqrt(2) + 5.0
    ours = 1e3 * FRAME.to_global(1e-3 * local)
    np.testing.assert_allclose(ours, np.column_stack([x, y, local[:, 2]]), atol=1e-12)


def test_printed_matrix():
    """The product (3-2), for r = 0."""
    half = 1 / np.sqrt(2)
    printed = [[half, -half, 0, 0], [half, half, 0, -52 * half], [0, 0, 1, 0], [0, 0, 0, 1]]
    matrix = SensorFrame(np.pi / 4, offset=26.0).matrix
    np.testing.assert_allclose(matrix, printed, atol=1e-14)


def test_inverse():
    points = np.random.default_rng(2).normal(size=(4, 5, 3))
    np.testing.assert_allclose(FRAME.to_global(FRAME.to_local(points)), points, atol=1e-15)


@pytest.mark.parametrize("angle", [0.0, np.pi / 4, 1.1])
def test_deviation_is_that_of_many_readings(angle):
    """200 000 readings with the deviations of Table 3-8; 0.5 % is three standard errors."""
    frame = SensorFrame(angle, offset=0.026)
    rng = np.random.default_rng(3)
    noise = rng.normal(size=(200_000, 3)) * [5.42e-6, 8.38e-6, 0.0]
    np.testing.assert_allclose(
        frame.to_global(noise).std(axis=0)[:2], frame.global_deviation(5.42e-6, 8.38e-6), rtol=5e-3
    )


@pytest.mark.parametrize(
    "broken",
    [
        lambda: SensorFrame(np.nan, 0.026),
        lambda: SensorFrame(0.7, 0.026, radius=-1e-3),
        lambda: FRAME.to_global([0.0, 0.0]),
        lambda: FRAME.to_global([0.0, np.inf, 0.0]),
        lambda: FRAME.global_deviation(-1e-6, 1e-6),
    ],
)
def test_bad_input(broken):
    with pytest.raises(InputError):
        broken()
