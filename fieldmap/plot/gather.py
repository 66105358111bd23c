"""Contents of a scene, from names: a device, its mesh, a field at currents, an equilibrium, a difference, a run."""

import os
import sys
import tomllib
from collections.abc import Mapping
from contextlib import nullcontext
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from fieldmap.arguments import check
from fieldmap.constants import GRAVITY
from fieldmap.device import read_device, recorded_device
from fieldmap.device.model import Device
from fieldmap.errors import InputError, NoEquilibrium
from fieldmap.field import FieldAtCurrents, as_field
from fieldmap.inputs.tables import is_number
from fieldmap.io import FieldSource
from fieldmap.io.answers import require_box
from fieldmap.levitation import ReachableSet, SearchedSet, equilibrium_surface, find_equilibrium, reachable
from fieldmap.lookup import MagneticBody, MapAtCurrents, magnetic_body
from fieldmap.plot.shown import Shown, ShownRun
from fieldmap.plot.words import amperes_in_words, fitting_prefix, millimetres
from fieldmap.progress import Progress
from fieldmap.shipped import shipped_file
from fieldmap.store import read_runs
from fieldmap.typing import Array, PathLike

SIGNALS = np.linspace(-0.3, 0.3, 13)
"""Values of both direction signals for the scene of the shift."""
WITH_FIELD = ("iron", "lines", "slices", "surfaces", "forces", "equilibrium")
"""Scenes of a field at currents."""
DEFAULT_LIMIT = 3.0
"""Limit of every current, A, for the reachable set of a device without driver."""


def shown_device(device: Device) -> Shown:
    """A device without a field."""
    return Shown(device.title, device, payload=device.payload)


def shown_mesh(device: Device, refinement: float = 1.0) -> Shown:
    """The mesh of a device's iron; nothing is solved. Raises InputError for a device without iron."""
    if not device.bodies:
        remedy = "name a device with iron"
        raise InputError.of(device.name, "must have iron to mesh", "no bodies", remedy)
    from fieldmap.iron import generate_mesh

    mesh = generate_mesh(device, refinement)
    return Shown(f"{device.name}: {len(mesh.tets)} tetrahedra", device, mesh=mesh)


def shown_field(
    source: FieldSource,
    currents: Array,
    what: str,
    minus: FieldSource | None = None,
    height: float | None = None,
    place: Array | None = None,
    limit: float | None = None,
    kind: str = "",
) -> Shown:
    """A named field at currents (n_coils,), A, for the scene `what`.

    minus: the field to subtract, for "difference". height: of the magnet's centre, m, for "shift". For "reachable":
    place (3,), m, by default the middle of the box; limit of every current, A, by default the driver's; kind: "force"
    on the payload, upright, or "B". Raises InputError, before anything is solved, for arguments that do not fit.
    """
    if what == "difference":
        return _difference(source, minus, currents)
    if what == "shift":
        return _shift(source, currents, height)
    title = f"{source.name} ({source.kind}), {amperes_in_words(currents, source.coil_names)}"
    lower, upper = source.bounds or (None, None)
    about = Shown(title, source.device, currents=currents, lower=lower, upper=upper, payload=source.payload)
    if what == "reachable":
        return _reachable(source, about, currents, place, limit, kind)
    return _with_field(source, about, currents, what) if what in WITH_FIELD else about


def _with_field(source: FieldSource, about: Shown, currents: Array, what: str) -> Shown:
    state = source.field.at(currents)
    at = find_equilibrium(source.field, currents, source.payload).position if what == "equilibrium" else None
    shown = replace(about, field=state, equilibrium=at, assumptions=_told(source, currents))
    if isinstance(state, MapAtCurrents):
        return shown
    # Imported here, because a scene of a map does not need the solver.
    from fieldmap.iron import SolvedState

    if not isinstance(state, SolvedState):
        return shown
    flux = None if state.mesh is None else state.element_flux_density
    return replace(shown, everywhere=True, mesh=state.mesh, flux_density=flux)


