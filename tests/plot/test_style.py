"""The look of all pictures: colours told apart by the colour-blind and seen on their paper, light and dark alike."""

from itertools import combinations

import numpy as np
import pytest
import pyvista as pv
from matplotlib import rcParams
from matplotlib.colors import to_hex, to_rgb
from matplotlib.image import imread

from fieldmap.errors import InputError
from fieldmap.plot import style
from fieldmap.plot.style import COLOURS, DARK_INK, DARK_PAPER, INK, dark_colour, dark_path, save_figure
from tests.plot.conftest import needs_opengl

# G. M. Machado, M. M. Oliveira, L. A. F. Fernandes, "A physiologically-based model for simulation of color vision
# deficiency", IEEE Trans. Vis. Comput. Graph. 15 (2009) 1291: severity 1, linear RGB.
SEEN = {
    "by all": np.eye(3).ravel(),
    "protanopia": [
        0.152286,
        1.052583,
        -0.204868,
        0.114503,
        0.786281,
        0.099216,
        -0.003882,
        -0.048116,
        1.051998,
    ],
    "deuteranopia": [
        0.367322,
        0.860646,
        -0.227968,
        0.280085,
        0.672501,
        0.047413,
        -0.011820,
        0.042940,
        0.968881,
    ],
}
TO_XYZ = np.array(
    [[0.4124564, 0.3575761, 0.1804375], [0.2126729, 0.7151522, 0.0721750], [0.0193339, 0.1191920, 0.9503041]]
)


def linear(colour):
    rgb = np.array(to_rgb(colour))
    return np.where(rgb <= 0.04045, rgb / 12.92, ((rgb + 0.055) / 1.055) ** 2.4)


def lab(rgb):
    """CIELAB, white D65."""
    ratio = TO_XYZ @ np.clip(rgb, 0.0, 1.0) / TO_XYZ.sum(axis=1)
    root = np.where(ratio > (6 / 29) ** 3, np.cbrt(ratio), ratio / (3 * (6 / 29) ** 2) + 4 / 29)
    return np.array([116 * root[1] - 16, 500 * (root[0] - root[1]), 200 * (root[1] - root[2])])


def contrast(one, other):
    """WCAG 2.1."""
    light = sorted((TO_XYZ[1] @ linear(colour) for colour in (one, other)), reverse=True)
    return (light[0] + 0.05) / (light[1] + 0.05)


DARK_COLOURS = tuple(to_hex(dark_colour(colour)) for colour in COLOURS)


@pytest.mark.parametrize("eye", SEEN)
@pytest.mark.parametrize("colours", [COLOURS, DARK_COLOURS], ids=["light", "dark"])
def test_the_colour_blind_tell_series_apart(colours, eye):
    """The first five, which is what figures have at most in the place of a legend beside them."""
    seen = [lab(np.reshape(SEEN[eye], (3, 3)) @ linear(colour)) for colour in colours[:5]]
    assert min(np.linalg.norm(one - other) for one, other in combinations(seen, 2)) > 10.0


def test_colours_are_seen_on_their_paper():
    assert min(contrast(colour, "white") for colour in COLOURS) > 2.0
    assert min(contrast(colour, DARK_PAPER) for colour in DARK_COLOURS) > 5.0
    assert contrast(INK, "white") > 12.0
    assert contrast(DARK_INK, DARK_PAPER) > 12.0


def test_the_style_is_that_of_the_constants():
    with style.new_figure((1.0, 1.0)):
        assert tuple(f"#{entry['color'].lstrip('#')}" for entry in rcParams["axes.prop_cycle"]) == COLOURS
        assert to_hex(rcParams["text.color"]) == INK


def drawn():
    with style.new_figure((3.0, 2.4)) as figure:
        axes = figure.add_subplot(title="title", xlabel="x", ylabel="y")
        axes.plot([0, 1], [0, 1], "o-", label="line")
        axes.contourf([0, 1], [0, 1], [[0, 1], [1, 2]], alpha=0.5)
        axes.annotate("note", (0.5, 0.5))
        axes.legend()
    return figure


def colours_of(figure):
    figure.draw_without_rendering()
    axes = figure.axes[0]
    texts = [*axes.texts, axes.xaxis.label, *axes.get_xticklabels(), *axes.get_legend().get_texts()]
    return [
        to_hex(one)
        for one in (figure.get_facecolor(), axes.lines[0].get_color(), *(t.get_color() for t in texts))
    ]


def test_a_figure_goes_into_the_dark_and_comes_back():
    figure = drawn()
    before, filled = colours_of(figure), figure.axes[0].collections[0].get_facecolor().copy()
    with style.in_the_dark(figure):
        paper, line, *texts = colours_of(figure)
        assert (paper, line) == (DARK_PAPER, DARK_COLOURS[0])
        assert set(texts) == {DARK_INK}
        np.testing.assert_array_equal(figure.axes[0].collections[0].get_facecolor(), filled)
    assert colours_of(figure) == before


@pytest.mark.parametrize(
    ("chosen", "names"), [("", {"p"}), ("light", {"p"}), ("dark", {"p"}), ("both", {"p", "p_dark"})]
)
def test_what_is_saved(chosen, names, tmp_path, monkeypatch):
    monkeypatch.setenv("FIELDMAP_PICTURES", chosen)
    path = save_figure(drawn(), tmp_path / "p.png")
    assert {one.stem for one in tmp_path.iterdir()} == names
    corner = to_hex(imread(path)[0, 0, :3])
    assert corner == (DARK_PAPER if chosen == "dark" else "#ffffff")
    if chosen == "both":
        assert to_hex(imread(dark_path(path))[0, 0, :3]) == DARK_PAPER


def test_an_unknown_scheme_is_refused(tmp_path, monkeypatch):
    monkeypatch.setenv("FIELDMAP_PICTURES", "sepia")
    with pytest.raises(InputError) as error:
        save_figure(drawn(), tmp_path / "p.png")
    assert error.value.problems[0].where == "FIELDMAP_PICTURES"
    assert list(tmp_path.iterdir()) == []


@needs_opengl
def test_a_scene_goes_into_the_dark_and_comes_back(tmp_path, monkeypatch):
    monkeypatch.setenv("FIELDMAP_PICTURES", "both")
    scene = pv.Plotter(off_screen=True, window_size=[300, 200])
    scene.background_color = pv.Color("white")
    scene.add_mesh(pv.Box(), color="#e08a4e", lighting=False)
    edges = scene.add_mesh(pv.Box().extract_all_edges(), color=INK)
    text = scene.add_text("words", color=INK)
    labels = scene.add_point_labels(np.array([[2.0, 0.0, 0.0]]), ["label"], text_color=INK, shape=None)

    def look():
        colours = (to_hex(one.prop.color.float_rgb) for one in (edges, text))
        return [*colours, scene.background_color.hex_rgb]

    before = look()
    with style.scene_in_the_dark(scene):
        assert look() == [DARK_INK, DARK_INK, DARK_PAPER]
        words = labels.GetMapper().GetInputAlgorithm().GetTextProperty()
        assert to_hex(words.GetColor()) == DARK_INK
    assert look() == before == [INK, INK, "#ffffff"]
    path = style.save_screenshot(scene, tmp_path / "scene.png")
    scene.close()
    light, dark = imread(path)[..., :3], imread(dark_path(path))[..., :3]
    assert (to_hex(light[0, -1]), to_hex(dark[0, -1])) == ("#ffffff", DARK_PAPER)
    # What is solid keeps its colour.
    np.testing.assert_allclose(light[110, 150], dark[110, 150], atol=0.02)
