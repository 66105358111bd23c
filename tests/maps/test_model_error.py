"""Errors of a model's field against sums over coils, background and charges, one state and one place at a time."""

from types import SimpleNamespace

import numpy as np
import pytest

from fieldmap.maps.training import model_error
from fieldmap.maps.training.model_error import ModeFields, Trial, larger
from fieldmap.sources import unit_flux_density_and_gradient
from tests.maps.test_resumed_training import COILS

POINTS = np.array([[1e-3, 2e-3, 30e-3], [-8e-3, 5e-3, 25e-3], [3e-3, -9e-3, 45e-3], [0.0, 1e-3, 60e-3]])
LARGEST = np.array([2.0, 0.5])
CURRENTS = np.array([[1.0, 0.4], [-1.5, 0.2], [2.0, -0.5]])
FACES, STATES = 5, len(CURRENTS)
RANDOM = np.random.default_rng(21)
FLUX, GRADIENT = RANDOM.standard_normal((FACES, 4, 3)), 30.0 * RANDOM.standard_normal((FACES, 4, 3, 3))
CHARGE, CHANGE = (
    1e-3 * RANDOM.standard_normal((STATES, FACES)),
    1e-5 * RANDOM.standard_normal((STATES, FACES)),
)
CONSTANT = 1e-3 * RANDOM.standard_normal((4, 3)), 0.1 * RANDOM.standard_normal((4, 3, 3))
# Two coils at one place; the second has three times the turns.
SECOND = 3.0


def solver(background=True):
    coils = [COILS[0], COILS[1].__class__("b", 6e-3, 8e-3, 10e-3, 300)]

    def of_charges(points, charge):
        assert points is POINTS
        return np.einsum("sf,fpi->spi", charge, FLUX), np.einsum("sf,fpij->spij", charge, GRADIENT)

    return SimpleNamespace(
        device=SimpleNamespace(
            coils=coils,
            background=SimpleNamespace(field_and_gradient=lambda points: CONSTANT) if background else None,
        ),
        surface=SimpleNamespace(field_and_gradient=of_charges),
        charge_density=lambda potentials: 2.0 * potentials.T,
    )


def largest_norm(field):
    """Largest norm over the points of (p, ...)."""
    return max(float(np.sqrt((one**2).sum())) for one in field)


def expected(background=True, factor=1.0):
    """Largest change, largest field and least size (states, 3) of flux density, then of the gradient."""
    unit, found = unit_flux_density_and_gradient(COILS[0], POINTS), []
    for of, part, constant in zip((FLUX, GRADIENT), unit, CONSTANT, strict=True):
        least = 1e-3 * max(2.0, 0.5 * SECOND) * largest_norm(part)
        rows = []
        for (i, j), charge, change in zip(factor * CURRENTS, factor * CHARGE, CHANGE, strict=True):
            iron = sum(q * face for q, face in zip(charge, of, strict=True))
            whole = (i + SECOND * j) * part + background * constant + iron
            rows.append(
                [
                    largest_norm(sum(q * face for q, face in zip(change, of, strict=True))),
                    largest_norm(whole),
                    least,
                ]
            )
        found.append(rows)
    return np.array(found)


# The last case has such weak currents that errors are relative to the coils' field at their largest currents.
@pytest.mark.parametrize(("background", "factor"), [(True, 1.0), (False, 1.0), (False, 1e-5)])
def test_changes_are_shares_of_a_states_largest_field(background, factor, monkeypatch):
    off, size, least = np.moveaxis(expected(background, factor), 2, 0)
    wanted = (off / np.maximum(size, least)).T
    assert (size < least).any() == (factor < 1.0)
    trial = Trial(solver(background), POINTS, LARGEST)
    currents, charge = factor * CURRENTS, factor * CHARGE
    np.testing.assert_allclose(trial.shares(currents, charge, CHANGE), wanted, rtol=1e-9)
    # By the fields of the faces as fields of modes, one or two states at a time, or all at once.
    for at_a_time in (1, 80, 2**17):
        monkeypatch.setattr(model_error, "_AT_A_TIME", at_a_time)
        found = trial.shares_of_sums(currents, (FLUX, GRADIENT), charge, CHANGE)
        np.testing.assert_allclose(found, wanted, rtol=1e-9)
    fields = ModeFields(trial, FLUX, GRADIENT)
    assert fields.changed(currents, charge, CHANGE) == pytest.approx(larger(wanted), rel=1e-9)
    assert larger(wanted) == pytest.approx([max(b, g / 2.0) for b, g in wanted])


def test_errors_at_solved_states_are_the_largest_of_each_kind():
    """The model's charges are the solver's less `CHANGE`; two of its three states were solved."""
    off, size, least = np.moveaxis(expected(), 2, 0)
    tried = SimpleNamespace(currents=CURRENTS, potentials=0.5 * CHARGE.T, solved=2)
    mix = np.array([[2.0, 0.0, 1.0], [1.0, 1.0, 0.0], [0.0, -1.0, 3.0]])
    found = Trial(solver(), POINTS, LARGEST).errors(mix, np.linalg.solve(mix, CHARGE - CHANGE), tried)
    shares = (off / np.maximum(size, least)).max(axis=1)
    assert (found.states, found.solved) == (3, 2)
    assert [found.flux_density, found.gradient] == pytest.approx(off.max(axis=1), rel=1e-9)
    assert [found.largest_flux_density, found.largest_gradient] == pytest.approx(size.max(axis=1), rel=1e-9)
    assert [found.flux_density_share, found.gradient_share] == pytest.approx(shares, rel=1e-9)
    assert found.share == pytest.approx(max(shares[0], shares[1] / 2.0), rel=1e-9)


def test_fields_of_modes_as_rows_and_of_their_combinations():
    fields = ModeFields(None, FLUX, GRADIENT)
    length = np.abs(FLUX).max() / np.abs(GRADIENT).max()
    for k, row in enumerate(fields.rows):
        np.testing.assert_allclose(row[:12], FLUX[k].ravel())
        np.testing.assert_allclose(row[12:], length * GRADIENT[k].ravel())
    mix = RANDOM.standard_normal((2, FACES))
    of = fields.combined(mix)
    for ours, parts in ((of.flux, FLUX), (of.gradient, GRADIENT)):
        for row, found in zip(mix, ours, strict=True):
            np.testing.assert_allclose(found, sum(w * part for w, part in zip(row, parts, strict=True)))
