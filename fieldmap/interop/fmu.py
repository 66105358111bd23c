"""A map as a functional mock-up unit (FMI 2.0 or 3.0), alone or with a rigid body in its field.

The unit consists of the C source fmu.c of this folder, headers of the C core and a header of numbers, compiled, and
the map's flat file as a resource. It runs without Python. Value references are indices of one array, see fmu.c.
"""

from __future__ import annotations

import copy
import io
import os
import platform
import shutil
import subprocess
import sys
import tempfile
import uuid
from collections.abc import Sequence
from hashlib import sha256
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple
from xml.etree.ElementTree import Element, indent, tostring
from zipfile import ZIP_DEFLATED, ZipFile, ZipInfo

import numpy as np
from numpy.typing import ArrayLike

from fieldmap.arguments import check, check_choice, check_signal
from fieldmap.core.headers import in_one
from fieldmap.errors import FieldmapError, InputError
from fieldmap.interop.c_map import c_identifier, write_c_iron_map, write_c_map
from fieldmap.lookup import FieldMap, MagneticBody, MapAtCurrents
from fieldmap.lookup.iron_response import inductance_at_zero
from fieldmap.store.whole_files import write_whole
from fieldmap.typing import Array, PathLike

if TYPE_CHECKING:
    from fieldmap.dynamics import CoilDrive, RigidBody

# Indices in the array of values, the same as in fmu.c.
_POSITION, _VELOCITY, _TURN, _ANGULAR, _DERIVATIVES, _PUSH, _TWIST = 1, 4, 7, 11, 14, 27, 30
_STRENGTH, _MASS, _INERTIA, _GRAVITY, _STEP = 33, 34, 35, 38, 39
_FIELD, _GRADIENT, _FORCE, _TORQUE, _CURRENTS = 40, 43, 52, 55, 58
_LARGEST_STEP = 5e-5
_COMPILERS = ("cc", "gcc", "clang")
_FLAGS = ("-std=c99", "-O2", "-fPIC", "-shared", "-fvisibility=hidden")
VERSIONS = {2: "2.0", 3: "3.0"}
# Units of FMI as exponents of SI base units.
_UNITS = {
    "m": {"m": 1},
    "s": {"s": 1},
    "A": {"A": 1},
    "kg": {"kg": 1},
    "m/s": {"m": 1, "s": -1},
    "m/s2": {"m": 1, "s": -2},
    "rad/s": {"s": -1, "rad": 1},
    "rad/s2": {"s": -2, "rad": 1},
    "1/s": {"s": -1},
    "V": {"kg": 1, "m": 2, "s": -3, "A": -1},
    "Wb": {"kg": 1, "m": 2, "s": -2, "A": -1},
    "N": {"kg": 1, "m": 1, "s": -2},
    "N.m": {"kg": 1, "m": 2, "s": -2},
    "T": {"kg": 1, "s": -2, "A": -1},
    "T/m": {"kg": 1, "s": -2, "A": -1, "m": -1},
    "kg.m2": {"kg": 1, "m": 2},
}


class _Variable(NamedTuple):
    """A variable of the model. state: for a derivative, the value reference of its state."""

    reference: int
    name: str
    causality: str
    unit: str
    about: str
    start: float | None = None
    state: int | None = None

    @property
    def initial(self) -> str | None:
        if self.causality in ("input", "independent"):
            return None
        return "calculated" if self.start is None else "exact"


