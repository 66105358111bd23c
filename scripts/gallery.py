"""Every picture that the program makes, in one folder with an index page.

    python scripts/gallery.py [FOLDER] [--maps maps/out] [--rows S4 S5 ...] [--only scenes | figures]

Scenes and plots come from commands, which the page prints; figures of the thesis from the rows of `fieldmap thesis`,
with the thesis's own numbers drawn over ours. Finished rows and scenes that are there already are kept, so a gallery
that was stopped goes on. What cannot be drawn, for want of a map for example, is named at the end of the page.
"""

import argparse
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from jinja2 import Environment, FileSystemLoader, StrictUndefined

import fieldmap
from fieldmap.adapters.whole_files import write_whole
from fieldmap.cli import main as run_command
from fieldmap.cli.progress import Progress
from fieldmap.thesis import attempt_rows
from fieldmap.thesis.kept import keeping
from fieldmap.thesis.registry import ROWS
from fieldmap.view.figures import save_curves


@dataclass(frozen=True)
class Picture:
    """file: relative to the page."""

    file: str
    title: str
    command: str
    remark: str = ""


@dataclass(frozen=True)
class Section:
    """Pictures under one heading."""

    title: str
    pictures: list[Picture]


# MAPS/NAME is a map in the folder of maps, FOLDER the gallery. The last word but one is --save.
SCENES = (
    ("device.png", "The drive unit", "show drive_unit"),
    ("mesh.png", "The elements of its iron", "show drive_unit --what mesh --refinement 0.5"),
    ("iron.png", "B in the iron", "show drive_unit --what iron --nonlinear --currents 1.5 --refinement 0.5"),
    ("lines.png", "Field lines", "show drive_unit --what lines --nonlinear --currents 1.5 --refinement 0.4"),
    ("slices.png", "B in the workspace", "show MAPS/division.h5 --what slices --currents 1.558"),
    (
        "vertical.png",
        "Bz in the workspace",
        "show MAPS/division.h5 --what slices --quantity Bz --currents 1.558",
    ),
    ("surfaces.png", "grad B", "show MAPS/division.h5 --what surfaces --quantity gradB --currents 1.558"),
    ("forces.png", "Forces on the magnet", "show MAPS/division.h5 --what forces --currents 1.558"),
    ("equilibrium.png", "Where it floats", "show MAPS/workspace.h5 --what equilibrium --currents 4.2"),
    (
        "difference.png",
        "Two maps of the same iron, trained on different currents",
        "show MAPS/division.h5 --minus MAPS/saturating.h5 --currents 1.558",
    ),
    (
        "shift_x.png",
        "x of the magnet over both direction signals, height held",
        "show MAPS/division.h5 --what shift --quantity x --currents 1.558 --height-mm -102",
    ),
    (
        "shift_y.png",
        "y of the magnet over both direction signals, height held",
        "show MAPS/division.h5 --what shift --quantity y --currents 1.558 --height-mm -102",
    ),
    ("app.png", "Sliders", "app MAPS/saturating.h5 --force-scale 2.1"),
    (
        "circle.png",
        "A circle flown in closed loop",
        "simulate circle --map MAPS/division.h5 -o FOLDER/circle.h5",
    ),
    ("circle_path.png", "The same circle in space", "show FOLDER/circle.h5"),
    ("circle.gif", "The same circle as it happens", "show FOLDER/circle.h5"),
)


def scenes(folder: Path, maps: Path, missing: list[str]) -> Iterator[Picture]:
    """Make the scenes that are not there yet."""
    for file, title, command in SCENES:
        words = (
            f"{command} --save FOLDER/{file}".replace("MAPS", str(maps))
            .replace("FOLDER", str(folder))
            .split()
        )
        lacking = [word for word in words[:-2] if word.endswith(".h5") and maps in Path(word).parents]
        lacking = [word for word in lacking if not Path(word).is_file()]
        if lacking:
            missing.append(f"{title}: fieldmap map {Path(lacking[0]).stem}")
        elif (folder / file).is_file() or run_command(words) == 0:
            yield Picture(file, title, f"fieldmap {' '.join(words)}")
        else:
            missing.append(f"{title}: failed: fieldmap {' '.join(words)}")


def figures(folder: Path, maps: Path, rows: Sequence[str], missing: list[str]) -> Iterator[Section]:
    """Draw the figures of the thesis's rows, a section for each row."""
    pictures: dict[str, list[Picture]] = {}
    with Progress("gallery") as progress:
        for result in attempt_rows(rows, progress, keeping(folder / "finished", maps)):
            if result.problem:
                missing.append(f"{result.part}: {result.problem}")
            for number, curves in enumerate(result.curves, start=1):
                file = f"{result.part}_{number}.png"
                save_curves(curves, folder / file)
                picture = Picture(
                    file, curves.title, f"fieldmap thesis {result.row} --report report", curves.remark
                )
                pictures.setdefault(result.row, []).append(picture)
    for row, drawn in pictures.items():
        yield Section(f"{row}: {ROWS[row]}", drawn)


def write_page(folder: Path, sections: Sequence[Section], missing: Sequence[str]) -> Path:
    """index.html of the folder."""
    loader = FileSystemLoader(Path(__file__).parent)
    environment = Environment(loader=loader, autoescape=True, trim_blocks=True, undefined=StrictUndefined)
    known = {"sections": sections, "missing": missing, "version": fieldmap.__version__}
    text = environment.get_template("gallery.html.j2").render(known)
    write_whole(folder / "index.html", text.encode())
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
    missing: list[str] = []
    sections: list[Section] = []
    if given.only != "figures":
        sections.append(Section("Scenes", list(scenes(given.folder, given.maps, missing))))
    if given.only != "scenes":
        sections += figures(given.folder, given.maps, given.rows, missing)
    print(write_page(given.folder, sections, missing))


if __name__ == "__main__":
    main()
