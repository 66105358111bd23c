"""Bodies that act on each other, in random fields and with a random reaction."""

import numpy as np
import pytest

from fieldmap.core import CoreMap
from fieldmap.core.body import CoreBody, wrench_slopes
from fieldmap.core.machine import INSIDE, STATE, CoreMachine
from fieldmap.core.several_bodies import CoreSeveralBodies
from tests.core.map_cases import CURRENTS, block_of
from tests.core.test_machine import MIDDLE, body_numbers, plant, state_at
from tests.core.test_soft_iron import DIPOLES, POSE, TURN, induced, pieces

PLACES = 0.02 * np.array([[0.0, 0.0, 0.0], [1.0, 0.5, -0.8], [-0.7, 1.0, 0.5]])
TURNS = np.array([POSE, TURN, POSE @ TURN])
WEIGHTS, FIELDS, REPELLED = np.array([0.3, -0.2, 0.4]), 4, 1


def loads(fields, reaction, bodies, weights=WEIGHTS):
    """Wrench (3, 6) and its slopes (3, 6, k)."""
    wrench, slopes = np.empty((3, 6)), np.empty((3, 6, len(weights)))
    assert wrench_slopes(bodies, PLACES, TURNS, weights, fields, reaction, wrench, slopes)
    return wrench, slopes


@pytest.fixture
def bodies(library):
    """A magnet with two soft pieces, soft iron with a law, and a magnet."""
    sphere, needle = pieces()
    return [CoreBody(DIPOLES, [sphere, needle]), CoreBody(DIPOLES[:0], [needle]), CoreBody(DIPOLES)]


@pytest.fixture
def random():
    """Random fields and a random reaction at the five points, with independent gradients."""
    rng = np.random.default_rng(5)
    fields = rng.normal(size=(5, 3, 3)), rng.normal(size=(5, 3, 3, 3))
    return fields, (REPELLED, 0.1 * rng.normal(size=(5, FIELDS, 3)), rng.normal(size=(5, FIELDS, 3, 3)))


def test_slopes_are_those_of_the_wrench(random, bodies):
    _, slopes = loads(*random, bodies)
    step = 1e-5
    exact = [
        (loads(*random, bodies, WEIGHTS + step * unit)[0] - loads(*random, bodies, WEIGHTS - step * unit)[0])
        / (2 * step)
        for unit in np.eye(3)
    ]
    np.testing.assert_allclose(slopes, np.moveaxis(exact, 0, -1), rtol=0, atol=1e-6 * np.abs(slopes).max())


def test_moments_and_loads_by_plain_sums(random, bodies):
    """Moments by fixed-point rounds with dipole tensors; loads of all points from these moments."""
    (flux, gradient), (_, back, back_slope) = random
    owner = np.array([0, 0, 0, 1, 2])
    arms = np.array([DIPOLES[0, :3], *(p.centre for p in pieces()), pieces()[1].centre, DIPOLES[0, :3]])
    arms = np.einsum("pij,pj->pi", TURNS[owner], arms)
    r = (PLACES[owner] + arms)[:, None] - (PLACES[owner] + arms)[None]
    other = owner[:, None] != owner[None]
    size = np.where(other, np.linalg.norm(r, axis=2), np.inf)[..., None, None]
    outer = r[..., None] * r[..., None, :]
    near = np.where(other[..., None, None], 1e-7 * (3 * outer / size**5 - np.eye(3) / size**3), 0.0)
    signs = np.where(np.arange(FIELDS) < FIELDS - REPELLED, 1.0, -1.0)
    near = near + np.einsum("k,pki,qkj->pqij", signs, back, back)
    applied = np.einsum("k,pki->pi", WEIGHTS, flux)
    moments = np.zeros((5, 3))
    for _ in range(300):
        whole = applied + np.einsum("pqij,qj->pi", near, moments)
        for body in range(3):
            points = owner == body
            moments[points] = induced(bodies[body], whole[None, points], TURNS[body][None].copy(), soft=0)[0][
                0
            ]
    # The slope of a dipole's field is (15 r r r - 3 r^2 (r 1 + ...)) / r^7; here by differences.
    wrench = np.zeros((3, 6))
    weights = np.einsum("pki,pi->k", back, moments) * signs
    slope = np.einsum("k,pkij->pij", WEIGHTS, gradient) + np.einsum("k,pkij->pij", weights, back_slope)
    for p in range(5):
        force = moments[p] @ slope[p]
        for q in np.flatnonzero(other[p]):
            force = force + [
                moments[p] @ (dipole(r[p, q] + h, moments[q]) - dipole(r[p, q] - h, moments[q])) / 2e-7
                for h in 1e-7 * np.eye(3)
            ]
        torque = np.cross(moments[p], whole[p]) + np.cross(arms[p], force)
        wrench[owner[p]] += [*force, *torque]
    found, _ = loads(*random, bodies)
    np.testing.assert_allclose(found, wrench, rtol=0, atol=1e-6 * np.abs(wrench).max())


def test_loads_in_a_map_are_derivatives_of_the_energy(bodies):
    """With attracting fields of the reaction and a repelling one."""
    (block, size), (back, _) = block_of("global", sets=2), block_of("global", sets=FIELDS)
    weak = back.copy()
    weak[-FIELDS * size :] *= 0.05
    both = CoreMap(block, reaction=CoreMap(weak), repelled=REPELLED)
    numbers = [body_numbers(magnetic=one.body) for one in bodies]
    machine = CoreMachine(plant(2, 2, map=both.map))
    several = CoreSeveralBodies(machine, numbers, np.zeros(3), np.zeros(9))
    assert several.follow(CURRENTS)
    start = np.array([state_at(MIDDLE + place) for place in PLACES])
    loads, unused, step = np.empty((3, 6)), np.empty((3, 6)), 1e-6
    assert several.wrench(start, loads)[0] == INSIDE
    expected = np.empty((3, 3))
    for n, k in np.ndindex(3, 3):
        ends = [several.wrench(start + sign * step * unit(n, k), unused)[1] for sign in (1, -1)]
        expected[n, k] = -(ends[0] - ends[1]) / (2 * step)
    np.testing.assert_allclose(loads[:, :3], expected, rtol=0, atol=1e-6 * np.abs(expected).max())


def unit(n, k):
    """1 in coordinate k of body n."""
    found = np.zeros((3, STATE))
    found[n, k] = 1.0
    return found


def dipole(r, moment):
    """Its field, T, at r from the dipole."""
    size = np.linalg.norm(r)
    return 1e-7 * (3 * (moment @ r) * r / size**5 - moment / size**3)
