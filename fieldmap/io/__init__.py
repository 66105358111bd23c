"""Any field by its name: a device file, the name of a shipped device, or a map file.

`open_field` gives a `Field`: a map is opened, a device is solved. `find_source` reads and checks the file first, and
solves when its `field` is asked for. Depends on the packages that make fields and on those that use them; plots and
commands import it.
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
