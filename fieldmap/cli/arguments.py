"""Values on the command line: several numbers after one option, currents, points, KEY=VALUE."""

import re
import tomllib
from collections.abc import Container

import numpy as np

from fieldmap.errors import InputError, Problem
from fieldmap.typing import Array

_LISTS = (
    "--at",
    "--at-mm",
    "--currents",
    "--direction",
    "--field",
    "--force",
    "--level",
    "--moment",
    "--start",
    "--torque",
)
_NUMBERS = re.compile(r"[-+]?(\d|\.\d|nan|inf)[\d.,eE+\- ]*,?", re.IGNORECASE)
# "left=1.5,right=-2", one or more of them.
_NAMED = re.compile(r"[^-=,][^=,]*=[-+.\d][^=,]*(,[^=,]+=[-+.\d][^=,]*)*,?")


def join_lists(argv: list[str]) -> list[str]:
    """Join the numbers that follow an option which takes several, so that `--at 0 0 -0.1` is one value.

    >>> join_lists(["probe", "unit", "--at", "0", "0", "-0.1", "--json"])
    ['probe', 'unit', '--at=0,0,-0.1', '--json']
    """
    joined: list[str] = []
    rest = list(argv)
    while rest:
        word = rest.pop(0)
        values = []
        while word in _LISTS and rest and _takes(word, rest[0]):
            values.append(rest.pop(0).strip(", "))
        joined.append(f"{word}={','.join(values)}" if values else word)
    return joined


def _takes(option: str, word: str) -> bool:
    """Whether a word belongs to the numbers of an option."""
    named = option in ("--currents", "--level") and _NAMED.fullmatch(word) is not None
    return named or _NUMBERS.fullmatch(word) is not None


def parse_currents(texts: list[str], coil_names: tuple[str, ...], option: str = "--currents") -> Array:
    """Currents (n_coils,), A, from the values of an option: one per coil, one for every coil, or NAME=A with no
    current in coils that are not named.

    >>> parse_currents(["5=1,-2"], ("5", "6"))
    Traceback (most recent call last):
    fieldmap.errors.InputError: --currents: must be NAME=A throughout, or numbers alone; received 5=1,-2; ...
    >>> parse_currents(["6=-2"], ("5", "6"))
    array([ 0., -2.])
    """
    if any("=" in text for text in texts):
        return _named_currents(texts, coil_names, option)
    values = _floats(texts, option)
    count = len(coil_names)
    if len(values) == 1:
        values = values * count
    if len(values) != count:
        raise InputError.of(
            option,
            f"must be one current per coil ({', '.join(coil_names)}), or one number for all",
            f"{len(values)} numbers: {', '.join(texts)}",
            f"give {count} numbers in A, for example {option} {','.join(['1.0'] * count)}, or those of "
            f"some coils by name: {option} {coil_names[-1]}=1.0",
        )
    return np.array(values)


def _named_currents(texts: list[str], coil_names: tuple[str, ...], option: str) -> Array:
    words = [word.strip() for word in ",".join(texts).split(",") if word.strip()]
    pairs = [(name.strip(), value.strip()) for name, _, value in (word.partition("=") for word in words)]
    given, example = ", ".join(texts), f"for example {option} {coil_names[-1]}=1.0"
    if not all("=" in word for word in words):
        must_hold = "must be NAME=A throughout, or numbers alone"
        raise InputError.of(option, must_hold, given, example)
    names = [name for name, _ in pairs]
    problems = [
        Problem(option, f"must name coils ({', '.join(coil_names)})", repr(name), example)
        for name in dict.fromkeys(names)
        if name not in coil_names
    ]
    problems += [
        Problem(option, "must name each coil once", f"{name} twice", "leave one of them out")
        for name in dict.fromkeys(names)
        if names.count(name) > 1
    ]
    if problems:
        raise InputError(*problems)
    amperes = dict(zip(names, _floats([value for _, value in pairs], option), strict=True))
    return np.array([amperes.get(name, 0.0) for name in coil_names])


def parse_points(metres: list[str] | None, millimetres: list[str] | None) -> Array:
    """Points (n, 3), m, from the values of `--at` and `--at-mm`, in that order."""
    points = [_triple(text, "--at", "m") for text in metres or []]
    points += [[1e-3 * x for x in _triple(text, "--at-mm", "mm")] for text in millimetres or []]
    return np.array(points).reshape(-1, 3)


def parse_moment(text: str) -> Array:
    """A dipole moment (3,), A m^2, from the value of `--moment`; one number is a moment upward.

    >>> parse_moment("0.5"), parse_moment("1,0,0")
    (array([0. , 0. , 0.5]), array([1., 0., 0.]))
    """
    values = _floats([text], "--moment")
    return np.array([0.0, 0.0, *values] if len(values) == 1 else _triple(text, "--moment", "A m2"))


