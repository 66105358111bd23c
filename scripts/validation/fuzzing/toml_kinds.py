"""TOML files that people write: devices, recipes, scenarios, studies, optimisations, fits, planar devices, curves of
materials."""

import math
import tomllib
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

import fieldmap as fm
from fieldmap.device.toml_text import toml_text
from fieldmap.dynamics.scenario.references import control_times, disturbances, open_loop_signals, references
from fieldmap.dynamics.scenario.schema import read_scenario
from fieldmap.errors import InputError, Problem
from fieldmap.inputs.expressions import ExpressionError, evaluate
from fieldmap.maps.recipe import choose_grid, read_recipe, read_recipe_device
from fieldmap.planar import read_planar_device
from fieldmap.shipped import shipped_file, shipped_names
from fieldmap.studies.machine_fit import read_fit
from fieldmap.studies.reading import read_design_problem, read_study
from validation.fuzzing.case import Case, Generator, Kind, not_finite
from validation.fuzzing.mutations import bytes_of, characters, other_files, strange_places, structure

FILE_KEYS = ("file", "include", "device", "recipe", "map", "path", "magnet_file")
LINKS = """
format = 1
name = "links"
title = "A machine that names files of every kind"
include = ["part.toml"]

[parameters]
gap = 2.5
radius = "= 8*gap"

[material.steel]
kind = "bh_table"
file = "curve.toml"
below = "straight line to the origin"
above = "slope mu0"

[[body]]
name = "from a surface"
material = "steel"
shape = "step_file"
file = "hole.step"
unit_mm = 1.0
mesh_size_mm = 5.0
position_mm = [0, 0, "= radius + gap"]

[[coil]]
name = "{k}"
repeat = { count = 3, x = [40.0, 50.0, "= 24*gap"], half = ["= radius", 20.0, 20.0] }
kind = "circular"
inner_radius_mm = "= half"
outer_radius_mm = "= half + 2*gap"
height_mm = 20
turns = 100
position_mm = ["= x*cosd(120*k)", "= x*sind(120*k)", 0]
"""
PART = """
[driver]
gain_A_per_V = 0.5
current_limit_A = 2.5
"""
CURVE = """
format = 1
name = "curve"
title = "A curve beside the device"
H_A_per_m = [100.0, 1000.0, 10000.0]
B_T = [0.5, 1.2, 1.6]
"""


def text_kind(
    name: str,
    originals: Callable[[Path], dict[str, str]],
    read: Callable[[Path], Any],
    fault: Callable[[Any, dict[str, Any], Path], str],
    command: Callable[[Path], tuple[str, ...]] = lambda path: (),
    seconds: float = 2.0,
) -> Kind:
    """A kind of TOML file. originals(folder): valid texts by name, with the files that they need written to the folder.
    fault(result, data, path): describes errors in the result, compared with the data of tomllib."""

    def prepare(folder: Path) -> Callable[[Generator, int], Case]:
        texts, strange, path = originals(folder), strange_places(folder), folder / "input.toml"
        names = sorted(texts)
        for text in texts.values():
            path.write_text(text)
            found = fault(read(path), tomllib.loads(text), path)
            if found:
                raise AssertionError(f"{name}: a sound file: {found}")

        def make(rng: Generator, number: int) -> Case:
            text = texts[names[int(rng.integers(len(names)))]]
            change, raw = _mutated(text, rng, number, strange)
            path.write_bytes(raw)
            return Case(change, partial(read, path), lambda found: _judged(found, path, fault), command(path))

        return make

    return Kind(name, prepare, seconds, names_files=True)


def _mutated(text: str, rng: Generator, number: int, strange: tuple[str, ...]) -> tuple[str, bytes]:
    way = number % 4
    if way == 0:
        return bytes_of(text.encode(), rng)
    if way == 1:
        change, text = characters(text, rng)
        return change, text.encode("utf-8", "surrogatepass")
    change, data = (
        structure(tomllib.loads(text), rng)
        if way == 2
        else other_files(tomllib.loads(text), rng, strange, FILE_KEYS)
    )
    return change, (toml_text(data) + "\n").encode("utf-8", "surrogatepass")


def _judged(found: Any, path: Path, fault: Callable[[Any, dict[str, Any], Path], str]) -> str:
    data = tomllib.loads(path.read_bytes().decode("utf-8-sig").replace("\r\n", "\n"))
    return fault(found, data, path)


def near(ours: Any, theirs: Any, unit: float = 1.0) -> bool:
    """Whether numbers agree within rounding; True for expressions, which are not evaluated here."""
    if not isinstance(theirs, int | float) or isinstance(theirs, bool):
        return True
    return math.isclose(float(ours), float(theirs) * unit, rel_tol=1e-12, abs_tol=1e-300)


