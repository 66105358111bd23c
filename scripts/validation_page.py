"""Write docs/validation*.md from the output of the validation and of the comparison with the thesis.

    fieldmap thesis --report report
    python scripts/validate.py --json > validate.json
    python scripts/validation_page.py report/numbers.csv validate.json

Several files of rows may be given; a case that is in more than one file is taken from the last.
"""

import argparse
import csv
import json
import platform
import statistics
from collections.abc import Iterable
from datetime import date
from importlib.metadata import version
from pathlib import Path
from typing import Any

from validate import STUDIES

import fieldmap
from fieldmap.thesis import read_rows

FOLDER = Path(__file__).parents[1] / "docs"
# Studies that compare a field with a closed form or an independent code; the others have a page of their own.
FIELDS = (
    "spheres", "shell", "cylinders", "sphere_and_coil", "joints", "thin_gaps", "to_tolerance", "axisymmetric",
    "saturated", "six_cores",
)  # fmt: skip
LIBRARIES = ("numpy", "scipy", "numba", "netgen-mesher")
HEAD = """# Validation

This page compares the numbers of this package with references. A program writes it
from the output of two others, before each release:

```console
$ fieldmap thesis --report report
$ python scripts/validate.py --json > validate.json
$ python scripts/validation_page.py report/numbers.csv validate.json
```

Made on {date} with fieldmap {version}, Python {python}, {libraries}, on {machine}. Errors are the largest over the
points, relative to the largest value of the same quantity there, unless a line says otherwise. Bounds are those that
the program fails on; those of seconds are for two quiet cores{beside}.
"""
THESIS = """## The thesis

Sharp numbers are arithmetic on stated inputs and must agree to the printed digits (misprints of the thesis, each with
its reason, left out); models are numbers that somebody else's model gave; measured ones say how far the model is from
the machine. Deviation is ours / thesis - 1, here the median of its size. Every number, with place, explanation and
assumptions: `fieldmap thesis ROW`, or the report of the first command above.

| row | what | sharp that agree | model: numbers, median deviation | measured: numbers, median deviation |
|---|---|---|---|---|
"""


def thesis_table(path: Path) -> str:
    """One line for each row of the thesis."""
    with path.open(newline="", encoding="utf-8") as file:
        numbers = list(csv.DictReader(file))
    lines = []
    for row in dict.fromkeys(number["row"] for number in numbers):
        mine = [number for number in numbers if number["row"] == row]
        sharp = [number for number in mine if number["kind"] == "sharp" and not number["misprint"]]
        agree = sum(number["agrees"] == "true" for number in sharp)
        cells = [row, read_rows()[row].system, f"{agree} of {len(sharp)}" if sharp else "-"]
        cells += [_deviation(mine, kind) for kind in ("model", "measured")]
        lines.append(f"| {' | '.join(cells)} |")
    sharp = [number for number in numbers if number["kind"] == "sharp" and not number["misprint"]]
    agree = sum(number["agrees"] == "true" for number in sharp)
    misprints = sum(bool(number["misprint"]) for number in numbers)
    total = (
        f"{agree} of {len(sharp)} sharp numbers agree; {misprints} misprints; {len(numbers)} numbers in all."
    )
    return THESIS + "\n".join(lines) + f"\n\n{total}\n"


def _deviation(numbers: Iterable[dict[str, str]], kind: str) -> str:
    of_kind = [number for number in numbers if number["kind"] == kind and not number["misprint"]]
    sizes = [abs(float(number["deviation"])) for number in of_kind if number["deviation"]]
    median = f", {100 * statistics.median(sizes):.2g} %" if sizes else ""
    return f"{len(of_kind)}{median}" if of_kind else "-"


