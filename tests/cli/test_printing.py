"""Properties of all printed pages: zeros without sign, directions, and tables that do not break numbers."""

import re
from types import SimpleNamespace

import numpy as np
import pytest

from fieldmap.cli.answers import force_table
from fieldmap.cli.maps import _unit_table
from fieldmap.cli.page import WIDTH, axis_text, facts, print_page, table, unsigned_zeros
from fieldmap.io.map_summary import MiddleField

NUMBER = re.compile(r"-?\d+\.\d+")


@pytest.mark.parametrize("line", ["Fx -0.01, -0.5, 1e-3, 5-0.0, a-0", "2026-01-02", "[-1, -2e-19]", "-0x"])
def test_what_is_not_minus_zero_stays(line):
    assert unsigned_zeros(line) == line


@pytest.mark.parametrize(
    ("line", "plain"),
    [("(-0, -0.00, -0.)", "(0, 0.00, 0.)"), ("a   -0.00   -0.10", "a    0.00   -0.10"), ("-0.0 %", "0.0 %")],
)
def test_zeros_have_no_sign(line, plain):
    assert unsigned_zeros(line) == plain


def test_no_page_prints_minus_zero(capsys):
    rows = [("force", f"{-1e-9:.2f}", f"{-0.5:.2f}"), ("moment", f"{3.0:.2f}", f"{-0.0:g}")]
    print_page(table(("what", "x", "y"), rows), facts([("at", f"({-1e-5:.1f}, 2) mm")]))
    out = capsys.readouterr().out
    assert [float(number) for number in NUMBER.findall(out)] == [0.0, -0.5, 3.0, 0.0]
    assert "-0.00" not in out
    assert len({len(line) for line in out.splitlines() if line.startswith((" force", " moment"))}) == 1


def test_what_rounding_leaves_is_printed_as_zero(capsys):
    """On the axis of a coil the moment is parallel to the field: no torque and no sideways force."""
    point = SimpleNamespace(
        at=np.zeros(3),
        moment=np.array([5e-17, 0.0, 0.8]),
        B=np.array([1e-19, 0.0, 0.004]),
        gradient=np.diag([-0.02, -0.02, 0.04]),
        force=np.array([-3e-19, 2e-19, 0.032]),
        torque=np.array([4e-19, -1e-19, 0.0]),
    )
    print_page(force_table(SimpleNamespace(points=(point,), held="moment up, fixed")))
    *_, row = capsys.readouterr().out.splitlines()
    assert [float(number) for number in row.split(") mm")[1].split()] == [0.0, 0.0, 32.0, 0.0, 0.0, 0.0]


def test_axes_have_a_letter_or_components():
    for letter, axis in zip("xyz", np.eye(3), strict=True):
        assert axis_text(axis) == letter
        assert axis_text(1e-12 - axis) == f"-{letter}"
    assert axis_text(np.array([0.6, -0.0, 0.8])) == "(0.6, 0, 0.8)"


def test_the_field_of_eight_coils_fits(capsys):
    names = tuple(f"north {k}" for k in range(8))
    flux, slope = np.linspace(-0.0987654, 0.1, 9), np.linspace(-12.345678, 10.0, 9)
    middle = MiddleField(np.array([-0.0125, 0.0125, -0.1085]), tuple(flux), tuple(slope))
    print_page(_unit_table(SimpleNamespace(middle=middle, info=SimpleNamespace(coil_names=names))))
    out = capsys.readouterr().out
    assert max(map(len, out.splitlines())) <= WIDTH
    assert "…" not in out
    found = [float(number) for line in out.splitlines()[2:] for number in NUMBER.findall(line)]
    np.testing.assert_allclose(found, 1e3 * np.column_stack([flux, slope]).ravel(), atol=1e-4)
    assert all(f"coil {name}" in out for name in names)
