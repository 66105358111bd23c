"""Draw figures of the thesis's chapters 2 and 4 with our curves: python scripts/thesis_figures.py [FOLDER]."""

import argparse

from fieldmap.view.thesis_figures import save_thesis_figures


def main() -> None:
    """Draw and print the paths."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument(
        "folder", nargs="?", default="figures", help="where the PNG files go (default: figures)"
    )
    for path in save_thesis_figures(parser.parse_args().folder):
        print(path)


if __name__ == "__main__":
    main()