def fault_of_device(device: Any, data: dict[str, Any], path: Path) -> str:
    """Find NaN and infinity, lost tables, and values that differ from the file."""
    lost = not_finite({k: getattr(device, k) for k in ("coils", "bodies", "payload", "driver", "workspace")})
    if lost:
        return f"a device with NaN or infinity in {lost}"
    if "include" in data:
        return ""
    for tables, parts, keys in (
        (data.get("coil", []), device.coils, {"turns": 1.0, "height_mm": 1e-3, "inner_radius_mm": 1e-3}),
        (data.get("body", []), device.bodies, {"mesh_size_mm": 1e-3}),
    ):
        if any("repeat" in table or "mirror" in table or "copies" in table for table in tables):
            continue
        if len(tables) != len(parts):
            return f"{len(parts)} parts of {len(tables)} tables"
        for table, part in zip(tables, parts, strict=True):
            for key, unit in keys.items():
                attribute = key.removesuffix("_mm")
                if key in table and not near(getattr(part, attribute), table[key], unit):
                    return f"{key} = {table[key]!r} became {getattr(part, attribute)!r}"
    return ""


def _devices(folder: Path) -> dict[str, str]:
    (folder / "part.toml").write_text(PART)
    (folder / "curve.toml").write_text(CURVE)
    (folder / "hole.step").write_text("ISO-10303-21;\nHEADER;\nENDSEC;\nDATA;\nENDSEC;\nEND-ISO-10303-21;\n")
    for name in ("materials", "parts", "measured"):
        (folder / name).mkdir(exist_ok=True)
        for file in shipped_names("geometry", name):
            source = shipped_file("geometry", file)
            (folder / name / source.name).write_text(source.read_text())
    everything = {name: shipped_file("geometry", name).read_text() for name in _three_dimensional()}
    return {**everything, "links": LINKS}


def _three_dimensional() -> list[str]:
    return [name for name in shipped_names("geometry") if "planar" not in name and "/" not in name]


def _read_recipe(path: Path) -> Any:
    recipe = read_recipe(path)
    device = read_recipe_device(recipe)
    return recipe, choose_grid(recipe.box(device), recipe.spacing)


def fault_of_recipe(found: Any, data: dict[str, Any], path: Path) -> str:
    """The grid must fill the box, and numbers must agree with the file."""
    recipe, grid = found
    if lost := not_finite([grid.lower, grid.spacing, recipe.tolerance, recipe.refinement]):
        return f"NaN or infinity in {lost}"
    spacing = data["spacing_mm"]
    asked = spacing if isinstance(spacing, list) else [spacing] * 3
    if any(ours > 1e-3 * wanted * (1 + 1e-8) for ours, wanted in zip(grid.spacing, asked, strict=True)):
        return f"nodes {grid.spacing} m apart, asked {spacing}"
    box = data.get("box")
    upper = grid.lower + grid.spacing * (grid.size**0 * [n - 1 for n in grid.shape])
    if box and not all(
        near(a, b, 1e-3) or abs(a - 1e-3 * b) < 1e-9 for a, b in zip(upper, box["upper_mm"], strict=True)
    ):
        return f"a grid to {upper}, asked {box['upper_mm']}"
    return ""


def _read_scenario(path: Path) -> Any:
    """A scenario and its signals."""
    scenario = read_scenario(path)
    given, control = scenario.settings, scenario.settings.control
    time = control_times(given.duration, control.period)
    wanted = references(
        given.reference, control.compensator, np.array([0.0, 0.0, 1e-2]), time, control.period
    )
    signals = [wanted, open_loop_signals(given.signal, time), disturbances(given.disturbance, time)]
    signals = [one for one in signals if one is not None]
    return scenario.contents, signals


def fault_of_scenario(found: Any, data: dict[str, Any], path: Path) -> str:
    """Signals must be finite, and every number must agree with its key."""
    contents, signals = found
    lost = not_finite(signals)
    return f"signals with NaN or infinity in {lost}" if lost else fault_of_contents(contents, data, path)


def fault_of_contents(found: Any, data: dict[str, Any], path: Path) -> str:
    """Every number must agree with its key in the file, and none may be NaN or infinite."""
    lost = not_finite(found)
    return f"NaN or infinity in {lost}" if lost else _different(found, data, "")


