"""The core takes no memory while it runs: the calls of each function of its headers, from relocation records.

Every function is compiled by itself, without optimisation, called or not, and its calls are read from the object file:
only mathematics and copying are allowed. Functions that open and close files take memory on purpose and are named here.
The functions that hand Python arrays to the core (python*.h) take memory from Python and are left out.
"""

import re
import shutil
import subprocess

import pytest

from fieldmap.core.headers import FOLDER

MATHEMATICS = {"cos", "sin", "exp", "sqrt", "floor", "fmin", "fmax"}
COPYING = {"memcpy", "memmove", "memset", "memcmp"}
FILES = {
    "fieldmap_read_file": {"fopen", "fseek", "ftell", "fread", "fgetc", "fclose", "malloc"},
    "fieldmap_open": {"free"},
    "fieldmap_close": {"free"},
    "fieldmap_iron_open": {"free"},
    "fieldmap_iron_close": {"free"},
    # A copy of the map, at fixed currents.
    "fieldmap_at": {"malloc"},
    "fieldmap_coil_name": {"strlen"},
}
NO_COMPILER = shutil.which("gcc") is None or shutil.which("objdump") is None

pytestmark = pytest.mark.skipif(NO_COMPILER, reason="no gcc or no objdump on this machine")


@pytest.fixture
def library():
    """Headers are the same for every processor: these tests run once."""


def beyond(headers, folder):
    """Function of the headers -> its calls besides the headers, mathematics and copying, if it has any."""
    source, target = folder / "all.c", folder / "all.o"
    # `static inline` as for compilers other than gcc and clang: otherwise an unused function would leave no trace.
    lines = ['#include "real.h"', "#undef FIELDMAP_INLINE", "#define FIELDMAP_INLINE static inline"]
    source.write_text("\n".join([*lines, *(f'#include "{path.name}"' for path in headers), ""]))
    every = ["-O0", "-fkeep-inline-functions", "-ffunction-sections", "-fno-stack-protector"]
    # An array of variable length would also take memory, from the stack.
    strict = ["-std=c99", "-Werror=vla", "-I", headers[0].parent]
    said("gcc", *every, *strict, "-c", source, "-o", target)
    compiled = set(re.findall(r"^\w+ t (\w+)$", said("nm", target), re.MULTILINE))
    for path in headers:
        declared = re.findall(r"^(?:static inline|FIELDMAP_INLINE) [^(;]*?(\w+)\(", path.read_text(), re.M)
        assert compiled.issuperset(declared), path
    found = {}
    for part in said("objdump", "-r", target).split("RELOCATION RECORDS FOR ")[1:]:
        if function := re.match(r"\[\.text\.(\w+)\]", part):
            called = set(re.findall(r"R_\w+\s+([A-Za-z_]\w*)", part))
            found[function[1]] = called - compiled - MATHEMATICS - COPYING - {"_GLOBAL_OFFSET_TABLE_"}
    assert len(found) > 100
    return {name: called for name, called in found.items() if called}


def said(*command):
    return subprocess.run(command, check=True, capture_output=True, text=True).stdout


def headers_of(folder):
    others = ("python", "fieldmap32.h")
    return [path for path in sorted(folder.glob("*.h")) if not path.name.startswith(others)]


def test_nothing_but_opening_a_file_takes_memory(tmp_path):
    assert beyond(headers_of(FOLDER), tmp_path) == FILES


def test_headers_for_microcontrollers_need_no_library_at_all(tmp_path):
    source, target = tmp_path / "all.c", tmp_path / "all.o"
    source.write_text('#include "fieldmap32.h"\n')
    said("gcc", "-O0", "-fkeep-inline-functions", "-std=c99", "-I", FOLDER, "-c", source, "-o", target)
    assert set(said("nm", "-u", target).split()) - {"U"} <= COPYING


@pytest.mark.parametrize(
    ("header", "kind"), [("closed_loop.h", "static inline"), ("wrench.h", "FIELDMAP_INLINE")]
)
def test_planted_memory_is_seen(header, kind, tmp_path):
    folder = tmp_path / "core"
    folder.mkdir()
    for path in FOLDER.glob("*.h"):
        shutil.copy(path, folder)
    before, end, behind = (folder / header).read_text().rpartition("#endif")
    planted = f"#include <stdlib.h>\n{kind} void *fieldmap_planted(size_t n)\n{{\n    return malloc(n);\n}}\n"
    (folder / header).write_text(before + planted + end + behind)
    assert beyond(headers_of(folder), tmp_path) == FILES | {"fieldmap_planted": {"malloc"}}
