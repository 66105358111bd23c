"""Flux linkage, inductance and energy of coils with iron: closed forms, derivatives, both forms of the solver."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from scipy.constants import mu_0
from scipy.integrate import quad

import fieldmap as fm
from fieldmap.errors import InputError
from fieldmap.iron import NonlinearSolver
from fieldmap.iron.elements.bh_law import law_tables
from fieldmap.maps.fields import from_arrays, to_arrays
from fieldmap.sources import unit_flux_density
from fieldmap.sources.inductance import bare_inductance
from tests.iron.shared import RING, STEEL, at, core_and_coils, sphere_inductance, toroid


@pytest.fixture(scope="module")
def forms():
    return {form: fm.solve_linear(core_and_coils(), form=form) for form in ("potential", "flux")}


@pytest.mark.parametrize("form", ["potential", "flux"])
def test_coil_above_a_sphere(form):
    device = fm.read_device("loop_and_sphere")
    unit = fm.solve_linear(device, form=form)
    added = unit.inductance() - bare_inductance(device.coils)
    assert added[0, 0] == pytest.approx(sphere_inductance(), rel=1e-3)


def test_inductance_is_symmetric_and_both_forms_agree(forms):
    one, two = (forms[form].inductance() for form in ("potential", "flux"))
    for matrix in (one, two):
        assert matrix == pytest.approx(matrix.T, rel=1e-6)
    assert one == pytest.approx(two, rel=2e-3)
    air = bare_inductance(forms["flux"].coils)
    assert one[0, 0] > 2 * air[0, 0]


@pytest.mark.parametrize("form", ["potential", "flux"])
def test_ring_linked_with_coils_is_a_toroid(form):
    """Six coils evenly round a closed iron ring link mu0 mu_r N^2 A / (2 pi r) with each other, with hardly any
    leakage, besides their linkage in air. The coils' field has a circulation in the iron."""
    (inner, outer, height), mu_r, turns = RING, 2000.0, 10.0
    device = toroid(fm.LinearMaterial("iron", mu_r))
    unit = fm.solve_linear(device, form=form)
    exact = mu_0 * mu_r * (6 * turns) ** 2 * height * np.log(outer / inner) / (2 * np.pi)
    air = bare_inductance(device.coils)
    assert unit.inductance().sum() - air.sum() == pytest.approx(exact, rel=0.01)


@pytest.fixture(scope="module")
def solver():
    return NonlinearSolver(core_and_coils(STEEL))


def test_linkage_is_the_derivative_of_the_coenergy(solver):
    """In saturation, by each current: exact on any mesh, up to the solver's tolerance and the step."""
    currents, step = np.array([20.0, 10.0]), 0.02
    state = solver.solve(currents, tolerance=1e-5)
    assert state.report.largest_flux_density > 1.7
    for k in range(2):
        ahead, behind = (
            solver.solve(currents + s * step * np.eye(2)[k], tolerance=1e-5, start=state).coenergy()
            for s in (1, -1)
        )
        assert (ahead - behind) / (2 * step) == pytest.approx(state.flux_linkage()[k], rel=1e-4)


def test_energy_is_the_work_of_the_currents(solver):
    """W = int I . dlambda from zero, by Gauss's rule after integration by parts: W = I . lambda - int lambda dI."""
    final = np.array([20.0, 10.0])
    x, w = np.polynomial.legendre.leggauss(5)
    states, begin = [], None
    for share in 0.5 * (1 + x):
        begin = solver.solve(share * final, tolerance=1e-4, start=begin)
        states.append(begin.flux_linkage() @ final)
    last = solver.solve(final, tolerance=1e-4, start=begin)
    work = final @ last.flux_linkage() - 0.5 * w @ states
    assert last.energy() == pytest.approx(work, rel=1e-3)
    assert last.coenergy() == pytest.approx(0.5 * w @ states, rel=3e-3)
    # Saturation: the co-energy is larger than the energy; in linear iron both are the same.
    assert last.coenergy() > 1.02 * last.energy()


def test_saturated_force_is_the_derivative_of_the_coenergy(solver):
    """Pulling the coil along the core at constant currents, in saturation."""
    currents, step = np.array([20.0, 0.0]), 5e-4
    device = core_and_coils(STEEL, shift=0.004)
    force = fm.solve(device, currents).force_on("around")
    ahead, behind = (
        fm.solve(core_and_coils(STEEL, shift=0.004 + s * step), currents).coenergy() for s in (1, -1)
    )
    assert force[2] < 0
    assert (ahead - behind) / (2 * step) == pytest.approx(force[2], rel=2e-3)


@pytest.mark.parametrize("form", ["potential", "flux"])
@pytest.mark.parametrize("mu_r", [1.0, 1.3])
def test_magnet_links_its_flux_with_a_coil(form, mu_r):
    """Reciprocity at mu_r = 1: linkage = int Br/mu0 . B_coil dV. With recoil permeability both forms agree, and the
    nonlinear solver agrees with both."""
    magnet = fm.Body("magnet", "magnet", fm.Box((0.01, 0.008, 0.006)), 0.0025)
    remanence = np.array([0.3, -0.2, 1.1])
    coil = fm.CircularCoil("coil", 0.012, 0.016, 0.006, 150.0, placement=at(0.002, 0, 0.003))
    device = fm.Device("d", "", (coil,), (magnet,), {"magnet": fm.PermanentMagnet("magnet", remanence, mu_r)})
    unit = fm.solve_linear(device, form=form)
    linkage = unit.flux_linkage([0.0])[0]
    assert fm.solve(device, [0.0]).flux_linkage()[0] == pytest.approx(linkage, rel=3e-3)
    if mu_r == 1:
        x, w = np.polynomial.legendre.leggauss(5)
        axes = np.meshgrid(0.005 * x, 0.004 * x, 0.003 + 0.003 * x, indexing="ij")
        grid = np.stack(axes, -1).reshape(-1, 3)
        weight = np.einsum("i,j,k->ijk", w, w, w).ravel() / 8 * 0.01 * 0.008 * 0.006
        exact = weight @ unit_flux_density(coil, grid) @ remanence / mu_0
        assert linkage == pytest.approx(exact, rel=1e-3)
    else:
        assert linkage == pytest.approx(fm.solve_linear(device, form="flux").flux_linkage([0.0])[0], rel=5e-3)


def test_law_integral():
    """int b dh of the fitted law by quadrature, from below the first point to beyond the last."""
    tables, number = law_tables([STEEL]), np.zeros(5, int)
    h = mu_0 * np.array([50.0, 300.0, 900.0, 5e4, 3e5])
    b, stored = tables.flux_density(h, number)[0], tables.integral(h, number)
    assert b[-1] == pytest.approx(2.3 + mu_0 * 2e5)
    for k in range(5):
        knots = np.sort(np.append(mu_0 * STEEL.h[mu_0 * STEEL.h < h[k]], [0.0, h[k]]))
        exact = sum(
            quad(lambda x: tables.flux_density(np.array([x]), number[:1])[0][0], low, high)[0]
            for low, high in pairwise(knots)
        )
        assert stored[k] == pytest.approx(exact, rel=1e-9)


def test_a_stored_solution_keeps_its_linkages(forms):
    stored = from_arrays(core_and_coils(), *to_arrays(forms["potential"], np.ones(2)))
    np.testing.assert_array_equal(stored.inductance(), forms["potential"].inductance())
    with pytest.raises(InputError) as caught:
        replace(stored, iron_linkage=None).inductance()
    assert caught.value.problems[0].where == "inductance"
