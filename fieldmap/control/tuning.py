"""PID controllers for a linear plant, tuned to required margins: docs/theory/control.md, Tuning."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray

from fieldmap import arguments
from fieldmap.control.blocks import ALONE
from fieldmap.control.loop import strictly_proper
from fieldmap.control.margins import Margins, margins_of_curves
from fieldmap.control.pid import INTEGRATION, PID, USUAL_INTEGRATION, pid_block
from fieldmap.core.sampled_loop import Plant
from fieldmap.errors import Infeasible, Problem
from fieldmap.records import Record
from fieldmap.typing import Array

# Number of frequencies of a curve. The search for the region of the optimum uses every `_EVERY`-th of them.
_FREQUENCIES, _EVERY, _SEED = 1500, 5, 1
# Range of the integral time, times the crossover in rad/s.
_TIMES = (0.1, 1e4)
# Merit of a loop: the logarithm of |Kc| / Ti if it has the margins, otherwise `_WITHOUT_MARGINS` plus the share of the
# margins; for an unstable loop `_UNSTABLE` times the magnitude of its largest pole.
_WITHOUT_MARGINS, _UNSTABLE = -1e3, -1e6
# Shares of margins: spare above the required ones, for rounding; cap, so that the constraints stay finite.
_SPARE, _AMPLE = 1e-9, 10.0


@dataclass(frozen=True, eq=False, repr=False)
class TunedPID(Record):
    """pid: the controller; margins: of its loop; largest_pole: largest magnitude of a closed-loop pole, below 1; share:
    smallest ratio of a margin to the required one (gains by their logarithms), 1 or more if all are met."""

    pid: PID
    margins: Margins
    largest_pole: float
    share: float


def tune_pid(
    plant: tuple,
    Ts: float,
    *,
    gain_margin: float = 2.0,
    phase_margin: float = 45.0,
    modulus: float = 0.4,
    crossover: float | None = None,
    N: float = 10.0,
    integration: str = USUAL_INTEGRATION,
) -> TunedPID:
    """The PID controller with these margins that rejects a constant disturbance fastest (largest |Kc| / Ti).

    Ti is at least 4 Td, so that the controller's zeros are real. It differentiates the measurement (c = 0). Limits,
    anti-windup and weights of the set point do not change the margins: set them by
    `dataclasses.replace(tuned.pid, upper=10.0)`.

    Parameters
    ----------
    plant
        (numerator, denominator) in q or (A, B, C, D), sampled at Ts; one input, one output, strictly proper, with
        every delay of the loop; of any sign, stable or not.
    Ts
        Sampling time, s.
    gain_margin
        Factor by which the gain may grow or shrink, above 1. Only an unstable plant has a lower limit of the gain.
    phase_margin
        Degrees.
    modulus
        Smallest distance of the loop's curve from -1, the inverse of the largest sensitivity. Unlike the two other
        margins, it also bounds curves that pass -1 at an angle.
    crossover
        Frequency at which the gain of the loop is 1, Hz; free unless given. A lower one passes less noise.
    N
        Td / Tf of the filter of the derivative; infinite for none.
    integration
        Rule of the integral, as in `PID`.

    Returns
    -------
    TunedPID
        The controller, its margins and its largest pole.

    Raises
    ------
    Infeasible
        If no controller with the margins was found. The message states the best margins found, and `reachable` of
        the error is their controller (None if none is stable). An unstable plant, a delay or slow sampling limit
        the margins.
    InputError
        For a plant or numbers that do not fit.

    Examples
    --------
    >>> plant = ([-0.03, 0.0298], [1, -1.915, 0.91405])
    >>> tuned = tune_pid(plant, 2e-3, gain_margin=1.5, phase_margin=40, crossover=8.0)
    >>> tuned.pid.acts_on_minus_error, bool(tuned.margins.phase >= 40)
    (True, True)
    """
    where = "tune_pid"
    arguments.check_positive(where, Ts=Ts)
    half = 0.5 / Ts
    given = {
        "gain_margin": (gain_margin, 1.0, np.inf),
        "phase_margin": (phase_margin, 0.0, 180.0),
        "modulus": (modulus, 0.0, 1.0),
        "crossover": (0.5 * half if crossover is None else crossover, 0.0, half),
        # 1 / N is 0 for no filter.
        "N": (1.0 / N if N > 0.0 else np.inf, -1.0, np.inf),
    }
    for name, (value, low, high) in given.items():
        must = "must be above 0" if name == "N" else f"must lie between {low:g} and {high:g}"
        arguments.check(low < value < high, f"{where}({name})", must, value, "choose another one")
    arguments.check_choice(f"{where}(integration)", integration, INTEGRATION)
    asked = (gain_margin, phase_margin, modulus, crossover)
    search = _Search(strictly_proper(plant, where), Ts, *asked, N, integration)
    best = search.best()
    if best is None or best.share < 1.0:
        raise search.refusal(best)
    return best


@dataclass(frozen=True, eq=False)
class _Search:
    """Loops of one plant under k PID controllers, given as columns of (4, k): a number with the sign of Kc; logarithms
    of the crossover, Hz, and of the integral time times the crossover in rad/s; and 4 Td / Ti."""

    plant: Plant
    Ts: float
    gain_margin: float
    phase_margin: float
    modulus: float
    crossover: float | None
    N: float
    integration: str

    @cached_property
    def frequencies(self) -> Array:
        """Frequencies (n,), Hz, up to half the sampling rate."""
        return np.geomspace(1e-5, 0.5, _FREQUENCIES) / self.Ts

    @cached_property
    def answers(self) -> NDArray[Any]:
        """Frequency response (n,) of the plant at `frequencies`."""
        return self.answer(self.frequencies)

    def answer(self, frequencies: Array) -> NDArray[Any]:
        """Frequency response of the plant."""
        q = np.exp(2j * np.pi * frequencies * self.Ts)[:, None, None]
        A, B, C = self.plant
        return np.asarray(np.linalg.solve(q * np.eye(len(A)) - A, B[None, :, None])[:, :, 0] @ C)

    def law(self, frequencies: Array, Ti: Array, Td: Array) -> NDArray[Any]:
        """Frequency response of controllers with Kc = 1 and times (k, 1), s, at frequencies (n,) or (k, 1)."""
        q = np.exp(2j * np.pi * frequencies * self.Ts)
        now, before = INTEGRATION[self.integration]
        Tf = Td / self.N
        integral = self.Ts / Ti * (now * q + before) / (q - 1.0)
        derivative = Td / (Tf + self.Ts) * (q - 1.0) / (q - Tf / (Tf + self.Ts))
        return 1.0 + integral + derivative

    def gains(self, tried: Array) -> tuple[Array, Array, Array]:
        """Kc with its sign, Ti and Td, (k, 1) each."""
        sign, at, time, share = tried[:, :, None]
        at = np.exp(at)
        Ti = np.exp(time) / (2.0 * np.pi * at)
        Td = 0.25 * share * Ti
        there = np.abs(self.law(at, Ti, Td) * self.answer(at[:, 0])[:, None])
        return np.where(sign < 0.0, -1.0, 1.0) / there, Ti, Td

    def margins(self, Kc: Array, Ti: Array, Td: Array, every: int = 1) -> Array:
        """Margins (5, k) of the loops with gains and times (k, 1), at every `every`-th frequency, the last included."""
        some = slice(None, None, -every)
        frequencies, answers = self.frequencies[some][::-1], self.answers[some][::-1]
        return margins_of_curves(frequencies, Kc * self.law(frequencies, Ti, Td) * answers)

    def shares(self, margins: Array) -> Array:
        """Ratios (4, k) of margins (5, k) to the required ones; gains by their logarithms."""
        with np.errstate(divide="ignore"):
            gains = np.log([margins[0], 1.0 / margins[1]]) / np.log(self.gain_margin)
        # A loop without crossover has no phase margin, and needs none.
        phase = np.nan_to_num(margins[2] / self.phase_margin, nan=np.inf)
        return np.array([*gains, phase, margins[4] / self.modulus])

    def tuned(self, tried: Array, every: int = 1) -> list[TunedPID]:
        """The controllers with their margins at every `every`-th frequency and their largest poles."""
        Kc, Ti, Td = self.gains(tried)
        margins = self.margins(Kc, Ti, Td, every)
        shares = self.shares(margins).min(axis=0)
        pids = []
        for numbers in zip(Kc[:, 0], Ti[:, 0], Td[:, 0], strict=True):
            gain, integral, derivative = (float(number) for number in numbers)
            rules: Any = {"integration": self.integration, "acts_on_minus_error": gain < 0.0}
            pids.append(PID(abs(gain), integral, derivative, self.Ts, Tf=derivative / self.N, c=0.0, **rules))
        return [
            TunedPID(pid, Margins("", *of.tolist()), float(pole), float(share))
            for pid, of, pole, share in zip(pids, margins.T, self.largest_poles(pids), shares, strict=True)
        ]

    def largest_poles(self, pids: list[PID]) -> Array:
        """Largest magnitude (k,) of a closed-loop pole in q, for each controller."""
        A, B, C = self.plant
        n, through = len(A), np.outer(B, C)
        loops = np.empty((len(pids), n + 3, n + 3))
        for loop, pid in zip(loops, pids, strict=True):
            k = pid_block(pid, ALONE)
            loop[:n, :n], loop[:n, n:] = A + k.D[0, 3] * through, np.outer(B, k.C[0])
            loop[n:, :n], loop[n:, n:] = np.outer(k.B[:, 3], C), k.A
        return np.asarray(np.abs(np.linalg.eigvals(loops)).max(axis=1))

    def best(self) -> TunedPID | None:
        """The loop with the largest merit; None if no stable one was found.

        Differential evolution finds the region, but ends about 1e-3 from the optimum, at a point that depends on
        rounding. Sequential quadratic programming continues from there.
        """
        half = 0.5 / self.Ts
        at = (2e-4 * half, half) if self.crossover is None else (self.crossover, self.crossover)
        bounds = [(-1.0, 1.0), tuple(np.log(at)), tuple(np.log(_TIMES)), (0.0, 1.0)]

        def lacking(tried: Array) -> Array:
            return np.array([-_merit(one) for one in self.tuned(tried, _EVERY)])

        found = scipy.optimize.differential_evolution(
            lacking,
            bounds,
            rng=_SEED,
            vectorized=True,
            updating="deferred",
            polish=False,
            tol=1e-9,
            maxiter=80,
        )
        best = max(self.tuned(np.column_stack([self.refined(found.x, bounds), found.x])), key=_merit)
        return best if _merit(best) > 0.5 * _UNSTABLE else None

    def refined(self, start: Array, bounds: list[tuple[float, ...]]) -> Array:
        """The local optimum (4,) near a start (4,): largest |Kc| / Ti with the margins."""

        def with_sign(x: Array) -> Array:
            return np.concatenate([start[:1], x])[:, None]

        def slowness(x: Array) -> float:
            Kc, Ti, _ = self.gains(with_sign(x))
            return float(np.log(Ti / np.abs(Kc)).item())

        def spare(x: Array) -> Array:
            shares = self.shares(self.margins(*self.gains(with_sign(x)))).ravel()
            # Margins may be infinite.
            return np.minimum(shares, _AMPLE) - 1.0 - _SPARE

        rule = {"type": "ineq", "fun": spare}
        near: Any = {"bounds": bounds[1:], "constraints": rule, "options": {"ftol": 1e-12}}
        found = scipy.optimize.minimize(slowness, start[1:], method="SLSQP", **near)
        return with_sign(found.x)[:, 0]

    def refusal(self, best: TunedPID | None) -> Infeasible:
        """The error with the best margins that were found, and an unstable pole of the plant."""
        must = f"must have margins of {self.phase_margin:g} degrees, of a factor {self.gain_margin:g} and of a modulus "
        must += f"of {self.modulus:g}" + (
            "" if self.crossover is None else f" at a crossover of {self.crossover:g} Hz"
        )
        received, remedy = "no stable loop under a PID controller", "sample faster, or shorten the delay"
        if best is not None:
            m = best.margins
            received = f"{m.phase:.3g} degrees at the nearest, factors {m.gain_down:.3g} to {m.gain_up:.3g}, modulus "
            received += f"{m.modulus:.3g}, crossover {m.crossover:.3g} Hz"
            remedy = f"ask for less, {remedy}"
        fastest = float(np.log(np.abs(scipy.linalg.eigvals(self.plant.A)).max())) / self.Ts
        if fastest * self.Ts > 1e-9:
            received += f"; the plant is unstable, with a pole of {fastest:.3g} 1/s"
        return Infeasible(Problem("tune_pid(plant)", must, received, remedy), reachable=best)


def _merit(tuned: TunedPID) -> float:
    if tuned.largest_pole >= 1.0:
        return _UNSTABLE * tuned.largest_pole
    if tuned.share < 1.0:
        return _WITHOUT_MARGINS + tuned.share
    return float(np.log(tuned.pid.Kc / tuned.pid.Ti))
