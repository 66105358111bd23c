"""Branches that are followed in a parameter, against known curves."""

import numpy as np
import pytest

from fieldmap.errors import NotConverged
from fieldmap.levitation.continuation import follow_branch

FOLD = 2.0 / (3.0 * np.sqrt(3.0))


def cubic(q, p):
    """q^3 - q + p = 0: turns back at q = 1 / sqrt(3), p = 2 / (3 sqrt(3)), and opposite."""
    return q**3 - q + p


def cubic_slope(q, p):
    return np.array([[3.0 * q[0] ** 2 - 1.0]])


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize("slope", [None, cubic_slope])
@pytest.mark.parametrize("way", [1.0, -1.0])
def test_both_ways_round_the_folds(way, slope, sign):
    """From the upper end up to the fold and on to the edge, and the mirror image; also with the equation's sign
    reversed."""
    found = follow_branch(
        lambda q, p: sign * cubic(q, p),
        [way],
        [0.0, 0.2 * way, 0.6 * way],
        [1.0, 1.0],
        slope=slope and (lambda q, p: sign * slope(q, p)),
        limits=(-1.0, 1.0),
    )
    assert [fold.parameter for fold in found.folds] == pytest.approx([way * FOLD, -way * FOLD], rel=1e-6)
    unknowns = [fold.unknowns[0] for fold in found.folds]
    assert unknowns == pytest.approx([way / np.sqrt(3), -way / np.sqrt(3)], abs=1e-4)
    # Cardano's: q = 2 / sqrt(3) cos(arccos(-p 3 sqrt(3) / 2) / 3) on the branch through q = 1.
    at = way * 2.0 / np.sqrt(3.0) * np.cos(np.arccos(-0.2 * 1.5 * np.sqrt(3.0)) / 3.0)
    assert found.at_stops[:, 0] == pytest.approx([way, at], rel=1e-9)
    assert found.ended == "edge"
    assert np.abs(cubic(found.unknowns[:, 0], found.parameters)).max() < 1e-8
    assert (np.diff(found.unknowns[:, 0]) * way < 0).all()


def test_what_a_parameter_is_measured_in_changes_nothing():
    """The circle q^2 + p^2 = 1 in a unit of q a thousand times smaller: the same points except for the steps."""
    fine = follow_branch(
        lambda q, p: (1e-3 * q) ** 2 + p**2 - 1.0, [1e3], [0.0, 0.6, 2.0], [1e3, 1.0], limits=(-0.8, 2.0)
    )
    assert fine.at_stops[:, 0] == pytest.approx([1e3, 0.8e3], rel=1e-8)
    assert [fold.parameter for fold in fine.folds] == pytest.approx([1.0], rel=1e-8)
    # The branch continues on the other side as far as the parameter may go.
    assert fine.ended == "edge"
    assert (fine.parameters[-1], fine.unknowns[-1, 0]) == pytest.approx((-0.8, -0.6e3), abs=0.1e3)


@pytest.mark.parametrize("sloped", [False, True])
def test_what_any_number_is_measured_in_changes_nothing(sloped):
    """The circle q^2 + p^2 = 1 and r = 2 q, with p in hundredths, q in thousands and r in another unit; the branch ends
    at p = 0.9, or at q = -0.5."""
    units = np.array([1e3, 0.2, 100.0])

    def residual(v, p):
        q, r, p = v[0] / 1e3, v[1] / 0.2, p / 100.0
        return np.array([q**2 + p**2 - 1.0, r - 2.0 * q])

    def slope(v, p):
        return np.array([[2.0 * v[0] / 1e6, 0.0], [-2.0 / 1e3, 1.0 / 0.2]])

    about = [1e3, 0.41], [0.0, 60.0, 200.0], units, slope if sloped else None
    found = follow_branch(residual, *about, limits=(-80.0, 90.0))
    np.testing.assert_allclose(found.at_stops, [[1e3, 0.4], [0.8e3, 0.32]], rtol=1e-8)
    assert found.ended == "edge"
    assert found.parameters[-1] == pytest.approx(90.0, abs=1e-3)
    turned = follow_branch(
        residual, *about, lambda v: v[0] > -500.0 and abs(v[1]) < 0.5, limits=(-80.0, 150.0)
    )
    assert turned.unknowns[-1] == pytest.approx([-500.0, -0.2], abs=0.01)
    assert [fold.parameter for fold in turned.folds] == pytest.approx([100.0], rel=1e-8)


@pytest.mark.parametrize("way", [-1.0, 1.0])
def test_two_stops_rise_or_fall(way):
    found = follow_branch(lambda q, p: q - p, [0.0], [0.0, way], [1.0, 1.0])
    assert (found.ended, found.at_stops[:, 0].tolist()) == ("last stop", pytest.approx([0.0, way]))
    assert len(found.parameters) == 1 + np.ceil(np.sqrt(2.0) / 0.05)


def test_how_a_branch_ends():
    line = ([0.0], [0.0, 0.5, 1.0], [1.0, 1.0])
    reached = follow_branch(lambda q, p: q - p, *line)
    assert reached.ended == "last stop"
    assert reached.at_stops[:, 0] == pytest.approx([0.0, 0.5, 1.0], abs=1e-9)
    assert reached.parameters[-1] == pytest.approx(1.0, abs=1e-9)
    inside = follow_branch(lambda q, p: q - p, *line, inside=lambda q: q[0] < 0.7)
    assert inside.ended == "edge"
    assert inside.at_stops[:, 0] == pytest.approx([0.0, 0.5], abs=1e-9)
    # Steps are halved down to a ten-thousandth of the largest.
    assert 0.7 - 1e-5 < inside.parameters[-1] < 0.7
    # Steps of 0.02 along a slope of 1.
    few = follow_branch(lambda q, p: q - p, *line, step=0.02, most_steps=10)
    assert few.ended == "steps"
    assert few.parameters == pytest.approx(0.02 / np.sqrt(2.0) * np.arange(11), abs=1e-9)
    with pytest.raises(NotConverged):
        follow_branch(lambda q, p: q**2 + 1.0 + p, [0.0], [0.0, 1.0], [1.0, 1.0])


@pytest.mark.parametrize(("jump", "small"), [(4e-6, True), (1e-7, True), (6e-6, False)])
def test_a_residual_that_steps_by_an_error_is_followed(jump, small):
    """A line with a step at zero, as an interpolated force has between cells: Newton's steps alternate by twice the
    jump, which counts as small below 1e-5 of the scale."""

    def line():
        slope, stops = (lambda q, p: np.eye(1)), [0.0, 0.5, 1.0]
        return follow_branch(
            lambda q, p: q - p + jump * np.where(q - p > 0.0, 1.0, -1.0),
            [0.1],
            stops,
            [1.0, 1.0],
            slope=slope,
        )

    if small:
        found = line()
        assert found.ended == "last stop"
        np.testing.assert_allclose(found.unknowns[:, 0], found.parameters, atol=1.5 * jump)
        assert found.at_stops[:, 0] == pytest.approx([0.0, 0.5, 1.0], abs=1.5 * jump)
    else:
        with pytest.raises(NotConverged):
            line()
