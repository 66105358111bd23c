"""Texts on a picture: their anchor; and numbers in words, each case with a different number."""

from types import SimpleNamespace

import numpy as np
import pytest

pytest.importorskip("pyvista")
from vtkmodules.vtkRenderingCore import vtkTextProperty

from fieldmap.plot import words
from fieldmap.plot.scales import add_words


@pytest.mark.parametrize(
    ("height", "place"), [(0.98, "Top"), (0.51, "Top"), (0.5, "Bottom"), (0.02, "Bottom")]
)
def test_words_hang_from_their_place_in_the_upper_half_and_stand_on_it_below(height, place):
    drawn = SimpleNamespace(prop=vtkTextProperty())
    given = {}
    scene = SimpleNamespace(add_text=lambda words, **how: given.update(how, words=words) or drawn)
    add_words(scene, "one\ntwo", (0.03, height), 15)
    assert drawn.prop.GetVerticalJustificationAsString() == place
    assert (given["words"], given["position"], given["font_size"]) == ("one\ntwo", (0.03, height), 15)
    assert given["viewport"]
    assert given["render"] is False


@pytest.mark.parametrize(
    ("function", "given", "expected"),
    [
        # From half a unit on the unit is kept, for either sign; nanometres are the smallest unit.
        *(
            (words.fitting_prefix, (size,), (prefix, factor))
            for size, prefix, factor in [
                (0.5, "", 1.0),
                (-12.0, "", 1.0),
                (0.4999, "m", 1e3),
                (-5e-4, "m", 1e3),
                (4.999e-4, "u", 1e6),
                (5e-7, "u", 1e6),
                (4.99e-7, "n", 1e9),
                (1e-12, "n", 1e9),
                (0.99e-12, "", 1.0),
                (0.0, "", 1.0),
                (np.nan, "", 1.0),
                (np.inf, "", 1.0),
            ]
        ),
        (words.fixed, (-0.004, 2), "0.00"),
        (words.fixed, (-0.006, 2), "-0.01"),
        (words.fixed, (12.346, 1), "12.3"),
        (words.millimetres, ([0.0012345, -0.02, 0.1],), "(1.2345, -20, 100)"),
        (words.amperes_in_words, ([2.5], ("one",)), "2.5 A in the coil"),
        (words.amperes_in_words, ([-1.5] * 3, ("a", "b", "c")), "-1.5 A in each of 3 coils"),
        (words.amperes_in_words, ([1.0, -2.25], ("left", "right")), "left: 1 A, right: -2.25 A"),
        # Four digits for the largest component, and at most three decimals.
        (words.force_in_words, ([0.0, -1.23456, 0.5],), "(0.000, -1.235, 0.500) N"),
        (words.force_in_words, ([12.3456, 0.0, -1.0],), "(12.35, 0.00, -1.00) N"),
        (words.force_in_words, ([0.0, 0.0, -0.1234567],), "(0.0, 0.0, -123.5) mN"),
        (words.force_in_words, ([0.0, 54321.6, 0.0],), "(0, 54322, 0) N"),
        (words.force_in_words, ([0.0, 0.0, 0.0],), "(0.0, 0.0, 0.0) N"),
        (words.unit_in_words, ("N m-1",), "N/m"),
        (words.unit_in_words, ("mm2",), "mm²"),
        (words.unit_in_words, ("1",), ""),
        (words.unit_in_words, ("T",), "T"),
        (words.with_unit, ("stiffness", "N m-1"), "stiffness (N/m)"),
        (words.with_unit, ("share", "1"), "share"),
        (words.with_unit, ("share", ""), "share"),
        # At most six steps of 1, 2 or 5 times a power of ten for a span.
        *(
            (words.label_step, (span,), pytest.approx(step))
            for span, step in [(6.0, 1.0), (6.01, 2.0), (12.0, 2.0), (12.1, 5.0), (30.0, 5.0), (30.1, 10.0)]
        ),
        (words.label_step, (0.025,), pytest.approx(0.005)),
        (words.round_numbers, (-0.5, 1.0, 0.25), pytest.approx([-0.5, -0.25, 0.0, 0.25, 0.5, 0.75, 1.0])),
        (words.round_numbers, (0.1, 0.3, 0.1), pytest.approx([0.1, 0.2, 0.3])),
        (words.round_numbers, (-19.0, 21.0, 20.0), pytest.approx([0.0, 20.0])),
        *(
            (words.decimals_of, (step,), decimals)
            for step, decimals in [(100.0, 0), (1.0, 0), (0.5, 1), (0.1, 1), (0.02, 2), (0.001, 3)]
        ),
    ],
)
def test_numbers_in_words(function, given, expected):
    found = function(*(np.array(one) if isinstance(one, list) else one for one in given))
    assert (found.tolist() if isinstance(found, np.ndarray) else found) == expected
