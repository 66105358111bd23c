"""A field in a plane and along a line, drawn into matplotlib's Axes."""

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from numpy.typing import ArrayLike

from fieldmap.arguments import check, check_choice, checked_vectors
from fieldmap.constants import GRAVITY
from fieldmap.device.model import Payload
from fieldmap.field import AnyField, Bounds, require_bounds, resolve_currents
from fieldmap.instruments import observability
from fieldmap.levitation.balance import upright_force
from fieldmap.lookup import FieldMap, MagneticBody
from fieldmap.plot.device_drawing import MAGNET
from fieldmap.plot.forces import net_force
from fieldmap.plot.places import AXES, MM, plane_of
from fieldmap.plot.scales import COLOUR_MAP
from fieldmap.plot.words import fitting_prefix, label_step
from fieldmap.typing import Array

_SHADED, _ARROWS = (61, 81), (9, 13)
"""Numbers of points along the two axes of a slice: for the colours, and for the arrows."""
_ON_LINE = 201
_COMPONENTS = ("Bx", "By", "Bz")
_SENSED = ("place", "tilt", "singular value")


def field_slice(
    field: AnyField,
    currents: Any = None,
    *,
    normal: str = "y",
    at: float | None = None,
    component: str = "",
    bounds: Bounds | None = None,
    ax: Axes | None = None,
) -> Axes:
    """Draw the flux density in a plane as colour.

    Parameters
    ----------
    field
        Map, solution, coils, solved state, or a field of your own.
    currents
        Currents, A, as for `field.at`; not for a solved state, which has its own.
    normal
        "x", "y" or "z", the axis normal to the plane.
    at
        Coordinate of the plane on that axis, m; by default the middle of the box.
    component
        "Bx", "By" or "Bz"; by default the magnitude of B.
    bounds
        Lower and upper corner (3,), m; by default the box of the field.
    ax
        Axes to draw into; by default matplotlib's current Axes.

    Returns
    -------
    Axes
        The Axes, lengths in mm, flux density in mT.

    Raises
    ------
    InputError
        For a field without a box, and for an unknown axis or component, or wrong currents.
    """
    if component:
        check_choice("component", component, _COMPONENTS)
    source, amperes = resolve_currents(field, currents)
    places, across = plane_of(bounds or require_bounds(source), normal, at, _SHADED)
    flux = MM * source.field(places, amperes)
    if component:
        values, label = flux[:, _COMPONENTS.index(component)], f"{component} (mT)"
    else:
        values, label = np.linalg.norm(flux, axis=1), "size of B (mT)"
    ax = _axes(ax)
    shade(ax, places, values, across, label)
    (square,) = {0, 1, 2} - set(across)
    ax.set_title(f"plane {AXES[square]} = {MM * places[0, square]:.4g} mm")
    return ax


def force_slice(
    field: AnyField,
    currents: Any = None,
    *,
    payload: Payload,
    normal: str = "y",
    at: float | None = None,
    bounds: Bounds | None = None,
    ax: Axes | None = None,
) -> Axes:
    """Draw the forces on an upright payload in a plane: lift over weight as colour, with a red line where the lift
    carries the payload, and arrows of the sum of magnetic force and weight.

    Parameters
    ----------
    field, currents, normal, at, bounds, ax
        As for `field_slice`.
    payload
        The payload; its mass must be known.

    Returns
    -------
    Axes
        The Axes, lengths in mm.

    Raises
    ------
    InputError
        As `field_slice`.
    """
    source, amperes = resolve_currents(field, currents)
    box = bounds or require_bounds(source)
    places, across = plane_of(box, normal, at, _SHADED)
    lift = upright_force(source, amperes, payload, places)[:, 2] / (payload.mass * GRAVITY)
    ax = _axes(ax)
    shade(ax, places, lift, across, "lift / weight", line=1.0)
    places, _ = plane_of(box, normal, at, _ARROWS)
    net = net_force(source, amperes, payload, places)
    x, y = (MM * places[:, k] for k in across)
    ax.quiver(x, y, *(net[:, k] for k in across), color="white", width=0.007, pivot="middle")
    longest = float(np.linalg.norm(net, axis=1).max())
    prefix, factor = fitting_prefix(longest)
    ax.set_title(f"arrows: net force, up to {factor * longest:.2g} {prefix.replace('u', 'µ')}N")
    return ax


