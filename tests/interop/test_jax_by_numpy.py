"""The code for JAX, run with numpy in its place, which compiles nothing: all forms and options in a moment.

tests/interop/test_jax.py holds what JAX alone can do: derivatives, compilation, precision.
"""

import sys
from contextlib import nullcontext
from math import factorial
from types import SimpleNamespace

import numpy as np
import pytest

from fieldmap.core import block
from fieldmap.core.iron import FOUND, CoreIron
from fieldmap.core.iron_numbers import core_numbers
from fieldmap.errors import InputError, OutsideMapError
from fieldmap.interop import JaxEvaluator, jax_field
from fieldmap.interop.jax_field import cell_field_and_gradient
from fieldmap.lookup import compiled_currents, interpolate
from tests.interop.test_c32 import cut
from tests.interop.test_c_iron import KINDS, saturating
from tests.interop.test_constant_field import constant_data

CURRENTS = np.array([1.0, 2.0, 0.5, -1.0, 0.2, 1.5])
SIZES, SHAPES = [], []
# In the package this name is the function, not its module.
MODULE = sys.modules[JaxEvaluator.__module__]


def rows_of(function, given, batch_size=None):
    """`lax.map`, with the sizes of its pieces noted."""
    SIZES.append(batch_size)
    rows = [function(one) for one in (zip(*given, strict=True) if isinstance(given, tuple) else given)]
    return tuple(map(np.stack, zip(*rows, strict=True))) if isinstance(rows[0], tuple) else np.stack(rows)


def vmap(function, axes=(0,), out=0):
    """Over one mapped argument, the last."""

    def mapped(*given):
        rows = [function(*given[:-1], one) for one in given[-1]]
        parts = zip(*rows, strict=True) if isinstance(rows[0], tuple) else [rows]
        found = tuple(np.stack(part, axis=out) for part in parts)
        return found if isinstance(rows[0], tuple) else found[0]

    return mapped


def jit(of):
    """Notes the shapes of points."""

    def compiled(sets, points, *weights):
        SHAPES.append(points.shape)
        return of(sets, points, *weights)

    return compiled


def jacfwd(of):
    """For a linear function."""
    return lambda at: np.stack([of(row) for row in np.eye(len(at))], axis=-1)


def while_loop(goes_on, step, state):
    while goes_on(state):
        state = step(state)
    return state


def custom_root(residual, start, solve, tangent_solve):
    """What JAX differentiates by; checks that the root is one and that the linear equations are solved."""
    found = solve(residual, start)
    assert np.abs(residual(found)).max() <= 1e-9 * np.abs(residual(start)).max()
    matrix = np.random.default_rng(0).normal(size=(len(found),) * 2)
    right = np.arange(1.0, len(found) + 1.0)
    np.testing.assert_allclose(matrix @ tangent_solve(lambda v: matrix @ v, right), right)
    return found


@pytest.fixture(autouse=True)
def _numpy_for_jax(monkeypatch):
    lax = {"map": rows_of, "while_loop": while_loop, "custom_root": custom_root}
    lax |= dict.fromkeys(("stop_gradient", "optimization_barrier"), lambda given: given)
    places = {"jit": jit, "vmap": vmap, "jacfwd": jacfwd, "enable_x64": lambda on: nullcontext()}
    places |= {"numpy": np, "lax": SimpleNamespace(**lax), "ensure_compile_time_eval": nullcontext}
    monkeypatch.setattr(MODULE, "require", lambda *_: SimpleNamespace(**places))


def close(found, exact, share=1e-12):
    assert np.shape(found) == np.shape(exact)
    assert (np.isnan(found) == np.isnan(exact)).all()
    assert np.nanmax(np.abs(found - exact)) < share * np.nanmax(np.abs(exact))


