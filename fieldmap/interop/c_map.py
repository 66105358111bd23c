"""Maps as one flat file for C programs: maps of given fields (read by fieldmap.h of the C core), and maps of
saturating iron at any currents (fieldmap_iron.h).

Layouts, in the byte order of the machine that writes. Map of given fields:

    0   8 bytes   "fieldmap"
    8   uint32    0x01020304, which shows the byte order
    12  uint32    version: 1; 2 where the last set of the block is a field that no current drives, of weight 1; 3 with
                  the iron's reaction to magnets; 4 with flux linkages of the coils
    16  uint64    size of the file in bytes
    24  uint32    CRC-32 of all that follows
    28  uint32    size of the names
    32  uint64    number of float64 numbers
    40  names     UTF-8, each ended by a zero byte; zeros up to a multiple of 8
        float64   the block of fieldmap.core.block, and behind it the fields of the reaction, inductances and constant
                  linkages; numbers 18 to 21 say whether there is a constant field, how many fields the reaction has,
                  how many of them count negatively, and how many coils have linkages

Map of saturating iron:

    0   8 bytes   "fmapiron"
    8   uint32    0x01020304, which shows the byte order
    12  uint32    version: 1, or 2 of iron with hysteresis
    16  uint64    size of the file in bytes
    24  uint32    CRC-32 of all that follows
    28  uint32    number of float64 numbers of the memory; 0 in version 1
    32  uint64    number of float64 numbers of the model
    40  float64   20 numbers: points, modes, numbers in a row of single precision, coils, fields of the iron, whether
                  there is a background, laws, knots, terms, signals, whether the currents are a lift and directions,
                  whether currents outside are refused, all fields; exponent, limit of a current, tolerance of currents
                  off the parametrisation, tolerance of a solve, play cells at a point; two zeros
        float64   the arrays of `fieldmap.core.iron_numbers.CompiledModel`
        float32   gradients and expansion, rows filled with zeros to a multiple of 16
        float64   the memory with which a state begins: `FieldMap.remembered`
        bytes     the fields of coils, iron and background as a map of given fields
"""

from __future__ import annotations

import struct
import zlib
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fieldmap.arguments import raise_all
from fieldmap.core import block as map_block
from fieldmap.core.headers import FOLDER, in_one
from fieldmap.core.iron_numbers import core_numbers
from fieldmap.errors import InputError
from fieldmap.field import require_affine
from fieldmap.interpolants import INTERPOLANTS
from fieldmap.lookup import FieldMap, MapAtCurrents, compiled_currents, unit_block
from fieldmap.lookup.current_model import STEP_TOLERANCE
from fieldmap.lookup.evaluation import MapReaction
from fieldmap.store import StoredLinkage
from fieldmap.store.output_formats import output_problems
from fieldmap.store.whole_files import write_whole
from fieldmap.typing import PathLike

VERSION, WITH_CONSTANT, WITH_REACTION, WITH_LINKAGE = 1, 2, 3, 4
_IRON, _WITH_MEMORY = 1, 2
_MOST_CONSTANTS = 1_000_000
# Indices in the header of the block, which the checksum covers: whether there is a constant field, number of fields
# of the iron's reaction to magnets, number of them with sign -1, and number of coils with linkages.
_CONSTANT, _REACTING, _REPELLED, _LINKED = 18, 19, 20, 21


def c_header() -> Path:
    """Path of the header for C and C++ programs in the package; headers that it includes are in the same folder."""
    return FOLDER / "fieldmap.h"


def write_c_map(field: FieldMap | MapAtCurrents, path: PathLike) -> Path:
    """Write an opened map, or a map at fixed currents, for C programs.

    The file keeps the coils of a map, whose currents the C program sets, a field that no current drives, and the rule
    for points outside: clamp, or NaN. A map of saturating iron can be written at fixed currents only. The file
    appears complete or not at all.

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
        For a Hermite form, which the header does not support.

    Examples
    --------
    >>> from fieldmap.lookup import open_map                                               # doctest: +SKIP
    >>> write_c_map(open_map("linear.h5"), "linear.fmap")                                   # doctest: +SKIP
    """
    block, names, constant = _contents(field)
    check_harmonic(block, "write_c_map, field")
    content = map_bytes(block, names, constant, field.reaction, _linkage(field))
    return write_whole(path, content, "map for C")


def _linkage(field: FieldMap | MapAtCurrents) -> StoredLinkage | None:
    return field.linkage if isinstance(field, FieldMap) and field.coil_names else None


def _contents(field: FieldMap | MapAtCurrents) -> tuple[NDArray[np.float64], tuple[str, ...], bool]:
    """The block, the names of its coils, and whether its last set is a field that no current drives."""
    source = field.at(0.0) if isinstance(field, FieldMap) and not field.coil_names else field
    if isinstance(source, FieldMap):
        require_affine(source, "map for C")
    block = unit_block(source)
    if isinstance(source, FieldMap):
        return block, source.coil_names, not source.proportional
    return block, ("fixed currents",), False


