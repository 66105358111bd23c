"""Linear iron is reported beyond its law as soon as the field in a sphere passes the saturation of its material."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.constants import mu_0

import fieldmap as fm
from fieldmap import read_device, solve_linear
from fieldmap.iron.notes import MOST_OF_ANY_IRON, bodies_beyond_saturation, largest_polarisation
from fieldmap.iron.solution import FluxDensitySamples
from tests.conftest import DEVICES


@pytest.fixture(scope="module")
def sphere():
    device = read_device(DEVICES / "sphere_in_wide_loop.toml")
    return device, solve_linear(device)


def test_a_sphere_is_beyond_saturation_where_three_times_the_applied_field_reaches_its_saturation(sphere):
    device, solution = sphere
    # B inside = 3 mu_r / (mu_r + 2) times the applied field, which is mu0 N i / 2a in the middle of the loop.
    per_ampere = 3 * 1000 / 1002 * mu_0 * 1000 / 0.2
    critical = 1.5 / per_ampere
    assert bodies_beyond_saturation(solution, device, [0.97 * critical]) == ()
    (found,) = bodies_beyond_saturation(solution, device, [1.03 * critical])
    assert (found.body, found.material, found.most) == ("sphere", "iron", 1.5)
    assert found.share > 0.9
    (ten_times,) = bodies_beyond_saturation(solution, device, [-10 * critical])
    assert ten_times.share == 1.0
    assert ten_times.largest == pytest.approx(15.0, rel=0.05)


def test_the_share_is_that_of_the_volume_of_this_body(sphere):
    """Two of the sphere's four samples are above 1.5 T. Samples of the other body do not count, and a share of at most
    a hundredth is not reported."""
    device, _ = sphere
    size, weight, body = [1.4, 1.6, 1.9, 1.5, 3.0], [5.0, 1.0, 3.0, 1.0, 7.0], [1, 1, 1, 1, 0]

    def found(weight):
        arrays = (np.array(values) for values in (size, weight, body))
        samples = FluxDensitySamples(*arrays, ("other", "sphere"))
        return bodies_beyond_saturation(
            SimpleNamespace(flux_density_samples=lambda currents: samples), device, [1.0]
        )

    (one,) = found(weight)
    assert (one.body, one.share, one.largest) == ("sphere", 0.4, 1.9)
    assert found([98.0, 0.5, 0.5, 1.0, 7.0]) == ()
    assert found([97.0, 0.5, 1.5, 1.0, 7.0])[0].share == pytest.approx(0.02)


@pytest.mark.parametrize("form", ["potential", "flux", "surface"])
def test_samples_weigh_what_they_stand_for(form):
    """Two balls far apart in a uniform field B0: B = 3 mu_r / (mu_r + 2) B0; weights sum to the volume or surface."""
    about = {"near": (0.05, 10.0, 0.0), "far": (0.03, 4.0, 1.0)}
    bodies = [
        fm.Body(name, name, (fm.Part(fm.Sphere(radius), fm.placed((0.0, 0.0, z))),), 0.4 * radius)
        for name, (radius, _, z) in about.items()
    ]
    laws = {name: fm.LinearMaterial(name, mu_r) for name, (_, mu_r, _) in about.items()}
    device = fm.Device("d", "", (), bodies, laws, background=fm.Background(0.1 * np.array([0.6, 0.0, 0.8])))
    samples = solve_linear(device, form=form).flux_density_samples(np.zeros(0))
    assert samples.body_names == tuple(about)
    for number, (radius, mu_r, _) in enumerate(about.values()):
        mine = samples.body == number
        whole = 4 * np.pi * radius**2 if form == "surface" else 4 / 3 * np.pi * radius**3
        # Flat faces enclose a little less.
        assert samples.weight[mine].sum() == pytest.approx(whole, rel=0.1)
        mean = samples.weight[mine] @ samples.size[mine] / samples.weight[mine].sum()
        assert mean == pytest.approx(0.3 * mu_r / (mu_r + 2), rel=0.02)


def test_the_largest_polarisation_of_a_law():
    h, b = np.array([100.0, 1e4, 1e5]), np.array([0.5, 1.6, 1.8])
    table = fm.BHTable("t", h, b, "straight line to the origin", "slope mu0", 4000.0)
    assert largest_polarisation(table) == pytest.approx(1.8 - mu_0 * 1e5)
    rising = fm.BHTable(
        "t", h, b, "straight line to the origin", "towards saturation", 4000.0, saturation=2.1
    )
    assert largest_polarisation(rising) == 2.1
    assert largest_polarisation(fm.Arctangent("a", 500.0, 1.9)) == 1.9
    # mu0 dH/dB = 1 at the end of the law: its polarisation is the maximum over a fine grid of the formula.
    marrocco = fm.Marrocco("m", 2e-4, 1.0, 5.5, 5e4)
    flux = np.linspace(0.0, 2.3, 20001)
    power = flux**11
    polarisation = flux * (1 - (2e-4 + (1 - 2e-4) * power / (power + 5e4)))
    assert largest_polarisation(marrocco) == pytest.approx(polarisation.max(), rel=1e-6)
    # The bound is iron-cobalt for a material without a law, and where the reluctivity stays below free space's (c < 1).
    for endless in (fm.LinearMaterial("l", 4000.0), fm.Marrocco("m", 2e-4, 1e-3, 5.5, 5e4)):
        assert largest_polarisation(endless) == MOST_OF_ANY_IRON
