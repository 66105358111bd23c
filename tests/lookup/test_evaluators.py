"""Two implementations of map evaluation give the same numbers; an interpolant is one object and one registration."""

import numpy as np
import pytest

from fieldmap import interpolants
from fieldmap.errors import InputError, OutsideMapError
from fieldmap.field import Field
from fieldmap.interpolants import INTERPOLANTS, Form, Interpolant
from fieldmap.lookup import interpolate, unit_block
from tests.lookup.reference_evaluator import ReferenceEvaluator

CURRENTS = np.array([1.0, -0.7, 0.4])


@pytest.mark.parametrize("outside", ["nan", "clamp"])
@pytest.mark.parametrize("kind", list(INTERPOLANTS))
def test_the_reference_gives_what_the_kernels_give(dipoles, kind, outside):
    data = dipoles.map((6, 5, 6))
    compiled = interpolate(data, kind, outside)
    reference = interpolate(data, kind, outside, evaluator=ReferenceEvaluator)
    points = dipoles.points(40)
    points[3], points[7, 1] = [0.5, 0.0, 0.0], np.nan
    rows = np.random.default_rng(8).normal(size=(40, 3))
    for name in ("field", "gradient", "second_gradient", "potential"):
        for currents in (CURRENTS, rows):
            ours, theirs = (getattr(m, name)(points, currents) for m in (reference, compiled))
            size = np.nanmax(np.abs(theirs))
            np.testing.assert_allclose(ours, theirs, rtol=1e-9, atol=1e-11 * size)
        fixed = [getattr(m.at(CURRENTS), name)(points) for m in (reference, compiled)]
        np.testing.assert_allclose(*fixed, rtol=1e-9, atol=1e-11 * np.nanmax(np.abs(fixed[1])))
    np.testing.assert_allclose(
        reference.unit_gradient(points), compiled.unit_gradient(points), rtol=1e-8, atol=1e-18
    )
    one = points[0]
    np.testing.assert_allclose(
        reference.wrench(one, [0, 0, 1], 1.0), compiled.wrench(one, [0, 0, 1], 1.0), rtol=1e-10
    )


def test_an_evaluator_that_is_not_compiled_says_so(dipoles):
    m = interpolate(dipoles.map((6, 5, 6)), evaluator=ReferenceEvaluator)
    with pytest.raises(InputError):
        m.compiled()
    with pytest.raises(OutsideMapError):
        m.field([1.0, 0.0, 0.0], CURRENTS)


class NearestNode:
    """An interpolant of a user: B of the nearest node, extended by its gradient."""

    places = 1

    def __init__(self, form, weights=None):
        self.form, self.weights = form, weights

    def field_and_gradient(self, points, weights, flux, slope):
        data = self.form.unit
        chosen = weights if self.weights is None else self.weights[None]
        rows = np.broadcast_to(chosen, (len(points), chosen.shape[1]))
        index = np.rint((points - data.grid.lower) / data.grid.spacing).astype(int)
        at = tuple(np.clip(index, 0, np.array(data.grid.shape) - 1).T)
        away = points - (data.grid.lower + np.stack(at, axis=1) * data.grid.spacing)
        slopes = np.einsum("snij,ns->nij", data.gradient[(slice(None), *at)], rows)
        flux[:] = np.einsum("sni,ns->ni", data.flux_density[(slice(None), *at)], rows)
        flux += np.einsum("nij,nj->ni", slopes, away)
        if slope.size:
            slope[:] = slopes
        return 0

    def at(self, weights):
        return NearestNode(self.form, weights)

    def field_at(self, point, weights):
        return None

    def dipole_wrench_at(self, point, moment, weights):
        return None


def test_an_interpolant_is_one_object_and_one_registration(dipoles, fine, monkeypatch):
    def form(data, outside):
        return Form("nearest", data, data, None)

    mine = Interpolant("nearest", "nearest node and its gradient", form, evaluator=NearestNode)
    monkeypatch.setitem(interpolants.INTERPOLANTS, mine.name, mine)
    m, points = interpolate(dipoles.map((24, 21, 24)), "nearest"), dipoles.points(200)
    assert isinstance(m, Field)
    exact = fine.field(points, CURRENTS)
    assert np.abs(m.field(points, CURRENTS) - exact).max() < 2e-2 * np.abs(exact).max()
    np.testing.assert_array_equal(m.at(CURRENTS).gradient(points), m.gradient(points, CURRENTS))
    assert m.jump().gradient == 0.0
    with pytest.raises(InputError) as caught:
        unit_block(m)
    assert caught.value.problems[0].received == "nearest"