def harmonic(l, m, x, y, z):
    """The complex solid harmonic of docs/theory/lookup.md (2): r^l P_l^m(cos theta) exp(i m phi) / (l + m)!."""
    w, total = x + 1j * y, 0
    for k in range((l - m) // 2 + 1):
        below = 2 ** (2 * k + m) * factorial(k + m) * factorial(k) * factorial(l - m - 2 * k)
        total = total + (-1) ** k * w ** (k + m) * np.conj(w) ** k * z ** (l - m - 2 * k) / below
    return total


def potentials(points):
    """Potentials (36, n), one for each coefficient of a polynomial of degree 5."""
    rows = []
    for l in range(6):
        rows.append(harmonic(l, 0, *points.T).real)
        for m in range(1, l + 1):
            one = harmonic(l, m, *points.T)
            rows += [one.real, one.imag]
    return np.array([np.broadcast_to(row, len(points)) for row in rows])


def slope(function, points, axis):
    """Derivative of polynomials up to degree 6, by differences that are exact for them."""
    weights = {1: 3 / 4, 2: -3 / 20, 3: 1 / 60}
    step = 0.1 * np.eye(3)[axis]
    return (
        sum(w * (function(points + k * step) - function(points - k * step)) for k, w in weights.items()) / 0.1
    )


def test_a_cell_is_the_gradient_of_its_solid_harmonics():
    """Every coefficient by itself, at places without symmetry."""
    points = np.array([[0.3, -0.5, 0.7], [-0.4, 0.9, -0.2]])
    found = np.array([cell_field_and_gradient(np.eye(36), *place) for place in points])
    flux = [slope(potentials, points, axis) for axis in range(3)]
    exact = [part.T for part in flux]
    for i, j in ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2)):
        exact.append(slope(lambda p, i=i: slope(potentials, p, i), points, j).T)
    np.testing.assert_allclose(found, np.stack(exact, axis=1), rtol=0, atol=1e-10)


def inside(m, n, seed=0):
    return m.lower + np.random.default_rng(seed).random((n, 3)) * (m.upper - m.lower)


@pytest.fixture(scope="module", params=["harmonic", "global"])
def small(ring, request):
    """A corner of the ring's map, with unequal counts of nodes, and the kind: polynomials of cells or of the box."""
    return cut(ring.data, (3, 2, 4)), request.param


@pytest.mark.parametrize("outside", ["nan", "clamp"])
def test_fields_and_derivatives_of_the_map(small, outside):
    """At one point and at many, at currents for all and for each; at corners, beyond them, at NaN and infinity."""
    m = interpolate(*small, outside)
    field = jax_field(m)
    ends = np.stack([m.lower, m.upper])
    beyond = np.concatenate([ends + side * d for d in 1e-3 * np.eye(3) for side in (1, -1)])
    points = np.concatenate([inside(m, 40), ends, beyond, [[np.nan, 0, 0], [0, np.inf, 0]]])
    rng = np.random.default_rng(1)
    for where, currents in (
        (points, CURRENTS),
        (points, rng.normal(size=(len(points), 6))),
        (points[:3], CURRENTS),
        (points[5], CURRENTS),
        (points[:12].reshape(3, 4, 3), CURRENTS),
    ):
        moments = rng.normal(size=where.shape)
        flux, steep = m.field_and_gradient(where, currents)
        for ours, exact in (
            (field(where, currents), flux),
            (field.gradient(where, currents), steep),
            (field.second_gradient(where, currents), m.second_gradient(where, currents)),
            (field.wrench(where, moments, currents), m.wrench(where, moments, currents)),
        ):
            close(ours, exact, 1e-11)
    close(jax_field(m.at(CURRENTS))(points), m.field(points, CURRENTS))
    close(field.wrench(points[:4], moments[0, 0], CURRENTS), m.wrench(points[:4], moments[0, 0], CURRENTS))


@pytest.mark.parametrize("same", [True, False])
def test_many_points_go_in_pieces(small, same, monkeypatch):
    """Only if there are more points than in two pieces."""
    monkeypatch.setattr(MODULE, "PIECE", 8)
    m = interpolate(*small)
    points = inside(m, 17)
    currents = CURRENTS if same else np.random.default_rng(1).normal(size=(len(points), 6))
    for count, pieces in ((16, []), (17, [8])):
        SIZES.clear()
        given = currents if same else currents[:count]
        close(jax_field(m).field(points[:count], given), m.field(points[:count], given))
        assert pieces == SIZES


