"""Draw every picture that the program makes, in one folder with an index page.

    python scripts/gallery.py [FOLDER] [--maps maps/out] [--rows S4 S5 ...] [--only scenes | figures]

Scenes and plots come from commands, which the page prints. Figures of the thesis come from the rows of `fieldmap
thesis`, with the thesis's own numbers drawn over ours, and the page lists them by number. Existing scenes and finished
rows are kept, so a stopped run can continue. The end of the page lists pictures that cannot be drawn, for example
because a map is missing.
"""

import argparse
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from jinja2 import Environment, FileSystemLoader, StrictUndefined

import fieldmap
from fieldmap.cli import main as run_command
from fieldmap.plot.figures import save_curves
from fieldmap.progress import Progress
from fieldmap.store.whole_files import write_whole
from fieldmap.thesis import Curves, attempt_rows, read_rows
from fieldmap.thesis.kept import cached_parts
from fieldmap.thesis.printed import figure_numbers, thesis_figures


@dataclass(frozen=True)
class Picture:
    """A picture to draw. file: in the folder. draw(path) draws it and returns the reason of a failure, or "".

    command: for the page. figures: numbers of the thesis's figures.
    """

    section: str
    file: str
    title: str
    command: str
    draw: Callable[[Path], str]
    remark: str = ""
    figures: tuple[str, ...] = ()


# MAPS stands for the folder of maps, FOLDER for the gallery.
_DIVISION = "show MAPS/division.h5 --currents 1.558 --what"
_SHIFT = f"{_DIVISION} shift --height-mm -102 --quantity"
_IRON = "show drive_unit --nonlinear --currents 1.5 --what"
SCENES = (
    ("device.png", "The drive unit", "show drive_unit"),
    ("mesh.png", "The elements of its iron", "show drive_unit --what mesh --refinement 0.5"),
    ("iron.png", "B in the iron", f"{_IRON} iron --refinement 0.5"),
    ("lines.png", "Field lines", f"{_IRON} lines --refinement 0.4"),
    ("slices.png", "B in the workspace", f"{_DIVISION} slices"),
    ("vertical.png", "Bz in the workspace", f"{_DIVISION} slices --quantity Bz"),
    ("surfaces.png", "grad B", f"{_DIVISION} surfaces --quantity gradB"),
    ("forces.png", "Forces on the magnet", f"{_DIVISION} forces"),
    ("equilibrium.png", "Where it floats", "show MAPS/workspace.h5 --what equilibrium --currents 3"),
    (
        "difference.png",
        "Two maps of the same iron, trained on different currents",
        "show MAPS/division.h5 --minus MAPS/saturating.h5 --currents 1.558",
    ),
    ("shift_x.png", "x of the magnet over both direction signals, height held", f"{_SHIFT} x"),
    ("shift_y.png", "y of the magnet over both direction signals, height held", f"{_SHIFT} y"),
    ("app.png", "Sliders", "app MAPS/saturating.h5 --force-scale 2.1"),
    (
        "circle.png",
        "A circle flown in closed loop",
        "simulate circle --map MAPS/division.h5 -o FOLDER/circle.h5",
    ),
    ("circle_path.png", "The same circle in space", "show FOLDER/circle.h5"),
    ("circle.gif", "The same circle as it happens", "show FOLDER/circle.h5"),
)


def scenes(folder: Path, maps: Path) -> Iterator[Picture]:
    """Pictures of commands."""
    for file, title, command in SCENES:
        text = f"{command} --save FOLDER/{file}".replace("MAPS", str(maps)).replace("FOLDER", str(folder))
        yield Picture("Scenes", file, title, f"fieldmap {text}", partial(_run, text.split(), maps))


def _run(words: Sequence[str], maps: Path, path: Path) -> str:
    lacking = [Path(word) for word in words if word.endswith(".h5") and maps in Path(word).parents]
    lacking = [one for one in lacking if not one.is_file()]
    if lacking:
        return f"fieldmap map {lacking[0].stem}"
    if path.is_file() or run_command(list(words)) == 0:
        return ""
    return f"failed: fieldmap {' '.join(words)}"


def figures(folder: Path, maps: Path, rows: Sequence[str]) -> Iterator[Picture]:
    """Figures of the thesis's rows; a row that cannot be computed counts as one picture that fails."""
    with Progress("gallery") as progress:
        for result in attempt_rows(rows, progress, cached_parts(folder, maps)):
            section, command = (
                f"{result.row}: {read_rows()[result.row].system}",
                f"fieldmap thesis {result.row} --report report",
            )
            if result.problem:
                yield Picture(section, "", result.part, command, lambda _, why=result.problem: why)
            for number, curves in enumerate(result.curves, start=1):
                file, draw = f"{result.part}_{number}.png", partial(_save, curves)
                yield Picture(
                    section, file, curves.title, command, draw, curves.remark, figure_numbers(curves.title)
                )


def _save(curves: Curves, path: Path) -> str:
    save_curves(curves, path)
    return ""


def draw_all(folder: Path, pictures: Iterable[Picture]) -> tuple[dict[str, list[Picture]], list[str]]:
    """Draw the pictures. Returns the drawn pictures by section, and the missing ones."""
    sections: dict[str, list[Picture]] = {}
    missing = []
    for picture in pictures:
        why = picture.draw(folder / picture.file)
        if why:
            missing.append(f"{picture.title}: {why}")
        else:
            sections.setdefault(picture.section, []).append(picture)
    return sections, missing


def write_page(folder: Path, sections: dict[str, list[Picture]], missing: Sequence[str]) -> Path:
    """index.html of the folder."""
    loader = FileSystemLoader(Path(__file__).parent)
    environment = Environment(loader=loader, autoescape=True, trim_blocks=True, undefined=StrictUndefined)
    drawn: dict[str, Picture] = {}
    for picture in (one for pictures in sections.values() for one in pictures):
        drawn |= {number: picture for number in picture.figures if number not in drawn}
    known = {
        "sections": sections,
        "missing": missing,
        "figures": [
            (number, figure.shows, drawn[number])
            for number, figure in thesis_figures().items()
            if number in drawn
        ],
        "version": fieldmap.__version__,
    }
    text = environment.get_template("gallery.html.j2").render(known)
    write_whole(folder / "index.html", text, "report")
    return folder / "index.html"


def main() -> None:
    """Draw, and print the path of the page."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folder", nargs="?", default="gallery", type=Path, help="default: gallery")
    parser.add_argument("--maps", default="maps/out", type=Path, metavar="FOLDER", help="default: maps/out")
    parser.add_argument(
        "--rows", nargs="*", default=[], metavar="ROW", help="of the thesis; all unless given"
    )
    parser.add_argument("--only", choices=("scenes", "figures"), help="both unless given")
    given = parser.parse_args()
    given.folder.mkdir(parents=True, exist_ok=True)
    pictures: list[Iterable[Picture]] = []
    if given.only != "figures":
        pictures.append(scenes(given.folder, given.maps))
    if given.only != "scenes":
        pictures.append(figures(given.folder, given.maps, given.rows))
    print(write_page(given.folder, *draw_all(given.folder, (one for some in pictures for one in some))))


if __name__ == "__main__":
    main()
