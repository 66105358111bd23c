"""Demagnetising factors of cylinders and the field of an axially magnetised one."""

import magpylib
import numpy as np
import pytest

from fieldmap.device.model import Body, Cylinder, Device, LinearMaterial, Part
from fieldmap.iron.elements.bh_law import Magnetisation, law_tables
from fieldmap.iron.elements.flux_form import FluxForm
from fieldmap.iron.elements.potential_form import PotentialForm
from fieldmap.iron.mesh.mesh import generate_mesh
from fieldmap.iron.operators.assembled import assemble

# Magnetometric (volume-averaged) axial factors of cylinders at mu_r = 1 + small susceptibility; Chen, Brug and
# Goldfarb, IEEE Trans. Magn. 27 (1991) 3601, table I, chi = 0, by length/diameter.
FORMS = (FluxForm, PotentialForm)
UP = np.array([0.0, 0.0, 1.0])
AXIAL_FACTOR = {1.0: 0.3116, 0.2: 0.6802}


def solved(problem, mu_r, applied, remanence, tolerance):
    count = len(problem.elements.volume)
    material = Magnetisation(
        np.zeros(count, np.int64),
        law_tables([LinearMaterial("iron", mu_r)]),
        np.tile(remanence, (1, count, 1)),
    )
    field = problem.elements.coil_field(lambda p: np.broadcast_to(applied, (1, *p.shape)))
    return problem.solve_linear(material, field, tolerance).iron


def cylinder_problem(form, radius, height, size, edge):
    body = Body("rod", "iron", (Part(Cylinder(radius, height)),), size, edge)
    return form(assemble(generate_mesh(Device("d", "", (), (body,), {"iron": LinearMaterial("iron", 1.0)}))))


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("slenderness", sorted(AXIAL_FACTOR))
def test_demagnetising_factor(slenderness, form):
    """Weakly magnetic: M = chi (B0/mu0 - N M), so <B>/B0 = 1 + chi (1 - N) to first order in chi."""
    radius, chi = 0.01, 1e-3
    problem = cylinder_problem(form, radius, 2 * radius * slenderness, 0.004, 0.001)
    state = solved(problem, 1 + chi, UP, 0 * UP, 1e-9)
    volume = problem.elements.volume
    mean = (volume @ state.flux_density[0] / volume.sum())[2]
    factor = 1 - (mean - 1) / chi
    assert factor == pytest.approx(AXIAL_FACTOR[slenderness], abs=2e-3)


@pytest.mark.parametrize("form", FORMS)
def test_permanent_magnet_is_that_of_magpylib(form):
    """mu_r = 1: charges on the end faces only, exact in magpylib."""
    state = solved(cylinder_problem(form, 0.01, 0.01, 0.004, None), 1.0, 0 * UP, 1.3 * UP, 1e-7)
    magnet = magpylib.magnet.Cylinder(
        polarization=(0, 0, 1.3), dimension=(0.02, 0.01), position=(0, 0, 0.005)
    )
    places = np.array([[0, 0, -0.02], [0.02, 0, 0.0], [0.01, 0.015, 0.03], [0.05, 0.0, -0.05]])
    theirs = magnet.getB(places)
    assert state.faces.field(places, state.density)[0] == pytest.approx(
        theirs, abs=3e-3 * np.abs(theirs).max()
    )
