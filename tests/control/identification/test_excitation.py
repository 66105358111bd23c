"""Feedback registers have the maximal period by algebra over GF(2), and the signals its known autocorrelation."""

import numpy as np
import pytest

from fieldmap.control.identification import pseudo_random_binary
from fieldmap.control.identification.excitation import TAPS
from fieldmap.errors import InputError


def prime_factors(order):
    """Prime factors of 2^order - 1. Each divides 2^d - 1 for a least divisor d of the order, is 1 modulo d, and odd."""
    found = set()
    for d in (d for d in range(2, order + 1) if order % d == 0):
        rest = 2**d - 1
        for prime in found:
            while rest % prime == 0:
                rest //= prime
        step = d if d % 2 == 0 else 2 * d
        candidates = np.arange(step + 1, int(rest**0.5) + 2, step)
        for prime in candidates[rest % candidates == 0].tolist():
            found.add(prime)
            while rest % prime == 0:
                rest //= prime
        found |= {rest} - {1}
    return found


def power_of_x(exponent, polynomial, order):
    """x^exponent modulo a polynomial over two elements, coefficients as bits."""

    def reduced(a):
        while a.bit_length() > order:
            a ^= polynomial << (a.bit_length() - order - 1)
        return a

    def product(a, b):
        total = 0
        while b:
            if b & 1:
                total ^= a
            a, b = reduced(a << 1), b >> 1
        return reduced(total)

    result, base = 1, reduced(2)
    while exponent:
        if exponent & 1:
            result = product(result, base)
        base, exponent = product(base, base), exponent >> 1
    return result


@pytest.mark.parametrize("order", range(2, 65))
def test_feedback_polynomials_are_primitive(order):
    """x has the full order 2^n - 1, which also makes the polynomial irreducible."""
    polynomial = (1 << order) | 1 | sum(1 << tap for tap in TAPS[order])
    full = 2**order - 1
    assert power_of_x(full, polynomial, order) == 1
    assert all(power_of_x(full // p, polynomial, order) != 1 for p in prime_factors(order))


@pytest.mark.parametrize("order", range(2, 13))
def test_period_balance_and_autocorrelation(order):
    """Golomb: one level occurs once more than the other, and the autocorrelation is -1/N at every shift but 0."""
    signal = pseudo_random_binary(order)
    n = 2**order - 1
    assert signal.size == n
    assert abs(signal.sum()) == 1.0
    spectrum = np.abs(np.fft.fft(signal)) ** 2
    correlation = np.fft.ifft(spectrum).real / n
    np.testing.assert_allclose(correlation[0], 1.0)
    np.testing.assert_allclose(correlation[1:], -1.0 / n, atol=1e-12)
    np.testing.assert_array_equal(pseudo_random_binary(order, samples=2 * n)[n:], signal)


def test_large_orders_do_not_repeat_early():
    signal = pseudo_random_binary(64, samples=4096, start=0x9E3779B97F4A7C15)
    windows = {signal[i : i + 64].tobytes() for i in range(4096 - 64)}
    assert len(windows) == 4096 - 64


def test_hold_and_start():
    slow = pseudo_random_binary(5, hold=3, amplitude=0.5)
    np.testing.assert_array_equal(slow[::3], 0.5 * pseudo_random_binary(5))
    np.testing.assert_array_equal(slow[1::3], slow[::3])
    shifted = pseudo_random_binary(5, start=7)
    base = np.tile(pseudo_random_binary(5), 2)
    assert any(np.array_equal(shifted, base[k : k + 31]) for k in range(31))


def test_own_taps():
    other = pseudo_random_binary(5, taps=[2])  # x^5 + x^2 + 1 is primitive as well
    assert abs(other.sum()) == 1.0
    assert not np.array_equal(other, pseudo_random_binary(5))


@pytest.mark.parametrize(
    "arguments",
    [
        {"order": 1},
        {"order": 65},
        {"order": 5, "taps": [5]},
        {"order": 4, "start": 16},
        {"order": 4, "hold": 0},
        {"order": 40},
    ],
)
def test_bad_registers(arguments):
    with pytest.raises(InputError):
        pseudo_random_binary(**arguments)