def write_fmu(
    field: FieldMap | MapAtCurrents,
    path: PathLike,
    magnet: MagneticBody | ArrayLike = (0.0, 0.0, 1.0),
    body: RigidBody | None = None,
    *,
    drive: CoilDrive | None = None,
    version: int = 2,
    binary: bool = True,
) -> Path:
    """Write a map as an FMU for co-simulation and model exchange, compiled for this machine.

    Inputs are the coils' currents, A (none for a map at fixed currents), and the magnet's pose; outputs are B and its
    gradient at the magnet, and force and torque on it. With a body the unit simulates its motion, and inputs are the
    currents and a disturbing force and torque. Only inertia, weight and the field act on the body: no drag, no walls.
    Iron with hysteresis begins with the memory of the map, and remembers the currents of every step.

    With a drive other than "ideal" the flux linkages of the map couple the coils with each other and with the magnet
    (docs/theory/electrical.md). Inputs are then voltages, V, or the reference currents of a controller; outputs
    include currents, linkages and induced voltages of the magnet. Without a body, inputs include velocities. Such a
    unit is for co-simulation only.

    Parameters
    ----------
    field
        The map.
    path
        Path of the file.
    magnet
        A moment (3,), A m^2, or dipoles, in the frame of the pose.
    body
        A rigid body, whose magnet replaces `magnet`.
    drive
        Drive of the coils; by default a current source. Of the amplifier only the current limits are used.
    version
        Version of FMI, 2 or 3.
    binary
        Whether the unit is compiled for this machine. Otherwise it has only its sources, for an importer that
        compiles them, such as `python -m fmpy compile`.

    Returns
    -------
    Path
        The path.

    Raises
    ------
    InputError
        For a Hermite form and for soft iron; with a drive, for a map at fixed currents, without linkages or of
        another number of coils.
    FieldmapError
        If no C compiler is found (CC, cc, gcc or clang).

    Examples
    --------
    >>> write_fmu(open_map("linear.h5"), "lift.fmu", magnet=[0, 0, 0.8])                     # doctest: +SKIP
    """
    check_choice("write_fmu(version)", str(version), map(str, VERSIONS))
    target, carried = Path(path), _dipoles(magnet if body is None else body.magnet)
    seat = np.zeros(3) if body is None else body.magnet_at
    coils = field.coil_names if isinstance(field, FieldMap) else ()
    rows = None if drive is None or not drive.coupled else _coils_of(field, drive)
    asked = None if rows is None or drive is None else "voltage" if drive.gives_voltage else "reference"
    middle = (np.asarray(field.lower) + field.upper) / 2
    variables = _variables(coils, _first_currents(field), middle, body, asked)
    identifier = c_identifier(target.stem, "fmu")
    with tempfile.TemporaryDirectory() as folder:
        work = Path(folder)
        flat, headers, iron = work / "map.fmap", ["fieldmap_body.h"], False
        if isinstance(field, FieldMap) and not field.affine:
            write_c_iron_map(field, flat)
            headers, iron = [*headers, "fieldmap_iron.h"], True
        else:
            write_c_map(field, flat)
        headers += ["caller.h", "machine.h"] if asked else []
        shutil.copy(Path(__file__).with_name("fmu.c"), work)
        for name in headers:
            (work / name).write_text(in_one(name), encoding="utf-8")
        numbers = _numbers_header(version, len(coils), iron, carried, seat, body, variables)
        numbers += _drives_header(field, rows)
        # The same map and magnet have the same token.
        token = str(uuid.uuid5(uuid.NAMESPACE_URL, numbers + sha256(flat.read_bytes()).hexdigest()))
        (work / "fmu_model.h").write_text(numbers.replace("@TOKEN@", token), encoding="utf-8")
        files = {
            "modelDescription.xml": _document(_description(version, identifier, token, variables, not asked)),
            "resources/map.fmap": flat.read_bytes(),
        }
        if binary:
            library = _compiled(work, identifier)
            files[f"binaries/{_folder(version)}/{library.name}"] = library.read_bytes()
        for name in ("fmu.c", *headers, "fmu_model.h"):
            files[f"sources/{name}"] = (work / name).read_bytes()
        if version == 3:
            files["sources/buildDescription.xml"] = _document(_build_description(identifier))
        return write_whole(target, _zipped(files), "unit of FMI")


def _dipoles(magnet: MagneticBody | ArrayLike) -> MagneticBody:
    if isinstance(magnet, MagneticBody):
        if magnet.soft:
            must_hold = "magnets only: the unit's code knows no soft iron"
            received, remedy = f"{len(magnet.soft)} soft pieces", "give the moment that it has at its place"
            raise InputError.of("write_fmu(magnet)", must_hold, received, remedy)
        return magnet
    return MagneticBody.dipole(np.ravel(check_signal("write_fmu(magnet)", magnet, columns=3)))


