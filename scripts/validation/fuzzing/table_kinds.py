"""Tables and texts of measurements: readings of flux densities, logs of rigs, maps of mag_manip."""

import math
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from fieldmap.control.identification import read_log
from fieldmap.dynamics.scenario.measured_log import read_measured_log
from fieldmap.interop import fit_map, read_mag_manip, read_measurements
from validation.fuzzing.case import Case, Generator, Kind, not_finite
from validation.fuzzing.mutations import bytes_of, characters

Cells = list[list[str]]
STRANGE = (
    "nan", "inf", "-inf", "1e308", "-1e308", "1e999", "5e-324", "0", "-0", "", " ", "text", '"', '""',
    "0x10", "1_0", "1,5", "1;5", "\x00", "=1+1", "9" * 400, "x" * 200_000, "1e5", "True", "None", "１２",
    "\r", "#", "# 1",
)  # fmt: skip


def cells_of(text: str, rng: Generator, separator: str = ",") -> tuple[str, str]:
    """One to three mistakes in cells, columns and rows of a table."""
    rows: Cells = [line.split(separator) for line in text.strip("\n").split("\n")]
    done = []
    for _ in range(int(rng.choice([1, 1, 2, 3]))):
        k = int(rng.integers(0, len(rows)))
        c = int(rng.integers(0, len(rows[k]))) if rows[k] else 0
        what = str(
            rng.choice(["cell", "cell", "head", "drop row", "double row", "column", "longer", "few", "swap"])
        )
        piece = STRANGE[int(rng.integers(len(STRANGE)))]
        if what == "cell" and rows[k]:
            rows[k][c] = piece
        elif what == "head" and rows[0]:
            c = int(rng.integers(0, len(rows[0])))
            names = (
                rows[0][int(rng.integers(len(rows[0])))], piece, "I__A", "time (s)", "x_mm", "x ()", "( )",
            )  # fmt: skip
            rows[0][c] = names[int(rng.integers(len(names)))]
        elif what == "drop row" and len(rows) > 1:
            del rows[k]
        elif what == "double row":
            rows.insert(k, list(rows[k]))
        elif what == "column":
            rows = [row[:c] + row[c + 1 :] for row in rows]
        elif what == "longer":
            rows[k] += [piece] * int(rng.integers(1, 4))
        elif what == "few":
            rows = rows[: int(rng.integers(0, 6))] or [[]]
        elif what == "swap":
            j = int(rng.integers(0, len(rows)))
            rows[k], rows[j] = rows[j], rows[k]
        done.append(f"{what} {piece[:12]!r}" if what in ("cell", "head", "longer") else what)
    return " and ".join(done), "\n".join(separator.join(row) for row in rows) + "\n"


def table_kind(
    name: str,
    text: Callable[[], str],
    read: Callable[[Path], Any],
    fault: Callable[[Any, str], str],
    command: Callable[[Path], tuple[str, ...]],
    suffix: str = ".csv",
    seconds: float = 3.0,
) -> Kind:
    """A kind of table. fault(result, text): describes errors in the result."""

    def prepare(folder: Path) -> Callable[[Generator, int], Case]:
        path, sound = folder / f"input{suffix}", text()
        path.write_text(sound)
        found = fault(read(path), sound)
        if found:
            raise AssertionError(f"{name}: a sound file: {found}")

        def make(rng: Generator, number: int) -> Case:
            way = number % 3
            if way == 0:
                change, raw = bytes_of(sound.encode(), rng)
            else:
                change, changed = (characters if way == 1 else cells_of)(sound, rng)
                raw = changed.encode("utf-8", "surrogatepass")
            path.write_bytes(raw)
            told = raw.decode("utf-8", "replace")
            return Case(change, partial(read, path), lambda answer: fault(answer, told), command(path))

        return make

    return Kind(name, prepare, seconds)


