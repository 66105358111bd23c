"""Make the report on the thesis, with missing maps: `fieldmap thesis --report report --make-maps`.

python scripts/reproduce_thesis.py [ROW ...] [--report report] [--maps maps/out]
"""

import argparse
import sys
from pathlib import Path

from fieldmap.cli import main as command_line
from fieldmap.thesis.detail import FOLDER


def main() -> int:
    """The command's exit code."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("rows", nargs="*", metavar="ROW", help="all rows unless given")
    parser.add_argument("--report", type=Path, default=Path("report"), help="folder of the report")
    parser.add_argument("--maps", type=Path, default=FOLDER, help="folder of the maps")
    given = parser.parse_args()
    folders = ["--report", str(given.report), "--maps", str(given.maps)]
    return command_line(["thesis", *given.rows, *folders, "--make-maps"])


if __name__ == "__main__":
    sys.exit(main())
