"""One style for all pictures, in a light and a dark scheme.

Figures are drawn in the light scheme (`figure.mplstyle` in this folder). The dark scheme replaces the colours in the
finished figure or scene, so that both show the same data. The environment variable FIELDMAP_PICTURES selects the saved
schemes: "light" (the default), "dark", or "both", where the name of the dark picture ends in `_dark`.
"""

import colorsys
import os
from collections.abc import Callable, Iterable, Iterator
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path
from textwrap import wrap
from typing import Any, Final, TypeVar

import numpy as np
import pyvista as pv
from matplotlib import style
from matplotlib.artist import Artist, getp
from matplotlib.axes import Axes
from matplotlib.collections import Collection
from matplotlib.colors import to_hex, to_rgb, to_rgba
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.quiver import Quiver
from matplotlib.text import Text

from fieldmap.arguments import check_choice
from fieldmap.store.whole_files import whole_file
from fieldmap.typing import PathLike

Thing = TypeVar("Thing")
STYLE: Final = "fieldmap.plot.figure"
"""For `matplotlib.style.use`."""
VARIABLE: Final = "FIELDMAP_PICTURES"
SCHEMES: Final = ("light", "dark", "both")
DARK: Final = "_dark"
"""End of the name of a dark picture, if the light one is saved, too."""
INK, QUIET = "#22282e", "#6b737b"
# Colours of the documentation's pages in their dark scheme.
DARK_PAPER, DARK_INK = "#1e2129", "#dfe3ea"
COLOURS: Final = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#56B4E9", "#E69F00", "#000000", "#7F7F7F")
"""Colours of series; the same as in figure.mplstyle."""
# The same hues, lighter, so that thin lines are visible and distinct on the dark page.
_IN_THE_DARK: Final = dict(
    zip(
        (colour.lower() for colour in COLOURS),
        ("#4fa3e3", "#ef7d3b", "#2fc79c", "#e59fc8", "#a6daf8", "#f4b93c", "#ffffff", "#a5a5a5"),
        strict=True,
    )
)
# Heading: line height over font size, and largest number of characters of a message in one line.
_TITLE_LINES, _MESSAGE_WIDTH = 1.45, 68
_SATURATED = 0.12
_LIGHTEST, _DARKEST = 0.92, 0.55


@contextmanager
def new_figure(size: tuple[float, float] | None = None) -> Iterator[Figure]:
    """Context with an empty figure in the style of the package. size: width and height, inches; by default the size of
    the style. Opens no window and uses no global state."""
    with style.context(STYLE):
        yield Figure(figsize=size)


