"""Force and torque on a point dipole against the closed form of two dipoles and the thesis's equations."""

import numpy as np
import pytest

from fieldmap.errors import InputError
from fieldmap.lookup import MagneticBody, interpolate
from tests.refusals import refused

MU0 = 4e-7 * np.pi
MOMENT = np.array([0.3, 0.5, 1.0])


def force_between(moment, position, source_moment, source):
    """Force on `moment` at `position` by another dipole: Yung, Landecker, Villani, Magn. Electr. Sep. 9 (1998)."""
    r = position - source
    d = np.linalg.norm(r)
    n = r / d
    a, b = source_moment @ n, moment @ n
    bracket = a * moment + b * source_moment + (source_moment @ moment) * n - 5 * a * b * n
    return 3 * MU0 / (4 * np.pi * d**4) * bracket


@pytest.mark.parametrize("coil", [0, 1, 2])
def test_force_and_torque_between_two_dipoles(fine, dipoles, coil):
    moment = np.array([0.2, -0.4, 0.8])
    currents = np.eye(3)[coil]
    for position in dipoles.points(10, seed=coil):
        source_moment, source = dipoles.moments[coil], dipoles.sources[coil]
        force = force_between(moment, position, source_moment, source)
        field = dipoles.field(source_moment, source, position[None])[0]
        wrench = fine.wrench(position, moment, currents)
        np.testing.assert_allclose(wrench[:3], force, rtol=0, atol=2e-4 * np.abs(force).max())
        torque = np.cross(moment, field)
        np.testing.assert_allclose(wrench[3:], torque, rtol=0, atol=1e-5 * np.linalg.norm(field))


def work_around_a_loop(field, n):
    """Work on a dipole along a closed path in n steps, and the mean of the power's magnitude."""
    angle = 2 * np.pi * np.arange(n) / n
    circle = np.stack(
        [0.012 * np.cos(angle), 0.012 * np.sin(angle), 0.005 * np.sin(2 * angle) - 0.01], axis=1
    )
    step = np.stack([-0.012 * np.sin(angle), 0.012 * np.cos(angle), 0.01 * np.cos(2 * angle)], axis=1)
    power = np.einsum("nj,nj->n", field.wrench(circle, MOMENT, [1.0, 1.0, 1.0])[:, :3], step)
    cells = np.floor((circle - field.lower) / field.info.grid.spacing)
    crossings = np.abs(np.diff(np.append(cells, cells[:1], axis=0), axis=0)).sum()
    return power.sum() * 2 * np.pi / n, np.abs(power).mean(), crossings


def test_work_around_a_loop_vanishes(dipoles):
    # F is the gradient of m . B of the interpolant itself: conservative even on a coarse grid. Trapezoid sums over a
    # smooth closed path converge fast; a force without an energy would leave a constant.
    work, power, _ = work_around_a_loop(interpolate(dipoles.map((6, 5, 6)), "hermite"), 800)
    assert abs(work) < 1e-6 * power


def test_work_around_a_loop_through_many_cells_is_the_sum_of_their_steps(coarse):
    work, power, crossings = work_around_a_loop(coarse, 20_000)
    step = np.linalg.norm(MOMENT) * coarse.jump().flux_density_bound
    assert crossings >= 8
    assert abs(work) < crossings * step + 1e-6 * power
    assert crossings * step < 0.2 * power  # the bound says something


def test_one_moment_for_all_or_one_each(coarse, dipoles):
    points = dipoles.points(4)
    moment = np.array([0.1, 0.2, 0.3])
    same = coarse.wrench(points, moment, [1, 1, 1])
    np.testing.assert_array_equal(same, coarse.wrench(points, np.tile(moment, (4, 1)), [1, 1, 1]))
    with pytest.raises(InputError, match=r"3 .* 4 ") as caught:
        coarse.wrench(points, np.ones((3, 3)), [1, 1, 1])
    assert caught.value.problems[0].where == "moments"


@pytest.mark.parametrize(
    ("points", "moments", "where"),
    [
        (np.zeros((2, 3)), np.ones((1, 3)), "MagneticBody(points, moments)"),
        (np.zeros(3), np.ones(3), "MagneticBody(points, moments)"),
        (np.zeros((1, 2)), np.ones((1, 2)), "MagneticBody(points, moments)"),
        (np.zeros((3, 3, 3)), np.ones((3, 3, 3)), "MagneticBody(points, moments)"),
        (np.zeros((1, 3)), np.ones((2, 3)), "MagneticBody(points, moments)"),
        (0.0, 0.0, "MagneticBody(points, moments)"),
        (np.full((1, 3), np.inf), np.ones((1, 3)), "MagneticBody(points)"),
        (np.zeros((1, 3)), np.full((1, 3), np.nan), "MagneticBody(moments)"),
    ],
)
def test_dipoles_of_other_shapes_are_no_body(points, moments, where):
    with refused(InputError, where=where):
        MagneticBody(points, moments)
