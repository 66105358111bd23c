"""Ways to corrupt a map file: bytes that a disk or a copy lost, and contents made with intent to harm."""

import json
from collections.abc import Callable
from typing import Any

import h5py
import numpy as np

from fieldmap.currents import IndependentCurrents
from fieldmap.store import FieldError, Grid, MapData, Provenance, ReducedModel
from fieldmap.store.map_format import write_text

Generator = np.random.Generator
BX = "/data/0/meshes/B_1/x"
HEADER = "/fieldmap/header"
MODEL = "/fieldmap/reduced_model"
PLACES = (
    *(f"/data/0/meshes/B_1/{c}" for c in "xyz"), "/data/0/meshes/gradB_1/xy",
    "/data/0/meshes/gradB_iron_mode_1/zz", "/data/0/meshes/B_1", "/data/0", "/fieldmap", HEADER,
    "/fieldmap/report", "/fieldmap/recipe", "/fieldmap/completion", "/fieldmap/completion/chunks",
    f"{MODEL}/gradients", f"{MODEL}/law", MODEL,
)  # fmt: skip


PLACES_OF_CONSTANT = (
    "/data/0/meshes/B_no_current/z",
    "/data/0/meshes/gradB_no_current/xx",
    "/data/0/meshes/B_no_current",
    f"{MODEL}/fixed",
)
"""Further places of a map with a background."""


def small_map(constant: bool = False) -> MapData:
    """One coil and one field of saturating iron, on 27 nodes. constant: whether the map also has a background."""
    rng = np.random.default_rng(0)
    grid = Grid([-0.01, -0.01, -0.1], [0.01, 0.01, 0.005], (3, 3, 3))
    knots = np.array([0.0, 1e3])
    model = ReducedModel(
        gradients=rng.normal(size=(6, 2)),
        source=rng.normal(size=(6, 1)),
        weights=np.array([1e-6, 2e-6]),
        law=np.array([0, 0]),
        law_offset=np.array([0, 2]),
        law_knots=knots,
        law_coefficients=rng.normal(size=(2, 4)),
        air=np.eye(2),
        constant=np.zeros(2),
        output=rng.normal(size=(1, 2)),
        known_currents=np.array([[1.0]]),
        known_amplitudes=np.zeros((1, 2)),
        lower=np.array([0.5]),
        upper=np.array([2.0]),
        parametrisation=IndependentCurrents(1),
        reference_weights=np.array([0.3]),
        fixed=rng.normal(size=6) if constant else np.zeros(0),
    )
    return MapData(
        grid,
        ("1",),
        np.array([1.5]),
        Provenance(
            "corrupted",
            "rig",
            "spacing_mm = 4\n",
            'name = "rig"\n',
            "abc",
            {"fieldmap": "0"},
            {"n": 7},
            ("a",),
            "now",
        ),
        FieldError(1e-9, 2e-7),
        {"harmonic": FieldError(2e-9, 3e-7)},
        model,
        FieldError(1e-6, 2e-5),
        ("background",) if constant else (),
        constant,
        flux_density=rng.normal(size=(2 + constant, *grid.shape, 3)),
        gradient=rng.normal(size=(2 + constant, *grid.shape, 3, 3)),
    )


# Damage of bytes with the original seal, as by disks, copies and transfers.


def flip_bytes(raw: bytearray, rng: Generator) -> bytearray:
    """Replace one to three bytes."""
    for place in rng.integers(0, len(raw), rng.integers(1, 4)):
        raw[place] ^= int(rng.integers(1, 256))
    return raw


def cut(raw: bytearray, rng: Generator) -> bytearray:
    """Remove the end."""
    return raw[: int(rng.integers(0, len(raw)))]


def drop_bytes(raw: bytearray, rng: Generator) -> bytearray:
    """Remove a piece."""
    first = int(rng.integers(0, len(raw) - 1))
    del raw[first : first + int(rng.integers(1, 600))]
    return raw


