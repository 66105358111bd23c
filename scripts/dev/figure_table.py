"""Write docs/thesis_figures.md: which figures of the thesis the rows draw, and why the others are not drawn.

python scripts/dev/figure_table.py
"""

from pathlib import Path

from fieldmap.thesis.report import figure_page

PAGE = Path(__file__).parents[2] / "docs" / "thesis_figures.md"

if __name__ == "__main__":
    PAGE.write_text(figure_page(), encoding="utf-8")
    print(PAGE)
