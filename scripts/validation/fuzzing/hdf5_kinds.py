"""HDF5 files: maps and recorded runs, with damaged bytes or malicious contents."""

from collections.abc import Callable
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Any

import h5py
import numpy as np

import fieldmap as fm
from fieldmap.errors import MapFileError
from fieldmap.plot.gather import shown_run
from fieldmap.shipped import shipped_file
from fieldmap.store import RunRecord, check_map, read_map, seal_map, write_map, write_runs
from fieldmap.store.seal import SEAL_LENGTH
from validation.corrupted_maps import same
from validation.corruption import HOSTILE, PLACES, PLACES_OF_CONSTANT, small_map, spoil_attribute
from validation.fuzzing.case import Case, Generator, Kind
from validation.fuzzing.mutations import bytes_of

Change = Callable[[h5py.File, str, Generator], None]


def object_reference(file: h5py.File, path: str, rng: Generator) -> None:
    """An attribute that points to an object."""
    at = file[path].attrs
    names = sorted(at) or ["unit"]
    at[names[int(rng.integers(len(names)))]] = file[path].ref


def unknown_filter(file: h5py.File, path: str, rng: Generator) -> None:
    """Numbers with an unknown filter, which HDF5 would search among the system's plug-ins."""
    properties = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
    properties.set_chunk((3, 3, 3))
    properties.set_filter(int(rng.choice([305, 32001, 32015, 65000])), h5py.h5z.FLAG_OPTIONAL, (1, 2))
    if path in file:
        del file[path]
    space = h5py.h5s.create_simple((3, 3, 3))
    h5py.h5d.create(file.id, path.encode(), h5py.h5t.IEEE_F64LE, space, dcpl=properties)


def named_type(file: h5py.File, path: str, rng: Generator) -> None:
    """A named type instead of numbers."""
    if path in file:
        del file[path]
    file[path] = np.dtype("f8")


def user_block(file: h5py.File, path: str, rng: Generator) -> None:
    """Thousands of attributes, or one of megabytes."""
    if rng.random() < 0.5:
        for k in range(2000):
            file[path].attrs[f"a{k}"] = k
    else:
        data = file.create_group("much")
        data.attrs.create("a", np.zeros(8000))


def dense_links(file: h5py.File, path: str, rng: Generator) -> None:
    """Thousands of links, all but one to other files."""
    for k in range(1000):
        file[f"/much/{k}"] = h5py.ExternalLink(file.filename + ".good", path)


MORE: tuple[Change, ...] = (object_reference, unknown_filter, named_type, user_block, dense_links)


def _forged(
    good: bytes, path: Path, places: tuple[str, ...], changes: tuple[Any, ...], rng: Generator
) -> str:
    path.write_bytes(good)
    change, place = changes[int(rng.integers(len(changes)))], str(rng.choice(places))
    with h5py.File(path, "r+") as file:
        try:
            change(file, place, rng)
        except (KeyError, TypeError, AttributeError, ValueError):
            # This place cannot take the change, and the file stays valid.
            return f"nothing by {change.__name__} at {place}"
    seal_map(path)
    return f"{change.__name__} at {place}"


def _damaged(good: bytes, path: Path, rng: Generator, sealed: bool) -> str:
    change, raw = bytes_of(good[:-SEAL_LENGTH] if sealed else good, rng)
    path.write_bytes(raw)
    if sealed:
        seal_map(path)
    return f"{change}{', sealed' if sealed else ''}"


def _mutated(
    good: bytes, path: Path, places: tuple[str, ...], changes: tuple[Any, ...], rng: Generator, number: int
) -> str:
    path.unlink(missing_ok=True)
    if number % 3 == 2:
        return _forged(good, path, places, changes, rng)
    return _damaged(good, path, rng, number % 3 == 1)