def _readings() -> str:
    """Readings of two coils with a uniform field and a gradient, in a box of 10 mm."""
    rng = np.random.default_rng(0)
    lines = ["x_mm,y_mm,z_mm,I_left_A,I_right_A,Bx_mT,By_mT,Bz_mT"]
    for k in range(60):
        x, y, z = rng.uniform(-5, 5, 3)
        one, two = (1.0, 0.0) if k % 2 else (0.3, -1.2)
        b = one * np.array([0.1, 0.2, 0.3 + 0.01 * z]) + two * np.array([0.02 * x, 0.02 * y, -0.04 * z])
        b += one * np.array([-0.005 * x, -0.005 * y, 0.0])
        lines.append(",".join(f"{value:.9g}" for value in (x, y, z, one, two, *b)))
    return "\n".join(lines) + "\n"


def _read_readings(path: Path) -> Any:
    measured = read_measurements(path)
    return measured, fit_map(measured, 2e-3)


def fault_of_readings(found: Any, text: str) -> str:
    """Compare with the numbers of the text, read by plain Python; the fit must be finite and follow them."""
    measured, fitted = found
    data = fitted.data
    if lost := not_finite([measured, data.flux_density, data.gradient, fitted.report]):
        return f"NaN or infinity in {lost}"
    lines = [line for line in text.lstrip("\ufeff").split("\n") if line.strip()]
    if any(mark in text for mark in '"\r#;\t%/'):
        return ""
    names = [name.strip() for name in lines[0].split(",")]
    rows = [[float(cell) for cell in line.split(",")] for line in lines[1:] if line.strip(", ")]
    units = {"mm": 1e-3, "m": 1.0, "mT": 1e-3, "T": 1.0, "uT": 1e-6, "A": 1.0}
    for axis, column in zip("xyz", measured.points.T, strict=True):
        called = [k for k, name in enumerate(names) if name.startswith(f"{axis}_")]
        # The tests of the reader cover other names and units.
        if len(called) != 1 or names[called[0]].rpartition("_")[2] not in units:
            continue
        (k,) = called
        exact = [row[k] * units[names[k].rpartition("_")[2]] for row in rows]
        if not np.allclose(column, exact, rtol=1e-12):
            return f"other {axis} than those of the file"
    return ""


