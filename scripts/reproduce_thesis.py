"""Make the maps that rows of the thesis need and that are not there, then the report.

python scripts/reproduce_thesis.py [ROW ...] [--report report] [--maps maps/out]
"""

import argparse
import sys
from pathlib import Path

import fieldmap
from fieldmap.cli import main as command_line
from fieldmap.cli.progress import Progress
from fieldmap.thesis.available_maps import FOLDER
from fieldmap.thesis.printed import read_part
from fieldmap.thesis.rows import parts_of


def main() -> int:
    """Maps first, then `fieldmap thesis --report`; its exit code."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("rows", nargs="*", metavar="ROW", help="all rows unless given")
    parser.add_argument("--report", type=Path, default=Path("report"), help="folder of the report")
    parser.add_argument("--maps", type=Path, default=FOLDER, help="folder of the maps")
    given = parser.parse_args()
    for recipe in sorted({read_part(part).map for part in parts_of(given.rows)} - {""}):
        path = given.maps / f"{recipe}.h5"
        if not path.is_file():
            path.parent.mkdir(parents=True, exist_ok=True)
            with Progress(f"map {recipe}") as progress:
                fieldmap.generate(recipe, output=path, progress=progress)
    return command_line(["thesis", *given.rows, "--report", str(given.report), "--maps", str(given.maps)])


if __name__ == "__main__":
    sys.exit(main())