def maps(folder: Path) -> Callable[[Generator, int], Case]:
    """Small maps, read completely, and the shipped map, opened and looked up. A change under a new seal may alter the
    numbers, so only small maps are compared, whose changes are known to keep them."""
    path, kinds = folder / "input.h5", []
    for constant, places in ((False, PLACES), (True, PLACES + PLACES_OF_CONSTANT)):
        good, truth = write_map(path, small_map(constant)).read_bytes(), read_map(path)
        kinds.append((good, truth, places))
    Path(f"{path}.good").write_bytes(kinds[0][0])
    sample = shipped_file("maps", "sample.h5").read_bytes()
    field = fm.open_map("sample")
    rng = np.random.default_rng(0)
    points = field.lower + rng.random((20, 3)) * (field.upper - field.lower)
    exact = field.field(points, 1.0)

    def look_up() -> Any:
        return fm.open_map(path).field(points, 1.0)

    def fault_of_field(found: Any) -> str:
        return "" if np.array_equal(found, exact) else "another field"

    def make(rng: Generator, number: int) -> Case:
        command = ("check", str(path))
        if number % 10 == 9:
            change = _damaged(sample, path, rng, number % 20 == 9)
            return Case(f"sample: {change}", look_up, fault_of_field, command)
        good, truth, places = kinds[number // 3 % 2]
        change = _mutated(good, path, places, (*HOSTILE, *MORE), rng, number)

        def read() -> Any:
            found = read_map(path)
            # The check may refuse random numbers, which are no field.
            with suppress(MapFileError):
                check_map(path)
            return found

        return Case(change, read, lambda found: "" if same(found, truth) else "other numbers", command)

    return make


def runs(folder: Path) -> Callable[[Generator, int], Case]:
    """A recorded run of a device, drawn."""
    path = folder / "input.h5"
    device = fm.read_device("single_electromagnet")
    time = np.linspace(0.0, 1.0, 60)
    place = np.column_stack([0.002 * np.cos(time), 0.002 * np.sin(time), np.full(60, -0.044)])
    turn = np.tile([1.0, 0.0, 0.0, 0.0], (60, 1))
    arrays = {"time": (time, "s", "time"), "quaternion": (turn, "1", "w, x, y, z")}
    arrays |= dict.fromkeys(("position", "sensed", "reference"), (place, "m", "x, y, z"))
    arrays["currents"] = (np.ones((60, 1)), "A", "coil")
    scenario = shipped_file("maps", "scenarios/vertical_step").read_text()
    about = {"title": "A run", "scenario": scenario, "device": device.text, "changes": "{}"}
    good = write_runs(path, [RunRecord(arrays, {"event": ""})] * 2, about).read_bytes()
    Path(f"{path}.good").write_bytes(good)
    names = ("time", "quaternion", "position", "sensed", "reference", "currents")
    places = (*(f"/run_0000/{name}" for name in names), "/run_0001/time", "/run_0000", "/run_0001")
    changes = (*HOSTILE[:-6], *MORE, _attribute, _attribute, _text, _text)
    truth = shown_run(path)

    def make(rng: Generator, number: int) -> Case:
        # Bytes are not damaged under a forged seal, because HDF5 itself may then never end.
        change = _mutated(good, path, places, changes, rng, number if number % 3 != 1 else 2)
        kept = "sealed" not in change and " at " not in change
        return Case(change, partial(shown_run, path), partial(_fault_of_run, truth=truth, kept=kept))

    return make


def _attribute(file: h5py.File, path: str, rng: Generator) -> None:
    """Replace or remove an attribute."""
    place = str(rng.choice(["/", "/run_0000", "/run_0000/time"]))
    spoil_attribute(file, place, rng, "[1]", "null")


def _text(file: h5py.File, path: str, rng: Generator) -> None:
    """Replace the scenario or device by a text that names files, is invalid, or nests deeply."""
    texts = (
        *(
            "",
            "x",
            'device = "decoys/secret.toml"',
            'device = "../../etc/passwd"',
            "a = " + "[" * 20000,
            "body = 3",
        ),
        *("[body]\nradius_mm = nan\nheight_mm = 1", '[body]\nradius_mm = "a"\nheight_mm = 1', "\ud800"[:0]),
        'format = 1\nname = "a"\ntitle = "a"\ninclude = "decoys/secret.toml"\n',
        'format = 1\nname = "a"\ntitle = "a"\n[material.m]\nkind = "bh_table"\nfile = "decoys/secret.toml"\n'
        'below = "straight line to the origin"\nabove = "slope mu0"\n[[coil]]\nname = "1"\nkind = "circular"\n'
        "inner_radius_mm = 1\nouter_radius_mm = 2\nheight_mm = 1\nturns = 1\n",
    )
    file.attrs[str(rng.choice(["scenario", "device"]))] = texts[int(rng.integers(len(texts)))]
    if rng.random() < 0.3:
        file.attrs.pop("device", None)


def _fault_of_run(found: Any, truth: Any, kept: bool) -> str:
    run = found.run
    names = ("time", "position", "quaternion", "currents", "wanted")
    if kept and not all(np.array_equal(getattr(run, name), getattr(truth.run, name)) for name in names):
        return "other numbers under an unbroken seal"
    if run.currents.shape[1] != len(run.device.coils) or not len(run.time):
        return "currents of other coils"
    return ""


MAPS = Kind("map files", maps, seconds=5.0)
RUNS = Kind("recorded runs", runs, seconds=5.0, through_command=0)
