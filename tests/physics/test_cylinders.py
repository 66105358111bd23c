"""Demagnetising factors of cylinders and the field of an axially magnetised one."""

import magpylib
import numpy as np
import pytest

from fieldmap.device.model import Body, Cylinder, LinearMaterial
from fieldmap.iron.elements.flux_form import FluxForm
from fieldmap.iron.elements.potential_form import PotentialForm
from tests.iron.shared import in_uniform_field, iron_of

# Magnetometric (volume-averaged) axial factors of cylinders at mu_r = 1 + small susceptibility; Chen, Brug and
# Goldfarb, IEEE Trans. Magn. 27 (1991) 3601, table I, chi = 0, by length/diameter.
FORMS = (FluxForm, PotentialForm)
UP = np.array([0.0, 0.0, 1.0])
AXIAL_FACTOR = {1.0: 0.3116, 0.2: 0.6802}


def cylinder_problem(form, radius, height, size, edge):
    return form(iron_of(Body("rod", "iron", Cylinder(radius, height), size, edge)))


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("slenderness", sorted(AXIAL_FACTOR))
def test_demagnetising_factor(slenderness, form):
    """Weakly magnetic: M = chi (B0/mu0 - N M), so <B>/B0 = 1 + chi (1 - N) to first order in chi."""
    radius, chi = 0.01, 1e-3
    problem = cylinder_problem(form, radius, 2 * radius * slenderness, 0.004, 0.001)
    state = in_uniform_field(problem, [LinearMaterial("iron", 1 + chi)], UP, 1e-9)
    volume = problem.elements.volume
    mean = (volume @ state.flux_density[0] / volume.sum())[2]
    factor = 1 - (mean - 1) / chi
    assert factor == pytest.approx(AXIAL_FACTOR[slenderness], abs=2e-3)


@pytest.mark.parametrize("form", FORMS)
def test_permanent_magnet_is_that_of_magpylib(form):
    """mu_r = 1: charges on the end faces only, exact in magpylib."""
    problem, air = cylinder_problem(form, 0.01, 0.01, 0.004, None), [LinearMaterial("iron", 1.0)]
    state = in_uniform_field(problem, air, 0 * UP, 1e-7, remanence=1.3 * UP)
    magnet = magpylib.magnet.Cylinder(
        polarization=(0, 0, 1.3), dimension=(0.02, 0.01), position=(0, 0, 0.005)
    )
    places = np.array([[0, 0, -0.02], [0.02, 0, 0.0], [0.01, 0.015, 0.03], [0.05, 0.0, -0.05]])
    ours, theirs = state.faces.field(places, state.density)[0], magnet.getB(places)
    assert ours == pytest.approx(theirs, abs=3e-3 * np.abs(theirs).max())
