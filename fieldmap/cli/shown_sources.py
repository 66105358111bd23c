"""What `fieldmap show` gathers before anything is drawn: a device, its mesh, a field, an equilibrium, a difference."""

import sys
import tomllib
from dataclasses import dataclass
from typing import Any

import numpy as np

from fieldmap.cli.iron import IronChoice
from fieldmap.cli.opening import Source, find_source, is_map, open_device
from fieldmap.errors import InputError, NoEquilibrium, Problem
from fieldmap.plot.shown import Shown

_SOLVED = ("iron", "lines", "slices", "surfaces", "forces", "equilibrium", "difference", "shift")
_SIGNALS = np.linspace(-0.3, 0.3, 13)


@dataclass(frozen=True)
class Request:
    """The command line. minus: the second field of a difference; height_mm: of the magnet in "shift"."""

    source: str
    what: str
    currents: tuple[str, ...]
    choice: IronChoice
    minus: str | None = None
    height_mm: float | None = None


def gather(request: Request) -> Shown:
    """Everything that the scene may draw. Raises InputError."""
    device = None if is_map(request.source) else open_device(request.source)
    if device is not None and request.what == "device":
        return Shown(device.title, device, payload=device.payload)
    if device is not None and request.what == "mesh":
        return _meshed(device, request.choice.refinement)
    return _with_field(request, device)


def _with_field(request: Request, device: Any) -> Shown:
    from fieldmap.cli.arguments import parse_currents

    found = find_source(request.source, request.choice)
    amperes = parse_currents(list(request.currents), found.coil_names)
    corners = found.corners or (None, None)
    title = f"{found.name} ({found.kind}), {amperes_in_words(amperes, found.coil_names)}"
    about: dict[str, Any] = {"device": device, "currents": amperes, "payload": found.payload}
    about |= {"lower": corners[0], "upper": corners[1]}
    if request.what not in _SOLVED:
        return Shown(title, **about)
    other = _second(request, found) if request.what == "difference" else None
    about["field"], about["assumptions"] = _opened(found, amperes)
    if device is not None:
        about |= _iron(about["field"], amperes)
    if request.what == "equilibrium":
        about["equilibrium"] = _equilibrium(found, about["field"], amperes)
    if request.what == "shift":
        return _shift(request, found, about)
    return Shown(title, **about) if other is None else _difference(found, other, about)


def _opened(found: Source, amperes: Any) -> tuple[Any, tuple[str, ...]]:
    field, assumptions = found.open(amperes)
    for text in assumptions:
        if text.startswith("warning"):
            print(text, file=sys.stderr)
    return field, tuple(assumptions)


def _meshed(device: Any, refinement: float) -> Shown:
    """The mesh alone needs no solution."""
    from fieldmap.cli.iron import require_iron
    from fieldmap.iron import generate_mesh

    require_iron(device)
    mesh = generate_mesh(device, refinement)
    return Shown(f"{device.name}: {len(mesh.tets)} tetrahedra", device, mesh=mesh)


def _iron(field: Any, amperes: Any) -> dict[str, Any]:
    from fieldmap.plot.shown import element_flux_density

    solution = field if hasattr(field, "mesh") else field.state
    if solution.mesh is None:
        return {"everywhere": True}
    flux_density = element_flux_density(solution, amperes)
    return {"everywhere": True, "mesh": solution.mesh, "flux_density": flux_density}


def _equilibrium(found: Source, field: Any, amperes: Any) -> Any:
    from fieldmap.cli.balance import searchable
    from fieldmap.levitation import find_equilibrium

    return find_equilibrium(searchable(found, field), amperes, found.payload).position


def _second(request: Request, found: Source) -> Source:
    """The other field, held against the first before either is solved."""
    from fieldmap.plot.difference import check_same_coils, common_box

    if request.minus is None:
        remedy = "add --minus MAP"
        raise InputError(Problem("--what difference", "must come with --minus", "no --minus", remedy))
    choice = IronChoice() if is_map(request.minus) else request.choice
    other = find_source(request.minus, choice)
    names = (found.name, other.name)
    check_same_coils(found.coil_names, other.coil_names, names)
    for source in (found, other):
        if source.corners is None:
            remedy = "add a [workspace] table to the device file"
            raise InputError(Problem(source.name, "must have a [workspace]", "none", remedy))
    assert found.corners is not None
    assert other.corners is not None
    common_box(found.corners, other.corners, names)
    return other


