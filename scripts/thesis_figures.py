"""Draw the thesis's figures with our curves: python scripts/thesis_figures.py [FOLDER] [--rows S4 S5]."""

import argparse
from pathlib import Path

from fieldmap.thesis import attempt_rows
from fieldmap.view.figures import save_curves


def main() -> None:
    """Draw and print the paths."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", nargs="?", default="figures", type=Path, help="default: figures")
    parser.add_argument("--rows", nargs="*", default=[], metavar="ROW", help="all rows unless given")
    given = parser.parse_args()
    given.folder.mkdir(parents=True, exist_ok=True)
    for result in attempt_rows(given.rows):
        if result.problem:
            print(f"{result.part}: {result.problem}")
        for number, curves in enumerate(result.curves, start=1):
            print(save_curves(curves, given.folder / f"{result.part}_{number}.png"))


if __name__ == "__main__":
    main()
