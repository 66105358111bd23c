"""Vectors copied number by number, and that kernels copy theirs so."""

import ast
from pathlib import Path

import numpy as np

import fieldmap
from fieldmap.kernels.copy_vector import copy_vector

KERNELS = Path(fieldmap.__file__).parent / "kernels"


def test_the_first_numbers_are_copied_and_no_others():
    to = np.full(5, -1.0)
    copy_vector(np.arange(9.0)[1::2], to[:3])
    np.testing.assert_array_equal(to, [1.0, 3.0, 5.0, -1.0, -1.0])


def slices_of_arrays(source):
    """Lines in which a slice is assigned what is not written as a number or a named constant."""
    pairs = []
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.AugAssign):
            pairs.append((node.target, node.value))
        if isinstance(node, ast.Assign):
            for target in node.targets:
                several = isinstance(target, ast.Tuple) and isinstance(node.value, ast.Tuple)
                pairs += zip(target.elts, node.value.elts, strict=True) if several else [(target, node.value)]
    return [
        target.lineno
        for target, value in pairs
        if isinstance(target, ast.Subscript)
        and any(isinstance(part, ast.Slice) for part in ast.walk(target.slice))
        and not number(value)
    ]


def number(value):
    if isinstance(value, ast.UnaryOp):
        return number(value.operand)
    name = value.attr if isinstance(value, ast.Attribute) else getattr(value, "id", "")
    return isinstance(value, ast.Constant) or name in ("inf", "nan") or name.isupper()


def test_kernels_assign_no_arrays_to_slices():
    """For each numba compiles the text of an error of shapes: fieldmap/kernels/copy_vector.py."""
    found = {path.name: slices_of_arrays(path.read_text(encoding="utf-8")) for path in KERNELS.rglob("*.py")}
    assert len(found) > 50
    assert {name: lines for name, lines in found.items() if lines} == {}


def test_slices_of_arrays_are_found():
    source = (
        "a[:] = b\nc[:2], d[1:] = e, 0.0\nf[0] = g\nh[:] = -np.inf\nk[1, :n] = m[2]\np[:] = -q\nr[:] += s\n"
    )
    assert slices_of_arrays(source) == [1, 2, 5, 6, 7]
