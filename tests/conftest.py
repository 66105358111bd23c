"""What the tests of all packages may use."""

from pathlib import Path

import numpy as np
import pytest

DEVICES = Path(__file__).parent / "devices"


@pytest.fixture
def valid_text() -> str:
    """Text of a valid device file with one of everything, for tests that break or vary it."""
    return (DEVICES / "everything.toml").read_text(encoding="utf-8")


@pytest.fixture(scope="session")
def legible():
    """legible(curves): draws each figure off screen, as it is saved, and holds it to what a reader needs: a unit on
    both axes, every word inside the picture, nothing upon another, and room left for the lines."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    from fieldmap.plot.figures import DOTS_PER_INCH, HEIGHT, WIDTH, draw_curves

    seen = set()

    def draw(curves):
        for one in (one for one in curves if one.title not in seen):
            seen.add(one.title)
            figure = Figure(figsize=(WIDTH, HEIGHT), layout="constrained", dpi=DOTS_PER_INCH)
            FigureCanvasAgg(figure)
            axes = figure.add_subplot()
            draw_curves(axes, one)
            figure.draw_without_rendering()
            check(figure, axes, one.title)

    def check(figure, axes, title):
        assert axes.get_xlabel().endswith(")"), title
        assert axes.get_ylabel().endswith(")"), title
        words = [axes.title, axes.xaxis.label, axes.yaxis.label, *shown(axes.xaxis), *shown(axes.yaxis)]
        boxes = [word.get_window_extent() for word in words]
        legend = axes.get_legend()
        inside = boxes if legend is None else [*boxes, legend.get_window_extent()]
        for box in inside:
            assert figure.bbox.x0 <= box.x0 < box.x1 <= figure.bbox.x1, title
            assert figure.bbox.y0 <= box.y0 < box.y1 <= figure.bbox.y1, title
        for k, box in enumerate(inside):
            assert not any(box.overlaps(other) for other in inside[k + 1 :]), title
        assert axes.bbox.width > 0.4 * figure.bbox.width, title
        assert np.prod(axes.bbox.size) > 0.3 * np.prod(figure.bbox.size), title

    def shown(axis):
        low, high = sorted(axis.get_view_interval())
        return [
            tick.label1
            for tick in axis.get_major_ticks()
            if low <= tick.get_loc() <= high and tick.label1.get_text()
        ]

    return draw
