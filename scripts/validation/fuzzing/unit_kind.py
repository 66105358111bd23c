"""FMUs of the package, called by a faulty importer, or with a damaged map among their resources."""

import ctypes
import math
import xml.etree.ElementTree as ElementTree
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

import fieldmap as fm
from fieldmap.dynamics import RigidBody
from fieldmap.errors import InputError, Problem
from fieldmap.interop import write_fmu
from fieldmap.lookup import FiniteMagnet
from validation.fuzzing.case import Case, Generator, Kind
from validation.fuzzing.mutations import bytes_of

CALLBACK = ctypes.CFUNCTYPE(
    None, ctypes.c_void_p, ctypes.c_char_p, ctypes.c_int, ctypes.c_char_p, ctypes.c_char_p
)
ODD = (math.nan, math.inf, -math.inf, 1e308, -1e308, 5e-324, 0.0, -1.0, 1e-300, 1e9, 0.01)
REFERENCES = 100
"""A value reference beyond the last of the unit."""


class Callbacks(ctypes.Structure):
    """Callbacks of FMI 2: a logger, and functions for memory and steps, which the unit does not use."""

    _fields_ = (("logger", CALLBACK), *((name, ctypes.c_void_p) for name in "abcd"))


def units(folder: Path) -> Callable[[Generator, int], Case]:
    """A rigid body in the field of a map, FMI 2: opened, set, stepped and read with any numbers."""
    field = fm.open_map("sample")
    magnet = FiniteMagnet(np.zeros((1, 3)), np.array([[0.0, 0.0, 0.8]]))
    body = RigidBody(0.01, np.array([6.8e-7, 7.1e-7, 1.9e-7]), magnet, magnet_at=np.zeros(3))
    path = write_fmu(field.at(1.0), folder / "unit.fmu", body=body, version=2)
    with zipfile.ZipFile(path) as archive:
        archive.extractall(folder / "unit")
    token = ElementTree.parse(folder / "unit" / "modelDescription.xml").getroot().get("guid", "").encode()
    (binary,) = (folder / "unit" / "binaries").rglob("*.so")
    library = ctypes.CDLL(str(binary))
    library.fmi2Instantiate.restype = ctypes.c_void_p
    resources = folder / "unit" / "resources"
    sound = (resources / "map.fmap").read_bytes()
    middle = 0.5 * (field.lower + field.upper)
    # Kept alive as long as the unit may log.
    callbacks = Callbacks(CALLBACK(lambda *_: None))

    def opened(token: bytes, place: bytes) -> Any:
        unit = library.fmi2Instantiate(b"one", 1, token, place, ctypes.byref(callbacks), 0, 1)
        if not unit:
            # The unit refuses by returning no instance; the message is made here.
            raise InputError(
                Problem("fmi2Instantiate", "must be given its own map", "another", "unpack it again")
            )
        return ctypes.c_void_p(unit)

    def call(rng: Generator, token: bytes, place: bytes) -> Any:
        unit, answers = opened(token, place), []
        try:
            for _ in range(int(rng.integers(1, 8))):
                count = int(rng.integers(1, 20))
                chosen = (ctypes.c_uint * count)(*(int(k) for k in rng.integers(0, REFERENCES, count)))
                odd = rng.random() < 0.7
                values = [float(rng.choice(ODD)) if odd else float(middle[k % 3]) for k in range(count)]
                library.fmi2SetReal(unit, chosen, ctypes.c_size_t(count), (ctypes.c_double * count)(*values))
                step = float(rng.choice([1e-3, 0.0, -1.0, math.nan, math.inf, 1e300, 1e-12]))
                library.fmi2DoStep(unit, ctypes.c_double(0.0), ctypes.c_double(step), 0)
                out = (ctypes.c_double * count)()
                status = library.fmi2GetReal(unit, chosen, ctypes.c_size_t(count), out)
                answers.append((status, list(chosen), list(out)))
            states = (ctypes.c_double * 13)()
            answers.append((library.fmi2GetDerivatives(unit, states, ctypes.c_size_t(13)), [], []))
            if rng.random() < 0.3:
                library.fmi2Reset(unit)
                reference = (ctypes.c_uint * 3)(40, 41, 42)
                out = (ctypes.c_double * 3)()
                status = library.fmi2GetReal(unit, reference, ctypes.c_size_t(3), out)
                answers.append((status, "reset", list(out)))
        finally:
            library.fmi2FreeInstance(unit)
        return answers

    good = resources.as_uri().encode()
    start = call_reset(library, opened(token, good))

    def make(rng: Generator, number: int) -> Case:
        place, given, change, raw = good, token, "calls", sound
        if number % 3 == 1:
            change, raw = bytes_of(sound, rng)
        elif number % 6 == 2:
            strange = (
                b"", b"file:///", b"file://host", b"/" * 5000, b"%", b"%0", b"%zz/x", b"file:%00",
                b"\xff\xfe", b".",
            )  # fmt: skip
            place, change = strange[int(rng.integers(len(strange)))], "folder"
        elif number % 6 == 5:
            given, change = (b"", b"{}", token[:-1], token * 500)[int(rng.integers(4))], "token"
        (resources / "map.fmap").write_bytes(raw)
        seed = int(rng.integers(2**31))
        read = lambda: call(np.random.default_rng(seed), given, place)  # noqa: E731
        return Case(f"{change}, seed {seed}", read, lambda found: _fault(found, start, raw == sound))

    return make


def call_reset(library: Any, unit: Any) -> list[float]:
    """B of the unit at its start values, after a reset."""
    out = (ctypes.c_double * 3)()
    library.fmi2GetReal(unit, (ctypes.c_uint * 3)(40, 41, 42), ctypes.c_size_t(3), out)
    library.fmi2FreeInstance(unit)
    return list(out)


def _fault(answers: Any, start: list[float], sound: bool) -> str:
    """A status must be one of FMI, a reset must restore the start values, and a damaged map must not give an answer."""
    if not sound:
        return "opened with a damaged map"
    for status, what, out in answers:
        if status not in (0, 1, 2, 3):
            return f"status {status}"
        if what == "reset" and status == 0 and out != start:
            return f"{out} after a reset, {start} at the start"
    return ""


UNITS = Kind("FMUs, by their importer", units, seconds=2.0, through_command=0)