def _log() -> str:
    """A step of current, and the response of a first-order system."""
    lines = ["time (s),current (A),position (mm)"]
    y = 0.0
    for k in range(400):
        u = 1.0 if (k // 50) % 2 else -0.5
        y += 0.01 / 0.08 * (2.0 * u - y)
        lines.append(f"{0.01 * k:.6g},{u:.6g},{y:.9g}")
    return "\n".join(lines) + "\n"


def _read_logs(path: Path) -> Any:
    """Columns by their roles, and all under their own names."""
    known = read_measured_log(path, ("left",), {"x": "position", "left": "current"})
    return known, read_log(path)


def fault_of_log(found: Any, text: str) -> str:
    """The log must be finite, evenly sampled, and the same by role and by name."""
    recognised, log = found
    if lost := not_finite([recognised.signals, log.signals, log.Ts, recognised.Ts]):
        return f"NaN or infinity in {lost}"
    for ours, theirs in (("x", "position"), ("left", "current")):
        if ours in recognised.signals and theirs in log.signals:
            a, b = recognised.signals[ours], log.signals[theirs]
            if a.shape != b.shape or not np.allclose(a, b, rtol=1e-12, atol=0):
                return f"{theirs} differs by role"
    return "" if log.Ts > 0 and math.isclose(log.Ts, recognised.Ts) else "another sampling time"


def _fields() -> str:
    """Fields of two coils on 5 x 5 x 5 nodes, with z as the fastest index."""
    axis = np.linspace(-0.01, 0.01, 5)
    lines = ["name: two", "vfields:"]
    for coil in range(2):
        lines += [f"  coil_{coil}:", "    data:"]
        for x in axis:
            for y in axis:
                for z in axis:
                    b = [0.1 + coil * x, 0.2 + coil * y, 0.3 - 2 * coil * z]
                    lines.append(f"    - [{b[0]:.6g}, {b[1]:.6g}, {b[2]:.6g}]")
        for name in "xyz":
            lines += [f"    dim_{name}: 5", f"    min_{name}: -0.01", f"    max_{name}: 0.01"]
    return "\n".join(lines) + "\n"


BOMBS = (
    "a: &a [x, x, x, x, x, x, x, x, x]\n"
    + "".join(f"{chr(98 + k)}: &{chr(98 + k)} [{', '.join([f'*{chr(97 + k)}'] * 9)}]\n" for k in range(9))
    + "vfields: {c: {data: *j, dim_x: 2, dim_y: 2, dim_z: 2, min_x: 0, max_x: 1, min_y: 0, max_y: 1,\n"
    "  min_z: 0, max_z: 1}}\n",
    "vfields: !!python/object/apply:os.system ['touch ran']\n",
    "vfields: !!python/name:os.system\n",
    "vfields: &a {c: *a}\n",
    "? " * 3000 + "\n",
    "vfields: " + "[" * 20000 + "\n",
    "vfields: []\n",
    "vfields: {}\n",
    "",
    "vfields: {1: {}, a: {}}\n",
    "%YAML 9.9\n---\nvfields: 1\n",
    "vfields: {c: {data: !!binary aGk=, dim_x: .inf, dim_y: 2, dim_z: 2}}\n",
)


def vector_fields(folder: Path) -> Callable[[Generator, int], Case]:
    """YAML for mag_manip, as other programs write it; YAML can hold objects, aliases and bombs."""
    path, sound = folder / "input.yaml", _fields()
    path.write_text(sound)
    truth = read_mag_manip(path)

    def fault(found: Any, raw: bytes) -> str:
        data = found.data
        if lost := not_finite(
            [data.flux_density, data.gradient, data.grid.lower, data.grid.spacing, found.report]
        ):
            return f"NaN or infinity in {lost}"
        same = (
            np.allclose(data.flux_density, truth.data.flux_density, atol=1e-9)
            if raw == sound.encode()
            else True
        )
        return "" if same else "other numbers of the same file"

    def make(rng: Generator, number: int) -> Case:
        way = number % 4
        if way == 0:
            change, raw = bytes_of(sound.encode(), rng)
        elif way == 3:
            text = BOMBS[int(rng.integers(len(BOMBS)))]
            change, raw = f"bomb {text[:20]!r}", text.encode()
        else:
            change, text = characters(sound, rng) if way == 1 else _other_value(sound, rng)
            raw = text.encode("utf-8", "surrogatepass")
        path.write_bytes(raw)
        return Case(change, partial(read_mag_manip, path), lambda found: fault(found, raw))

    return make


def _other_value(text: str, rng: Generator) -> tuple[str, str]:
    """Replace one of the sizes and corners, or the value of one node."""
    values = (
        ".nan", ".inf", "-.inf", "1e308", "-1", "0", "1", "2", "1000000000", "999999999999999999999",
        "text", "[1]", "{}", "null", "true", "1.5", '"5"', "2026-11-23", "!!int x", "0o17", "1_000", "~",
        "[1, 2]", "*a", "1e-300",
    )  # fmt: skip
    lines = text.split("\n")
    chosen = [k for k, line in enumerate(lines) if ": " in line and "name" not in line]
    if rng.random() < 0.4:
        chosen = [k for k, line in enumerate(lines) if line.strip().startswith("- [")]
    done = []
    for _ in range(int(rng.integers(1, 3))):
        k, value = chosen[int(rng.integers(len(chosen)))], values[int(rng.integers(len(values)))]
        head, sign, _ = lines[k].partition(": ")
        lines[k] = f"{head}: {value}" if sign else lines[k].replace("0.", str(value), 1)
        done.append(f"{lines[k].strip()[:30]}")
    return " and ".join(done), "\n".join(lines)


READINGS = table_kind(
    "readings of B (CSV)",
    _readings,
    _read_readings,
    fault_of_readings,
    lambda path: ("import", str(path), "-o", str(path.with_name("out.h5")), "--spacing-mm", "2"),
)
LOGS = table_kind("logs of rigs (CSV)", _log, _read_logs, fault_of_log, lambda path: ("identify", str(path)))
VECTOR_FIELDS = Kind("mag_manip (YAML)", vector_fields, seconds=5.0, through_command=0)
