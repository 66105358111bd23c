"""Maps for other programs.

Depends on: errors, store, lookup. Never on the rooms that make maps.
"""

from fieldmap.adapters.c_map import c_header, write_c_map
from fieldmap.adapters.whole_files import write_whole

__all__ = ["c_header", "write_c_map", "write_whole"]
