"""Devices of the shape of published benchmark problems: thin plates with gaps of 0.5 mm, a pole in a box with 1 mm.

Their fields have no closed form; the tests are meshes, conservation, symmetry, virtual work and reaction. The finer
meshes are in scripts/studies/benchmark_shapes.py and in docs/theory/forces.md.
"""

from dataclasses import replace

import numpy as np
import pytest

import fieldmap as fm
from fieldmap.iron import NonlinearSolver

BOX = ("box", "floor pad", "lid collar")
# At this current the pole is saturated: 1.8 T.
CURRENT = [3.0]


def solved(device, refinement, current=CURRENT):
    return NonlinearSolver(device, refinement).solve(current)


@pytest.fixture(scope="module")
def pole():
    device = fm.read_device("pole_in_box")
    return [solved(device, refinement) for refinement in (0.5, 0.75)]


def test_force_on_the_pole_converges(pole):
    """Meshes of 1150 and 2000 faces, against 327.6 N at 4080 and 327.3 N at 7030 (studies/benchmark_shapes.py)."""
    forces = [state.force_on("pole")[2] for state in pole]
    assert forces == pytest.approx([-327.3] * 2, rel=0.1)
    assert forces[1] == pytest.approx(-327.3, rel=0.03)


def test_action_is_reaction_across_the_gap(pole):
    """Force and torque, with elements wider than the gap."""
    for state in pole:
        parts = ("pole", BOX, "coil")
        forces = np.array([state.force_on(part) for part in parts])
        torques = np.array([state.torque_on(part, [0.05, 0.0, 0.0]) for part in parts])
        assert np.abs(forces.sum(axis=0)).max() < 2e-3 * np.abs(forces).max()
        assert np.abs(torques.sum(axis=0)).max() < 2e-3 * np.abs(torques).max()
        # The device has twofold symmetry, which the mesh does not have.
        assert np.abs(forces[0, :2]).max() < 0.02 * abs(forces[0, 2])


def test_force_is_the_derivative_of_the_coenergy(pole):
    """The pole moved by 25 um either way in the gap of 1 mm, in saturation: 1 %."""
    device, step = fm.read_device("pole_in_box"), 2.5e-5

    def coenergy(shift):
        bodies = [body.moved([0, 0, shift]) if body.name == "pole" else body for body in device.bodies]
        return solved(replace(device, bodies=bodies), 0.5).coenergy()

    work = (coenergy(step) - coenergy(-step)) / (2 * step)
    assert work == pytest.approx(pole[0].force_on("pole")[2], rel=0.01)


def test_sections_of_pole_and_box_converge(pole):
    coarse, fine = ([state.section_flux_density(s) for s in state.sections] for state in pole)
    assert coarse == pytest.approx(fine, rel=0.04)
    assert fine[0] == pytest.approx(1.826, rel=0.01)


@pytest.fixture(scope="module")
def plates():
    device = fm.read_device("thin_plates")
    return [solved(device, refinement, [1.0]) for refinement in (0.5, 0.7)]


def test_sections_of_thin_plates_converge(plates):
    coarse, fine = ([state.section_flux_density(s) for s in state.sections] for state in plates)
    assert coarse == pytest.approx(fine, rel=0.015)
    assert all(1 > b > 0 for b in fine[2:])


def test_flux_of_the_plate_returns_through_both_channels(plates):
    """Half a turn about z takes the device to itself, so both channels carry the same flux. Together they carry the
    plate's flux and a third more, which the coil drives through them without the plate."""
    state = plates[1]
    by_name = {section.name: section for section in state.sections}
    back = by_name["channel back"]
    left = replace(back, origin=back.origin * [-1, -1, 1], bodies=("left channel",))
    right_flux, left_flux = state.section_flux(back).flux, state.section_flux(left).flux
    assert left_flux == pytest.approx(right_flux, rel=5e-3)
    middle = state.section_flux("plate middle").flux
    assert 0.5 * middle < right_flux + left_flux < middle * 1.4


def test_gap_field_of_thin_plates(plates):
    """In the middle of the gap of 0.5 mm, where plate and channel face each other."""
    coarse, fine = (state.field([1.85e-3, 0.02, 0.0624]) for state in plates)
    assert fine == pytest.approx(coarse, abs=0.05 * np.linalg.norm(fine))
    assert abs(fine[0]) > 0.95 * np.linalg.norm(fine)
