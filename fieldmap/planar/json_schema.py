"""JSON Schema of planar device files, for editors: `python -m fieldmap.planar.json_schema` rewrites it."""

from pathlib import Path

from fieldmap.device.json_schema import schema_text
from fieldmap.planar.schema import PlanarFile
from fieldmap.shipped import shipped_folder

FILE = "planar.schema.json"


def write_schema(folder: Path) -> Path:
    """Write the schema file into a folder and return its path."""
    path = folder / FILE
    path.write_text(schema_text(PlanarFile), encoding="utf-8")
    return path


if __name__ == "__main__":
    print(write_schema(shipped_folder("geometry")))
