"""Fixtures and settings for the tests of all packages."""

import gc
import os
import tempfile
from collections import Counter
from pathlib import Path

import numpy as np
import pytest

DEVICES = Path(__file__).parent / "devices"
SCENARIOS = Path(__file__).parent / "scenarios"


@pytest.fixture
def valid_text() -> str:
    """Text of a valid device file with one of everything, for tests that break or vary it."""
    return (DEVICES / "everything.toml").read_text(encoding="utf-8")


@pytest.hookimpl(tryfirst=True)
def pytest_configure(config):
    """One folder of meshes for all processes of a run, so that each body is meshed once. Meshes of earlier runs are not
    used, because the tests must test the current mesher."""
    # Set in the environment, because the xdist controller does not import the package.
    if "FIELDMAP_MESHES" not in os.environ:
        folder = tempfile.TemporaryDirectory(prefix="fieldmap_meshes_")
        os.environ["FIELDMAP_MESHES"] = folder.name
        config.add_cleanup(folder.cleanup)
    # numba formats thousands of messages about unmatched overloads while it compiles, and shows none: no colours.
    os.environ.setdefault("NUMBA_DISABLE_ERROR_MESSAGE_HIGHLIGHTING", "1")
    if workers := getattr(config.option, "numprocesses", None):
        # With threads for all processors in every process, the processes would mostly wait for each other.
        for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
            os.environ.setdefault(name, str(max(1, (os.cpu_count() or 1) // workers)))


gc.disable()


def pytest_collection_finish():
    """Exclude the 700 000 objects loaded so far from garbage collection, and collect less often. Before, collection
    took a seventh of the processor time of 250 tests."""
    gc.freeze()
    gc.set_threshold(10_000, 20, 10)
    gc.enable()


# The first two start together, one per process. One process compiles what most tests call, the other single kernels.
# Kernels needed by both at the same time would be compiled twice. Folders whose files have few and long tests follow,
# so that the last files are short.
FIRST = (
    "tests/test_records.py",
    "tests/kernels/",
    "tests/maps/",
    "tests/interop/",
    "tests/dynamics/",
    "tests/docs/",
)
SLOW = Path(__file__).parent / "slow.txt"


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(config, items):
    """Mark the tests of slow.txt before markers select tests. A line that names no test is an error."""
    lines = SLOW.read_text(encoding="utf-8").splitlines()
    named = {line for line in lines if line and not line.startswith("#")}
    found, functions = set(), set()
    for item in items:
        function = item.nodeid.split("[")[0]
        functions.add(function)
        if of := named & {item.nodeid, function, file_of(item)}:
            item.add_marker("slow")
            found |= of
    # In a run of some tests, or without a library, a missing name is no error, nor are further parameters of a function
    # when one was asked for.
    functions -= {name.split("[")[0] for name in config.args if "[" in name}
    files = {function.split("::")[0] for function in functions}
    lost = {name for name in named - found if name.split("[")[0] in functions}
    lost |= {name for name in named - found if name.split("::")[0] in files and not is_written(name)}
    # With --lf some parameters of a function are collected without the others.
    if lost and not config.getoption("lf", False):
        raise pytest.UsageError(f"tests/slow.txt names tests that are not there: {', '.join(sorted(lost))}")
    if "PYTEST_XDIST_WORKER" in os.environ:
        # xdist hands out whole files: the smallest last, so that processes wait little for each other.
        sizes = Counter(file_of(item) for item in items)
        items.sort(key=lambda item: (turn_of(file_of(item)), -sizes[file_of(item)]))


def turn_of(file):
    """Index of the longest entry of FIRST that the name starts with."""
    turns = [k for k, start in enumerate(FIRST) if file.startswith(start)]
    return max(turns, key=lambda k: len(FIRST[k]), default=len(FIRST))


def file_of(item):
    return item.nodeid.split("::")[0]


def is_written(name):
    """Whether the file of a test defines it."""
    file, _, function = name.split("[")[0].partition("::")
    path = SLOW.parents[1] / file
    return path.is_file() and f"def {function}(" in path.read_text(encoding="utf-8")


def pytest_addoption(parser):
    parser.addoption(
        "--rewrite-golden", action="store_true", help="write what the commands print into tests/cli/golden"
    )


def dipole_field(moment, source, points):
    """B (n, 3) of a vertical dipole, Jackson eq. (5.56)."""
    r = points - source
    d = np.linalg.norm(r, axis=1)[:, None]
    return 1e-7 * (3 * moment * r[:, 2:] * r / d**5 - np.array([0.0, 0.0, moment]) / d**3)


def dipole_gradient(moment, source, points):
    r = points - source
    d2 = np.sum(r**2, axis=1)[:, None, None]
    m = np.array([0.0, 0.0, moment])
    along = (r @ m)[:, None, None]
    outer = m[:, None] * r[:, None, :] + m * r[:, :, None]
    return 3e-7 * (outer + along * np.eye(3) - 5 * along * r[:, :, None] * r[:, None, :] / d2) / d2**2.5


def _write_dipoles(sources, path, device="", **provenance):
    """Write a map file of vertical dipoles (n, 3), each of 8 A m^2 per ampere, in the workspace of the drive unit.

    device: text of the device file recorded in the map; provenance: further recorded fields.
    """
    from fieldmap.store import Grid, MapData, Provenance, write_map

    n = len(sources)
    lower, upper = np.array([-0.02, -0.02, -0.14]), np.array([0.02, 0.02, -0.076])
    cells = np.array([8, 8, 12])
    grid = Grid(lower, (upper - lower) / cells, tuple(cells + 1))
    points = grid.points()
    flux = [dipole_field(8.0, s, points) for s in sources]
    slope = [dipole_gradient(8.0, s, points) for s in sources]
    data = MapData(
        grid,
        tuple(str(k + 1) for k in range(n)),
        np.ones(n),
        flux_density=np.array(flux).reshape(n, *grid.shape, 3),
        gradient=np.array(slope).reshape(n, *grid.shape, 3, 3),
        provenance=Provenance(device_text=device, **provenance),
    )
    write_map(path, data)
    return path


@pytest.fixture(scope="session")
def dipole_map():
    return _write_dipoles


@pytest.fixture(scope="session")
def circle_of_six():
    """Places (6, 3), m, on the circle of the drive unit's coils, in its order of coils."""
    angles = np.deg2rad([240.0, 180.0, 120.0, 300.0, 0.0, 60.0])
    return np.column_stack([0.044 * np.cos(angles), 0.044 * np.sin(angles), np.full(6, 0.026)])


@pytest.fixture(scope="session")
def six_coils(circle_of_six, tmp_path_factory):
    """A map file of six dipoles on the circle of the drive unit."""
    return _write_dipoles(circle_of_six, tmp_path_factory.mktemp("maps") / "six.h5")


@pytest.fixture
def written(six_coils, tmp_path):
    """written(text, name): path of a scenario file on the map of six dipoles; default text: scenarios/step.toml."""

    def write(text=None, name="step.toml"):
        path = tmp_path / name
        path.write_text((text or (SCENARIOS / "step.toml").read_text()).replace("six.h5", str(six_coils)))
        return path

    return write


@pytest.fixture(scope="session")
def legible():
    """legible(curves): draw each figure off screen and check that it is legible: units on both axes, every text inside
    the picture, no overlaps, and room left for the lines."""
    from fieldmap.plot.figures import curves_figure

    seen = set()

    def draw(curves):
        for one in (one for one in curves if one.title not in seen):
            seen.add(one.title)
            figure = curves_figure(one)
            (axes,) = figure.axes
            figure.draw_without_rendering()
            check(figure, axes, one.title)

    def check(figure, axes, title):
        # Ratios and roots in the z-plane have no unit.
        with_unit = (")", "signal", "over weight", "part", "of the denominator")
        assert axes.get_xlabel().endswith(with_unit), title
        assert axes.get_ylabel().endswith(with_unit), title
        words = [axes.xaxis.label, axes.yaxis.label, *axes.texts, *shown(axes.xaxis), *shown(axes.yaxis)]
        words += [word for word in title_texts(axes) if word.get_text()]
        boxes = [word.get_window_extent() for word in words]
        legend = axes.get_legend()
        inside = boxes if legend is None else [*boxes, legend.get_window_extent()]
        for box in inside:
            assert figure.bbox.x0 <= box.x0 < box.x1 <= figure.bbox.x1, title
            assert figure.bbox.y0 <= box.y0 < box.y1 <= figure.bbox.y1, title
        for k, box in enumerate(inside):
            assert not any(box.overlaps(other) for other in inside[k + 1 :]), title
        assert axes.bbox.width > 0.4 * figure.bbox.width, title
        assert np.prod(axes.bbox.size) > 0.3 * np.prod(figure.bbox.size), title

    def title_texts(axes):
        return [
            child
            for child in axes.get_children()
            if getattr(child, "get_text", str)() == axes.get_title("left")
        ]

    def shown(axis):
        low, high = sorted(axis.get_view_interval())
        return [
            tick.label1
            for tick in axis.get_major_ticks()
            if low <= tick.get_loc() <= high and tick.label1.get_text()
        ]

    return draw
