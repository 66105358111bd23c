"""Mutated device files and their Python twins: each mistake gives a message, soon, and never another error."""

import copy
import os
import random
import time
import tomllib

import pytest

from fieldmap.device import read_device
from fieldmap.device.cross_checks import all_paths
from fieldmap.device.schema import DEVICE
from fieldmap.device.toml_text import toml_text
from fieldmap.errors import DeviceFileError, InputError
from fieldmap.shipped import shipped_file
from tests.device.made_in_code import made_in_code
from tests.device.test_short_forms import SHORT

SEEDS = {"few": range(2, 120, 3), "many": range(int(os.environ.get("FIELDMAP_MUTATIONS", "120")))}
"""Every third, from one on that finds whole numbers which are too large for a float (65), and all, for `make slow`."""
seeded = pytest.mark.parametrize("seeds", SEEDS.values(), ids=SEEDS)
LONGEST_S = 5.0
pytestmark = pytest.mark.filterwarnings("ignore::fieldmap.errors.UnusualValueWarning")
VALUES = ["-1.5", '"text"', "true", "nan", "[[1, 2], [3]]", "{a = 1}", '[{name = "x"}, 1]', "1979-05-27"]
NUMBERS = [float("nan"), float("inf"), 1e308, -1e308, 5e-324, 0, -1, -0.0, 10**400, 2**70]
OTHERS = [
    "text",
    "",
    "= 1/0",
    "= 9**9**9",
    "{k}",
    True,
    [],
    {},
    [[1, 2], [3]],
    [{"name": "x"}, 1],
    {"a": {"b": 1}},
]


def places(data, location=()):
    """Every place of the data: (table or array, key)."""
    entries = data.items() if isinstance(data, dict) else enumerate(data) if isinstance(data, list) else ()
    for key, value in entries:
        yield data, key
        yield from places(value)


def mutated(data, rng):
    """The data with one to three mistakes."""
    data = copy.deepcopy(data)
    for _ in range(rng.choice([1, 1, 2, 3])):
        table, key = rng.choice(list(places(data)))
        value = table[key]
        what = rng.choice(["drop", "double", "retype", "number", "negative", "key"])
        if what == "drop":
            del table[key]
        elif what == "double" and isinstance(value, list):
            value += copy.deepcopy(value)
        elif what == "double" and isinstance(table, list):
            table.append(copy.deepcopy(value))
        elif what == "number":
            table[key] = rng.choice(NUMBERS)
        elif what == "negative" and isinstance(value, int | float):
            table[key] = -value
        elif what == "key" and isinstance(table, dict):
            table[rng.choice(["colour", "radius_m", "name ", "x" * 5000, "ключ"])] = table.pop(key)
        else:
            table[key] = copy.deepcopy(rng.choice(OTHERS))
    return data


def told(make, seed):
    """Whether the device was refused; any other error fails the test."""
    begin, problems = time.perf_counter(), None
    try:
        make()
    except InputError as error:
        problems = error.problems
    assert time.perf_counter() - begin < LONGEST_S, seed
    if problems is None:
        return False
    assert problems, seed
    for problem in problems:
        assert all((problem.where, problem.must_hold, problem.received, problem.remedy)), (seed, problem)
        assert len(str(problem)) < 20_000, seed
    return True


# The share of mutants that are refused. In files that include others, a dropped key may still come from there.
LEAST = {"everything": 0.7, "short": 0.7, "eight_coils": 0.6, "drive_unit": 0.6, "drive_unit_a3": 0.5}


@seeded
@pytest.mark.parametrize("source", LEAST)
def test_files(source, seeds, valid_text):
    text = {"everything": valid_text, "short": SHORT}.get(source)
    data = tomllib.loads(shipped_file("geometry", source).read_text() if text is None else text)
    refused = 0
    for seed in seeds:
        wrong = mutated(data, random.Random(seed))
        refused += told(lambda wrong=wrong: read_device(toml_text(wrong) + "\n"), seed)
    assert refused > LEAST[source] * len(seeds)


@pytest.mark.parametrize("value", VALUES)
def test_any_value_anywhere(value, valid_text, tmp_path):
    """The value replaces each value of one line, and each table."""
    path, lines, problems = tmp_path / "device.toml", valid_text.split("\n"), []

    def told_of(text):
        path.write_text(text)
        try:
            read_device(path)
        except DeviceFileError as error:
            problems.extend(error.problems)
            return True
        return False

    for k, line in enumerate(lines):
        key, is_value, _ = line.partition("=")
        text = "\n".join([*lines[:k], f"{key}= {value}", *lines[k + 1 :]])
        # Lines that begin a value of several lines are left as they are.
        if is_value and is_toml(text):
            told_of(text)
    assert len(problems) > 20
    for key in ["body", "material", "coil", "payload", "driver", "workspace", "reference", "provenance"]:
        assert told_of(f'format = 1\nname = "x"\ntitle = "x"\n{key} = {value}\n')
    assert all(problem.where.startswith(str(path)) for problem in problems)


def is_toml(text):
    try:
        return bool(tomllib.loads(text))
    except tomllib.TOMLDecodeError:
        return False


@seeded
def test_changes(seeds):
    """Any value at any key of a shipped device, as given by `--set`."""
    paths = all_paths(DEVICE.load(shipped_file("geometry", "drive_unit")).data)
    refused = 0
    for seed in seeds:
        rng = random.Random(seed)
        changes = {rng.choice(paths): rng.choice([*NUMBERS, *OTHERS]) for _ in range(rng.choice([1, 1, 2]))}
        refused += told(lambda changes=changes: read_device("drive_unit", changes), seed)
    assert refused > 0.8 * len(seeds)


@seeded
def test_python_twins(seeds, valid_text):
    data = tomllib.loads(valid_text)
    refused = 0
    for seed in seeds:
        wrong = mutated(data, random.Random(seed))
        refused += told(lambda wrong=wrong: made_in_code(wrong), seed)
    assert refused > 0.6 * len(seeds)