def write_c_files(field: FieldMap | MapAtCurrents, path: PathLike) -> tuple[Path, Path]:
    """Write a map as `write_c_map` does, and beside it, in one piece, the header that reads it.

    Parameters
    ----------
    field
        The map.
    path
        Path of the map's file.

    Returns
    -------
    tuple[Path, Path]
        Paths of the map and the header.

    Raises
    ------
    InputError
        As for `write_c_map`.
    """
    written = write_c_map(field, path)
    return written, header_beside(written, c_header().name)


def header_beside(path: Path, name: str, without: frozenset[str] = frozenset()) -> Path:
    """Write a header of the C core in one piece beside a file. without: headers that it still includes."""
    return write_whole(path.with_name(name), in_one(name, without=without), "C header")


def c_iron_header() -> Path:
    """Path of the header for C programs in the package; it includes `fieldmap.interop.c_header()`."""
    return FOLDER / "fieldmap_iron.h"


def write_c_iron_map(field: FieldMap, path: PathLike) -> Path:
    """Write an opened map of saturating iron for C programs that set its currents.

    The file keeps the rules for points outside (clamp or NaN) and currents outside (NaN or "evaluate"). It also keeps
    the memory of iron with hysteresis, with which the program begins. Steps in C have the tolerance of
    `FieldMap.step`.

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
        For a map whose fields superpose (use `write_c_map`), and for a Hermite form.

    Examples
    --------
    >>> from fieldmap.lookup import open_map                                               # doctest: +SKIP
    >>> write_c_iron_map(open_map("workspace.h5"), "workspace.fmap")                        # doctest: +SKIP
    >>> write_c_iron_map(open_map("remembering.h5").memory("shaken", 1.2), "iron.fmap")     # doctest: +SKIP
    """
    if field.affine:
        must_hold = "must be a map of saturating iron"
        raise InputError.of("write_c_iron_map, field", must_hold, "one that superposes", "use write_c_map")
    block, model, remembered = unit_block(field), compiled_currents(field), np.zeros(0)
    if field.remembers:
        model, remembered = model._replace(tolerance=STEP_TOLERANCE), field.remembered
    check_harmonic(block, "write_c_iron_map, field")
    names = (*field.coil_names, *(f"iron {k + 1}" for k in range(len(model.output))))
    names += ("background",) if model.fixed.size else ()
    numbers = core_numbers(model)
    behind = map_bytes(block, names, False, field.reaction, field.linkage)
    content = struct.pack("=IQ", len(remembered), len(numbers)) + numbers.tobytes() + remembered.tobytes()
    version = _WITH_MEMORY if field.remembers else _IRON
    return write_whole(path, sealed(b"fmapiron", version, content + behind), "map for C")


def write_c_iron_files(field: FieldMap, path: PathLike) -> tuple[Path, Path, Path]:
    """Write a map as `write_c_iron_map` does, and the two headers that read it, into the same folder.

    Parameters
    ----------
    field
        The map.
    path
        Path of the map's file.

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


def write_c32_files(field: FieldMap | MapAtCurrents, path: PathLike) -> tuple[Path, Path]:
    """Write a map as a C header of constants in single precision, with fieldmap32.h, which evaluates it.

    For microcontrollers: no file, no allocation, no library. The constant has the name of the file. Otherwise as
    `write_c_map`.

    Parameters
    ----------
    field
        The map.
    path
        Path of the header.

    Returns
    -------
    tuple[Path, Path]
        Paths of both headers.

    Raises
    ------
    InputError
        As for `write_c_map`, and for a map of more than a million numbers.

    Examples
    --------
    >>> write_c32_files(open_map("linear.h5", kind="global"), "lift.h")                     # doctest: +SKIP
    """
    block, names, constant = _contents(field)
    where = "write_c32_files, field"
    check_harmonic(block, where)
    target, count = Path(path), len(block) - map_block.HEADER
    if count > _MOST_CONSTANTS:
        must_hold = f"must have at most {_MOST_CONSTANTS} coefficients"
        remedy = 'open it with kind="global", or write_c_map for a file'
        raise InputError.of(where, must_hold, f"{count}", remedy)
    raise_all(output_problems(where, target, ["C header"], [target.with_name("fieldmap32.h")]))
    write_whole(target, _constants(block, names, target.stem, constant, _linkage(field)), "C header")
    return target, header_beside(target, "fieldmap32.h")


def _constants(
    block: NDArray[np.float64],
    names: tuple[str, ...],
    stem: str,
    constant: bool,
    linkage: StoredLinkage | None,
) -> str:
    """The text of a map as C constants."""

    def some(position: int) -> str:
        return "{" + ", ".join(_single(x) for x in block[position : position + 3]) + "}"

    name, degree = c_identifier(stem), int(block[map_block.DEGREE])
    arrays, linked = _array(f"{name}_coefficients", block[map_block.HEADER :]), "0, 0, 0"
    if linkage is not None:
        arrays += _array(f"{name}_inductance", linkage.inductance.ravel())
        arrays += _array(f"{name}_constant_linkages", linkage.constant)
        linked = f"{len(names)}, {name}_inductance, {name}_constant_linkages"
    cells = ", ".join(str(int(n)) for n in block[map_block.CELLS : map_block.CELLS + 3])
    coils = "".join(f" *   {k}: {_in_comment(coil)}\n" for k, coil in enumerate(names))
    # An older fieldmap32.h would use the set that no current drives as the set of a coil.
    needed = """#ifndef FM32_CONSTANT_FIELD
