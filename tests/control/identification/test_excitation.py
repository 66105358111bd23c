"""Registers are maximal by algebra over two elements, and the signals have the autocorrelation that follows."""

from math import gcd

import numpy as np
import pytest

from fieldmap.control.identification import pseudo_random_binary
from fieldmap.control.identification.excitation import TAPS
from fieldmap.errors import InputError


def is_prime(n):
    """Miller and Rabin, exact below 3.3e24 with these bases."""
    if n < 2:
        return False
    bases = (2, 3, 5, 7, 11, 13, 17, 19, 23, 29, 31, 37, 41)
    if n in bases:
        return True
    odd, twos = n - 1, 0
    while odd % 2 == 0:
        odd, twos = odd // 2, twos + 1
    for base in bases:
        x = pow(base, odd, n)
        if x not in (1, n - 1) and all((x := x * x % n) != n - 1 for _ in range(twos - 1)):
            return False
    return n % 2 == 1


def prime_factors(n):
    """Pollard's rho."""
    if n == 1:
        return set()
    if is_prime(n):
        return {n}
    for small in (2, 3, 5, 7, 11, 13):
        if n % small == 0:
            return {small} | prime_factors(n // small)
    shift = 1
    while True:
        slow = fast = 2
        while True:
            slow = (slow * slow + shift) % n
            fast = (fast * fast + shift) % n
            fast = (fast * fast + shift) % n
            divisor = gcd(slow - fast, n)
            if divisor > 1:
                break
        if divisor < n:
            return prime_factors(divisor) | prime_factors(n // divisor)
        shift += 1


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
    assert all(power_of_x(full // p, polynomial, order) != 1 for p in prime_factors(full))


@pytest.mark.parametrize("order", range(2, 13))
def test_period_balance_and_autocorrelation(order):
    """Golomb: one more of one level, and -1/N at every shift but 0."""
    signal = pseudo_random_binary(order)
    n = 2**order - 1
    assert signal.size == n
    assert abs(signal.sum()) == 1.0
    spectrum = np.abs(np.fft.fft(signal)) ** 2
    correlation = np.fft.ifft(spectrum).real / n
    np.testing.assert_allclose(correlation[0], 1.0)
    np.testing.assert_allclose(correlation[1:], -1.0 / n, atol=1e-12)
    np.testing.assert_array_equal(pseudo_random_binary(order, samples=2 * n)[n:], signal)


def test_every_state_of_the_register_comes_once():
    signal = pseudo_random_binary(8, samples=255 + 7)
    windows = {tuple(signal[i : i + 8]) for i in range(255)}
    assert len(windows) == 255


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
    ],
)
def test_bad_registers(arguments):
    with pytest.raises(InputError):
        pseudo_random_binary(**arguments)


def test_a_period_that_no_memory_holds():
    with pytest.raises(InputError, match="at most"):
        pseudo_random_binary(40)
