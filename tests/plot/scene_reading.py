"""The content of a scene, read from its actors: solids, texts, labels at places, colour bars, and the camera."""

from types import SimpleNamespace

import numpy as np
import pyvista as pv
from matplotlib.colors import to_hex


def solids_of(scene, colour=None):
    """Actors with a mapper, in the order in which they were added; of one colour if given."""
    wanted = None if colour is None else np.array(pv.Color(colour).float_rgb)
    return [
        actor
        for actor in scene.actors.values()
        if isinstance(actor, pv.Actor)
        and (wanted is None or np.allclose(actor.prop.color.float_rgb, wanted, atol=0.01))
    ]


def data_of(actor):
    """The data of an actor at its position in the scene."""
    actor.mapper.Update()
    data = pv.wrap(actor.mapper.GetInput())
    return data.copy().transform(pv.array_from_vtkmatrix(actor.GetMatrix()), inplace=False)


def bounds_of(*actors):
    """Lower and upper ends (3, 2) of all actors."""
    ends = np.array([np.reshape(actor.bounds, (3, 2)) for actor in actors])
    return np.column_stack([ends[..., 0].min(axis=0), ends[..., 1].max(axis=0)])


def labels_of(scene):
    """Labels at places: .words, .place (3,), .size, .ink, .across, .up."""
    found = []
    for actor in scene.actors.values():
        source = getattr(getattr(actor, "GetMapper", lambda: None)(), "GetInputAlgorithm", lambda: None)()
        if not hasattr(source, "GetTextProperty"):
            continue
        data, look = pv.wrap(source.GetInput()), source.GetTextProperty()
        about = {"size": look.GetFontSize(), "ink": to_hex(look.GetColor())}
        about["across"] = look.GetJustificationAsString()
        about["up"] = look.GetVerticalJustificationAsString()
        for words, place in zip(data["labels"], data.points, strict=True):
            found.append(SimpleNamespace(words=str(words), place=np.array(place, float), **about))
    return found


def words_of(scene):
    """Texts on the picture: .words, .place (shares of width and height), .size, .ink, .up, .spacing."""
    return [
        SimpleNamespace(
            words=actor.input,
            place=tuple(actor.position),
            # pyvista doubles the size.
            size=actor.prop.font_size / 2,
            ink=to_hex(actor.prop.color.float_rgb),
            up=actor.prop.GetVerticalJustificationAsString(),
            spacing=actor.prop.GetLineSpacing(),
        )
        for actor in scene.actors.values()
        if isinstance(actor, pv.Text)
    ]


def bars_of(scene):
    """Colour bars: .title, .range, .labels, .fmt, .box (left, bottom, width, height, as shares), .sizes of fonts."""
    return [
        SimpleNamespace(
            title=bar.GetTitle().strip(),
            lines=bar.GetTitle().count("\n"),
            range=tuple(bar.GetLookupTable().GetTableRange()),
            labels=bar.GetNumberOfLabels(),
            fmt=bar.GetLabelFormat(),
            box=(*bar.GetPosition()[:2], bar.GetWidth(), bar.GetHeight()),
            sizes=(bar.GetTitleTextProperty().GetFontSize(), bar.GetLabelTextProperty().GetFontSize()),
            upright=bool(bar.GetOrientation()),
            ink=to_hex(bar.GetLabelTextProperty().GetColor()),
        )
        for bar in scene.scalar_bars.values()
    ]


def seen(scene, places, size=None):
    """Places (n, 3) in a parallel projection: (n, 2), across and up the panel, from -1 to 1."""
    camera, (width, height) = scene.camera, size or scene.window_size
    assert camera.parallel_projection
    forward = np.subtract(camera.focal_point, camera.position)
    forward /= np.linalg.norm(forward)
    right = np.cross(forward, camera.up)
    right /= np.linalg.norm(right)
    off = np.asarray(places, float) - camera.focal_point
    panel = width / len(scene.renderers) / height
    across, up = off @ right / panel, off @ np.cross(right, forward)
    return np.column_stack([across, up]) / camera.parallel_scale


def filled(scene, bounds, size=None):
    """Lower and upper ends (2, 2) of a box (3, 2) across and up the panel, from -1 to 1."""
    corners = np.array(np.meshgrid(*bounds, indexing="ij")).reshape(3, -1).T
    shown = seen(scene, corners, size)
    return np.column_stack([shown.min(axis=0), shown.max(axis=0)])


def check_legible(scene, smallest=9.0, largest=32.0):
    """Checks for every picture: shading, thin lines, legible texts in their places, and a colour bar beside the scene
    with labels at its ends."""
    for actor in solids_of(scene):
        look = actor.prop
        assert 0.0 < look.opacity <= 1.0
        assert 0.0 <= look.ambient <= 0.7
        assert 0.0 <= look.specular <= 0.3
        if look.lighting:
            assert 0.9 <= look.ambient + look.diffuse + look.specular <= 1.7
        assert 0.9 <= look.line_width <= 5.0
    for label in labels_of(scene):
        assert smallest <= label.size <= largest
        assert (label.ink, label.up) == ("#22282e", "Centered")
    for text in words_of(scene):
        across, up = text.place
        assert 0.0 < across < 0.1
        assert 0.0 < up < 1.0
        assert min(up, 1.0 - up) < 0.1
        assert text.up == ("Top" if up > 0.5 else "Bottom")
        assert 1.1 <= text.spacing <= 1.5
        assert smallest <= text.size <= largest
        assert text.ink == "#22282e"
    for bar in bars_of(scene):
        left, bottom, width, height = bar.box
        assert 0.0 < left < left + width < 1.0
        assert 0.0 < bottom < bottom + height < 0.9
        assert height >= 0.3
        assert 0.03 <= width <= 0.1
        assert bar.upright
        # A title of one line does not touch the highest label.
        assert bar.lines == 1
        title, labels = bar.sizes
        assert smallest <= labels <= title <= largest
        assert bar.ink == "#22282e"
