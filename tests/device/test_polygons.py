"""Simple polygons and refused ones; areas and arcs against elementary geometry."""

import math
import re

import numpy as np
import pytest

from fieldmap.device.polygons import polygon_fault, rounding_fault, signed_area

STAR = [[math.cos(2 * math.pi * 2 * k / 5), math.sin(2 * math.pi * 2 * k / 5)] for k in range(5)]
COMB = [[0, 0], [5, 0], [5, 3], [4, 3], [4, 1], [3, 1], [3, 3], [2, 3], [2, 1], [1, 1], [1, 3], [0, 3]]


@pytest.mark.parametrize("count", [3, 4, 17])
def test_regular_polygons_are_simple_and_have_their_area(count):
    corners = [[math.cos(2 * math.pi * k / count), math.sin(2 * math.pi * k / count)] for k in range(count)]
    assert polygon_fault(corners) is None
    assert signed_area(corners) == pytest.approx(count / 2 * math.sin(2 * math.pi / count))
    assert signed_area(corners[::-1]) == pytest.approx(-count / 2 * math.sin(2 * math.pi / count))


def test_a_comb_is_simple_wherever_it_begins():
    for k in range(len(COMB)):
        assert polygon_fault(COMB[k:] + COMB[:k]) is None


@pytest.mark.parametrize(
    ("points", "words"),
    [
        ([[0, 0], [1, 0]], "only 2 corners"),
        (STAR, "meets"),
        ([[0, 0], [2, 0], [2, 0], [0, 2]], "corners 2 and 3 are the same"),
        ([[0, 0], [4, 0], [2, 0], [2, 2]], "edge 1-2 meets edge 2-3"),  # folds back
        ([[0, 0], [4, 0], [4, 4], [2, 0], [0, 4]], "meets"),  # a corner on another edge
        ([[0, 0], [1, 1], [2, 2], [3, 3]], "meets"),  # all on one line
    ],
)
def test_what_is_not_simple(points, words):
    assert words in polygon_fault(points)


def test_scale_and_place_do_not_matter():
    for scale in (1e-3, 1.0, 1e5):
        moved = (np.array(COMB) * scale + 7 * scale).tolist()
        assert polygon_fault(moved) is None
        assert polygon_fault((np.array(STAR) * scale + 7 * scale).tolist()) is not None


def test_arcs_fit_up_to_half_the_edge_of_a_square():
    square = [[0, 0], [10, 0], [10, 10], [0, 10]]
    assert rounding_fault(square, 5.0) is None
    assert re.findall(r"[\d.]+", rounding_fault(square, 5.1))[:4] == ["1", "2", "10", "10.2"]


def test_the_inscribed_circle_is_the_roundest_a_triangle_can_be():
    triangle = [[0, 0], [30, 0], [0, 40]]  # right angle: inradius (30 + 40 - 50)/2 = 10
    assert rounding_fault(triangle, 10.0) is None
    assert rounding_fault(triangle, 10.001) is not None