#error "this map needs the fieldmap32.h that was written beside it"
#endif
"""
    return f"""/* A map for fieldmap32.h, written by fieldmap. Coils, in the order of currents:
{coils} */
#ifndef FM32_MAX_DEGREE
#define FM32_MAX_DEGREE {degree}
#endif
#include "fieldmap32.h"
{needed if constant else ""}
{arrays}static const fm32_map {name} = {{
    {len(names)}, {degree}, {int(block[map_block.RULE] == map_block.CLAMP)}, {{{cells}}},
    {some(map_block.LOWER)}, {some(map_block.INVERSE)}, {some(map_block.LOCAL)},
    {_single(block[map_block.PER_LENGTH])}, {name}_coefficients, {int(constant)},
    {{{linked}}}
}};
"""


def _array(name: str, values: NDArray[np.float64]) -> str:
    numbers = [_single(x) for x in values]
    rows = ",\n".join("    " + ", ".join(numbers[k : k + 8]) for k in range(0, len(numbers), 8))
    return f"static const fm32_real {name}[{len(numbers)}] = {{\n{rows}\n}};\n\n"


def _single(value: float) -> str:
    """A constant of type float that reads back to the same bits."""
    text = np.format_float_scientific(np.float32(value), unique=True, trim="0")
    return f"{text}f"


def _in_comment(text: str) -> str:
    return "".join(c if c.isprintable() else "?" for c in text).replace("*/", "* /")


def c_identifier(text: str, prefix: str = "map") -> str:
    """The text as a C identifier: invalid characters become "_"; a prefix is added if it does not begin with a
    letter."""
    plain = "".join(c if c.isascii() and c.isalnum() else "_" for c in text)
    return plain if plain[:1].isalpha() else f"{prefix}_{plain}"


def check_harmonic(block: NDArray[np.float64], where: str) -> None:
    """Raise InputError at `where` unless the block holds harmonic polynomials, which other programs require."""
    kind = int(block[map_block.KIND])
    if not any(each.kind == kind and each.in_c for each in INTERPOLANTS.values()):
        readable = " or ".join(f'kind="{each.name}"' for each in INTERPOLANTS.values() if each.in_c)
        received = " or ".join(each.name for each in INTERPOLANTS.values() if each.kind == kind)
        raise InputError.of(where, f"must be harmonic polynomials: {readable}", received, "open the map so")


def map_bytes(
    block: NDArray[np.float64],
    names: tuple[str, ...],
    constant: bool,
    reaction: MapReaction | None = None,
    linkage: StoredLinkage | None = None,
) -> bytes:
    """The file of a block. names: of its sets; constant: whether one more set has the weight 1 at any currents;
    reaction: of the iron to magnets; linkage: of the coils."""
    block = block.copy()
    block[_CONSTANT] = float(constant)
    if reaction is not None:
        block[_REACTING], block[_REPELLED] = reaction.core.sets, reaction.repelled
        block = np.concatenate([block, reaction.core.block[map_block.HEADER :]])
    if linkage is not None:
        block[_LINKED] = len(linkage.constant)
        block = np.concatenate([block, linkage.inductance.ravel(), linkage.constant])
    text = b"".join(name.encode() + b"\0" for name in names)
    text += bytes(-len(text) % 8)
    known = (
        (linkage, WITH_LINKAGE),
        (reaction, WITH_REACTION),
        (constant or None, WITH_CONSTANT),
        (text, VERSION),
    )
    version = next(number for content, number in known if content is not None)
    return sealed(b"fieldmap", version, struct.pack("=IQ", len(text), len(block)) + text + block.tobytes())


def sealed(mark: bytes, version: int, content: bytes) -> bytes:
    """A flat file for C: its mark of 8 bytes, byte order, version, size and checksum before its content."""
    head = struct.pack("=8sIIQ", mark, 0x01020304, version, 28 + len(content))
    return head + struct.pack("=I", zlib.crc32(content)) + content