def _reachable(
    source: FieldSource, about: Shown, currents: Array, place: Array | None, limit: float | None, kind: str
) -> Shown:
    lower, upper = require_box(source)
    at = 0.5 * (lower + upper) if place is None else place
    most = limit or (DEFAULT_LIMIT if source.driver is None else source.driver.current_limit)
    acted_on: Array | MagneticBody | None = None
    if kind != "B":
        about.need("payload")
        assert source.payload is not None
        acted_on = source.payload.moment_vector
        # The force on soft iron is not linear in the currents.
        if source.payload.pieces and len((body := magnetic_body(source.payload)).soft):
            acted_on = body
    exact = as_field(source.field).affine and not isinstance(acted_on, MagneticBody)
    with nullcontext() if exact else Progress("reachable set") as say:
        found = reachable(source.field, at, most, acted_on, progress=say)
    title = f"{source.name}, at {millimetres(at)} mm, each current within {most:g} A\n{_reach_in_words(found, source)}"
    title += "; arrows: one coil alone at its limit" if isinstance(found, ReachableSet) else ""
    assumptions = _told(source, currents)
    if isinstance(found, SearchedSet):
        assumptions += (
            f"what is reachable was searched along {len(found.directions)} directions: the currents may reach further, "
            "and need not reach all within the solid",
        )
    return replace(about, title=title, reachable=found, assumptions=assumptions)


def _reach_in_words(found: ReachableSet | SearchedSet, source: FieldSource) -> str:
    """Text with the largest values of the set along x, y and z."""
    ways = {name: found.largest_along(axis) for name, axis in zip(("x", "y", "z"), np.eye(3), strict=True)}
    prefix, factor = fitting_prefix(max(ways.values()))
    reach = ", ".join(f"{factor * value:.3g} along {name}" for name, value in ways.items())
    words = f"reaches{'' if found.exact else ' at least'}, in {prefix}{found.unit}, {reach}"
    if found.quantity == "force" and source.payload is not None:
        words += f"; lift up to {ways['z'] / (source.payload.mass * GRAVITY):.2f} times the weight"
    return words


def _told(source: FieldSource, currents: Array) -> tuple[str, ...]:
    """Assumptions of the field; warnings are printed on stderr, too."""
    assumptions = source.assumptions(currents)
    for text in assumptions:
        if text.startswith("warning"):
            print(text, file=sys.stderr)
    return assumptions


def _difference(source: FieldSource, minus: FieldSource | None, currents: Array) -> Shown:
    if minus is None:
        must_hold = "must come with --minus"
        raise InputError.of("--what difference", must_hold, "no --minus", "add --minus MAP")
    both, where = (source, minus), "show, --minus"
    coils = "; ".join(f"{one.name}: {', '.join(one.coil_names)}" for one in both)
    must_hold = "both must have the same coils in the same order"
    check(source.coil_names == minus.coil_names, where, must_hold, coils, "compare two maps of one device")
    lows, highs = zip(*(require_box(one) for one in both), strict=True)
    lower, upper = np.maximum(*lows), np.minimum(*highs)
    boxes = [
        f"{one.name} {millimetres(low)} to {millimetres(high)} mm"
        for one, low, high in zip(both, lows, highs, strict=True)
    ]
    shared, remedy = bool((lower < upper).all()), "choose two maps of the same workspace, in the same frame"
    check(shared, where, "the boxes of both must share a volume", ", ".join(boxes), remedy)
    for one in both:
        _told(one, currents)
    field = FieldDifference(source.field.at(currents), minus.field.at(currents))
    title = f"{source.name} less {minus.name}, {amperes_in_words(currents, source.coil_names)}"
    return Shown(title, field=field, currents=currents, lower=lower, upper=upper, payload=source.payload)


class FieldDifference(FieldAtCurrents):
    """The field first - second at the same currents."""

    def __init__(self, first: FieldAtCurrents, second: FieldAtCurrents) -> None:
        self.first, self.second = first, second
        self.currents = first.currents

    @property
    def coil_names(self) -> tuple[str, ...]:
        """Names of the coils, which both have."""
        return self.first.coil_names

    def field(self, points: ArrayLike) -> Array:
        """B of the first less B of the second (n, 3), T."""
        return np.asarray(self.first.field(points) - self.second.field(points))

    def gradient(self, points: ArrayLike) -> Array:
        """Gradient of the first less gradient of the second (n, 3, 3), T/m."""
        return np.asarray(self.first.gradient(points) - self.second.gradient(points))


