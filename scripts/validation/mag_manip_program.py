"""Maps exported for mag_manip and read by that program, in an environment of its own because it needs numpy < 2.

The environment is made once with pip in the user's cache folder. The wheel was built with run-time checks and takes
about 10 s to read 100 000 nodes of a coil.
"""

import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from fieldmap.interop import sample_for_mag_manip
from fieldmap.lookup import FieldMap, open_map
from fieldmap.maps import generate, read_recipe
from fieldmap.shipped import shipped_names
from validation.own_environment import OwnEnvironment, UnavailableError
from validation.row import Array, Row, largest_error, timed

# Python 3.13 has no wheels of numpy < 2.
PROGRAM = OwnEnvironment("mag_manip", ("mag_manip==3.0.0", "numpy==1.26.4"), newest_python=(3, 12))
MAPS = Path(__file__).parents[2] / "maps" / "out"
POINTS = 1000
# Bounds relative to the largest value: the accuracy of B in the export, and of the program's differences of B.
FIELD_BOUND = 1e-4
GRADIENT_BOUND = 0.03
SOURCE = "the map, at 1000 points of its box and its corners; mag_manip 3.0.0, tricubic"
_READER = Path(__file__).with_name("mag_manip_reader.py")


@dataclass(frozen=True, eq=False)
class Read:
    """Results of the program at points: unit_field (n, n_coils, 3), T/A; gradient (n, 3, 3), T/m, at given currents;
    and inverse (n, n_coils), A, the currents of the backward model for the field of the given currents."""

    unit_field: Array
    gradient: Array
    inverse: Array


def is_installed() -> bool:
    """Whether the environment exists."""
    return PROGRAM.is_installed()


def environment() -> Path:
    """The interpreter of the environment, which is made if it is missing. Raises UnavailableError."""
    return PROGRAM.python()


def ask(path: Path, points: Array, currents: Array) -> Read:
    """Evaluate a file by the program at points (n, 3), m, inside its box. Raises UnavailableError."""
    python = environment()
    with tempfile.TemporaryDirectory() as folder:
        given, read = Path(folder) / "given.npz", Path(folder) / "read.npz"
        np.savez(given, points=points, currents=currents)
        PROGRAM.run(str(python), str(_READER), str(path), str(given), str(read))
        with np.load(read) as found:
            return Read(found["unit_field"].swapaxes(1, 2), found["gradient"], found["currents"])


def box_points(field: FieldMap, n: int = POINTS) -> Array:
    """Random points of a map's box, and its corners."""
    ends = np.stack([field.lower, field.upper])
    corners = np.stack(np.meshgrid(*ends.T, indexing="ij"), axis=-1).reshape(-1, 3)
    inside = field.lower + np.random.default_rng(5).random((n, 3)) * (field.upper - field.lower)
    return np.concatenate([corners, inside])


def field_error(read: Array, exact: Array) -> float:
    """Largest difference of a coil over its largest value, for the worst coil; both (n, n_coils, 3)."""
    off, size = (np.linalg.norm(part, axis=-1).max(axis=0) for part in (read - exact, exact))
    return float((off / size).max())


def mag_manip() -> Iterator[Row]:
    """The shipped maps read by the program. Maps of linear iron are made here; maps of saturating iron, which take
    long, are used if `fieldmap map` has made them, at currents of their domain."""
    try:
        environment()
    except UnavailableError as error:
        yield _skipped("mag_manip", str(error))
        return
    with tempfile.TemporaryDirectory() as folder:
        for recipe in shipped_names("maps"):
            linear = read_recipe(recipe).currents is None
            path = Path(folder) / f"{recipe}.h5" if linear else MAPS / f"{recipe}.h5"
            if linear:
                generate(recipe, path)
            elif not path.exists():
                yield _skipped(f"mag_manip, map {recipe}", f"no map yet: fieldmap map {recipe}")
                continue
            yield from _map_rows(recipe, open_map(path), Path(folder) / f"{recipe}.yaml")


def _skipped(case: str, reason: str) -> Row:
    return Row(case, "error of B", float("nan"), FIELD_BOUND, SOURCE, note=reason, skipped=True)


def inner_currents(field: FieldMap) -> Array | None:
    """Currents (n_coils,), A, well inside the domain of a map of saturating iron; None for any other map."""
    reduced = field.info.reduced_model
    if reduced is None:
        return None
    lower, upper = np.array(reduced.domain.lower), np.array(reduced.domain.upper)
    shares = np.where(np.arange(len(lower)) % 2, 0.3, 0.7)
    return reduced.domain.parametrisation.currents(lower + shares * (upper - lower))


def _map_rows(name: str, field: FieldMap, target: Path) -> Iterator[Row]:
    """Errors of the program's B of each field in the file, of its gradient, and of the B at its inverse currents."""
    fixed = inner_currents(field)
    sampled = sample_for_mag_manip(field, currents=fixed)
    sampled.write(target)
    points = box_points(field)
    factors = np.linspace(-1.0, 2.0, len(sampled.coil_names)) if fixed is None else np.ones(1)
    read, seconds, cpu = timed(lambda: ask(target, points, factors))
    before = " x ".join(map(str, sampled.map_nodes))
    kind = "" if fixed is None else " at fixed currents"
    case = f"mag_manip, map {name}{kind}, {before} nodes written as {sampled.count} in each direction"
    exact = field.unit_field(points) if fixed is None else field.field(points, fixed)[:, None]
    slope = field.gradient(points, factors if fixed is None else fixed)
    cost = {"seconds": seconds, "cpu_seconds": cpu}
    yield Row(case, "error of B", field_error(read.unit_field, exact), FIELD_BOUND, SOURCE, **cost)
    yield Row(case, "error of gradient", largest_error(read.gradient, slope), GRADIENT_BOUND, SOURCE)
    if fixed is None:
        reached = np.einsum("nci,nc->ni", exact, read.inverse)
        quantity = "error of B of the currents that it asks for"
        yield Row(
            case, quantity, largest_error(reached, exact.swapaxes(1, 2) @ factors), 2 * FIELD_BOUND, SOURCE
        )
