"""No value of any type, wherever it stands, makes the reader fail in another way than with its own error."""

import tomllib
from functools import cache

import pytest

from fieldmap.device import read_device
from fieldmap.errors import DeviceFileError

VALUES = ["-1.5", '"text"', "true", "nan", "[[1, 2], [3]]", "{a = 1}", '[{name = "x"}, 1]', "1979-05-27"]


@cache
def lines_with_values(text: str) -> list[int]:
    """Lines whose value may be any other of one line: not those that begin one of several."""
    lines = text.split("\n")
    return [k for k, line in enumerate(lines) if "=" in line and is_toml(with_value(lines, k, "0"))]


def is_toml(text: str) -> bool:
    try:
        tomllib.loads(text)
    except tomllib.TOMLDecodeError:
        return False
    return True


def with_value(lines: list[str], k: int, value: str) -> str:
    key = lines[k].partition("=")[0]
    return "\n".join([*lines[:k], f"{key}= {value}", *lines[k + 1 :]])


@pytest.mark.parametrize("value", VALUES)
def test_a_wrong_value_is_told_or_read(value, valid_text, tmp_path):
    lines, path = valid_text.split("\n"), tmp_path / "device.toml"
    problems = []
    for k in lines_with_values(valid_text):
        path.write_text(with_value(lines, k, value))
        try:
            read_device(path)
        except DeviceFileError as error:
            problems += error.problems
    assert len(problems) > 20
    assert all(problem.where.startswith(str(path)) for problem in problems)


@pytest.mark.parametrize("value", VALUES)
def test_a_wrong_table_is_told(value, valid_text, tmp_path):
    path = tmp_path / "device.toml"
    for key in ["body", "material", "coil", "payload", "driver", "workspace", "reference", "provenance"]:
        path.write_text(f'format = 1\nname = "x"\ntitle = "x"\n{key} = {value}\n')
        with pytest.raises(DeviceFileError):
            read_device(path)


def test_a_line_left_out_is_told_or_read(valid_text, tmp_path):
    lines, path = valid_text.split("\n"), tmp_path / "device.toml"
    told = 0
    for k in range(len(lines)):
        path.write_text("\n".join(lines[:k] + lines[k + 1 :]))
        try:
            read_device(path)
        except DeviceFileError:
            told += 1
    assert told > 60
