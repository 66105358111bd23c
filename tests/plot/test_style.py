"""The style of all pictures: colours are distinct for the colour-blind and visible on light and dark backgrounds."""

from itertools import combinations

import numpy as np
import pytest
import pyvista as pv
from matplotlib import rcParams
from matplotlib.colors import to_hex, to_rgb
from matplotlib.image import imread
from matplotlib.patches import Rectangle

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
    """The contrast ratio of WCAG 2.1."""
    light = sorted((TO_XYZ[1] @ linear(colour) for colour in (one, other)), reverse=True)
    return (light[0] + 0.05) / (light[1] + 0.05)


DARK_COLOURS = tuple(to_hex(dark_colour(colour)) for colour in COLOURS)


@pytest.mark.parametrize("eye", SEEN)
@pytest.mark.parametrize("colours", [COLOURS, DARK_COLOURS], ids=["light", "dark"])
def test_the_colour_blind_tell_series_apart(colours, eye):
    """The first five colours, the most that figures have without a legend."""
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


def test_a_heading_has_its_message_above_its_title():
    """In bold above the title for any number of lines; a long message is broken into two lines of similar length."""
    short, long = "i" * 68, " ".join(14 * ["iiii"])
    for message, title, lines in (
        ("", "t", 0),
        (short, "t", 1),
        (short, "t\nu", 1),
        (long, "t", 2),
        (2 * long, "t", 3),
    ):
        with style.new_figure() as figure:
            axes = figure.add_subplot()
            style.add_heading(axes, message, title)
        assert axes.get_title("left") == title
        assert to_hex(axes._left_title.get_color()) == (style.QUIET if message else INK)
        assert len(axes.texts) == bool(message)
        if not message:
            continue
        (words,) = axes.texts
        assert words.get_text().replace("\n", " ") == message
        broken = words.get_text().split("\n")
        assert len(broken) == lines
        assert max(map(len, broken)) <= 68
        if lines == 2:
            # Evenly: neither line is shorter than 0.6 of the other.
            assert min(map(len, broken)) > 0.6 * max(map(len, broken))
        assert (words.get_fontweight(), words.get_fontsize(), to_hex(words.get_color())) == ("bold", 10, INK)
        figure.draw_without_rendering()
        below, above = axes._left_title.get_window_extent(), words.get_window_extent()
        assert above.x0 == pytest.approx(axes.bbox.x0, abs=2.0)
        assert below.y1 < above.y0 < below.y1 + 0.8 * 130 / 72 * 10
        assert above.y1 < figure.bbox.y1


@pytest.mark.parametrize(
    ("colour", "dark"),
    [
        ("#0072B2", "#4fa3e3"),
        ("#D55E00", "#ef7d3b"),
        ("#000000", "#ffffff"),
        # Greys by their distance from white: ink and darker, white, and half-way between.
        (INK, DARK_INK),
        ("#0a0a0a", DARK_INK),
        ("white", DARK_PAPER),
        # The mean of INK is (0x22 + 0x28 + 0x2e) / 3 = 40 of 255, so half-way to 255 is 147.5.
        ("#949494", "#7e828a"),
        # Lines become lighter at the same hue, light fills become deep.
        ("#800000", "#ff1919"),
        ("#cc0000", "#ff1919"),
        ("#ff3333", "#ff3333"),
        ("#ffe0e0", "#970000"),
    ],
)
def test_what_stands_for_a_colour_in_the_dark(colour, dark):
    found = dark_colour(colour)
    np.testing.assert_allclose(found[:3], to_rgb(dark), atol=0.012)
    assert found[3] == 1.0
    assert dark_colour((*to_rgb(colour), 0.4))[3] == 0.4


def test_colours_and_greys_part_at_an_eighth():
    """Of the range of the components: below an eighth the colour counts as grey."""
    grey, coloured = dark_colour((0.5, 0.5, 0.61)), dark_colour((0.5, 0.5, 0.63))
    to_paper = np.array(to_rgb(DARK_PAPER)) - to_rgb(DARK_INK)
    share = (np.array(grey[:3]) - to_rgb(DARK_INK)) / to_paper
    assert share == pytest.approx([share[0]] * 3)
    assert share[0] == pytest.approx((0.555 - np.mean(to_rgb(INK))) / (1.0 - np.mean(to_rgb(INK))))
    # Already light enough.
    assert coloured[:3] == pytest.approx((0.5, 0.5, 0.63))
    # Fills of more than 92 % lightness become deep, others are kept.
    assert dark_colour((0.84, 0.99, 0.99))[:3] == pytest.approx((0.84, 0.99, 0.99), abs=1e-9)
    assert max(dark_colour((0.86, 0.99, 0.99))[:3]) < 0.6


