"""Fuzz the reader of map files in the C core: maps mutated by coverage are opened and evaluated under sanitizers.

    python scripts/dev/fuzz_core.py [--minutes 10] [--corpus FOLDER] [--findings FOLDER]

Small maps of each kind of file are the seeds: harmonic, global, clamped, with a background, and saturating.
fuzz/open_map.c opens the files that libFuzzer makes of the seeds (fieldmap.h and fieldmap_iron.h), and evaluates each
accepted file completely. clang (Debian: clang) builds it with Address- and UndefinedBehaviorSanitizer. --corpus keeps
the corpus, and a later run continues with it. The exit code is 1 if anything is found: a crash, a report of a
sanitizer, or an input that takes more than ten seconds. The input is then in the folder of findings.
"""

import argparse
import re
import shutil
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from fieldmap.currents import CoilGroups, CurrentParametrisation, IndependentCurrents, LiftAndDirections
from fieldmap.interop import write_c_iron_map, write_c_map
from fieldmap.interop.c_map import map_bytes
from fieldmap.lookup import FieldMap, interpolate, unit_block
from fieldmap.store import Grid, MapData, ReducedModel

ROOT = Path(__file__).parents[2]
CORE = ROOT / "fieldmap" / "core"
TARGET = ROOT / "scripts" / "dev" / "fuzz" / "open_map.c"
SANITIZERS = (
    "-fsanitize=fuzzer,address,undefined,float-cast-overflow",
    "-fno-sanitize-recover=all",
    "-g",
    "-O1",
)
SLOWEST_S = 10
POINTS, MODES = 5, 2


@dataclass(frozen=True)
class Figures:
    """Statistics of a run, and the inputs with findings."""

    executions: int
    seconds: int
    edges: int
    corpus: int
    accepted: int
    solved: int
    findings: tuple[Path, ...]


