"""The figures are drawn, and what is marked in them lies where the numbers say."""

import numpy as np
import pytest
from matplotlib.figure import Figure

from fieldmap.thesis import planar_unit
from fieldmap.view.thesis_figures import FIGURES, electromagnet_force, planar_ratios, save_thesis_figures


def test_all_figures_are_written(tmp_path):
    paths = save_thesis_figures(tmp_path / "new" / "folder")
    assert [path.stem for path in paths] == list(FIGURES)
    assert all(path.read_bytes()[:4] == b"\x89PNG" for path in paths)


def test_the_sphere_is_marked_where_force_and_weight_cross():
    figure = Figure()
    electromagnet_force(figure)
    curve, weight, mark = figure.axes[0].lines
    depth, force = (float(value[0]) for value in mark.get_data())
    assert np.interp(depth, *curve.get_data()) == pytest.approx(force, rel=1e-6)
    assert weight.get_ydata()[0] == pytest.approx(force)
    assert 44 < depth < 45


def test_equilibria_are_marked_on_the_maxima():
    figure = Figure()
    planar_ratios(figure)
    box = figure.axes[0].lines
    for curve, mark in list(zip(box[::2], box[1::2], strict=True))[1:]:
        x, field = curve.get_data()
        assert abs(x[np.argmax(field)] - mark.get_xdata()[0]) < 2e3 * planar_unit.WINDOW / 299
