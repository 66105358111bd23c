"""A map of saturating iron as one flat file for C programs, at any currents.

fieldmap_iron.h of the C core reads it.

Layout, in the byte order of the machine that writes:

    0   8 bytes   "fmapiron"
    8   uint32    0x01020304, which shows the byte order
    12  uint32    version: 1
    16  uint64    size of the file in bytes
    24  uint32    CRC-32 of all that follows
    28  uint32    0
    32  uint64    number of float64 numbers of the model
    40  float64   20 numbers: points, modes, numbers in a row of single precision, coils, fields of the iron, whether
                  there is a background, laws, knots, terms, signals, whether the currents are a lift and directions,
                  whether currents outside are refused, all fields; exponent, limit of a current, tolerance of currents
                  off the parametrisation, tolerance of a solve; three zeros
        float64   the arrays of `fieldmap.core.iron_numbers.CompiledModel`
        float32   gradients and expansion, rows filled with zeros to a multiple of 16
        bytes     the fields of coils, iron and background as a map of `fieldmap.interop.c_map`
"""

from __future__ import annotations

import struct
from pathlib import Path

from fieldmap.core.headers import FOLDER
from fieldmap.core.iron_numbers import core_numbers
from fieldmap.errors import InputError
from fieldmap.interop.c_map import c_header, check_harmonic, header_beside, map_bytes, sealed
from fieldmap.lookup import FieldMap, compiled_currents, unit_block
from fieldmap.store.whole_files import write_whole
from fieldmap.typing import PathLike

VERSION = 1


def c_iron_header() -> Path:
    """The header for C programs, as it lies in the package; it needs `fieldmap.interop.c_header()` beside it."""
    return FOLDER / "fieldmap_iron.h"


def write_c_iron_map(field: FieldMap, path: PathLike) -> Path:
    """Write an opened map of saturating iron for C programs that set its currents.

    The rules for points and currents outside go with it: clamp or NaN, NaN or "evaluate".

    Parameters
    ----------
    field
        The map.
    path
        Path of the file.

    Returns
    -------
    Path
        The path.

    Raises
    ------
    InputError
        For a map whose fields superpose, which `write_c_map` writes, and for a Hermite form.

    Examples
    --------
    >>> from fieldmap.lookup import open_map                                               # doctest: +SKIP
    >>> write_c_iron_map(open_map("workspace.h5"), "workspace.fmap")                        # doctest: +SKIP
    """
    if field.affine:
        must_hold = "must be a map of saturating iron"
        raise InputError.of("write_c_iron_map, field", must_hold, "one that superposes", "use write_c_map")
    block, model = unit_block(field), compiled_currents(field)
    check_harmonic(block, "write_c_iron_map, field")
    names = (*field.coil_names, *(f"iron {k + 1}" for k in range(len(model.output))))
    names += ("background",) if model.fixed.size else ()
    numbers = core_numbers(model)
    behind = map_bytes(block, names, constant=False)
    content = struct.pack("=IQ", 0, len(numbers)) + numbers.tobytes() + behind
    return write_whole(path, sealed(b"fmapiron", VERSION, content))


def write_c_iron_files(field: FieldMap, path: PathLike) -> tuple[Path, Path, Path]:
    """`write_c_iron_map`, and the two headers that read the map beside it.

    Parameters
    ----------
    field
        The map.
    path
        Of the map's file.

    Returns
    -------
    tuple[Path, Path, Path]
        Paths of the map and the headers.

    Raises
    ------
    InputError
        As for `write_c_iron_map`.
    """
    written = write_c_iron_map(field, path)
    names = c_iron_header().name, c_header().name
    of_iron = header_beside(written, names[0], without=frozenset({names[1]}))
    return written, of_iron, header_beside(written, names[1])