def _different(model: Any, data: Any, where: str) -> str:
    """Place at which a number or text of a schema's instance differs from the data."""
    if isinstance(data, dict):
        for key, value in data.items():
            fields = getattr(type(model), "model_fields", None)
            if isinstance(model, dict):
                member = model.get(key)
            elif fields is not None and key in fields:
                member = getattr(model, key)
            else:
                continue
            if told := _different(member, value, f"{where}.{key}"):
                return told
        return ""
    if isinstance(data, list) and isinstance(model, list | tuple) and len(model) == len(data):
        for k, (one, value) in enumerate(zip(model, data, strict=True)):
            if told := _different(one, value, f"{where}[{k}]"):
                return told
        return ""
    if isinstance(data, int | float) and not isinstance(data, bool) and isinstance(model, int | float):
        return "" if near(model, data) else f"{where} = {data!r} became {model!r}"
    return ""


def fault_of_study(found: Any, data: dict[str, Any], path: Path) -> str:
    """The number of variants must follow from the values of the axes."""
    count = 1
    for axis in data.get("vary", []):
        count *= len(axis.get("values", [1])) if "values" in axis else 1
    if all("values" in axis for axis in data.get("vary", [])) and data.get("combine", "grid") == "grid":
        return "" if len(found.variants) == count else f"{len(found.variants)} variants of {count}"
    return ""


def fault_of_optimisation(found: Any, data: dict[str, Any], path: Path) -> str:
    """Variables and limits must agree with the file and lie within its bounds."""
    if lost := not_finite([found.check_refinement, found.tolerance]):
        return f"NaN or infinity in {lost}"
    keys = data["optimise"]["variable"]
    if len(found.variables) != len(keys) or len(found.limits) != len(data["optimise"].get("constraint", [])):
        return "variables or limits lost"
    for ours, theirs in zip(found.variables, keys, strict=True):
        if not (near(ours.lower, theirs["lower"]) and near(ours.upper, theirs["upper"])):
            return f"bounds {ours.lower}, {ours.upper} of {theirs}"
    return ""


FIT_TABLES = ("flux_density", "inductance", "lift_current")


def fault_of_fit(found: Any, data: dict[str, Any], path: Path) -> str:
    """Unknowns and tables must agree with the file, and each reading must be a number."""
    tables = [table for name in FIT_TABLES for table in data.get(name, [])]
    if len(found.unknowns) != len(data["unknown"]) or len(found.readings) + len(found.predict) != len(tables):
        return "unknowns or tables lost"
    # Quantities that were not measured are NaN.
    read = sum(int(np.isfinite(table.measured).sum()) for table in (*found.readings, *found.predict))
    told = sum(
        np.size(value) for table in tables for key, value in table.items() if key.startswith("measured")
    )
    if read != told:
        return f"{read} readings of {told}"
    for ours, theirs in zip(found.unknowns, data["unknown"], strict=True):
        if not near(ours.start, theirs["start"]):
            return f"a start at {ours.start} of {theirs}"
    return ""


def fault_of_planar(device: Any, data: dict[str, Any], path: Path) -> str:
    """Find NaN and infinity, and lost coils."""
    lost = not_finite([device.coils, device.bodies, device.walls, device.moment])
    if lost:
        return f"NaN or infinity in {lost}"
    return "" if len(device.coils) == len(data["coil"]) else "coils lost"


def fault_of_curve(law: Any, data: dict[str, Any], path: Path) -> str:
    """The law must pass through the points of the file."""
    if lost := not_finite([law.h, law.b]):
        return f"NaN or infinity in {lost}"
    same = len(law.h) == len(data["H_A_per_m"]) and all(
        map(near, [*law.h, *law.b], data["H_A_per_m"] + data["B_T"])
    )
    return "" if same else "other points than those of the file"


def expressions(folder: Path) -> Callable[[Generator, int], Case]:
    """Arithmetic expressions. A value must agree with Python's; texts without a value in Python must be refused."""
    names = {"radius": 10.0, "gap": 2.5, "k": 3.0, "places": [1.0, 2.0], "tag": "left"}
    sound = (
        "= 2*(radius + 1.5)", "= sqrt(radius**2 - gap**2)", "= max(gap, min(3, 4)) - abs(-k)", "= 60*cosd(120*k)",
        "= places", "= tag", "= -(gap + k)/2**-3", "= pi*radius**2/4", "= tand(45)*1e-3 + .5",
    )  # fmt: skip
    pieces = (
        "(", ")", "+", "-", "*", "/", "**", "9", "1e308", "radius", "gap", "sqrt(", "places", "tag", ",",
        " ", ".", "0", "__import__('os').system('true')", "[1]", "lambda:1", "(k:=1)", ".__class__", "if",
        "for", "'a'", "j", "\x00", "\n", "é", "²", "1_0", "0x1", "nan", "inf", "%", "//", "@", "~", "not ",
        "==", "(" * 90, "-" * 190, "**9" * 20, "max(", "{", "f'{k}'", "\\", "#", ";", "=", "await ",
        "*places", "yield",
    )  # fmt: skip

    def make(rng: Generator, number: int) -> Case:
        if number % 3 == 0:
            text = "= " + "".join(
                pieces[int(k)] for k in rng.integers(0, len(pieces), int(rng.integers(1, 12)))
            )
            change = "pieces"
        elif number % 3 == 1:
            text, change = "= " + _sum(rng, 0), "a sound one"
        else:
            change, text = characters(sound[int(rng.integers(len(sound)))], rng)

        def read() -> Any:
            try:
                return evaluate(text, names)
            except ExpressionError as error:
                raise InputError(Problem("text", error.must_hold, error.received, error.remedy)) from None

        return Case(f"{change}: {text!r:.80}", read, partial(_fault_of_value, text=text, names=names))

    return make