def _shift(source: FieldSource, currents: Array, height: float | None) -> Shown:
    """The scene of the shift. Equal currents set the level of the field's own signals, other currents their shares."""
    require_box(source)
    equal = not np.ptp(currents)
    level = float(currents[0] if equal else np.abs(currents).mean())
    shares = None if equal else currents / level
    at, why = (height, "") if height is not None else floating_height(source, currents)
    surface = equilibrium_surface(source.field, source.payload, SIGNALS, SIGNALS, level, at, shares=shares)
    missing = int(np.isnan(surface.levels).sum())
    words = f", none for {missing} of {surface.levels.size} pairs" if missing else ""
    place = f"at z = {1e3 * at:.4g} mm{why}"
    title = f"{source.name}: where the magnet rests {place}, {level:g} A at signals 0{words}"
    return Shown(title, surface=surface, assumptions=_told(source, currents))


def floating_height(source: FieldSource, currents: Array) -> tuple[float, str]:
    """z of the magnet's centre, m: at the equilibrium for these currents, or the middle of the box; and which one."""
    lower, upper = require_box(source)
    try:
        found = find_equilibrium(source.field, currents, source.payload)
    except NoEquilibrium:
        return 0.5 * float(lower[2] + upper[2]), ", middle of the box (floats nowhere)"
    return float(found.position[2]), ", where it floats"


# Numbers of columns of the drawn signals.
_COLUMNS = {"position": 3, "quaternion": 4, "sensed": 3, "reference": 3}


def shown_run(path: PathLike) -> Shown:
    """The first run of a file that `fieldmap simulate -o` wrote, with the device that it records.

    Raises InputError for a file without samples or without a run.
    """
    runs, about = read_runs(path)
    if not runs or not np.size(runs[0].arrays.get("time", ((),))[0]):
        raise _no_run(path, "must hold a run with samples", "none")
    signals = {name: values for name, (values, _, _) in runs[0].arrays.items()}
    device, scenario = _recorded(path, about)
    rows = signals["time"].shape
    for name, columns in {**_COLUMNS, "currents": len(device.coils)}.items():
        there = signals[name].shape if name in signals else None
        if there != (*rows, columns):
            must_hold = f"{name} must have {columns} columns and a row for each time"
            raise _no_run(path, must_hold, f"shape {there}")
    body = scenario.get("body", {})
    given = [body.get(key) for key in ("radius_mm", "height_mm")] if isinstance(body, dict) else []
    sizes = [1e-3 * float(size) for size in given if size is not None and is_number(size)]
    # The reference is for the sensed point, which is above the centre of mass.
    above = np.mean(signals["sensed"] - signals["position"], axis=0)
    title = about.get("title", "")
    run = ShownRun(
        title,
        device,
        signals["time"],
        signals["position"],
        signals["quaternion"],
        signals["currents"],
        wanted=signals["reference"] - above,
        body=(sizes[0], sizes[1]) if len(sizes) == 2 else None,
        event=str(runs[0].about.get("event", "")),
    )
    return Shown(title, run=run)


def _recorded(path: PathLike, about: Mapping[str, str]) -> tuple[Device, dict[str, Any]]:
    """The device that a file of runs records, and the scenario. Older files name a shipped device; no other file is
    read."""
    try:
        scenario = tomllib.loads(about.get("scenario", ""))
    except (tomllib.TOMLDecodeError, RecursionError) as error:
        raise _no_run(path, "must record its scenario", str(error)) from None
    if "device" in about:
        return recorded_device(about["device"], solids=True), scenario
    shipped = shipped_file("geometry", str(scenario.get("device")))
    if shipped is None:
        raise _no_run(path, "must record its device", "none")
    return read_device(shipped), scenario


def _no_run(path: PathLike, must_hold: str, received: str) -> InputError:
    return InputError.of(os.fspath(path), must_hold, received, "simulate again, with -o and at most 50 runs")
