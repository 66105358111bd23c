"""The iron's reaction to dipoles against closed series, and against itself."""

import numpy as np
import pytest
from scipy.constants import mu_0

import fieldmap as fm
from fieldmap.device.materials.froehlich import Froehlich
from fieldmap.iron.solvers.linear import solve_linear_and_reaction

RADIUS = 0.02
BOX = np.array([-0.004, -0.004, -0.046]), np.array([0.004, 0.004, -0.034])
DISTANCES = np.array([0.034, 0.038, 0.046])
STRONG = 150.0


def ball(material, size=0.004):
    """A ball of iron at the origin, and a coil far above it."""
    body = fm.Body("ball", material.name, (fm.Part(fm.Sphere(RADIUS)),), size)
    ring = fm.CircularCoil("1", 0.01, 0.02, 0.01, 2000.0, placement=fm.Placement([0.0, 0.0, 0.03]))
    return fm.Device("ball", "", (ring,), (body,), {material.name: material})


def series(mu_r, d):
    """Reaction of a permeable ball to a dipole of 1 A m^2 at distance d, at the dipole: along the radius and across,
    and the same for the force away from the ball.

    To a potential r^l P_l the ball answers -chi a^(2l+1) / r^(l+1) P_l, chi = l (mu_r - 1) / (l mu_r + l + 1): Jackson,
    section 4.4, in its magnetic form."""
    l = np.arange(1, 200)[:, None]
    share = mu_0 / (4 * np.pi) * l * (mu_r - 1) / (l * mu_r + l + 1) * (RADIUS / d) ** (2 * l + 1) / d**3
    both = np.stack([(l + 1) ** 2 * share, l * (l + 1) / 2 * share])
    return both.sum(axis=1), -(both * (l + 2) / d).sum(axis=1)


def own(reaction, points):
    """A (n, 3, 3) at equal places, and the force (n, 3, 3) on unit dipoles along each axis."""
    b, g = reaction.fields(points)
    return np.einsum("k,kni,knj->nij", reaction.signs, b, b), np.einsum(
        "k,kni,knij->nij", reaction.signs, b, g
    )


@pytest.mark.parametrize(("mu_r", "within"), [(0.2, 1e-2), (2.0, 5e-3), (10.0, 5e-3), (10_000.0, 5e-3)])
def test_ball(mu_r, within):
    """Iron that is less permeable than air repels. Mesh elements are as wide as a fifth of the ball's radius."""
    _, found, _ = solve_linear_and_reaction(ball(fm.LinearMaterial("iron", mu_r)), box=BOX)
    assert (found.repelled == len(found.charge)) == (mu_r < 1)
    points = np.column_stack([0 * DISTANCES, 0 * DISTANCES, -DISTANCES])
    flux, force = own(found, points)
    exact, away = series(mu_r, DISTANCES)
    assert flux[:, 2, 2] == pytest.approx(exact[0], rel=within)
    assert flux[:, 0, 0] == pytest.approx(exact[1], rel=within)
    # Away from the ball is down.
    assert force[:, 2, 2] == pytest.approx(-away[0], rel=within)
    assert force[:, 0, 2] == pytest.approx(-away[1], rel=within)
    # The stated error of the fields is the error at dipoles that had no part in their choice.
    assert found.error < 5e-3
    assert found.asymmetry < 1e-3
    # Elements of 4 mm, 14 mm from the box.
    assert found.width == pytest.approx(4 / 14, rel=0.2)


def test_size_scales_out():
    """All lengths doubled: A falls by 8, the force by 16."""
    small, large = ball(fm.LinearMaterial("iron", 100.0)), ball(fm.LinearMaterial("iron", 100.0))
    doubled = fm.Body("ball", "iron", (fm.Part(fm.Sphere(2 * RADIUS)),), 0.008)
    ring = fm.CircularCoil("1", 0.02, 0.04, 0.02, 100.0, placement=fm.Placement([0.0, 0.0, 0.16]))
    large = fm.Device("ball", "", (ring,), (doubled,), large.materials)
    points = np.array([[0.001, 0.002, -0.037]])
    found = [
        solve_linear_and_reaction(device, box=(k * BOX[0], k * BOX[1]))[1]
        for k, device in ((1.0, small), (2.0, large))
    ]
    pairs = [own(found[0], points), own(found[1], 2.0 * points)]
    assert found[0].width == pytest.approx(found[1].width, rel=1e-6)
    assert 8.0 * pairs[1][0] == pytest.approx(pairs[0][0], rel=1e-6)
    assert 16.0 * pairs[1][1] == pytest.approx(pairs[0][1], rel=1e-6)


def test_saturating_iron_reacts_like_its_tangent():
    """Without currents it reacts like linear iron of the initial permeability; saturated by its coil it reacts less."""
    law = Froehlich("iron", 100.0, 1.0)
    solver = fm.iron.NonlinearSolver(ball(law))
    found = solver.reaction_in(BOX, others=[np.array([STRONG])])
    _, linear, _ = solve_linear_and_reaction(ball(fm.LinearMaterial("iron", 100.0)), box=BOX)
    points = np.array([[0.0, 0.0, -0.036], [0.002, 0.001, -0.042]])
    assert own(found, points)[1] == pytest.approx(own(linear, points)[1], rel=2e-3, abs=1e-6)
    strong = solver.reaction_in(BOX, currents=np.array([STRONG]))
    weaker = own(strong, points)[1][:, 2, 2] / own(found, points)[1][:, 2, 2]
    assert (weaker < 0.99).all()
    # The stated change is the largest over the box; these are two places.
    assert found.change > 0.9 * (1.0 - weaker).max()