def test_currents_are_given_or_fixed(small):
    m = interpolate(*small)
    for field, currents in ((jax_field(m), None), (jax_field(m.at(CURRENTS)), CURRENTS)):
        with pytest.raises(InputError):
            field(m.lower, currents)
    with pytest.raises(InputError):
        jax_field(interpolate(small[0], "hermite"))


def test_a_field_that_no_current_drives():
    m = interpolate(constant_data())
    points = inside(m, 20)
    for currents in (np.zeros(2), np.array([1.5, -0.5]), np.random.default_rng(0).normal(size=(20, 2))):
        close(jax_field(m)(points, currents), m.field(points, currents))


@pytest.mark.parametrize("kind", ["free", "background"])
def test_saturating_iron_is_that_of_the_c_core(ring, kind):
    """Two laws, with and without a background, at currents from none to far beyond saturation."""
    m = saturating(ring, *KINDS[kind], outside_currents="evaluate")
    field, point = jax_field(m), m.lower + [0.011, 0.013, 0.017]
    state = CoreIron(core_numbers(compiled_currents(m))).state()
    coils = len(m.coil_names)
    used = np.resize(np.arange(6), coils + 2 + (kind == "background"))
    unit = ring.map.unit_field(point)[used]
    several = np.array(
        [np.zeros(coils), np.linspace(-0.9, 0.8, coils), 0.01 * np.ones(coils), 30.0 * np.ones(coils)]
    )
    exact = []
    for currents in several:
        weights = np.empty(len(unit))
        assert state.solve(currents, weights, np.empty((len(unit), coils)), tolerance=1e-13) == FOUND
        exact.append(weights @ unit)
    for currents, flux in zip(several[1:], exact[1:], strict=True):
        close(field(point, currents), flux, 1e-8)
    close(field(np.tile(point, (4, 1)), several), np.array(exact), 1e-8)


EVALUATED = ("field", "gradient", "second_gradient", "potential")


@pytest.mark.parametrize("outside", ["nan", "clamp"])
def test_an_evaluator_of_maps(small, outside):
    ours, m = interpolate(*small, outside, evaluator=JaxEvaluator), interpolate(*small, outside)
    points = np.concatenate([inside(m, 60), [m.lower, m.upper, m.upper + 0.01, [np.nan, 0, 0]]])
    for currents in (CURRENTS, np.random.default_rng(1).normal(size=(64, 6))):
        for name in EVALUATED:
            close(getattr(ours, name)(points, currents), getattr(m, name)(points, currents), 1e-11)
    for name in ("unit_field", "unit_gradient"):
        close(getattr(ours, name)(points), getattr(m, name)(points))
    fixed, same = ours.at(CURRENTS), m.at(CURRENTS)
    for name in EVALUATED:
        close(getattr(fixed, name)(points), getattr(same, name)(points), 1e-11)
    with pytest.raises(InputError):
        ours.compiled()


def test_an_evaluator_counts_what_lies_outside(small):
    """A point beyond the edge by no more than rounding is inside; NaN and infinity do not count as outside."""
    ours = interpolate(*small, evaluator=JaxEvaluator)
    edge = block.EDGE * (ours.upper - ours.lower if small[1] == "global" else small[0].grid.spacing)
    near = np.stack([ours.lower - 0.5 * edge, ours.upper + 0.5 * edge])
    assert np.isfinite(ours.field(near, CURRENTS)).all()
    far = [side for d in np.diag(2 * edge) for side in (ours.lower - d, ours.upper + d)]
    for points, count in ((far, 6), ([ours.upper, [np.nan, 0, 0]], 0), ([*far[:2], [np.inf, 0, 0]], 2)):
        if not count:
            ours.field(points, CURRENTS)
            continue
        with pytest.raises(OutsideMapError) as caught:
            ours.field(points, CURRENTS)
        assert caught.value.problems[0].received.startswith(f"{count} of {len(points)} ")


def test_few_shapes_are_compiled(small):
    """Numbers of points are rounded up to powers of two."""
    m = interpolate(*small, evaluator=JaxEvaluator)
    for count in (1, 2, 3, 5, 8):
        SHAPES.clear()
        assert m.field(inside(m, count), CURRENTS).shape == (count, 3)
        assert [shape[0] for shape in SHAPES] == [{3: 4, 5: 8}.get(count, count)]
