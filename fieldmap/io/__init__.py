"""Any field by its name: a device file, the name of a shipped device, or a map file.

`open_field` gives a `Field`: it opens a map, and solves a device. `find_source` only reads and checks the file; the
`field` of its result is solved at the first access. Depends on the packages that make fields and that use them; plots
and commands import it.
"""

from fieldmap.io.field_source import (
    FieldSource,
    IronOptions,
    existing_map,
    find_source,
    is_map_file,
    named_device,
    open_field,
    refuse_directory,
    solve_device,
)

__all__ = [
    "FieldSource",
    "IronOptions",
    "existing_map",
    "find_source",
    "is_map_file",
    "named_device",
    "open_field",
    "refuse_directory",
    "solve_device",
]