def rows_of(paths: Iterable[Path]) -> list[dict[str, Any]]:
    """Rows of the validation; a case in more than one file is taken from the last."""
    found: dict[tuple[str, str], dict[str, Any]] = {}
    for path in paths:
        for row in json.loads(path.read_text(encoding="utf-8")):
            found[row["case"], row["quantity"]] = row
    return list(found.values())


def validation_table(rows: list[dict[str, Any]], wanted: bool) -> str:
    """The rows with a bound (wanted), or the rows without one."""
    lines = ["| case | quantity | measured | bound | reference |", "|---|---|---|---|---|"]
    for row in rows:
        if (row["bound"] is not None) == wanted:
            bound = "-" if row["bound"] is None else f"{row['bound']:g}"
            verdict = "" if row["verdict"] in ("pass", "-") else f" **{row['verdict']}**"
            cells = (
                row["case"],
                row["quantity"],
                f"{row['value']:.2g}{verdict}",
                bound,
                row["note"] or row["source"],
            )
            lines.append("| " + " | ".join(str(cell).replace("|", "/") for cell in cells) + " |")
    return "\n".join(lines) + "\n"


def _left_out(rows: list[dict[str, Any]]) -> str:
    """Sentence with the studies of the validation that are not on the page."""
    missing = [name for name in STUDIES if name not in {row["study"] for row in rows}]
    names = ", ".join(f"`{name}`" for name in missing)
    return (
        f"Not run for this edition: {names} (`python scripts/validate.py --only NAME`).\n" if missing else ""
    )


def pages(numbers: Path, paths: list[Path], busy: bool = False) -> dict[str, str]:
    """The pages, by name. busy: whether other programs ran during the validation."""
    rows = rows_of(paths)
    passed = sum(row["verdict"] == "pass" for row in rows)
    judged = sum(row["bound"] is not None for row in rows)
    head = HEAD.format(
        date=date.today().isoformat(),
        version=fieldmap.__version__,
        python=platform.python_version(),
        libraries=", ".join(f"{name} {version(name)}" for name in LIBRARIES),
        machine=f"{platform.system()} {platform.machine()}",
        beside=", and this edition was made beside other work" if busy else "",
    )
    first = "\n".join(
        (
            head,
            _left_out(rows),
            f"{passed} of {judged} numbers that have a bound are within it: fields of [closed forms and independent"
            " codes](validation_fields.md), and [machines, maps and interrupted runs](validation_machines.md)."
            f" {len(rows) - judged} have none: they are [below](#convergence-and-numbers-without-a-bound), and nothing"
            " judges them.\n",
            "## Convergence, and numbers without a bound\n",
            "Errors at several mesh sizes and spacings, and the order that a straight line through their logarithms"
            " shows.\n",
            validation_table(rows, False),
            thesis_table(numbers),
        )
    )
    of_fields = [row for row in rows if row["study"] in FIELDS]
    others = [row for row in rows if row["study"] not in FIELDS]
    more = "[Validation](validation.md) has the versions, the meaning of an error, and the programs of the table."
    return {
        "validation": first,
        "validation_fields": "\n".join(
            (
                "# Validation: closed forms and independent codes\n",
                f"{more}\n",
                validation_table(of_fields, True),
            )
        ),
        "validation_machines": "\n".join(
            (
                "# Validation: machines, maps and interrupted runs\n",
                f"{more}\n",
                validation_table(others, True),
            )
        ),
    }


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("numbers", type=Path, help="numbers.csv of `fieldmap thesis --report`")
    parser.add_argument("rows", type=Path, nargs="+", help="what scripts/validate.py --json printed")
    parser.add_argument("-o", "--output", type=Path, default=FOLDER, help="folder of the pages")
    parser.add_argument("--busy", action="store_true", help="the rows were made beside other work")
    options = parser.parse_args()
    for name, text in pages(options.numbers, options.rows, options.busy).items():
        (options.output / f"{name}.md").write_text(text, encoding="utf-8")
        print(options.output / f"{name}.md")


if __name__ == "__main__":
    main()
