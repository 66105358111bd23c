"""The arguments of `fm.optimise` and `analyse_tolerances` as a problem of design.

They are checked by the same rules as a study file with [optimise]; each mistake is told at its argument.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from fieldmap.device.model import Device
from fieldmap.device.reader import TEXT, device_of
from fieldmap.device.schema import DEVICE
from fieldmap.errors import DeviceFileError, InputError, Problem
from fieldmap.inputs.document import Document, parsed
from fieldmap.inputs.findings import Finding
from fieldmap.studies.design import Carrying, DesignProblem, Number, Search
from fieldmap.studies.design_checks import checked
from fieldmap.studies.quantities import GROUPS
from fieldmap.studies.study import CurrentSet, Record, StudyIron, current_set, saturates
from fieldmap.typing import PathLike


def design_problem(
    device: PathLike | Device,
    search: Search,
    *,
    currents: Any,
    saturating: bool | None,
    refinement: float,
    points: ArrayLike | None,
    box: tuple[ArrayLike, ArrayLike] | None,
    force_share: float,
    besides: Sequence[Number] = (),
    caller: str = "optimise",
) -> DesignProblem:
    """A search with the device and the currents that `optimise`, or another caller, was given. Raises InputError with
    one Problem for every mistake."""
    document = device_document(device)
    made = device_of(document)
    problems: list[Problem] = []
    sets = current_sets(currents, made, f"{caller}(currents)", problems)
    curved = saturates(made) if saturating is None else saturating
    corners = None if box is None else (np.asarray(box[0], dtype=float), np.asarray(box[1], dtype=float))
    limit = made.driver.current_limit if made.driver is not None else None
    where = np.asarray([] if points is None else points, dtype=float).reshape(-1, 3)

    only = sets[0].name if len(sets) == 1 else ""

    def named(number: Number) -> Number:
        """With its set of currents, where there is one only."""
        return replace(number, currents=number.currents or only)

    draft = DesignProblem(
        **vars(search.with_numbers(named)),
        title=f"Optimum of {made.name}",
        document=document,
        current_sets=sets,
        iron=StudyIron("saturating" if curved else "linear", refinement=refinement),
        record=Record(GROUPS, where, force_share, limit, corners),
        coil_names=made.coil_names,
        body_names=tuple(body.name for body in made.bodies),
        besides=tuple(map(named, besides)),
    )
    done, findings = checked(draft, made)
    problems += [_told(finding, draft, caller) for finding in findings]
    if problems:
        raise InputError(*problems)
    return done


def _told(finding: Finding, draft: DesignProblem, caller: str) -> Problem:
    """A mistake at the argument that it is in."""
    where = f"{caller}({finding.location[-1]})"
    match finding.location:
        case ("optimise", "variable"):
            where = f"{caller}(variables)"
        case ("optimise", "variable", int(k), *_):
            where = f"{caller}, {draft.variables[k].key}"
        case ("optimise", "minimise" | "maximise", *_):
            where = f"{caller}, {draft.objective.label}"
        case ("optimise", "constraint", int(k), *_):
            where = f"{caller}, {draft.limits[k].asked.label}"
        case ("besides", int(k), *_):
            where = f"{caller}, {draft.besides[k].label}"
    return Problem(where, finding.must_hold, finding.received, finding.remedy)


def device_document(device: PathLike | Device) -> Document:
    """The device file of a path, a name, a text of several lines, or a device made in Python."""
    if isinstance(device, Device):
        path = device.source or Path(TEXT)
        return DEVICE.prepared(parsed(path, device.text or device.to_toml(), DeviceFileError))
    if isinstance(device, str) and "\n" in device:
        return DEVICE.prepared(parsed(Path(TEXT), device, DeviceFileError))
    return DEVICE.load(DEVICE.find(device))


def current_sets(given: Any, device: Device, where: str, problems: list[Problem]) -> tuple[CurrentSet, ...]:
    """The argument `currents` as sets of currents, as `optimise` describes it. where: what its mistakes, which go to
    `problems`, are told of."""
    named = given if isinstance(given, Mapping) else {"": 1.0 if given is None else given}
    coils, sets = len(device.coils), []
    for name, one in named.items():
        place = np.asarray(one.position, dtype=float) if isinstance(one, Carrying) else None
        amperes = (1.0 if one.shares is None else one.shares) if isinstance(one, Carrying) else one
        if (
            np.shape(amperes) not in ((), (1,), (coils,))
            or not np.any(amperes)
            or not np.isfinite(amperes).all()
        ):
            must_hold = f"one number for all coils, or one for each of {coils}, not all 0"
            remedy = "write amperes, or Carrying(position)"
            problems.append(Problem(where, must_hold, f"{amperes}"[:80], remedy))
            amperes = 1.0
        if place is not None and (device.payload is None or device.workspace is None):
            must_hold = "the device needs a [payload] and a [workspace] for currents that carry"
            problems.append(Problem(where, must_hold, "none", "add them, or write amperes"))
        sets.append(current_set(str(name), amperes, coils, place))
    return tuple(sets)