def main() -> int:
    """Make the seeds, build and run."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--minutes", type=float, default=10.0)
    parser.add_argument("--corpus", type=Path, help="folder of what was bred; kept only if it is given")
    parser.add_argument("--findings", type=Path, default=Path("findings"), help="folder; made if need be")
    options = parser.parse_args()
    if shutil.which("clang") is None:
        print("no clang on this machine", file=sys.stderr)
        return 2
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        program = built(folder / "open_map", CORE)
        corpus = (options.corpus or folder / "corpus").resolve()
        found = fuzzed(
            program, seeds(folder / "seeds"), corpus, options.findings.resolve(), options.minutes * 60
        )
    print(
        f"{found.executions} executions in {found.seconds} s, {found.edges} edges covered, corpus {found.corpus}"
    )
    print(f"{found.accepted} maps accepted and asked, {found.solved} solves that converged")
    print(f"{len(found.findings)} findings", *found.findings, sep="\n")
    return 1 if found.findings else 0


def built(program: Path, core: Path) -> Path:
    """Build the fuzz target with the headers of a folder."""
    command = ["clang", "-std=c99", *SANITIZERS, "-I", str(core), str(TARGET), "-lm", "-o", str(program)]
    subprocess.run(command, check=True)
    return program


def fuzzed(program: Path, seeds: Path, corpus: Path, findings: Path, seconds: float) -> Figures:
    """Run for `seconds`, or until something is found."""
    corpus.mkdir(parents=True, exist_ok=True)
    findings.mkdir(parents=True, exist_ok=True)
    before = set(findings.iterdir())
    largest = max(path.stat().st_size for path in seeds.iterdir())
    options = {
        "max_total_time": max(1, round(seconds)),
        "timeout": SLOWEST_S,
        "rss_limit_mb": 2048,
        "max_len": largest + 1024,
        "artifact_prefix": f"{findings}/",
        "print_final_stats": 1,
    }
    command = [
        str(program),
        *(f"-{name}={value}" for name, value in options.items()),
        str(corpus),
        str(seeds),
    ]
    done = subprocess.run(command, cwd=program.parent, capture_output=True, text=True, errors="replace")
    new = tuple(sorted(set(findings.iterdir()) - before))
    if done.returncode or new:
        print(done.stderr[-6000:], file=sys.stderr)
    if done.returncode and not new:
        raise RuntimeError(f"the fuzzer itself ended with exit code {done.returncode}")
    numbers = {
        name: int(([0, *re.findall(pattern, done.stderr)])[-1])
        for name, pattern in {
            "executions": r"stat::number_of_executed_units: (\d+)",
            "seconds": r"Done \d+ runs in (\d+) second",
            "edges": r" cov: (\d+)",
            "corpus": r" corp: (\d+)",
            "accepted": r"accepted: (\d+)",
            "solved": r"solved: (\d+)",
        }.items()
    }
    return Figures(**numbers, findings=new)


def seeds(folder: Path) -> Path:
    """One small file of each kind."""
    folder.mkdir()
    two, one = linear_fields(2), linear_fields(1)
    write_c_map(interpolate(two), folder / "harmonic.fmap")
    write_c_map(interpolate(two, "global"), folder / "global.fmap")
    write_c_map(interpolate(one), folder / "one_coil.fmap")
    write_c_map(interpolate(two, outside="clamp").at(np.array([2.0, -1.0])), folder / "clamped.fmap")
    write_c_map(interpolate(linear_fields(2, background=True)), folder / "background.fmap")
    # Files must not hold Hermite forms; readers must refuse this kind.
    hermite = interpolate(one, "hermite")
    (folder / "hermite").write_bytes(map_bytes(unit_block(hermite), hermite.coil_names, False))
    division = LiftAndDirections(1.25, 2.0)
    for name, field in {
        "iron": saturating(1, IndependentCurrents(1), [-1.0], [1.0]),
        "iron_background": saturating(2, CoilGroups([[0, 1]]), [-1.0], [1.0], background=True),
        "iron_groups": saturating(3, CoilGroups([[0, 2], [1]]), [-1.0, 0.0], [1.0, 2.0]),
        "iron_division": saturating(6, division, [0.5, -0.4, -0.4], [2.0, 0.4, 0.4]),
    }.items():
        write_c_iron_map(field, folder / f"{name}.fmap")
    return folder


def linear_fields(coils: int, background: bool = False, model: ReducedModel | None = None) -> MapData:
    """Fields that are linear in the position: of coils, of a model's iron and of a background."""
    fields = coils + (0 if model is None else len(model.output)) + background
    grid = Grid([-0.01, -0.01, -0.02], [0.01, 0.01, 0.02], (2, 2, 3))
    slopes = np.linspace(1.0, 2.0, fields)[:, None, None] * np.diag([-1.0, -1.0, 2.0])
    places = grid.points().reshape(*grid.shape, 3)
    return MapData(
        grid,
        tuple("abcdef"[:coils]),
        np.ones(coils),
        flux_density=np.einsum("cij,xyzj->cxyzi", slopes, places) + 0.01,
        gradient=np.broadcast_to(slopes[:, None, None, None], (fields, *grid.shape, 3, 3)),
        reduced_model=model,
        constant_field=background,
        fixed_sources=("background",) if background else (),
    )


def saturating(
    coils: int, of: CurrentParametrisation, lower: list[float], upper: list[float], background: bool = False
) -> FieldMap:
    """A map of a made-up model of iron: a few points, two laws, two modes."""
    rng = np.random.default_rng(7)
    model = ReducedModel(
        gradients=3e-3 * rng.standard_normal((3 * POINTS, MODES)),
        source=3e-3 * rng.standard_normal((3 * POINTS, coils)),
        weights=rng.random(POINTS) + 0.1,
        law=np.arange(POINTS) % 2,
        law_offset=[0, 3, 6],
        law_knots=[0, 1e-3, 3e-3] * 2,
        law_coefficients=[[0, 0, 2e3, 0], [0, -1999 / 4e-3, 2e3, 2], [0, 0, 1, 4.001]] * 2,
        air=1e-4 * np.eye(MODES),
        constant=np.zeros(MODES),
        output=rng.standard_normal((1, MODES)),
        known_currents=of.currents(0.5 * (np.array(lower) + upper))[None],
        known_amplitudes=np.zeros((1, MODES)),
        lower=lower,
        upper=upper,
        parametrisation=of,
        reference_weights=np.zeros(1),
        fixed=1e-3 * rng.standard_normal(3 * POINTS) if background else np.zeros(0),
    )
    return interpolate(linear_fields(coils, background, model))


if __name__ == "__main__":
    sys.exit(main())
