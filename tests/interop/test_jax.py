"""Maps in JAX: the numbers of the map and of its derivatives, under jit, vmap and grad."""

import time
from dataclasses import replace

import numpy as np
import pytest

from fieldmap.errors import InputError
from fieldmap.interop import JaxEvaluator, jax_field
from fieldmap.lookup import interpolate, iron_weights
from fieldmap.store import StoredReaction
from tests.docs.pages import blocks
from tests.dynamics.conftest import saturating_map

jax = pytest.importorskip("jax", reason='JAX is not installed (pip install "fieldmap[jax]")')
CURRENTS = np.array([1.0, 2.0, 0.5, -1.0, 0.2, 1.5])


@pytest.fixture(autouse=True)
def _double():
    with jax.enable_x64(True):
        yield


@pytest.fixture(scope="module", params=["harmonic", "global"])
def opened(ring, request):
    return interpolate(ring.data, request.param, "nan")


def inside(m, n, seed=0):
    return m.lower + np.random.default_rng(seed).random((n, 3)) * (m.upper - m.lower)


def off(ours, exact):
    return np.abs(np.asarray(ours) - exact).max() / np.abs(exact).max()


def test_field_derivatives_and_wrench_are_those_of_the_closed_form(ring):
    """At one point of loops without symmetry at these currents, so that every sign and the order of axes count."""
    point, moment = np.array([0.002, -0.003, -0.1]), np.array([0.1, 0.2, 0.8])
    each, slopes = (part[:, 0] for part in ring.fields(point[None]))
    flux, slope = CURRENTS @ each, np.tensordot(CURRENTS, slopes, 1)
    field = jax_field(ring.map)

    def everything(p, i):
        return field(p, i), jax.jacfwd(field)(p, i), jax.jacfwd(field, 1)(p, i), field.wrench(p, moment, i)

    *found, wrench = jax.jit(everything)(point, CURRENTS)
    exact = flux, slope, each.T, moment @ slope, np.cross(moment, flux)
    for ours, one in zip((*found, wrench[:3], wrench[3:]), exact, strict=True):
        assert off(ours, one) < 1e-4


def test_jacfwd_of_the_field_is_the_gradient(opened):
    field, points = jax_field(opened), inside(opened, 100)
    slope = opened.gradient(points, CURRENTS)
    by_place = jax.jit(jax.vmap(jax.jacfwd(field), (0, None)))(points, CURRENTS)
    assert off(by_place, slope) < 1e-12
    assert off(jax.vmap(jax.jacrev(field), (0, None))(points, CURRENTS), slope) < 1e-12
    per_ampere = jax.vmap(jax.jacfwd(field, 1), (0, None))(points, CURRENTS)
    assert off(np.moveaxis(per_ampere, 2, 1), opened.unit_field(points)) < 1e-12
    second = jax.vmap(jax.jacfwd(field.gradient), (0, None))(points, CURRENTS)
    assert off(second, opened.second_gradient(points, CURRENTS)) < 1e-12


@pytest.mark.parametrize("kind", ["harmonic", "global"])
def test_the_reaction_of_the_iron(ring, kind):
    """Three coils' fields serve as those of a reaction, one of them negative."""
    stored = StoredReaction(ring.data.flux_density[:3], ring.data.gradient[:3], repelled=1)
    m = interpolate(replace(ring.data, reaction=stored), kind, "nan")
    points, moments = inside(m, 40), np.random.default_rng(2).normal(size=(40, 3))
    exact = m.wrench(points, moments, CURRENTS)
    assert off(jax.jit(jax_field(m).wrench)(points, moments, CURRENTS), exact) < 1e-12
    assert off(jax_field(m.at(CURRENTS)).wrench(points[0], moments[0]), exact[0]) < 1e-12
    assert off(interpolate(ring.data, kind).wrench(points, moments, CURRENTS), exact) > 1e-3


@pytest.mark.parametrize("same", [True, False])
def test_values_are_those_of_the_map(opened, same):
    """At one set of currents and at one for each point; at few points, and at many, which go in pieces."""
    for n in (1, 3000):
        points = inside(opened, n)
        currents = CURRENTS if same else np.random.default_rng(1).normal(size=(n, 6))
        moments = np.random.default_rng(2).normal(size=(n, 3))
        field = jax_field(opened)
        for ours, exact in zip(
            jax.jit(field.field_and_gradient)(points, currents),
            opened.field_and_gradient(points, currents),
            strict=True,
        ):
            assert ours.dtype == np.float64
            assert off(ours, exact) < 1e-12
        assert off(field.wrench(points, moments, currents), opened.wrench(points, moments, currents)) < 1e-12
    assert off(field.second_gradient(points, currents), opened.second_gradient(points, currents)) < 1e-12


def test_fixed_currents_edges_and_outside(opened):
    fixed, field = jax_field(opened.at(CURRENTS)), jax_field(opened)
    corners = np.stack([opened.lower, opened.upper, (opened.lower + opened.upper) / 2])
    assert off(fixed(corners), opened.field(corners, CURRENTS)) < 1e-12
    with pytest.raises(InputError):
        fixed(corners, CURRENTS)
    with pytest.raises(InputError):
        field(corners)
    out = np.stack([opened.upper + 1e-6, [np.nan, 0, 0]])
    assert np.isnan(field(out, CURRENTS)).all()
    assert np.isnan(jax.vmap(jax.jacfwd(field), (0, None))(out, CURRENTS)).all()
    # Points outside do not spoil the gradient inside.
    both = jax.grad(lambda p: jax.numpy.nansum(field(p, CURRENTS)))(np.concatenate([corners, out]))
    assert np.isfinite(both[:3]).all()


