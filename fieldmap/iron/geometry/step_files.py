"""Solids of STEP files, in the length unit that the device file gives them."""

from __future__ import annotations

import re
import tempfile
from pathlib import Path

import numpy as np

from fieldmap.device.another_process import read_by_another
from fieldmap.iron.geometry.cad_kernel import occ

_SI_LENGTH = re.compile(r"SI_UNIT\s*\(\s*([$.\w]+)\s*,\s*\.METRE\.")
_SI_PREFIX = {"$": 1.0, ".MILLI.": 1e-3, ".CENTI.": 1e-2, ".DECI.": 1e-1, ".MICRO.": 1e-6, ".KILO.": 1e3}
# In the kernel's own format, or an empty file where there is no solid.
_TO_BREP = """
from netgen import occ
limit()
pieces = list(occ.OCCGeometry(path).shape.solids)
if len(pieces) > 1:
    pieces = [occ.Fuse(pieces).UnifySameDomain()]
if pieces:
    pieces[0].WriteBrep(out, withTriangles=False)
else:
    open(out, "w").close()
"""
_CONVERTED = re.compile(r"CONVERSION_BASED_UNIT\s*\(\s*'\s*(\w+)")
_CONVERTED_UNIT = {"INCH": 0.0254, "FOOT": 0.3048}


def declared_step_unit(path: Path) -> float | None:
    """The length unit that a STEP file (ISO 10303-21) declares, in metres; None where it declares none.

    Raises ValueError where the file cannot be read, or declares an unknown length unit or several ones.
    """
    entities = [e for e in _text(path).split(";") if "LENGTH_UNIT" in e]
    converted = {name.upper() for e in entities for name in _CONVERTED.findall(e)}
    prefixes = {prefix for e in entities for prefix in _SI_LENGTH.findall(e)}
    # A converted unit is defined through an SI unit, which is then only its base.
    names, table = (converted, _CONVERTED_UNIT) if converted else (prefixes, _SI_PREFIX)
    if len(names) > 1 or not names <= table.keys():
        raise ValueError(f"the STEP file {path} must declare one known length unit, not {sorted(names)}")
    return table[names.pop()] if names else None


def _text(path: Path) -> str:
    try:
        return path.read_text(encoding="latin-1")
    except OSError as error:
        raise ValueError(f"the STEP file {path} cannot be opened ({error.strerror})") from error


def _is_whole(path: Path) -> bool:
    """True where a file has the first and last word of a STEP file."""
    text = _text(path).strip()
    return text.startswith("ISO-10303-21;") and text.endswith("END-ISO-10303-21;")


def solid_of_step_file(path: Path, scale: float) -> occ.TopoDS_Shape:
    """The solid of a STEP file, mm: numbers in the file times `scale` are metres. Several solids are joined.

    The device file's scale decides; the kernel's own conversion from the unit that the STEP file declares is undone.
    Another process reads the file and hands the solid over: on a damaged one the kernel's reader may end the process
    that it runs in. Raises ValueError where the file cannot be read or holds no solid.
    """
    if not (np.isfinite(scale) and scale > 0.0):
        raise ValueError(f"the scale of a STEP file must be above zero, not {scale}")
    unit = declared_step_unit(path)
    if not _is_whole(path):  # asked first, because the kernel's reader prints its complaints
        raise ValueError(f"{path} is not a whole STEP file (from ISO-10303-21 to END-ISO-10303-21)")
    solid = _solid_of_brep(read_by_another(path, _TO_BREP), path)
    # The kernel has turned the declared unit into mm, and takes numbers without a unit as mm.
    factor = scale / (1e-3 if unit is None else unit)
    return solid if abs(factor - 1.0) < 1e-12 else solid.Scale(occ.Pnt(0.0, 0.0, 0.0), factor)


def _solid_of_brep(brep: bytes | None, path: Path) -> occ.TopoDS_Shape:
    """A new solid of its own for each call; path: of the file it was read from."""
    if brep is None:
        raise ValueError(f"the STEP file {path} cannot be read")
    if not brep:
        raise ValueError(f"the STEP file {path} holds no solid (surfaces and curves have no volume)")
    with tempfile.TemporaryDirectory() as folder:
        copy = Path(folder) / "solid.brep"
        copy.write_bytes(brep)
        try:
            return occ.OCCGeometry(str(copy)).shape
        except Exception as error:  # the reader's exception type is not exported
            raise ValueError(f"the STEP file {path} cannot be read") from error
