"""Interpolants of harmonic polynomials: up to the degree of each form they are exact between nodes.

A potential (a . x)^n with a complex vector a, a . a = 0, is harmonic; B is the real part of n (a . x)^(n-1) a, and its
gradient the real part of n (n-1) (a . x)^(n-2) a a.
"""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from fieldmap.lookup import interpolate
from fieldmap.store import Grid, MapData, Provenance

# Highest degree of the potential that each form represents exactly.
DEGREES = {"harmonic": 5, "hermite": 4, "global": 6}
GRIDS = st.tuples(*[st.integers(5, 7)] * 3)
CENTRE, SIZE = np.array([0.01, -0.02, -0.1]), 0.02


def sum_of(terms):
    """Functions for B and its gradient from (degree, null vector, factor), in lengths of the box about its centre."""

    def flux(points):
        local = (points - CENTRE) / SIZE
        return sum((c * n * (local @ a)[:, None] ** (n - 1) * a).real for n, a, c in terms)

    def gradient(points):
        local = (points - CENTRE) / SIZE
        powers = ((c * n * (n - 1) * (local @ a) ** max(n - 2, 0), a) for n, a, c in terms)
        return sum((p[:, None, None] * np.outer(a, a)).real for p, a in powers) / SIZE

    return flux, gradient


@st.composite
def fields(draw, highest):
    """A sum of harmonic polynomials."""
    terms = []
    for degree in draw(st.lists(st.integers(1, highest), min_size=1, max_size=3)):
        turn = Rotation.from_euler("xyz", draw(st.tuples(*[st.floats(-180, 180)] * 3)), degrees=True)
        null = turn.apply([1.0, 0.0, 0.0]) + 1j * turn.apply([0.0, 1.0, 0.0])
        terms.append((degree, null, complex(draw(st.floats(-1, 1)), draw(st.floats(0.1, 1)))))
    return sum_of(terms)


def map_of(flux, gradient, shape):
    grid = Grid(CENTRE - SIZE, 2 * SIZE / (np.array(shape) - 1.0), shape)
    points = grid.points()
    return MapData(
        grid,
        ("a",),
        np.array([1.0]),
        Provenance(title="closed form"),
        flux_density=flux(points).reshape(1, *shape, 3),
        gradient=gradient(points).reshape(1, *shape, 3, 3),
    )


def anywhere(data, count=30):
    rng = np.random.default_rng(data.draw(st.integers(0, 2**32 - 1)))
    return CENTRE + SIZE * rng.uniform(-1, 1, (count, 3))


CELLS = ("harmonic", "hermite")


@pytest.mark.parametrize("kind", CELLS)
@given(data=st.data())
def test_polynomials_are_exact(kind, data):
    check_polynomials(kind, data, data.draw(GRIDS))


@settings(max_examples=2)
@given(data=st.data())
def test_polynomials_are_exact_in_the_whole_box(data):
    check_polynomials("global", data, (5, 5, 5))


def check_polynomials(kind, data, shape):
    flux, gradient = data.draw(fields(DEGREES[kind]))
    m = interpolate(map_of(flux, gradient, shape), kind)
    points = np.vstack([anywhere(data), CENTRE + SIZE * np.array([[1, 1, 1], [-1, 0, 1], [-1, -1, -1.0]])])
    scale = np.abs(flux(points)).max() + 1e-9
    slope = np.abs(gradient(points)).max() + scale / SIZE
    np.testing.assert_allclose(m.field(points, 1.0), flux(points), atol=1e-9 * scale)
    np.testing.assert_allclose(m.gradient(points, 1.0), gradient(points), atol=1e-8 * slope)


@given(data=st.data())
def test_one_degree_more_is_not_exact(data):
    """Shows that the exactness tests above can fail."""
    for kind, degree in (("harmonic", 7), ("hermite", 6)):
        flux, gradient = sum_of([(degree, np.array([1.0, 1j, 0.0]), 1.0)])
        m = interpolate(map_of(flux, gradient, (5, 5, 5)), kind)
        points = anywhere(data)
        assert np.abs(m.field(points, 1.0) - flux(points)).max() > 1e-5


@given(data=st.data())
def test_nodes_are_reproduced(data):
    """The Hermite form passes through its nodes for any field, here of degree 12."""
    shape = data.draw(GRIDS)
    flux, gradient = data.draw(fields(12))
    m = interpolate(map_of(flux, gradient, shape), "hermite")
    nodes = m.info.grid.points()
    scale = np.abs(flux(nodes)).max() + 1e-12
    np.testing.assert_allclose(m.field(nodes, 1.0), flux(nodes), atol=1e-10 * scale)


@pytest.mark.parametrize("kind", CELLS)
@given(data=st.data())
def test_the_gradient_is_the_derivative_of_the_field(kind, data):
    check_gradient(kind, data, data.draw(GRIDS))


@settings(max_examples=2)
@given(data=st.data())
def test_the_gradient_is_the_derivative_in_the_whole_box(data):
    check_gradient("global", data, (5, 5, 5))


def check_gradient(kind, data, shape):
    """For a field that no form represents exactly: against differences of the form itself, within a cell."""
    m = interpolate(map_of(*data.draw(fields(9)), shape), kind)
    grid, h = m.info.grid, 1e-6
    rng = np.random.default_rng(data.draw(st.integers(0, 2**32 - 1)))
    cell = rng.integers(0, np.array(shape) - 1, (20, 3)) + rng.uniform(0.1, 0.9, (20, 3))
    points = grid.lower + cell * grid.spacing
    gradient = m.gradient(points, 1.0)
    steps = [(m.field(points + h * e, 1.0) - m.field(points - h * e, 1.0)) / (2 * h) for e in np.eye(3)]
    scale = np.abs(gradient).max() + 0.01 * np.abs(m.field(points, 1.0)).max() / SIZE
    np.testing.assert_allclose(np.stack(steps, axis=-1), gradient, atol=2e-5 * scale)
    # Forms made of harmonic polynomials satisfy Laplace's equation, and have a symmetric gradient.
    if kind != "hermite":
        assert np.abs(np.trace(gradient, axis1=1, axis2=2)).max() < 1e-9 * scale
        assert np.abs(gradient - np.swapaxes(gradient, 1, 2)).max() < 1e-9 * scale
