import control
import numpy as np
import pytest

from fieldmap.control import from_roots, pid_transfer_function, transfer_function
from fieldmap.control.identification import root_locus
from fieldmap.errors import InputError

PLANT = from_roots(-0.03, [0.9935], [1.01, 0.905])
UNIT = pid_transfer_function(1.0, 0.007, 0.001, 2e-3)
CONTROLLER = transfer_function(-UNIT.numerator, UNIT.denominator)


def test_against_python_control():
    gains = np.linspace(0.05, 1.5, 30)
    ours = root_locus(PLANT, CONTROLLER, gains)
    loop = control.tf(*PLANT, 2e-3) * control.tf(*CONTROLLER, 2e-3)
    theirs = control.root_locus_map(loop, gains=gains).loci
    for mine, other in zip(ours.poles, theirs, strict=True):
        np.testing.assert_allclose(np.sort_complex(mine), np.sort_complex(other), atol=1e-9)


def test_branches_are_followed_through_equal_magnitudes():
    """A real pole overtakes a complex pair in magnitude: sorting by size jumps there, the branches do not."""
    plant = from_roots(1.0, [0.95], [0.5, 0.6 + 0.3j, 0.6 - 0.3j])
    poles = root_locus(plant, ([1.0], [1.0]), np.linspace(0.01, 2.0, 400)).poles
    by_size = np.array([p[np.argsort(np.abs(p))] for p in poles])
    assert np.abs(np.diff(by_size, axis=0)).max() > 0.2
    assert np.abs(np.diff(poles, axis=0)).max() < 0.05


def test_few_gains_follow_the_same_branches_as_many():
    gains = np.linspace(0.15, 0.33, 200)  # no two poles meet in between
    fine = root_locus(PLANT, CONTROLLER, gains).poles[-1]
    np.testing.assert_allclose(root_locus(PLANT, CONTROLLER, [0.15, 0.33]).poles[-1], fine, atol=1e-9)


def test_the_arc_of_figure_5_6():
    """As the gain falls, the complex pair of the model moves out to the unit circle, like the poles of Table 5-2."""
    locus = root_locus(PLANT, CONTROLLER, [0.05, 0.15, 0.2, 0.334, 0.5])
    size = np.array([np.abs(p[np.argmax(p.imag)]) for p in locus.poles])
    assert np.all(np.diff(size) < 0)
    assert locus.stable.tolist() == [False, True, True, True, True]


def test_a_loop_that_answers_at_once():
    """With as many zeros as poles the leading coefficient depends on the gain: (q - 0.9)^2 + k (q - 0.5)^2."""
    gains = np.array([0.5, 1.0, 2.0])
    poles = root_locus(([1.0, -1.0, 0.25], [1.0, -1.8, 0.81]), ([1.0], [1.0]), gains).poles
    root = 1j * np.sqrt(gains)
    wanted = np.stack([(0.9 - 0.5 * root) / (1.0 - root), (0.9 + 0.5 * root) / (1.0 + root)], axis=1)
    np.testing.assert_allclose(np.sort_complex(poles), np.sort_complex(wanted), atol=1e-12)


def test_unsorted_gains():
    with pytest.raises(InputError, match="sort"):
        root_locus(PLANT, CONTROLLER, [0.5, 0.2, 0.3])