def _sum(rng: Generator, depth: int) -> str:
    """A valid expression, a few levels deep."""
    what = int(rng.integers(0, 6)) if depth < 3 else 0
    if what == 0:
        leaf = ("radius", "gap", "k", "pi", "2", "0.25", "1e-3", "7.", ".5", "1e5")
        return leaf[int(rng.integers(len(leaf)))]
    one, other = _sum(rng, depth + 1), _sum(rng, depth + 1)
    if what == 1:
        return f"({one})"
    if what == 2:
        function = str(rng.choice(["sqrt", "abs", "sind", "cosd", "tand", "min", "max"]))
        return f"{function}({one}, {other})" if function in ("min", "max") else f"{function}({one})"
    return f"{one} {rng.choice(['+', '-', '*', '/', '**', '-', '*', '+'])} {'-' * int(what == 5)}{other}"


def _fault_of_value(value: Any, text: str, names: dict[str, Any]) -> str:
    """Compare with Python's own value of the text, with the names of the grammar only."""
    told = text.removeprefix("=").strip()
    functions = {"sqrt": math.sqrt, "abs": abs, "min": min, "max": max, "pi": math.pi}
    functions |= {
        "sind": lambda a: math.sin(math.radians(a)),
        "cosd": lambda a: math.cos(math.radians(a)),
        "tand": lambda a: math.tan(math.radians(a)),
    }
    if any(
        word in told for word in ("__", "lambda", "for", "if", ":", "'", "[", "\\", "await", "yield", "{")
    ):
        return f"a value, {value!r}, of what is no arithmetic"
    exact = eval(told, {"__builtins__": {}}, {**functions, **names})
    if isinstance(exact, list | str):
        return "" if value == exact else f"{value!r} for {exact!r}"
    return (
        ""
        if math.isfinite(value) and math.isclose(value, exact, rel_tol=1e-12)
        else f"{value!r} for {exact!r}"
    )


def _texts(package: str, names: list[str]) -> Callable[[Path], dict[str, str]]:
    return lambda folder: {name: shipped_file(package, name).read_text() for name in names}


def _recipes(folder: Path) -> dict[str, str]:
    return {name: shipped_file("maps", name).read_text() for name in shipped_names("maps") if "/" not in name}


DEVICES = text_kind(
    "device files", _devices, fm.read_device, fault_of_device, lambda path: ("check", str(path), "--toml")
)
RECIPES = text_kind("map recipes", _recipes, _read_recipe, fault_of_recipe)
SCENARIOS = text_kind(
    "scenarios", _texts("maps", shipped_names("maps", "scenarios")), _read_scenario, fault_of_scenario
)
_OPTIMISATIONS = [
    name
    for name in shipped_names("maps", "studies")
    if "optimise" in tomllib.loads(shipped_file("maps", name).read_text())
]
STUDIES = text_kind(
    "studies",
    _texts("maps", [name for name in shipped_names("maps", "studies") if name not in _OPTIMISATIONS]),
    read_study,
    fault_of_study,
)
OPTIMISATIONS = text_kind(
    "optimisations", _texts("maps", _OPTIMISATIONS), read_design_problem, fault_of_optimisation
)
FITS = text_kind("fits", _texts("maps", shipped_names("maps", "fits")), read_fit, fault_of_fit)
PLANAR = text_kind(
    "planar devices",
    _texts("geometry", ["planar_drive_unit", "planar_drive_unit_8mm"]),
    read_planar_device,
    fault_of_planar,
)
CURVES = text_kind(
    "B-H curves",
    lambda folder: {
        **_texts("geometry", ["materials/steel_a3", "materials/steel_foot"])(folder),
        "own": CURVE,
    },
    lambda path: fm.material(path),
    fault_of_curve,
)
EXPRESSIONS = Kind("expressions", expressions, 0.5, 50.0, 0)