def add_heading(axes: Axes, message: str, title: str) -> None:
    """Add a heading above axes: the message in bold, if there is one, and the title below it."""
    axes.set_title(title, loc="left", color=QUIET if message else INK)
    if not message:
        return
    lines = [message]
    if len(message) > _MESSAGE_WIDTH:
        lines = wrap(message, min(_MESSAGE_WIDTH, len(message) // 2 + 8))
    above = 6.0 + _TITLE_LINES * float(axes.title.get_fontsize()) * (title.count("\n") + 1)
    axes.annotate(
        "\n".join(lines),
        (0.0, 1.0),
        xycoords="axes fraction",
        xytext=(0.0, above),
        textcoords="offset points",
        fontsize=10,
        fontweight="bold",
        color=INK,
        annotation_clip=False,
    )


def grouped(things: Iterable[Thing], same: Callable[[Thing, Thing], bool]) -> list[list[Thing]]:
    """Groups of things that equal the first of their group, in the order of these first things.

    >>> grouped([1, 2, 11, 3, 12], lambda one, other: one % 10 == other % 10)
    [[1, 11], [2, 12], [3]]
    """
    groups: list[list[Thing]] = []
    for thing in things:
        group = next((group for group in groups if same(group[0], thing)), None)
        if group is None:
            groups.append([thing])
        else:
            group.append(thing)
    return groups


def schemes() -> tuple[str, ...]:
    """Saved schemes: "light", "dark" or both. Raises InputError for another value of FIELDMAP_PICTURES."""
    chosen = os.environ.get(VARIABLE, "") or "light"
    check_choice(VARIABLE, chosen, SCHEMES)
    return ("light", "dark") if chosen == "both" else (chosen,)


def dark_path(path: PathLike) -> Path:
    """Path of the dark picture for the path of a light one.

    >>> dark_path("hold.png").name
    'hold_dark.png'
    """
    return Path(path).with_stem(Path(path).stem + DARK)


def save_figure(figure: Figure, path: PathLike, kind: str = "figure", **options: Any) -> Path:
    """Save a figure in the schemes of FIELDMAP_PICTURES.

    Parameters
    ----------
    figure
        The figure.
    path
        Path of the file.
    kind
        Format in `fieldmap.store.output_formats`: "drawn figure" replaces no figure of another program.
    **options
        Options of `Figure.savefig`.

    Returns
    -------
    Path
        The path.
    """
    _save(path, kind, lambda target: figure.savefig(target, **options), lambda: in_the_dark(figure))
    return Path(path)


def save_screenshot(scene: pv.Plotter, path: PathLike) -> Path:
    """Save a scene in the schemes of FIELDMAP_PICTURES. Returns `path`."""

    def save(target: Path) -> None:
        scene.render()
        scene.screenshot(str(target))

    _save(path, "picture", save, lambda: scene_in_the_dark(scene))
    return Path(path)


def _save(
    path: PathLike,
    kind: str,
    save: Callable[[Path], object],
    dark: Callable[[], AbstractContextManager[None]],
) -> None:
    wanted = schemes()
    if "light" in wanted:
        with whole_file(path, kind) as partial:
            save(partial)
    if "dark" in wanted:
        with dark(), whole_file(dark_path(path) if "light" in wanted else path, kind) as partial:
            save(partial)


def dark_colour(colour: Any) -> tuple[float, float, float, float]:
    """The colour of the dark scheme for a colour: the partner of a series' colour, grey at the same distance from the
    paper, or the same hue, light enough to be visible.

    >>> to_hex(dark_colour("white")) == DARK_PAPER, to_hex(dark_colour(INK)) == DARK_INK
    (True, True)
    """
    red, green, blue, alpha = to_rgba(colour)
    known = _IN_THE_DARK.get(to_hex((red, green, blue)))
    if known is not None:
        return to_rgba(known, alpha)
    hue, lightness, saturation = colorsys.rgb_to_hls(red, green, blue)
    if max(red, green, blue) - min(red, green, blue) < _SATURATED:
        ink, paper, darkest = to_rgba(DARK_INK), to_rgba(DARK_PAPER), np.mean(to_rgba(INK)[:3])
        share = float(np.clip((lightness - darkest) / (1.0 - darkest), 0.0, 1.0))
        mixed = [one + share * (other - one) for one, other in zip(ink[:3], paper[:3], strict=True)]
        return (*mixed, alpha)  # type: ignore[return-value]
    # Pale fills become deep ones, lines light ones.
    seen = 1.0 - 0.75 * lightness if lightness > _LIGHTEST else max(lightness, _DARKEST)
    return (*colorsys.hls_to_rgb(hue, seen, saturation), alpha)


@contextmanager
def in_the_dark(figure: Figure) -> Iterator[None]:
    """Context in which a figure has the colours of the dark scheme.

    Artists coloured by values keep their colours, and so do arrows, which are drawn on them.

    Parameters
    ----------
    figure
        The figure.
    """
    figure.draw_without_rendering()  # ticks are made when they are drawn
    before = [(artist, _recolour(artist)) for artist in figure.findobj()]
    try:
        yield
    finally:
        for artist, colours in before:
            artist.set(**colours)


_COLOURED: tuple[tuple[type[Artist], tuple[str, ...]], ...] = (
    (Line2D, ("color", "markeredgecolor", "markerfacecolor")),
    (Text, ("color",)),
    (Patch, ("edgecolor", "facecolor")),
    (Collection, ("edgecolor", "facecolor")),
)
"""Artists with colours of their own, and the names of these colours."""


def _recolour(artist: Artist) -> dict[str, Any]:
    """Replace each colour of an artist by its dark partner. Returns the old colours."""
    if isinstance(artist, Quiver) or (isinstance(artist, Collection) and artist.get_array() is not None):
        return {}
    names = next((names for kind, names in _COLOURED if isinstance(artist, kind)), ())
    before = {name: getp(artist, name) for name in names}
    for name, colour in before.items():
        if len(colour) and not (isinstance(colour, str) and colour in ("none", "auto")):
            many = np.ndim(colour) == 2
            artist.set(**{name: [dark_colour(one) for one in colour] if many else dark_colour(colour)})
    return before


@contextmanager
def scene_in_the_dark(scene: pv.Plotter) -> Iterator[None]:
    """Context in which a scene has dark paper and light words, rulers and edges; solids keep their colours.

    Parameters
    ----------
    scene
        The scene.
    """
    solids = [
        actor.GetProperty()
        for renderer in scene.renderers
        for actor in renderer.actors.values()
        if isinstance(actor, pv.Actor)
    ]
    inked = [
        (one, one.GetColor())
        for one in (*solids, *text_properties(scene))
        if np.allclose(one.GetColor(), to_rgb(INK), atol=0.01)
    ]
    papers = [(renderer, renderer.GetBackground()) for renderer in scene.renderers]
    try:
        for one, _ in inked:
            one.SetColor(*to_rgb(DARK_INK))
        for renderer, _ in papers:
            renderer.SetBackground(to_rgb(DARK_PAPER))
        yield
    finally:
        for one, colour in inked:
            one.SetColor(*colour)
        for renderer, colour in papers:
            renderer.SetBackground(colour)


def text_properties(scene: pv.Plotter) -> list[Any]:
    """Text properties of all words in a scene: texts, labels, colour bars and sliders."""
    actors = [actor for renderer in scene.renderers for actor in renderer.actors.values()]
    found = [words for actor in [*actors, *scene.scalar_bars.values()] for words in _text_properties(actor)]
    # The attribute of pyvista depends on its release.
    for slider in getattr(getattr(scene, "widgets", scene), "slider_widgets", ()):
        representation = slider.GetRepresentation()
        found += [representation.GetTitleProperty(), representation.GetLabelProperty()]
    return found


def _text_properties(actor: Any) -> list[Any]:
    """Text properties of a text, a colour bar, or labels at points."""
    holders = [actor]
    if not isinstance(actor, pv.Actor) and hasattr(actor, "GetMapper"):
        holders.append(actor.GetMapper())
        if hasattr(holders[-1], "GetInputAlgorithm"):
            holders.append(holders[-1].GetInputAlgorithm())
    names = ("GetTextProperty", "GetTitleTextProperty", "GetLabelTextProperty")
    return [getattr(holder, name)() for holder in holders for name in names if hasattr(holder, name)]