def test_each_part_of_a_figure_has_its_colour_in_the_dark_and_its_own_again():
    """Lines with their marks, patches, collections of one and of many colours; colours from values are kept."""
    with style.new_figure((3.0, 2.4)) as figure:
        axes = figure.add_subplot()
        (line,) = axes.plot(
            [0, 1], [0, 1], "o-", color=COLOURS[0], markerfacecolor="none", markeredgecolor=INK
        )
        patch = axes.add_patch(Rectangle((0, 0), 1, 1, facecolor="none", edgecolor=INK))
        dots = axes.scatter([0, 1], [0, 1], color=[INK, COLOURS[1]])
        valued = axes.scatter([0, 1], [0, 1], c=[0.0, 1.0])
        arrows = axes.quiver([0], [0], [1], [1], color="white")

    def look():
        return [
            *(to_hex(one) for one in (line.get_color(), line.get_markeredgecolor())),
            line.get_markerfacecolor(),
            to_hex(patch.get_edgecolor()),
            patch.get_facecolor()[3],
            *(to_hex(one) for one in dots.get_facecolor()),
            *(to_hex(one) for one in (*valued.get_facecolor(), *arrows.get_facecolor())),
        ]

    figure.draw_without_rendering()
    before = look()
    with style.in_the_dark(figure):
        after = look()
    assert look() == before
    dark = DARK_COLOURS[0], DARK_INK, "none", DARK_INK, 0.0, DARK_INK, DARK_COLOURS[1]
    assert after == [*dark, *before[len(dark) :]]
    assert before[-1] == "#ffffff"


def test_things_that_are_the_same_as_the_first_of_their_group():
    near = style.grouped([1.0, 1.4, 2.0, 1.6, 9.0], lambda one, other: abs(one - other) < 0.7)
    assert near == [[1.0, 1.4, 1.6], [2.0], [9.0]]


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


@pytest.fixture
def scene():
    """A box in copper, its edges, a text and a label in ink; a second panel."""
    made = pv.Plotter(off_screen=True, window_size=[300, 200], shape=(1, 2), border=False)
    made.background_color = pv.Color("white")
    made.subplot(0, 0)
    box = made.add_mesh(pv.Box(), color="#e08a4e", lighting=False)
    edges = made.add_mesh(pv.Box().extract_all_edges(), color=INK)
    text = made.add_text("words", color=INK)
    labels = made.add_point_labels(np.array([[2.0, 0.0, 0.0]]), ["label"], text_color=INK, shape=None)
    yield made, (box, edges, text, labels)
    made.close()


@needs_opengl
def test_a_scene_goes_into_the_dark_and_comes_back(scene):
    """Texts, labels, bars, sliders and edges in ink change with the background; solids keep their colour."""
    scene, (box, edges, text, labels) = scene
    grid = pv.Plane()
    scene.add_mesh(grid, scalars=grid.points[:, 0], scalar_bar_args={"title": "x", "color": INK})
    slider = scene.add_slider_widget(
        lambda _: None, (0.0, 1.0), color=INK, style="modern"
    ).GetRepresentation()
    (bar,) = scene.scalar_bars.values()
    worded = labels.GetMapper().GetInputAlgorithm()
    ink = [edges.GetProperty(), text.prop, worded.GetTextProperty()]
    ink += [bar.GetTitleTextProperty(), bar.GetLabelTextProperty()]
    ink += [slider.GetTitleProperty(), slider.GetLabelProperty()]

    def look():
        papers = [to_hex(renderer.GetBackground()) for renderer in scene.renderers]
        return [to_hex(one.GetColor()) for one in ink], papers, to_hex(box.GetProperty().GetColor())

    with style.scene_in_the_dark(scene):
        assert look() == ([DARK_INK] * 7, [DARK_PAPER] * 2, "#e08a4e")
    assert look() == ([INK] * 7, ["#ffffff"] * 2, "#e08a4e")


@needs_opengl
def test_a_scene_is_saved_on_both_papers(scene, tmp_path, monkeypatch):
    monkeypatch.setenv("FIELDMAP_PICTURES", "both")
    path = style.save_screenshot(scene[0], tmp_path / "scene.png")
    light, dark = imread(path)[..., :3], imread(dark_path(path))[..., :3]
    assert (to_hex(light[0, -1]), to_hex(dark[0, -1])) == ("#ffffff", DARK_PAPER)
    # Solids keep their colour.
    copper = [(np.abs(image - to_rgb("#e08a4e")) < 0.02).all(axis=-1) for image in (light, dark)]
    assert copper[0].sum() > 1000
    assert np.mean(copper[0] != copper[1]) < 1e-3
