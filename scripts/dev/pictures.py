"""Draw the pictures of the pages that no test draws, light and dark, into docs/images.

    python scripts/dev/pictures.py [NAME ...] [--maps maps/out]

NAME: app, drive_unit, figure_6_5, joints_x, joints_y, pole_disk, reachable, remembering_gain, remembering_step, show or
workspace; all by default. The maps must exist.
Afterwards `pytest tests/docs --rewrite-pictures` records the new files.
"""

import argparse
import os
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from PIL import Image

from fieldmap.io.map_summary import summarise_map
from fieldmap.plot.map_pictures import save_map_pictures
from fieldmap.plot.style import DARK, VARIABLE

ROOT = Path(__file__).parents[2]
IMAGES = ROOT / "docs" / "images"
# Three scenes of show.png: share of the height for the title, margin around the scene and its colour bar, and height,
# both in pixels.
_TITLE, _AIR, _HEIGHT = 0.09, 20, 900
Draw = Callable[[Path, Path], None]


def command(*words: str) -> None:
    """Run `fieldmap WORDS`, which draws both schemes."""
    environment = {**os.environ, VARIABLE: "both"}
    subprocess.run([sys.executable, "-m", "fieldmap", *words], check=True, env=environment)


def app(folder: Path, maps: Path) -> None:
    """The sliders."""
    command("app", str(maps / "workspace.h5"), "--force-scale", "2.1", "--save", str(folder / "app.png"))


def drive_unit(folder: Path, maps: Path) -> None:
    """The drive unit and the field in its workspace."""
    words = ["drive_unit", str(maps / "workspace.h5"), "--amperes", "1.5", "--sensor-mm", "10"]
    environment = {**os.environ, VARIABLE: "both"}
    script = [sys.executable, str(ROOT / "scripts" / "view.py"), *words]
    subprocess.run([*script, "--output", str(folder / "drive_unit.png")], check=True, env=environment)


def show(folder: Path, maps: Path) -> None:
    """Three scenes side by side."""
    iron = ["--nonlinear", "--currents", "1.5"]
    scenes = (
        ["drive_unit", "--what", "iron", *iron, "--refinement", "0.5"],
        ["drive_unit", "--what", "lines", *iron, "--refinement", "0.4"],
        [str(maps / "workspace.h5"), "--what", "equilibrium", "--currents", "2.82"],
    )
    for k, words in enumerate(scenes):
        command("show", *words, "--save", str(folder / f"part{k}.png"))
    places = [drawn_places(folder / f"part{k}.png") for k in range(len(scenes))]
    for scheme in ("", DARK):
        parts = [
            np.asarray(Image.open(folder / f"part{k}{scheme}.png").convert("RGB")) for k in range(len(scenes))
        ]
        kept = [part[np.ix_(*place)] for part, place in zip(parts, places, strict=True)]
        beside([Image.fromarray(part) for part in kept], folder / f"show{scheme}.png")


def drawn_places(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """Rows and columns below the title with something other than white in them or in their neighbours."""
    image = np.asarray(Image.open(path).convert("L")).copy()
    image[: round(_TITLE * len(image))] = 255
    rows, columns = (np.flatnonzero((image < 250).any(axis=axis)) for axis in (1, 0))
    near = np.unique(columns[:, None] + np.arange(-_AIR, _AIR + 1))
    return np.arange(rows[0] - _AIR, rows[-1] + _AIR), near[(near >= 0) & (near < image.shape[1])]


def beside(parts: list[Image.Image], target: Path) -> None:
    """Put pictures side by side, scaled to one height."""
    scaled = [
        part.resize((round(part.width * _HEIGHT / part.height), _HEIGHT), Image.Resampling.LANCZOS)
        for part in parts
    ]
    Image.fromarray(np.concatenate([np.asarray(part) for part in scaled], axis=1)).save(target)


def reachable(folder: Path, maps: Path) -> None:
    """Flux densities that eight coils can make."""
    words = ["--what", "reachable", "--quantity", "B", "--limit", "5"]
    command("show", "eight_coils", *words, "--save", str(folder / "reachable.png"))


def workspace(folder: Path, maps: Path) -> None:
    """The figure that `make map` writes beside the map."""
    os.environ[VARIABLE] = "both"
    save_map_pictures(summarise_map(Path(shutil.copy(maps / "workspace.h5", folder / "workspace.h5"))))
    del os.environ[VARIABLE]


def pole_disk(folder: Path, maps: Path) -> None:
    """Every summary of a study; minutes."""
    command("study", "pole_disk", "-o", str(folder / "pole_disk.nc"))


def figure_6_5(folder: Path, maps: Path) -> None:
    """A figure of the report on the thesis; minutes."""
    of_report("S14_x_branches", "figure_6_5", folder, maps)


def joints_x(folder: Path, maps: Path) -> None:
    """Both branches along x with joints; minutes, unless the runs are cached."""
    of_report("S14_x_joints", "joints_x", folder, maps)


def joints_y(folder: Path, maps: Path) -> None:
    """The same along y."""
    of_report("S14_y_joints", "joints_y", folder, maps)


def remembering_gain(folder: Path, maps: Path) -> None:
    """Gain over the size of a loop, with hysteresis and without; a minute."""
    of_remembering(folder, maps)


def remembering_step(folder: Path, maps: Path) -> None:
    """A step of the height, with hysteresis and without."""
    of_remembering(folder, maps)


def of_remembering(folder: Path, maps: Path) -> None:
    """Both pictures of the study of hysteresis."""
    script = [
        sys.executable,
        str(ROOT / "scripts" / "studies" / "remembering_study.py"),
        "--only",
        "pictures",
    ]
    words = ["--map", str(maps / "remembering.h5"), "--folder", str(folder)]
    subprocess.run([*script, *words], check=True, env={**os.environ, VARIABLE: "both"})


def of_report(part: str, name: str, folder: Path, maps: Path) -> None:
    """The figure of one part of the report on the thesis."""
    command("thesis", part, "--report", str(folder / "report"), "--maps", str(maps))
    for scheme in ("", DARK):
        found = [*(folder / "report" / "plots").glob(f"*{scheme}.png")]
        plot = next(path for path in found if path.stem.endswith(DARK) == bool(scheme))
        shutil.copy(plot, folder / f"{name}{scheme}.png")


PICTURES: tuple[Draw, ...] = (
    app, drive_unit, figure_6_5, joints_x, joints_y, pole_disk, reachable, remembering_gain,
    remembering_step, show, workspace,
)  # fmt: skip


def main() -> None:
    """Draw, and print the paths."""
    known = {draw.__name__: draw for draw in PICTURES}
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("names", nargs="*", metavar="NAME", choices=[*known, []], help="all unless given")
    parser.add_argument("--maps", default="maps/out", type=Path, metavar="FOLDER", help="default: maps/out")
    given = parser.parse_args()
    for name in given.names or known:
        with TemporaryDirectory() as folder:
            known[name](Path(folder), given.maps.resolve())
            for file in (f"{name}.png", f"{name}{DARK}.png"):
                print(shutil.copy(Path(folder) / file, IMAGES / file))


if __name__ == "__main__":
    main()
