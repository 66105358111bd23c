import numpy as np
import pytest
from scipy.special import ellipe, ellipkm1, elliprf, elliprj

from fieldmap.kernels.coils.elliptic import complete_integrals, complete_integrals_three

COMPLEMENTS = 10.0 ** np.linspace(-8, -0.01, 9)


@pytest.mark.parametrize("kc", COMPLEMENTS)
def test_first_and_second_kind_equal_scipy(kc):
    m = (1 - kc) * (1 + kc)
    k, s = complete_integrals(m, kc)
    assert k == pytest.approx(ellipkm1(kc * kc), rel=3e-15)
    assert k * (1 - m / 2 - m * m * s) == pytest.approx(ellipe(m), rel=2e-15)


def test_the_small_difference_keeps_its_digits():
    """E/K = 1 - m/2 - m^2/16 - m^3/32 - 41 m^4/2048 - ..., from the series of K and E."""
    for m in (0.0, 1e-12, 1e-6, 1e-3):
        s = complete_integrals(m, np.sqrt(1 - m))[1]
        assert s == pytest.approx(1 / 16 + m / 32 + 41 * m**2 / 2048, rel=1e-15, abs=0.02 * m**3)


@pytest.mark.parametrize("kc", COMPLEMENTS)
@pytest.mark.parametrize("g", [1.0, 0.3, 1e-3, -1e-3, -0.3, -0.999])
def test_third_kind_equals_carlson_forms(kc, g):
    """cel = R_F + (g - g^2)/3 R_J at (0, kc^2, 1, g^2): Carlson's integrals as scipy computes them."""
    m = (1 - kc) * (1 + kc)
    k, s, cel = complete_integrals_three(m, kc, g)
    assert (k, s) == pytest.approx(complete_integrals(m, kc), rel=2e-15)
    carlson = elliprf(0, kc * kc, 1) + (g - g * g) / 3 * elliprj(0, kc * kc, 1, g * g)
    assert cel == pytest.approx(carlson, rel=1e-13, abs=1e-13 * k)


def test_third_kind_takes_the_mean_at_its_jump():
    kc = 0.4
    m = 1 - kc * kc
    below, at, above = (complete_integrals_three(m, kc, g)[2] for g in (-1e-9, 0.0, 1e-9))
    assert at == pytest.approx((below + above) / 2, rel=1e-8)
    assert above - below == pytest.approx(np.pi / kc, rel=1e-8)