def test_clamped_outside(ring):
    m = interpolate(ring.data, outside="clamp")
    far = m.upper + [0.01, -0.005, 0.02]
    assert off(jax_field(m)(far, CURRENTS), m.field(far, CURRENTS)) < 1e-12
    slope = jax.jacfwd(jax_field(m))(far, CURRENTS)
    # Along x and z, where the point is clamped, the field does not change.
    assert not np.asarray(slope)[:, [0, 2]].any()
    assert off(np.asarray(slope)[:, 1], m.gradient(far, CURRENTS)[:, 1]) < 1e-12


def test_single_precision_where_double_is_not_set(opened):
    points = inside(opened, 500)
    with jax.enable_x64(False):
        flux, slope = jax_field(opened).field_and_gradient(points, CURRENTS)
    assert flux.dtype == np.float32
    exact = opened.field_and_gradient(points, CURRENTS)
    assert 1e-9 < off(flux, exact[0]) < 1e-5
    assert off(slope, exact[1]) < 1e-4


def test_a_hermite_form_is_refused(ring):
    with pytest.raises(InputError) as caught:
        jax_field(interpolate(ring.data, "hermite"))
    assert caught.value.problems[0].received == "hermite"


def test_saturating_iron_by_its_reduced_model():
    """Against the model of lookups, which solves to 1e-6; derivatives against differences."""
    m = saturating_map("harmonic")
    field, point = jax_field(m), (m.lower + m.upper) / 2 + 1e-3
    for signals in ([0.8, 0.1, -0.1], [1.2, -0.2, 0.2]):
        currents = m.parametrisation.currents(np.array([signals]))[0]
        assert off(field(point, currents), m.field(point, currents)) < 2e-6
        assert off(jax.jacfwd(field)(point, currents), m.gradient(point, currents)) < 2e-6
        per_ampere = np.asarray(jax.jacrev(field, 1)(point, currents))
        step = 1e-5 * np.eye(6)
        differences = [(field(point, currents + d) - field(point, currents - d)) / 2e-5 for d in step]
        assert off(per_ampere, np.stack(differences, axis=1)) < 1e-6
        assert off(jax.jacfwd(field, 1)(point, currents), per_ampere) < 1e-12
        weights, slopes = iron_weights(m, currents)
        # Nonlinear enough to matter.
        assert off(slopes[0] @ currents, weights[0]) > 0.02
    assert np.isfinite(jax.jacfwd(field, 1)(point, np.zeros(6))).all()
    both = np.stack([currents, 0.9 * currents])
    together = jax.vmap(field, (None, 0))(point, both)
    assert off(together[1], field(point, both[1])) < 1e-9


@pytest.mark.parametrize("kind", ["harmonic", "global"])
@pytest.mark.parametrize("outside", ["nan", "clamp"])
def test_as_an_evaluator_of_maps(ring, kind, outside):
    """The same lookups, by JAX in the place of the compiled kernels."""
    ours = interpolate(ring.data, kind, outside, evaluator=JaxEvaluator)
    m = interpolate(ring.data, kind, outside)
    points = np.concatenate([inside(m, 60), [m.lower, m.upper, m.upper + 0.01, [np.nan, 0, 0]]])
    for currents in (CURRENTS, np.random.default_rng(1).normal(size=(64, 6))):
        for name in ("field", "gradient", "second_gradient", "potential"):
            found, exact = getattr(ours, name)(points, currents), getattr(m, name)(points, currents)
            np.testing.assert_allclose(found, exact, rtol=0, atol=1e-11 * np.nanmax(np.abs(exact)))
    np.testing.assert_allclose(ours.unit_gradient(points), m.unit_gradient(points), rtol=0, atol=1e-11)
    np.testing.assert_allclose(
        ours.at(CURRENTS).field(points), m.at(CURRENTS).field(points), rtol=0, atol=1e-13
    )
    with pytest.raises(InputError):
        ours.compiled()


def test_a_million_points_in_one_call(ring):
    """Times of one run, on as many cores as there are; docs/other_programs.md has what one core gives."""
    m, points = interpolate(ring.data, threads=1), inside(ring.map, 1_000_000)
    field = jax.jit(jax_field(m).field_and_gradient)
    jax.block_until_ready(field(points, CURRENTS))
    begin = time.perf_counter()
    flux, slope = jax.block_until_ready(field(points, CURRENTS))
    middle = time.perf_counter()
    exact = m.field_and_gradient(points, CURRENTS)
    end = time.perf_counter()
    print(f"a million points: JAX {middle - begin:.3f} s, compiled kernels {end - middle:.3f} s")
    assert off(flux, exact[0]) < 1e-12
    assert off(slope, exact[1]) < 1e-12


def test_the_lines_of_the_documentation(ring, tmp_path, monkeypatch, capsys):
    from fieldmap.store import write_map

    monkeypatch.chdir(tmp_path)
    write_map("linear.h5", ring.data)
    names = {}
    exec(blocks("other_programs.md", below="## JAX")[0], names)
    m, point = ring.map, np.array([0.002, -0.003, -0.1])
    assert off(names["slope"], m.gradient(point, CURRENTS * 0 + 1.5)) < 1e-12
    assert off(names["many"], m.field(names["points"], np.full(6, 1.5))) < 1e-12