def insert_bytes(raw: bytearray, rng: Generator) -> bytearray:
    """Insert a piece."""
    first = int(rng.integers(0, len(raw)))
    raw[first:first] = rng.bytes(int(rng.integers(1, 600)))
    return raw


def clear_block(raw: bytearray, rng: Generator) -> bytearray:
    """Replace a block of a disk by zeros or random bytes."""
    first = int(rng.integers(0, len(raw) - 512))
    raw[first : first + 512] = bytes(512) if rng.random() < 0.5 else rng.bytes(512)
    return raw


def exchange_blocks(raw: bytearray, rng: Generator) -> bytearray:
    """Exchange two blocks."""
    a, b = (512 * int(k) for k in rng.integers(0, len(raw) // 512 - 1, 2))
    raw[a : a + 512], raw[b : b + 512] = raw[b : b + 512], raw[a : a + 512]
    return raw


BYTES = (flip_bytes, cut, drop_bytes, insert_bytes, clear_block, exchange_blocks)


# Changes with a valid seal, as by an attacker: everything that HDF5 can hold.


def put(file: h5py.File, path: str, make: Callable[[], Any]) -> None:
    """Replace the object at a path."""
    if path in file:
        del file[path]
    make()


def external_link(file: h5py.File, path: str, rng: Generator) -> None:
    """A link to numbers of another file."""
    put(file, path, lambda: file.__setitem__(path, h5py.ExternalLink(file.filename + ".good", path)))


def soft_link(file: h5py.File, path: str, rng: Generator) -> None:
    """A link to numbers of another data set."""
    put(file, path, lambda: file.__setitem__(path, h5py.SoftLink("/data/0/meshes/B_iron_mode_1/x")))


def cycle(file: h5py.File, path: str, rng: Generator) -> None:
    """A link to itself."""
    put(file, path, lambda: file.__setitem__(path, h5py.SoftLink(path)))


def hard_cycle(file: h5py.File, path: str, rng: Generator) -> None:
    """A group inside itself."""
    put(file, path, lambda: file.__setitem__(path, file["/data"] if path != "/data/0" else file["/"]))


def other_record(file: h5py.File, path: str, rng: Generator) -> None:
    """A hard link to numbers of another shape or kind."""
    other = str(rng.choice([p for p in PLACES if not p.startswith(path) and not path.startswith(p)]))
    put(file, path, lambda: file.__setitem__(path, file[other]))


def giant(file: h5py.File, path: str, rng: Generator) -> None:
    """Data sets of up to 1e15 numbers without stored values."""
    shape = tuple(int(n) for n in rng.choice([3, 10**3, 10**5], size=int(rng.integers(1, 4))))
    chunks = tuple(min(n, 64) for n in shape) if rng.random() < 0.5 else None
    put(
        file,
        path,
        lambda: file.create_dataset(path, shape, str(rng.choice(["f8", "S900", "u1"])), chunks=chunks),
    )


def bomb(file: h5py.File, path: str, rng: Generator) -> None:
    """A few bytes that unpack to a gigabyte."""
    shape = (2**27,) if rng.random() < 0.1 else (3, 3, 3)
    put(
        file,
        path,
        lambda: file.create_dataset(path, shape, "f8", compression="gzip", shuffle=True, chunks=True),
    )
    if shape == (3, 3, 3):
        file[path][...] = 1.0


def strange_type(file: h5py.File, path: str, rng: Generator) -> None:
    """Types that no map has."""
    kinds = (
        h5py.ref_dtype, h5py.regionref_dtype, h5py.vlen_dtype(np.float64), h5py.string_dtype(),
        h5py.string_dtype("utf-8", 1000), np.dtype([("a", "f8"), ("b", "S3")]), np.dtype(">f8"),
        np.dtype("f4"), np.dtype("c16"), np.dtype("V16"), np.dtype("?"),
        h5py.enum_dtype({"A": 1, "B": 2}, "i4"), np.dtype("u8"),
    )  # fmt: skip
    shape = ((3, 3, 3), (), (7,), (0,))[int(rng.integers(4))]
    put(file, path, lambda: file.create_dataset(path, shape, kinds[int(rng.integers(len(kinds)))]))


def empty_space(file: h5py.File, path: str, rng: Generator) -> None:
    """A data set without a space."""
    put(file, path, lambda: file.__setitem__(path, h5py.Empty(str(rng.choice(["f8", "S5", "u1"])))))


def raw_file(file: h5py.File, path: str, rng: Generator) -> None:
    """Numbers in an external raw file."""
    outside = [(str(rng.choice(["/etc/passwd", "/dev/zero", file.filename])), 0, 216)]
    put(file, path, lambda: file.create_dataset(path, (3, 3, 3), "f8", external=outside))


def virtual(file: h5py.File, path: str, rng: Generator) -> None:
    """A virtual data set with numbers of another file."""
    layout = h5py.VirtualLayout((3, 3, 3), "f8")
    layout[...] = h5py.VirtualSource(file.filename + ".good", BX, shape=(3, 3, 3))
    put(file, path, lambda: file.create_virtual_dataset(path, layout))


def nothing(file: h5py.File, path: str, rng: Generator) -> None:
    """Remove an object."""
    put(file, path, lambda: None)


def group(file: h5py.File, path: str, rng: Generator) -> None:
    """A group instead of numbers."""
    put(file, path, lambda: file.create_group(path))


def attribute(file: h5py.File, path: str, rng: Generator) -> None:
    """Replace or remove an attribute."""
    place = str(rng.choice(["/fieldmap", "/fieldmap/completion", "/data/0/meshes/B_1", HEADER, BX, "/"]))
    spoil_attribute(file, place, rng, np.zeros((2, 2)))


def spoil_attribute(file: h5py.File, place: str, rng: Generator, *more: Any) -> None:
    """Replace one of the attributes of a place by a strange value, also from `more`, or remove it."""
    at = file[place].attrs
    name = sorted(at)[int(rng.integers(len(at)))]
    strange = ("text", b"\xff\xfe", np.nan, -1, 10**18, np.zeros(3), h5py.Empty("f8"), file.ref, True, *more)
    choice = int(rng.integers(len(strange) + 1))
    del at[name]
    if choice < len(strange):
        at[name] = strange[choice]


def numbers(file: h5py.File, path: str, rng: Generator) -> None:
    """NaN and infinity."""
    data = file[str(rng.choice([BX, f"{MODEL}/air", "/data/0/meshes/gradB_iron_mode_1/yz"]))]
    flat = data[()].ravel()
    flat[int(rng.integers(flat.size))] = rng.choice([np.nan, np.inf, -np.inf])
    data[...] = flat.reshape(data.shape)


def header(file: h5py.File, path: str, rng: Generator) -> None:
    """Strange JSON in the header or report, with a matching hash."""
    name = str(rng.choice(["header", "report"]))
    content = json.loads(file[f"/fieldmap/{name}"][()])
    key = sorted(content)[int(rng.integers(len(content)))]
    strange = (
        None, [], {}, "x", -1, 1e308, [1e9, 1e9, 1e9], ["1"] * 99, ["../../x"], [None], {"a": []}, [[1]],
        "\ud800",
    )  # fmt: skip
    value = strange[int(rng.integers(len(strange)))]
    text = json.dumps(
        {k: v for k, v in content.items() if k != key} | ({key: value} if rng.random() < 0.8 else {})
    )
    ways = (
        text, "[" * 10**5, "1e999", "nan", '{"a":' * 4000 + "1" + "}" * 4000, text.replace("1", "1" * 5000),
    )  # fmt: skip
    write_text(file, name, ways[0] if rng.random() < 0.7 else ways[int(rng.integers(1, len(ways)))])


HOSTILE = (
    external_link, soft_link, cycle, hard_cycle, other_record, giant, bomb, strange_type, empty_space,
    raw_file, virtual, nothing, group, attribute, attribute, numbers, header, header, header,
)  # fmt: skip