def _difference(found: Source, other: Source, about: dict[str, Any]) -> Shown:
    from fieldmap.plot.difference import FieldDifference, common_box

    assert found.corners is not None
    assert other.corners is not None
    lower, upper = common_box(found.corners, other.corners, (found.name, other.name))
    field = FieldDifference(about["field"], _opened(other, about["currents"])[0])
    title = f"{found.name} less {other.name}, {amperes_in_words(about['currents'], found.coil_names)}"
    same = {"currents": about["currents"], "payload": about["payload"]}
    return Shown(title, field=field, lower=lower, upper=upper, **same)


def _shift(request: Request, found: Source, about: dict[str, Any]) -> Shown:
    from fieldmap.cli.balance import searchable
    from fieldmap.levitation import equilibrium_surface

    amperes, field = about["currents"], searchable(found, about["field"])
    if np.ptp(amperes) > 0:
        remedy = "give one number: the lift signal, which the direction signals divide"
        raise InputError(
            Problem("--currents", "must be the same in every coil for --what shift", f"{amperes}", remedy)
        )
    height, why = _height(request, found, field, amperes)
    surface = equilibrium_surface(field, found.payload, _SIGNALS, _SIGNALS, float(amperes[0]), height)
    missing = int(np.isnan(surface.levels).sum())
    words = f", none for {missing} of {surface.levels.size} pairs" if missing else ""
    place = f"at z = {1e3 * height:.4g} mm{why}"
    title = f"{found.name}: where the magnet rests {place}, {amperes[0]:g} A at signals 0{words}"
    return Shown(title, surface=surface, assumptions=about["assumptions"])


def _height(request: Request, found: Source, field: Any, amperes: Any) -> tuple[float, str]:
    """z of the magnet's centre, m: as given, or where it floats at these currents, or the middle of the box; and words
    for a height that was not given."""
    from fieldmap.levitation import find_equilibrium

    if request.height_mm is not None:
        return 1e-3 * request.height_mm, ""
    try:
        return float(find_equilibrium(field, amperes, found.payload).position[2]), ", where it floats"
    except NoEquilibrium:
        return 0.5 * float(field.lower[2] + field.upper[2]), ", middle of the box (floats nowhere)"


def amperes_in_words(amperes: Any, names: tuple[str, ...]) -> str:
    """One number where all are the same."""
    if len(set(amperes)) == 1:
        return f"{amperes[0]:g} A in {'the coil' if len(names) == 1 else f'each of {len(names)} coils'}"
    return ", ".join(f"{name}: {value:g} A" for name, value in zip(names, amperes, strict=True))


def gather_run(path: str) -> Shown:
    """The first run of a file that `fieldmap simulate -o` wrote. Raises InputError."""
    from fieldmap.device import read_device, recorded_device
    from fieldmap.plot.trajectory import ShownRun
    from fieldmap.store import read_runs

    runs, about = read_runs(path)
    if not runs or not len(runs[0].arrays["time"][0]):
        remedy = "simulate again, with -o and at most 50 runs"
        raise InputError(Problem(path, "must hold a run with samples", "none", remedy))
    signals = {name: values for name, (values, _, _) in runs[0].arrays.items()}
    scenario = tomllib.loads(about["scenario"])
    body = scenario.get("body", {})
    sized = {"radius_mm", "height_mm"} <= set(body)
    # The reference is that of the sensed point, above the centre of mass.
    above = np.mean(signals["sensed"] - signals["position"], axis=0)
    run = ShownRun(
        about["title"],
        read_device(scenario["device"]) if "device" in scenario else recorded_device(about["device"]),
        signals["time"],
        signals["position"],
        signals["quaternion"],
        signals["currents"],
        wanted=signals["reference"] - above,
        body=(1e-3 * body["radius_mm"], 1e-3 * body["height_mm"]) if sized else None,
        event=str(runs[0].about.get("event", "")),
    )
    return Shown(about["title"], run=run)