def _coils_of(field: FieldMap | MapAtCurrents, drive: CoilDrive) -> Array:
    """Coils with their drives (n, 15) for the C core. Raises InputError if the map has other coils or no linkages."""
    count = len(field.coil_names) if isinstance(field, FieldMap) else 0
    must_hold, remedy = "must have the coils of the map", "give resistances of these, and no fixed currents"
    good = isinstance(field, FieldMap) and drive.coils == count
    check(good, "write_fmu(drive)", must_hold, f"{drive.coils} coils, of {count} in the map", remedy)
    assert isinstance(field, FieldMap)
    return drive.coil_numbers(inductance_at_zero(field))


def _first_currents(field: FieldMap | MapAtCurrents) -> Array:
    """Initial currents (c,), A, in the domain of saturating iron."""
    if not isinstance(field, FieldMap):
        return np.zeros(0)
    first = field.last_currents if field.remembers else np.zeros(len(field.coil_names))
    reduced = field.info.reduced_model
    return first if reduced is None or reduced.domain.holds(first) else reduced.domain.middle


def _variables(
    coils: Sequence[str], currents: Array, middle: Array, body: RigidBody | None, asked: str | None
) -> list[_Variable]:
    """The variables of the unit. asked: input of the drives, "voltage" or "reference"; None for current sources."""
    found: list[_Variable] = []

    def add(
        first: int, name: str, causality: str, unit: str, about: str, start: Any = None, parts: Any = "xyz"
    ) -> None:
        starts = [None] * len(parts) if start is None else np.ravel(start).tolist()
        for k, part in enumerate(parts):
            full = f"{name}_{part}" if part else name
            found.append(_Variable(first + k, full, causality, unit, about, starts[k]))

    one = ("",)
    pose, at = ("input", "at the place") if body is None else ("output", "at the magnet's centre")
    add(0, "time", "independent", "s", "time", parts=one)
    for k, name in enumerate(coils):
        of, number, kind = f"of coil {name}", (str(k + 1),), "output" if asked else "input"
        add(_CURRENTS + k, "current", kind, "A", f"current {of}", currents[k], number)
        if asked:
            first, size = (0.0, "V") if asked == "voltage" else (currents[k], "A")
            add(_CURRENTS + len(coils) + k, asked, "input", size, f"asked for, {of}", first, number)
            add(_CURRENTS + 2 * len(coils) + k, "flux_linkage", "output", "Wb", of, parts=number)
            induced = f"that the magnet's motion induces {of}"
            add(_CURRENTS + 3 * len(coils) + k, "emf", "output", "V", induced, parts=number)
    add(_POSITION, "position", pose, "m", "place of the body's centre, frame of the map", middle)
    add(_TURN, "quaternion", pose, "1", "from the body to the map", (1.0, 0.0, 0.0, 0.0), "wxyz")
    zero = np.zeros(3)
    if body is not None or asked:
        add(_VELOCITY, "velocity", pose, "m/s", "of the body's centre", zero)
        add(_ANGULAR, "angular_velocity", pose, "rad/s", "in the frame of the body", zero)
        about = "longest step of the integrator inside, co-simulation only"
        add(_STEP, "step", "parameter", "s", about, _LARGEST_STEP, one)
    if body is not None:
        add(_PUSH, "push", "input", "N", "force that disturbs, frame of the map", zero)
        add(_TWIST, "twist", "input", "N.m", "torque that disturbs, frame of the map", zero)
        add(_MASS, "mass", "parameter", "kg", "of the body", body.mass, one)
        # An upright body has the large inertia of the simulator.
        add(_INERTIA, "inertia", "parameter", "kg.m2", "principal moments", body.numbers().inertia)
        add(_GRAVITY, "gravity", "parameter", "m/s2", "downward", body.gravity, one)
    if body is not None and not asked:
        names = {each.reference: each.name for each in found}
        for k, unit in enumerate(["m/s"] * 3 + ["m/s2"] * 3 + ["1/s"] * 4 + ["rad/s2"] * 3):
            state = _POSITION + k
            name = f"der({names[state]})"
            found.append(_Variable(_DERIVATIVES + k, name, "local", unit, "", state=state))
    add(_FIELD, "field", "output", "T", f"flux density {at}")
    for k, (a, b) in enumerate(product("xyz", "xyz")):
        add(_GRADIENT + k, "gradient", "output", "T/m", f"dB_{a}/d{b} {at}", parts=(a + b,))
    add(_FORCE, "force", "output", "N", "of the field, frame of the map")
    add(_TORQUE, "torque", "output", "N.m", "of the field about the body's centre, frame of the map")
    add(_STRENGTH, "strength", "parameter", "1", "all moments times this", 1.0, one)
    return found