def parse_wanted(text: str, option: str, unit: str) -> Array:
    """A demand (3,) from the value of an option; NaN for a free component.

    >>> parse_wanted("nan 0 0.1", "--force", "N")
    array([nan, 0. , 0.1])
    """
    free = [word.lower() == "nan" for word in re.split(r"[,\s]+", text.strip(", "))]
    given = re.sub(r"(?i)\bnan\b", "0", text)
    return np.where(free, np.nan, _triple(given, option, unit))


def _triple(text: str, option: str, unit: str) -> list[float]:
    values = _floats([text], option)
    if len(values) != 3:
        must_hold, remedy = f"must be three numbers in {unit}", f"{option} X Y Z"
        raise InputError.of(option, must_hold, f"{len(values)}: {text}", remedy)
    return values


def _floats(texts: list[str], option: str) -> list[float]:
    values = []
    for word in re.split(r"[,\s]+", ",".join(texts).strip(", ")):
        try:
            values.append(float(word))
        except ValueError:
            values.append(float("nan"))
        if not np.isfinite(values[-1]):
            remedy = "use a decimal point, and commas or spaces between"
            raise InputError.of(option, "must be finite numbers", repr(word), remedy)
    return values


def parse_settings(texts: list[str] | None, example: str = "parameters.gap=120") -> dict[str, object]:
    """Values by key from the values of `--set`. Raises InputError for a text that is not KEY=VALUE.

    A value is read as TOML does; text needs no quotes. A key may come once.

    >>> parse_settings(["control.z.Kc=0.2", "name=unit"])
    {'control.z.Kc': 0.2, 'name': 'unit'}
    """
    pairs: dict[str, object] = {}
    for text in texts or []:
        key, sign, value = (part.strip() for part in text.partition("="))
        if not (sign and key and value):
            raise InputError.of("--set", "must be KEY=VALUE", text, f"write for example {example}")
        _check_new("--set", key, pairs)
        pairs[key] = _toml_value(value)
    return pairs


def parse_variations(texts: list[str] | None, fixed: Container[str] = ()) -> dict[str, list[object]]:
    """Values by key from the values KEY=A,B,... of `--vary`, otherwise as `parse_settings`. Raises InputError for a key
    that `--set` fixes.

    >>> parse_variations(["control.z.Kc=0.2,0.5", "control.z.Td_s=0.03,0.05"])
    {'control.z.Kc': [0.2, 0.5], 'control.z.Td_s': [0.03, 0.05]}
    """
    found: dict[str, list[object]] = {}
    for text in texts or []:
        key, sign, values = (part.strip() for part in text.partition("="))
        parts = [part.strip() for part in values.split(",") if part.strip()]
        if not (sign and key and parts):
            remedy = "write for example control.z.Kc=0.2,0.334,0.5"
            raise InputError.of("--vary", "must be KEY=A,B,...", text, remedy)
        _check_new("--vary", key, found)
        if key in fixed:
            raise InputError.of(
                "--vary", "must be a key that --set does not fix", key, "leave out one of them"
            )
        found[key] = [_toml_value(part) for part in parts]
    return found


def _check_new(option: str, key: str, before: Container[str]) -> None:
    if key in before:
        raise InputError.of(option, "must name a key once", f"{key} twice", "keep one of them")


def _toml_value(text: str) -> object:
    try:
        value: object = tomllib.loads(f"v = {text}")["v"]
    except ValueError:
        # Not TOML, or an integer with more digits than Python reads.
        return text
    return value


def parse_pairs(
    texts: list[str] | None, option: str, form: str, example: str
) -> tuple[dict[str, str], list[Problem]]:
    """Pairs of words around the last = of each text, and problems for texts without =.

    >>> parse_pairs(["ch 1=mm"], "--unit", "NAME=UNIT", "depth=mm")
    ({'ch 1': 'mm'}, [])
    """
    pairs, problems = {}, []
    for text in texts or []:
        key, sign, value = (part.strip() for part in text.rpartition("="))
        if not (sign and key and value):
            problems.append(Problem(option, f"must be {form}", text, f"write for example {option} {example}"))
        pairs[key] = value
    return pairs, problems


def positive_problems(option: str, value: float | None, remedy: str) -> list[Problem]:
    """Problems of a number that must be positive; none if it was not given."""
    if value is None or 0.0 < value < float("inf"):
        return []
    return [Problem(option, "must be a positive number", f"{value}", remedy)]
