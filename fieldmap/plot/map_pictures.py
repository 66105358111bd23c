"""The two pictures of a finished map, written to its folder: NAME.png, forces on its magnet and computed and measured
rest positions, and NAME_3d.png, the machine with the field in its workspace."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Rectangle

from fieldmap.currents import LiftAndDirections
from fieldmap.curves import Curves, Series, percent
from fieldmap.device import recorded_device
from fieldmap.device.model import MagnetCylinder, Payload
from fieldmap.errors import FieldmapError, InputError
from fieldmap.io.map_summary import MapSummary
from fieldmap.levitation import ShiftBesideMeasured, equilibrium_surface
from fieldmap.lookup import FieldMap, open_map
from fieldmap.plot.device_drawing import MAGNET
from fieldmap.plot.figures import draw_curves
from fieldmap.plot.picture import save_picture
from fieldmap.plot.places import MM
from fieldmap.plot.slices import field_slice, force_slice
from fieldmap.plot.style import QUIET, new_figure, save_figure
from fieldmap.plot.words import amperes_in_words
from fieldmap.records import Record
from fieldmap.typing import Array

_SIZE = (11.4, 5.2)
_SIGNALS = 81
"""Number of points of a line over a direction signal."""


@dataclass(frozen=True, repr=False)
class MapPicture(Record):
    """A picture of a map: "figure" or "3-D picture". path: of the file, or None with the reason in `problem`."""

    shows: str
    path: Path | None
    problem: str = ""


def save_map_pictures(summary: MapSummary) -> tuple[MapPicture, ...]:
    """Write both pictures beside the map, NAME.png and NAME_3d.png.

    A picture that cannot be drawn, on a machine without OpenGL or of a map without a recorded device, is left out, with
    the reason in its `problem`; no error is raised.

    Parameters
    ----------
    summary
        Summary of the map: `fieldmap.io.map_summary.summarise_map`.

    Returns
    -------
    tuple[MapPicture, ...]
        The two pictures.
    """
    figure = summary.path.with_suffix(".png")
    scene = figure.with_name(f"{figure.stem}_3d.png")
    opened = open_map(summary.path)
    drawn = _Drawn(summary, opened, summary.info.reference_current)
    carried = [(row.current, row.height) for row in summary.lift if row.current is not None]
    if carried:
        current, height = carried[len(carried) // 2]
        drawn = _Drawn(summary, opened, np.full(len(opened.coil_names), round(current, 3)), height)
    return (
        _saved("figure", figure, lambda: _save_figure(drawn, figure)),
        _saved("3-D picture", scene, lambda: _save_scene(drawn, scene)),
    )


def _saved(shows: str, path: Path, save: Callable[[], Path]) -> MapPicture:
    try:
        return MapPicture(shows, save())
    except FieldmapError as error:
        problem = error.problems[0]
        return MapPicture(shows, None, f"{path} not drawn: {problem.must_hold}; {problem.received}")


@dataclass(frozen=True, eq=False)
class _Drawn:
    """A map and the currents (n_coils,), A, of its pictures: equal currents that carry the magnet at a height z, m, the
    middle one of the summary's heights at which that is possible; otherwise the reference currents."""

    summary: MapSummary
    opened: FieldMap
    currents: Array
    height: float | None = None

    @property
    def amperes(self) -> str:
        """The currents in words."""
        return amperes_in_words(self.currents, self.opened.coil_names)


def _save_scene(drawn: _Drawn, path: Path) -> Path:
    """The machine, its magnet, and the field and net force in the workspace, in three dimensions."""
    text = drawn.summary.info.provenance.device_text
    if not text:
        remedy = "make the map from a recipe"
        raise InputError.of(str(path), "the map must record its device", "none recorded", remedy)
    device, at, caption = recorded_device(text, solids=True), None, ""
    if drawn.height is not None:
        at = (0.0, 0.0, drawn.height)
        caption = f"they carry the magnet at z = {MM * drawn.height:.0f} mm; arrows: net force on it"
    return save_picture(path, device, drawn.opened, drawn.currents, at, caption, forces=True)


