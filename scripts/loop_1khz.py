"""Time of a 1 kHz loop in C on maps of saturating iron, with load threads: median, 99.9 % and the worst of a million.

    fieldmap map eight_coils ; make map
    python scripts/loop_1khz.py [MAP.h5 ...] [--steps N] [--paced S] [--threads N] [--derivatives] [--realtime]

Exports each map, compiles scripts/loop_1khz.c with the exported headers, and runs it: first steps without pause, each
timed by the clock and by the processor time of its thread (a million at 1 kHz would take 17 minutes), then steps at
1 kHz for some seconds. A step solves the iron at new currents and looks up field, gradient and wrench at a new place;
in every thousandth step the currents jump across the domain. Of two load threads one moves memory, one computes.
--realtime uses a real-time priority and locked memory for the paced steps, which needs privileges. The steps without
pause do not use it, because Linux throttles a real-time thread that never waits.
"""

import argparse
import os
import shutil
import subprocess
import tempfile
from pathlib import Path

import fieldmap as fm
from fieldmap.interop.c_map import write_c_iron_files

SOURCE = Path(__file__).with_suffix(".c")
MAPS = ("maps/out/eight_coils.h5", "maps/out/workspace.h5")


def compiled(folder: Path) -> Path:
    """Compile the program with the headers in a folder."""
    compiler = shutil.which("cc")
    if compiler is None:
        raise SystemExit("no C compiler here")
    words = ["-std=c11", "-O3", "-march=native", "-Wall", "-Wextra", "-pthread"]
    program = folder / "loop_1khz"
    subprocess.run([compiler, *words, "-I", folder, SOURCE, "-lm", "-o", program], check=True)
    return program


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("maps", nargs="*", default=MAPS, help="map files")
    parser.add_argument("--steps", type=int, default=1_000_000)
    parser.add_argument("--paced", type=int, default=60, help="seconds of steps a millisecond apart")
    parser.add_argument("--threads", type=int, default=2, help="of load")
    parser.add_argument("--derivatives", action="store_true", help="of the weights by the currents, too")
    parser.add_argument("--realtime", action="store_true")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for path in options.maps:
            # Rounding may put the path of the currents slightly outside the domain.
            field = fm.open_map(path, outside_currents="evaluate", outside="clamp")
            target = write_c_iron_files(field, folder / "loop.fmap")[0]
            print(
                f"{path}: {len(field.coil_names)} coils; {options.threads} threads of load, "
                f"{os.cpu_count()} processors, load {os.getloadavg()[0]:.1f} before",
                flush=True,
            )
            numbers = (options.steps, options.paced, options.threads, options.derivatives, options.realtime)
            arguments = [str(int(number)) for number in numbers]
            subprocess.run([compiled(folder), target, *arguments], check=True)


if __name__ == "__main__":
    main()