def sensing_slice(
    field_map: FieldMap,
    body: MagneticBody,
    deviation: ArrayLike,
    *,
    shows: str = "place",
    normal: str = "y",
    at: float | None = None,
    bounds: Bounds | None = None,
    ax: Axes | None = None,
) -> Axes:
    """Draw the accuracy with which field sensors determine the pose of an upright magnet with its centre in a plane.

    Parameters
    ----------
    field_map, body, deviation
        As for `fieldmap.instruments.observability`.
    shows
        "place" or "tilt", the largest standard deviation of an estimate from one set of readings, or "singular value",
        the smallest of the sensitivity matrix.
    normal, at, ax
        As for `field_slice`.
    bounds
        Lower and upper corner (3,), m, for the centre of the magnet; by default all positions with the magnet in the
        map.

    Returns
    -------
    Axes
        The Axes, lengths in mm.

    Raises
    ------
    InputError
        As `observability`, and for another value of `shows`.
    OutsideMapError
        For bounds within which the magnet leaves the map.
    """
    reach = np.abs(body.points).max(axis=0, initial=0.0)
    lower, upper = bounds or (field_map.lower + reach, field_map.upper - reach)
    places, across = plane_of((lower, upper), normal, at, _SHADED)
    found = observability(field_map, body, places, deviation)
    shifts, turns = np.hsplit(found.deviations, 2)
    # A rotation that no sensor sees at any point, such as roll, does not count as tilt.
    turns = turns[:, np.isfinite(turns).any(axis=0)]
    values, label = {
        "place": (MM * shifts.max(axis=1), "deviation of the place (mm)"),
        "tilt": (np.rad2deg(turns.max(axis=1, initial=0.0)), "deviation of the tilt (degrees)"),
        "singular value": (found.smallest, "smallest singular value (1/mm, 1/degree)"),
    }[check_choice("shows", shows, _SENSED)]
    must_hold, remedy = (
        "the sensors must tell it everywhere in the plane",
        "add sensors, or show another quantity",
    )
    check(bool(np.isfinite(values).all()), f'sensing_slice, "{shows}"', must_hold, "no estimate", remedy)
    ax = _axes(ax)
    shade(ax, places, values, across, label)
    (square,) = {0, 1, 2} - set(across)
    ax.set_title(f"plane {AXES[square]} = {MM * places[0, square]:.4g} mm")
    return ax


def field_along(
    field: AnyField,
    currents: Any = None,
    *,
    start: ArrayLike,
    end: ArrayLike,
    points: int = _ON_LINE,
    ax: Axes | None = None,
) -> Axes:
    """Draw the components of the flux density along a straight line.

    Parameters
    ----------
    field, currents, ax
        As for `field_slice`.
    start, end
        Ends of the line (3,), m.
    points
        Number of points.

    Returns
    -------
    Axes
        The Axes: distance from the start, or the coordinate parallel to the line, in mm; flux density in mT.

    Raises
    ------
    InputError
        For ends that are not points, and as `field.at`.
    """
    source, amperes = resolve_currents(field, currents)
    ends = [checked_vectors(name, given)[0] for name, given in (("start", start), ("end", end))]
    places = ends[0] + np.linspace(0.0, 1.0, points)[:, None] * (ends[1] - ends[0])
    moved = np.flatnonzero(np.ptp(places, axis=0))
    if len(moved) == 1:
        along, label = MM * places[:, moved[0]], f"{AXES[moved[0]]} (mm)"
    else:
        along, label = MM * np.linalg.norm(places - places[0], axis=1), "distance from the start (mm)"
    ax = _axes(ax)
    for name, values in zip(_COMPONENTS, (MM * source.field(places, amperes)).T, strict=True):
        ax.plot(along, values, label=name)
    ax.set(xlabel=label, ylabel="flux density (mT)")
    ax.legend()
    return ax


def shade(
    ax: Axes, places: Array, values: Array, across: tuple[int, int], label: str, line: float | None = None
) -> None:
    """Draw values (n,) at points of `plane_of` as colour, with round numbers at the bar; and a red line at `line`."""
    x, y, shown = (one.reshape(_SHADED) for one in (*(MM * places[:, k] for k in across), values))
    largest = float(np.abs(values).max())
    # The span of a uniform field is rounding.
    span = float(np.ptp(values))
    step = label_step(span if span > 1e-9 * largest else largest or 1.0)
    low, high = step * np.floor(values.min() / step), step * (np.floor(values.max() / step) + 1.0)
    levels = np.linspace(low, high, 5 * round((high - low) / step) + 1)
    shaded = ax.contourf(x, y, shown, levels=levels, cmap=COLOUR_MAP)
    figure: Any = ax.figure
    bar = figure.colorbar(shaded, ax=ax, label=label, ticks=levels[::5])
    if line is not None and values.min() < line < values.max():
        ax.contour(x, y, shown, levels=[line], colors=[MAGNET], linewidths=1.6)
        bar.ax.axhline(line, color=MAGNET, linewidth=1.6)
    ax.set(xlabel=f"{AXES[across[0]]} (mm)", ylabel=f"{AXES[across[1]]} (mm)", aspect="equal")
    ax.grid(False)


def _axes(ax: Axes | None) -> Axes:
    if ax is not None:
        return ax
    from matplotlib import pyplot  # imported only without `ax`, because it selects a window system

    return pyplot.gca()
