"""The kernels of a lookup for compiled callers, in all forms, against the C core.

Small, because these tests run without compilation as well: there an index out of range raises.
"""

import numpy as np
import pytest

from fieldmap.core import CoreMap
from fieldmap.interpolants.form import completed, contract
from fieldmap.kernels.map import lookup
from tests.core.map_cases import CURRENTS, KINDS, block_of

POINT = np.array([-0.2, 0.25, 1.1])


@pytest.mark.parametrize("kind", list(KINDS))
def test_doors_for_compiled_callers(kind):
    block, size = block_of(kind)
    expected = CoreMap(block).field_at(POINT, CURRENTS)
    units, slopes = np.empty((1, 2, 3)), np.empty((1, 2, 3, 3))
    assert lookup.evaluate_units(block, POINT[None], units, slopes) == 0
    for flux, slope in (
        lookup.at(completed(contract(block, CURRENTS, size)), *POINT),
        lookup.at_currents(block, CURRENTS, *POINT),
        (CURRENTS @ units[0], np.tensordot(CURRENTS, slopes[0], 1)),
    ):
        np.testing.assert_allclose(flux, expected[0], rtol=1e-12)
        np.testing.assert_allclose(slope, expected[1], rtol=1e-11)