def _numbers_header(
    version: int,
    coils: int,
    iron: bool,
    magnet: MagneticBody,
    seat: Array,
    body: RigidBody | None,
    variables: list[_Variable],
) -> str:
    """The text of fmu_model.h for fmu.c; @TOKEN@ stands for the token."""
    starts = np.zeros(1 + max(each.reference for each in variables))
    for each in variables:
        if each.start is not None:
            starts[each.reference] = each.start
    rows = np.hstack([magnet.points + seat, magnet.moments])
    dipoles = ", ".join(map(_braces, rows))
    lines = {
        "FMU_VERSION": version,
        "FMU_TOKEN": '"@TOKEN@"',
        "FMU_COILS": coils,
        "FMU_IRON": int(iron),
        "FMU_BODY": int(body is not None),
        "FMU_DIPOLES": len(rows),
        "FMU_MAGNET": f"{{{dipoles}}}",
        "FMU_SEAT": _braces(seat),
        "FMU_STARTS": _braces(starts),
    }
    return "".join(f"#define {name} {value}\n" for name, value in lines.items())


def _drives_header(field: FieldMap | MapAtCurrents, rows: Array | None) -> str:
    """Part of fmu_model.h: the coils with their drives; largest current of the iron's domain, A."""
    if rows is None:
        return "#define FMU_DRIVEN 0\n"
    reduced = field.info.reduced_model if isinstance(field, FieldMap) else None
    largest = 0.0 if reduced is None else float(np.max(reduced.domain.largest))
    coils = ", ".join(map(_braces, rows))
    return f"#define FMU_DRIVEN 1\n#define FMU_DRIVES {{{coils}}}\n#define FMU_LARGEST {largest!r}\n"


def _braces(numbers: Array) -> str:
    finite = np.clip(numbers, -np.finfo(float).max, np.finfo(float).max)
    return "{" + ", ".join(repr(float(x)) for x in finite) + "}"