def _save_figure(drawn: _Drawn, path: Path) -> Path:
    """Two panels: forces in the plane y = middle, or the field of a map without a payload; and computed and measured
    rest positions, or otherwise the field on the axis."""
    summary = drawn.summary
    with new_figure(_SIZE) as figure:
        left, right = figure.subplots(1, 2, width_ratios=(0.62, 1.0), gridspec_kw={"wspace": 0.08})
        if summary.payload is None:
            field_slice(drawn.opened, drawn.currents, ax=left)
            left.set_title(f"{left.get_title('left')}\n{drawn.amperes}")
        else:
            _draw_forces(left, drawn, summary.payload)
        if summary.payload is not None and summary.shifts:
            draw_curves(right, shift_curves(drawn.opened, summary.payload, summary.shifts[0]))
        else:
            draw_curves(right, _axis_curves(drawn))
        figure.suptitle(summary.info.provenance.title, fontweight="normal", color=QUIET)
    return save_figure(figure, path, "drawn figure")


def shift_curves(opened: FieldMap, payload: Payload, shift: ShiftBesideMeasured) -> Curves:
    """x of the magnet over its signal: measured, with the lift constant, and with the level constant."""
    signals = np.linspace(0.0, float(shift.signals.max()), _SIGNALS)
    measured = np.append(0.0, shift.signals), MM * np.append(shift.zero, shift.measured)
    about = (opened, payload, signals, [0.0], shift.level, shift.height, LiftAndDirections(shift.n))
    lines = []
    for held, rule in ((True, "lift constant"), (False, f"mean current {shift.level:.3f} A")):
        x = equilibrium_surface(*about, hold_height=held).positions[:, 0, 0]
        ends = " (map ends)" if np.isnan(x).any() else ""
        lines.append(Series(f"{rule}{ends}", signals, MM * (shift.zero + x - x[0])))
    points = Series(f"measured on the rig, {shift.source}", *measured, "measured", points=True)
    where = f"Where the magnet comes to rest at z = {MM * shift.height:.0f} mm"
    title = f"{where} as one direction signal rises\nNothing is fitted"
    message = shift_message(points, lines[0])
    return Curves(title, "x signal", "x of the magnet (mm)", (points, *lines), message=message)


def shift_message(measured: Series, model: Series) -> str:
    """Sentence with the motion of the magnet and the error of the model, from the data of both.

    >>> measured = Series("measured", [0.0, 0.2, 0.4], [0.0, 4.0, 9.0], "measured", points=True)
    >>> shift_message(measured, Series("ours", [0.0, 0.2, 0.4], [0.0, 4.5, 8.1]))
    'Equilibrium moves 9 mm at signal 0.4; at constant lift the model follows within 10 %'
    """
    moved = measured.y - measured.y[0]
    known = np.isfinite(model.y)
    within = measured.x <= model.x[known].max(initial=0.0)
    off = np.interp(measured.x, model.x[known], model.y[known]) - measured.y
    share = float(np.abs(off[within]).max(initial=0.0) / np.abs(moved).max())
    so_far = "" if within.all() else f" up to {measured.x[within].max():g}"
    ends = f"{abs(moved[-1]):.0f} mm at signal {measured.x[-1]:g}"
    return f"Equilibrium moves {ends}; at constant lift the model follows within {percent(share)}{so_far}"


def _axis_curves(drawn: _Drawn) -> Curves:
    """Bz on the vertical line through the middle of the box."""
    lower, upper = drawn.opened.bounds
    z = np.linspace(lower[2], upper[2], 201)
    middle = np.broadcast_to(0.5 * (lower + upper)[:2], (len(z), 2))
    flux = drawn.opened.field(np.column_stack([middle, z]), drawn.currents)[:, 2]
    return Curves(f"On the axis, {drawn.amperes}", "z (mm)", "Bz (mT)", (Series("Bz", MM * z, MM * flux),))


def _draw_forces(axes: Axes, drawn: _Drawn, payload: Payload) -> None:
    force_slice(drawn.opened, drawn.currents, payload=payload, ax=axes)
    red = ""
    if drawn.height is not None and isinstance(payload.magnet, MagnetCylinder):
        red = "red: where lift equals weight, and the magnet there"
        size = MM * payload.magnet.diameter, MM * payload.magnet.height
        corner = -0.5 * size[0], MM * drawn.height - 0.5 * size[1]
        axes.add_patch(Rectangle(corner, *size, facecolor="none", edgecolor=MAGNET, linewidth=1.8))
    axes.set_title("\n".join(line for line in (drawn.amperes, red, axes.get_title("left")) if line))
