"""A model with its uncertainty from a log of a rig, for `fieldmap identify`."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fieldmap.arguments import check, check_choice
from fieldmap.control.identification.estimators import (
    armax,
    identify_direct,
    identify_two_stage,
    least_squares,
)
from fieldmap.control.identification.log import Log, check_rest
from fieldmap.control.identification.regression import Estimate, Orders
from fieldmap.inputs.columns import Column
from fieldmap.plain import Plain, plain_items
from fieldmap.records import Record
from fieldmap.typing import Array

ROLES: dict[str, tuple[str, ...]] = {
    "input": ("input", "control", "u", "control signal", "voltage", "current", "command", "drive"),
    "output": ("output", "position", "y", "measured", "gap", "height", "depth", "distance"),
    "reference": ("reference", "r", "ref", "setpoint", "target", "wanted"),
}
"""Names by which columns are recognised."""
_ESTIMATORS: dict[str, Callable[..., Estimate]] = {
    "direct": identify_direct,
    "armax": armax,
    "least-squares": least_squares,
}
METHODS = (*_ESTIMATORS, "two-stage")


@dataclass(frozen=True, eq=False, repr=False)
class IdentifiedLog(Record):
    """A model from the input to the output of a log, as deviations from rest, in the units of the log.

    estimate: with its covariance; columns: role -> column; samples: their number; rest: number of samples at the
    beginning, whose mean is the operating point; operating_point: role -> that mean.
    """

    estimate: Estimate
    columns: Mapping[str, Column]
    samples: int
    rest: int
    operating_point: Mapping[str, float]

    @property
    def continuous_poles(self) -> tuple[NDArray[np.complex128], Array]:
        """Poles in s, 1/s, for the poles in q, and their standard errors; poles at q = 0 (dead time) are left out."""
        poles, errors = self.estimate.poles, self.estimate.pole_errors
        moving = np.abs(poles) > 1e-12
        q = poles[moving].astype(complex)
        in_s = np.asarray(np.log(q) / self.estimate.Ts, np.complex128)
        return in_s, errors[moving] / (np.abs(q) * self.estimate.Ts)

    @property
    def coefficients(self) -> list[tuple[str, float, float]]:
        """Name, value and standard error of a_1 ... and b_0 ... of docs/theory/identification.md (1)."""
        model, p = self.estimate.model, len(self.estimate.covariance) - self.estimate.model.numerator.size
        values = [*model.denominator[1 : p + 1], *model.numerator]
        names = [f"a_{k + 1}" for k in range(p)] + [f"b_{k}" for k in range(model.numerator.size)]
        return [
            (name, float(value), float(error))
            for name, value, error in zip(names, values, self.estimate.standard_errors, strict=True)
        ]

    def to_dict(self) -> dict[str, Plain]:
        """As plain Python: complex numbers as [real, imaginary]."""
        found, (poles_per_s, errors_per_s) = self.estimate, self.continuous_poles
        roots = {"poles": found.poles, "zeros": found.zeros, "poles_per_s": poles_per_s}
        pairs = {name: np.stack([np.real(each), np.imag(each)], axis=-1) for name, each in roots.items()}
        of_log = ("samples", "rest", "operating_point")
        of_estimate = ("method", "Ts", "covariance", "pole_errors", "zero_errors", "gain", "steady_gain")
        return plain_items(
            columns={role: {"name": c.name, "unit": c.unit} for role, c in self.columns.items()},
            **{name: getattr(self, name) for name in of_log},
            **{name: getattr(found, name) for name in (*of_estimate, "residual_rms", "assumptions")},
            **found.model._asdict(),
            coefficients=[{"name": n, "value": v, "standard_error": e} for n, v, e in self.coefficients],
            **pairs,
            pole_errors_per_s=errors_per_s,
        )


def identify_log(log: Log, orders: Orders, method: str = "direct", rest: int | None = None) -> IdentifiedLog:
    """Identify the model from "input" to "output" of a log.

    Parameters
    ----------
    log
        The log.
    orders
        Numbers of poles and zeros.
    method
        "direct" and "armax" use both signals, also with feedback; "least-squares" is biased by noise of the
        sensor; "two-stage" also uses the "reference".
    rest
        Number of samples at the beginning at which the rig is at its operating point; unless given, the
        samples before the first move of the reference, or one without a reference.

    Returns
    -------
    IdentifiedLog
        The model with its uncertainty.

    Raises
    ------
    InputError
        For signals that the log does not have.
    NotConverged
        As for the method.
    """
    check_choice("identify_log(method)", method, METHODS)
    referred = method != "two-stage" or "reference" in log.signals
    must, remedy = "needs a column that is the reference", "name it, or take another method"
    check(referred, "identify_log(method)", must, "none", remedy)
    count = _at_rest(log) if rest is None else rest
    signals = {role: log.shown(role)[0] for role in log.signals}
    check_rest("identify_log(rest)", count, log.time.size)
    means = {role: float(values[:count].mean()) for role, values in signals.items()}
    shown = {role: values - means[role] for role, values in signals.items()}
    y, u = shown["output"], shown["input"]
    if method == "two-stage":
        loop = Orders(orders.poles + 2, orders.poles + 2)
        found = identify_two_stage(y, u, shown["reference"], orders, log.Ts, loop=loop)
    else:
        found = _ESTIMATORS[method](y, u, orders, log.Ts)
    return IdentifiedLog(found, log.columns, y.size, count, means)


def _at_rest(log: Log) -> int:
    """Number of samples before the first move of the reference; one without a reference, or if it moves at once."""
    if "reference" not in log.signals:
        return 1
    reference = log["reference"]
    moving = np.flatnonzero(reference != reference[0])
    return int(moving[0]) if moving.size else 1
