"""A winding made of arcs and bars; further physical checks are in tests/sources."""

import numpy as np
import pytest

from fieldmap.kernels.coils.path import extent, path_flux_density_and_gradient
from fieldmap.kernels.coils.ring import ring_flux_density_and_gradient

THICKNESS, HEIGHT = 0.010, 0.039
SHIFT = 0.004


def quarter_arcs(shift):
    angles = np.pi / 4 + np.pi / 2 * np.arange(4)
    return np.array(
        [
            [
                shift * np.sign(np.cos(a)),
                shift * np.sign(np.sin(a)),
                np.cos(a),
                np.sin(a),
                np.pi / 4,
                0.011,
                0.021,
                1.0,
            ]
            for a in angles
        ]
    )


def side_bars(shift):
    angles = np.pi / 2 * np.arange(4)
    reach = shift + 0.016
    return np.array([[reach * np.cos(a), reach * np.sin(a), -np.sin(a), np.cos(a), shift] for a in angles])


POINTS = np.array(
    [
        [0.009, 0.004, 0.015],
        [0.012, 0.009, 0.01],
        [0.016, 0.003, 0.0205],
        [0.0, -0.031, 0.02],
        [0.03, 0.01, -0.08],
        [0.4, 0.2, 0.1],
    ]
)


def test_four_quarters_are_the_circular_winding():
    no_bars = np.zeros((0, 5))
    ours = path_flux_density_and_gradient(POINTS, quarter_arcs(0.0), no_bars, THICKNESS, HEIGHT, 10.0)
    rings = ring_flux_density_and_gradient(POINTS, 0.011, 0.021, HEIGHT, 10.0)
    for one, two in zip(ours, rings, strict=True):
        size = np.abs(two).reshape(len(POINTS), -1).max(axis=1)
        assert (np.abs(one - two).reshape(len(POINTS), -1).max(axis=1) / size).max() < 1e-9


def test_extent_encloses_the_winding():
    x, y, size, quarter = extent(quarter_arcs(SHIFT), side_bars(SHIFT), THICKNESS, HEIGHT)
    assert (x, y) == pytest.approx((0, 0), abs=1e-15)
    assert quarter == pytest.approx(0.025**2)
    assert size == pytest.approx(np.sqrt(2 * 0.025**2 + 0.0195**2))
