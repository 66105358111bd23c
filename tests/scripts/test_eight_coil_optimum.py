"""The forces that the search for eight coils maximises, against the wrench on a bead."""

import numpy as np
import pytest

import fieldmap as fm
from fieldmap.lookup.payload import magnetic_body
from scripts.studies import eight_coil_optimum as optimum


@pytest.fixture(scope="module")
def design():
    device = fm.read_device(optimum.machine(), {"parameters.radius": 18.0, "parameters.level": -5.0})
    return device, fm.solve_linear(device, refinement=0.4)


def currents_of(power, device):
    """Random currents (8,) of this total power."""
    random = np.random.default_rng(0).normal(size=8)
    return random * np.sqrt(power / optimum.resistance_of(device)) / np.linalg.norm(random)


def test_forces_are_those_of_the_wrench(design):
    """On a ball of such high permeability that its moment does not depend on it: 3/(mu_r + 2) is negligible."""
    device, solved = design
    amperes = currents_of(optimum.POWER, device)
    one = amperes / np.linalg.norm(amperes)
    found = np.einsum("a,jab,b->j", one, optimum.forces_of_currents(device, solved.at(0.0)), one)
    ball = magnetic_body(fm.SoftSphere(optimum.BEAD, fm.LinearMaterial("iron", 1e7)))
    wrench = solved.at(amperes).wrench([0.0, 0.0, 0.0], ball)
    np.testing.assert_allclose(found, wrench[:3], rtol=1e-3)


def test_no_currents_make_more_than_the_largest(design):
    device, solved = design
    forces, largest = (
        optimum.forces_of_currents(device, solved.at(0.0)),
        optimum.largest_forces(device, solved.at(0.0)),
    )
    random = np.random.default_rng(1).normal(size=(2000, 8))
    random /= np.linalg.norm(random, axis=1)[:, None]
    along = np.einsum("nj,ka,jab,kb->nk", optimum.directions(), random, forces, random, optimize=True)
    assert np.all(along.max(axis=1) <= largest)
    assert np.mean(along.max(axis=1) / largest) > 0.5


def test_the_shipped_machine_comes_out_at_its_numbers():
    device, shipped = fm.read_device(optimum.machine()), fm.read_device("eight_coils")
    for one, other in zip(device.coils, shipped.coils, strict=True):
        np.testing.assert_allclose(one.placement.position, other.placement.position, atol=1e-8)
        np.testing.assert_allclose(one.placement.rotation, other.placement.rotation, atol=1e-12)
        assert (one.turns, one.inner_radius) == pytest.approx((other.turns, other.inner_radius))
    for one, other in zip(device.bodies, shipped.bodies, strict=True):
        place, there = one.parts[0].placement, other.parts[0].placement
        np.testing.assert_allclose(place.position, there.position, atol=1e-8)
        np.testing.assert_allclose(place.rotation, there.rotation, atol=1e-12)
    assert optimum.smallest_angle(device, None) == pytest.approx(60.0)
