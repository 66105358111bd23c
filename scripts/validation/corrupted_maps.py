"""Corrupt a small map in every way, read it, and count the outcomes. A separate program, because it may crash.

    python corrupted_maps.py COUNT SEED

Three cases with a map of coils and iron alternate with three cases of a map that also has a constant field. Prints
JSON: how many cases were refused with the package's own error, how many gave identical data, and the cases with other
data ("wrong"), any other exception ("traceback") or no answer within a minute ("hung"). A crash of the HDF5 library
ends the process; the last line on stderr then names the case.
"""

import contextlib
import io
import json
import os
import resource
import signal
import sys
import tempfile
from pathlib import Path
from typing import Any

import h5py
import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))

from fieldmap.cli import main as command
from fieldmap.errors import MapFileError
from fieldmap.store import Grid, MapData, ReducedModel, read_info, read_map, seal_map, write_map
from fieldmap.store.seal import SEAL_LENGTH
from validation.corruption import BYTES, HOSTILE, PLACES, PLACES_OF_CONSTANT, small_map

# Limit of the address space of this process. A reader that allocates the size that a file claims gets a MemoryError.
MEMORY = 8 << 30


def corrupt(case: int, seed: int, good: bytes, path: Path, places: tuple[str, ...]) -> str:
    """Write a corrupted copy, and return a description of the change."""
    rng = np.random.default_rng([seed, case])
    way = case % 3
    if way == 2:
        path.write_bytes(good)
        change = HOSTILE[int(rng.integers(len(HOSTILE)))]
        place = str(rng.choice(places))
        with h5py.File(path, "r+") as file:
            change(file, place, rng)
        seal_map(path)
        return f"{change.__name__} at {place}"
    change_bytes = BYTES[int(rng.integers(len(BYTES)))]
    if way == 0:
        path.write_bytes(change_bytes(bytearray(good), rng))
        return change_bytes.__name__
    # Damage under a valid seal tests HDF5 and the reader, not the seal.
    path.write_bytes(change_bytes(bytearray(good[:-SEAL_LENGTH]), rng))
    seal_map(path)
    return f"{change_bytes.__name__}, sealed"


def same(a: MapData, b: MapData) -> bool:
    """Whether the numbers are equal bit for bit. Texts may differ, because the seal and hashes were made again."""

    def key(value: Any) -> Any:
        if isinstance(value, np.ndarray):
            return (value.dtype.str, value.shape, value.tobytes())
        if isinstance(value, (Grid, ReducedModel)):
            return tuple(key(v) for v in vars(value).values())
        return value

    names = (
        "grid",
        "coil_names",
        "reference_current",
        "flux_density",
        "gradient",
        "reduced_model",
        "constant_field",
    )
    return all(key(getattr(a, name)) == key(getattr(b, name)) for name in names)


def outcome(path: Path, truth: MapData) -> str:
    """ "refused", "identical", or the name of a failure."""
    try:
        found = read_map(path)
    except MapFileError as error:
        if str(path) not in str(error) or error.exit_code != 2:
            return "traceback"
        with contextlib.suppress(MapFileError):
            read_info(path)
        with contextlib.redirect_stderr(io.StringIO()), contextlib.redirect_stdout(io.StringIO()):
            return "refused" if command(["check", str(path)]) == 2 else "wrong"
    return "identical" if same(found, truth) else "wrong"


def main() -> None:
    """Run the cases, one after the other."""
    count, seed = int(sys.argv[1]), int(sys.argv[2])
    found: dict[str, Any] = {"refused": 0, "identical": 0, "wrong": [], "traceback": [], "hung": []}

    def late(*_: Any) -> None:
        raise TimeoutError

    signal.signal(signal.SIGALRM, late)
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "map.h5"
        kinds = []
        for constant, places in ((False, PLACES), (True, PLACES + PLACES_OF_CONSTANT)):
            good, truth = write_map(path, small_map(constant)).read_bytes(), read_map(path)
            kinds.append((good, truth, places))
        Path(f"{path}.good").write_bytes(kinds[0][0])
        for case in range(count):
            path.unlink(missing_ok=True)
            good, truth, places = kinds[case // 3 % 2]
            name = f"case {case}, {corrupt(case, seed, good, path, places)}"
            print(name, file=sys.stderr, flush=True)
            signal.alarm(60)
            try:
                result = outcome(path, truth)
            except TimeoutError:
                result = "hung"
            except Exception as error:
                result, name = "traceback", f"{name}: {type(error).__name__}: {error}"
            signal.alarm(0)
            if isinstance(found[result], int):
                found[result] += 1
            else:
                found[result].append(name)
    print(json.dumps(found))


if __name__ == "__main__":
    os.environ.setdefault("HDF5_USE_FILE_LOCKING", "FALSE")
    main()