def _compiled(folder: Path, identifier: str) -> Path:
    """Compile the library in a folder. Raises FieldmapError without a compiler, and if it fails."""
    named = os.environ.get("CC")
    compiler = shutil.which(named) if named else next(filter(None, map(shutil.which, _COMPILERS)), None)
    if compiler is None:
        remedy = "install gcc or clang, name one in CC, or write the sources alone (binary=False, --sources)"
        received = f"no {named} (CC)" if named else f"none of {', '.join(_COMPILERS)}"
        raise FieldmapError.of("write_fmu", "needs a C compiler", received, remedy)
    library = folder / (identifier + {"win32": ".dll", "darwin": ".dylib"}.get(sys.platform, ".so"))
    command = [compiler, *_FLAGS, "-I", str(folder), str(folder / "fmu.c"), "-o", str(library), "-lm"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        lines = [line for line in done.stderr.splitlines() if "error" in line]
        said = (lines or [f"exit code {done.returncode}"])[0]
        raise FieldmapError.of("write_fmu", f"{compiler} must compile the unit", said, "name another in CC")
    return library


def _folder(version: int) -> str:
    """Folder in which importers look for the library of this machine."""
    if version == 2:
        return {"win32": "win64", "darwin": "darwin64"}.get(sys.platform, "linux64")
    machine = platform.machine().lower()
    machine = {"amd64": "x86_64", "arm64": "aarch64"}.get(machine, machine)
    return f"{machine}-" + {"win32": "windows", "darwin": "darwin"}.get(sys.platform, "linux")


def _zipped(files: dict[str, bytes]) -> bytes:
    content = io.BytesIO()
    with ZipFile(content, "w", ZIP_DEFLATED) as archive:
        for name, of_file in files.items():
            # The time is constant, so that equal units have equal bytes.
            archive.writestr(ZipInfo(name, (1980, 1, 1, 0, 0, 0)), of_file, ZIP_DEFLATED)
    return content.getvalue()


def _element(name: str, /, *inside: Element, **attributes: str | None) -> Element:
    """An XML element; attributes that are None are left out."""
    made = Element(name, {key: value for key, value in attributes.items() if value is not None})
    made.extend(inside)
    return made


def _document(root: Element) -> bytes:
    indent(root)
    return tostring(root, encoding="UTF-8", xml_declaration=True)


def _build_description(identifier: str) -> Element:
    sources = _element("SourceFileSet", _element("SourceFile", name="fmu.c"), language="C99")
    build = _element("BuildConfiguration", sources, modelIdentifier=identifier)
    return _element("fmiBuildDescription", build, fmiVersion="3.0")


def _description(
    version: int, identifier: str, token: str, variables: list[_Variable], exchange: bool
) -> Element:
    """modelDescription.xml."""
    sources = [_element("SourceFiles", _element("File", name="fmu.c"))] if version == 2 else []
    keeps = {"canGetAndSetFMUstate" if version == 2 else "canGetAndSetFMUState": "true"}
    units = [
        _element("Unit", _element("BaseUnit", **{k: str(v) for k, v in _UNITS[unit].items()}), name=unit)
        for unit in sorted({each.unit for each in variables} - {"1"})
    ]
    about = {"guid" if version == 2 else "instantiationToken": token}
    if version == 2:
        about |= {"variableNamingConvention": "structured", "numberOfEventIndicators": "0"}
    # References between variables: FMI 2 uses their index from 1, FMI 3 value references.
    numbers = {
        each.reference: str(each.reference if version == 3 else n) for n, each in enumerate(variables, 1)
    }
    named = {"modelIdentifier": identifier}
    steps = {"canHandleVariableCommunicationStepSize": "true"}
    return _element(
        "fmiModelDescription",
        *([_element("ModelExchange", *copy.deepcopy(sources), **named, **keeps)] if exchange else []),
        _element("CoSimulation", *sources, **named, **steps, **keeps),
        _element("UnitDefinitions", *units),
        _element("DefaultExperiment", startTime="0", stopTime="1", stepSize="0.001"),
        _element("ModelVariables", *(_described(version, each, numbers) for each in variables)),
        _element("ModelStructure", *_structure(version, variables, numbers)),
        fmiVersion=VERSIONS[version],
        modelName=identifier,
        description="Field of a map and what it does to a magnet",
        generationTool="fieldmap",
        **about,
    )


def _described(version: int, each: _Variable, numbers: dict[int, str]) -> Element:
    common = {
        "name": each.name,
        "valueReference": str(each.reference),
        "causality": each.causality,
        "variability": "fixed" if each.causality == "parameter" else "continuous",
        "initial": each.initial,
        "description": each.about or None,
    }
    value = {
        "unit": None if each.unit == "1" else each.unit,
        "start": None if each.start is None else repr(each.start),
        "derivative": None if each.state is None else numbers[each.state],
    }
    if version == 3:
        return _element("Float64", **common, **value)
    return _element("ScalarVariable", _element("Real", **value), **common)


def _structure(version: int, variables: list[_Variable], numbers: dict[int, str]) -> list[Element]:
    states = [each for each in variables if each.state is not None]
    groups = {
        "Output": [each for each in variables if each.causality == "output"],
        "Derivative" if version == 2 else "ContinuousStateDerivative": states,
        "InitialUnknown": [each for each in variables if each.initial == "calculated"],
    }
    found = []
    for name, those in groups.items():
        if version == 3:
            found += [_element(name, valueReference=numbers[each.reference]) for each in those]
        elif those:
            unknowns = (_element("Unknown", index=numbers[each.reference]) for each in those)
            found.append(_element(f"{name}s", *unknowns))
    return found
