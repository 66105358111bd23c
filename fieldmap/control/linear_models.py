"""Linear models of plants: transfer functions and state spaces, continuous and sampled.

Models are plain arrays, which scipy.signal and python-control accept: a transfer function is (numerator, denominator),
highest power first, a state space is (A, B, C, D). `to_control` makes systems of python-control.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, Any, NamedTuple, cast

import numpy as np
import scipy
from numpy.typing import ArrayLike, NDArray

from fieldmap.arguments import check, check_matrix, check_positive, check_signal
from fieldmap.extras import require
from fieldmap.plain import Plain, plain_items
from fieldmap.records import Record, tuple_line
from fieldmap.typing import Array

if TYPE_CHECKING:
    import control as python_control


class TransferFunction(NamedTuple):
    """numerator / denominator, coefficients of falling powers; the denominator's first is 1."""

    numerator: Array
    denominator: Array

    def __repr__(self) -> str:
        return tuple_line(self)

    def to_dict(self) -> dict[str, Plain]:
        """The values by their names, as plain Python."""
        return plain_items(**self._asdict())

    @property
    def zeros(self) -> NDArray[Any]:
        """Roots of the numerator."""
        return np.roots(self.numerator)

    @property
    def poles(self) -> NDArray[Any]:
        """Roots of the denominator."""
        return np.roots(self.denominator)

    def to_control(self, Ts: float | None = None) -> python_control.TransferFunction:
        """The model as a system of python-control.

        Parameters
        ----------
        Ts
            Sampling time, s, of a transfer function in q; None for one in s.

        Returns
        -------
        python_control.TransferFunction
            A transfer function of python-control.

        Raises
        ------
        FieldmapError
            If python-control is not installed.
        """
        library = require("control", "control", "TransferFunction.to_control")
        system: python_control.TransferFunction = library.tf(self.numerator, self.denominator, _period(Ts))
        return system


class StateSpace(NamedTuple):
    """dx/dt = A x + B u (or x[n+1] = A x[n] + B u[n]), y = C x + D u."""

    A: Array
    B: Array
    C: Array
    D: Array

    def __repr__(self) -> str:
        return tuple_line(self)

    def to_dict(self) -> dict[str, Plain]:
        """The values by their names, as plain Python."""
        return plain_items(**self._asdict())

    def to_control(
        self,
        Ts: float | None = None,
        states: Sequence[str] | None = None,
        inputs: Sequence[str] | None = None,
        outputs: Sequence[str] | None = None,
    ) -> python_control.StateSpace:
        """The model as a system of python-control.

        Parameters
        ----------
        Ts
            Sampling time, s, of a sampled model; None for a continuous one.
        states, inputs, outputs
            Names of these.

        Returns
        -------
        python_control.StateSpace
            A state space of python-control.

        Raises
        ------
        FieldmapError
            If python-control is not installed.
        """
        library = require("control", "control", "StateSpace.to_control")
        named = {"states": states, "inputs": inputs, "outputs": outputs}
        given = {name: list(labels) for name, labels in named.items() if labels is not None}
        system: python_control.StateSpace = library.ss(*self, _period(Ts), **given)
        return system


def _period(Ts: float | None) -> float:
    """Sampling time as python-control states it: 0 for a continuous system."""
    if Ts is None:
        return 0.0
    check_positive("to_control", Ts=Ts)
    return Ts


def transfer_function(numerator: ArrayLike, denominator: ArrayLike) -> TransferFunction:
    """A proper transfer function from coefficients of falling powers; leading zeros are dropped.

    Parameters
    ----------
    numerator, denominator
        Coefficients (n,).

    Returns
    -------
    TransferFunction
        The transfer function.

    Raises
    ------
    InputError
        For coefficients that are not finite, a denominator of zeros, or more zeros than poles.

    Examples
    --------
    >>> transfer_function([0, 2, 4], [2, 0, 8])
    TransferFunction(numerator=[1.0, 2.0], denominator=[1.0, 0.0, 4.0])
    """
    where = "transfer_function"
    top = np.trim_zeros(np.atleast_1d(check_signal(f"{where}(numerator)", numerator)), "f")
    bottom = np.trim_zeros(np.atleast_1d(check_signal(f"{where}(denominator)", denominator)), "f")
    check(bottom.size > 0, f"{where}(denominator)", "must not be zero", "zeros", "give its coefficients")
    top = top if top.size else np.zeros(1)
    must = "must be proper: the numerator's degree is at most the denominator's"
    received = f"degrees {top.size - 1} and {bottom.size - 1}"
    remedy = "the output of an improper plant would precede its input; add its fast poles"
    check(top.size <= bottom.size, where, must, received, remedy)
    return TransferFunction(top / bottom[0], bottom / bottom[0])


def from_roots(gain: float, zeros: ArrayLike, poles: ArrayLike) -> TransferFunction:
    """gain * prod(q - zeros) / prod(q - poles).

    Parameters
    ----------
    gain
        The factor.
    zeros, poles
        Roots, complex ones with their conjugates.

    Returns
    -------
    TransferFunction
        The transfer function.

    Raises
    ------
    InputError
        For complex roots without their conjugates.

    Examples
    --------
    >>> from_roots(-0.03, [0.9935], [1.01, 0.905]).denominator.round(5).tolist()
    [1.0, -1.915, 0.91405]
    """
    roots = [np.atleast_1d(np.asarray(values)) for values in (zeros, poles)]
    top, bottom = (np.atleast_1d(np.real_if_close(np.poly(values))) for values in roots)
    where, must = "from_roots(zeros, poles)", "must be real or come in conjugate pairs"
    real = np.isrealobj(top) and np.isrealobj(bottom)
    check(real, where, must, np.concatenate(roots), "give both of a pair")
    return transfer_function(gain * top, bottom)


def controller_form(numerator: ArrayLike, denominator: ArrayLike) -> StateSpace:
    """Realisation with the denominator in the first row of A and B = (1, 0, ...).

    Parameters
    ----------
    numerator, denominator
        Coefficients of falling powers.

    Returns
    -------
    StateSpace
        The model.

    Raises
    ------
    InputError
        As for `transfer_function`.

    Examples
    --------
    >>> model = controller_form([-15.63, -50.97], [1, 44.94, -248.3])
    >>> model.A.tolist(), model.C.tolist()
    ([[-44.94, 248.3], [1.0, 0.0]], [[-15.63, -50.97]])
    """
    top, bottom = transfer_function(numerator, denominator)
    order = bottom.size - 1
    full = np.concatenate([np.zeros(order + 1 - top.size), top])
    A = np.eye(order, k=-1)
    A[:1] = -bottom[1:]
    return StateSpace(A, np.eye(order, 1), (full[1:] - full[0] * bottom[1:])[None, :], full[:1, None])


def to_transfer_function(model: StateSpace) -> TransferFunction:
    """The transfer function of a model: det(s - A + B C) / det(s - A) - 1 + D.

    Parameters
    ----------
    model
        The model, with one input and one output.

    Returns
    -------
    TransferFunction
        The transfer function.

    Raises
    ------
    InputError
        For a model with more inputs or outputs.
    """
    A, B, C, D = check_model("to_transfer_function", model, inputs=1, outputs=1)
    bottom = cast(Array, np.poly(A))
    return TransferFunction(np.poly(A - B @ C) + (D[0, 0] - 1.0) * bottom, bottom)


def with_output_integral(A: ArrayLike, B: ArrayLike, C: ArrayLike) -> StateSpace:
    """The model with one more state per output: the integral of the output. The outputs stay the same.

    Parameters
    ----------
    A, B, C
        The model, (n, n), (n, m) and (p, n).

    Returns
    -------
    StateSpace
        The augmented model.

    Raises
    ------
    InputError
        For matrices that do not fit.

    Examples
    --------
    >>> with_output_integral([[-44.94, 248.3], [1, 0]], [[1], [0]], [[-15.63, -50.97]]).A[2].tolist()
    [-15.63, -50.97, 0.0]
    """
    A, B, C, _ = check_model("with_output_integral", (A, B, C, None))
    outputs, (order, inputs) = len(C), B.shape
    still, direct = np.zeros((outputs, outputs)), np.zeros((outputs, inputs))
    wider = np.block([[A, np.zeros((order, outputs))], [C, still]])
    return StateSpace(wider, np.vstack([B, direct]), np.hstack([C, still]), direct)


def zero_order_hold(A: ArrayLike, B: ArrayLike, Ts: float) -> tuple[Array, Array]:
    """The sampled model for a held input: the exponential of [[A, B], [0, 0]] Ts.

    Van Loan, IEEE Trans. Automatic Control 23 (1978) 395. C and D stay the same.

    Parameters
    ----------
    A, B
        The continuous model, (n, n) and (n, m).
    Ts
        Sampling time, s.

    Returns
    -------
    tuple[Array, Array]
        A and B of the sampled model.

    Raises
    ------
    InputError
        For matrices that do not fit.
    """
    A, B, _, _ = check_model("zero_order_hold", (A, B, None, None))
    check_positive("zero_order_hold", Ts=Ts)
    order, inputs = B.shape
    grown = scipy.linalg.expm(np.block([[A, B], [np.zeros((inputs, order + inputs))]]) * Ts)
    return grown[:order, :order], grown[:order, order:]


def inverse_zero_order_hold(A_d: ArrayLike, B_d: ArrayLike, Ts: float) -> tuple[Array, Array]:
    """The continuous model from which `zero_order_hold` gives this one.

    Of several such models it is the one without oscillations above half the sampling rate (principal logarithm).

    Parameters
    ----------
    A_d, B_d
        The sampled model, (n, n) and (n, m).
    Ts
        Sampling time, s.

    Returns
    -------
    tuple[Array, Array]
        A and B of the continuous model.

    Raises
    ------
    InputError
        If there is no such model, because of poles at 0 (a dead time) or on the negative real axis.
    """
    A_d, B_d, _, _ = check_model("inverse_zero_order_hold", (A_d, B_d, None, None))
    check_positive("inverse_zero_order_hold", Ts=Ts)
    order, inputs = B_d.shape
    poles = np.linalg.eigvals(A_d)
    bad = poles[(np.abs(poles.imag) < 1e-12) & (poles.real <= 1e-12)].real
    must = "must have no poles at 0 or on the negative real axis: no continuous model of that order has them"
    received = f"pole {', '.join(f'{pole:.4g}' for pole in bad[:1])}"
    remedy = "remove dead time first; identify a model of another order, or sample faster"
    check(not bad.size, "inverse_zero_order_hold(A_d)", must, received, remedy)
    both = np.eye(order + inputs)
    both[:order] = np.hstack([A_d, B_d])
    grown = np.real(scipy.linalg.logm(both)) / Ts
    return grown[:order, :order], grown[:order, order:]


def sampled(plant: tuple[ArrayLike, ArrayLike], Ts: float) -> TransferFunction:
    """The transfer function in q of a continuous one with a held input.

    Parameters
    ----------
    plant
        Numerator and denominator in s.
    Ts
        Sampling time, s.

    Returns
    -------
    TransferFunction
        Numerator and denominator in q.

    Raises
    ------
    InputError
        As for `transfer_function`.
    """
    model = controller_form(*plant)
    return to_transfer_function(StateSpace(*zero_order_hold(model.A, model.B, Ts), model.C, model.D))


def continuous(plant: tuple[ArrayLike, ArrayLike], Ts: float) -> TransferFunction:
    """The transfer function in s with this sampled form in q: the inverse of docs/theory/control.md (4).

    Parameters
    ----------
    plant
        Numerator and denominator in q.
    Ts
        Sampling time, s.

    Returns
    -------
    TransferFunction
        Numerator and denominator in s.

    Raises
    ------
    InputError
        As for `inverse_zero_order_hold`.

    Examples
    --------
    >>> vertical = from_roots(-0.03, [0.9935], [1.01, 0.905])
    >>> top, bottom = continuous(vertical, 2e-3)
    >>> top.round(2).tolist(), bottom.round(1).tolist()
    ([-15.63, -50.97], [1.0, 44.9, -248.3])
    """
    model = controller_form(*plant)
    A, B = inverse_zero_order_hold(model.A, model.B, Ts)
    numerator, denominator = to_transfer_function(StateSpace(A, B, model.C, model.D))
    # A strictly proper model stays strictly proper: the subtraction leaves only rounding in its first coefficients.
    lead = np.abs(numerator) > 1e-12 * np.abs(numerator).max(initial=0.0)
    return TransferFunction(numerator[np.argmax(lead) :], denominator)


def closed_loop(
    plant: tuple[ArrayLike, ArrayLike], controller: tuple[ArrayLike, ArrayLike]
) -> TransferFunction:
    """y / r = C P / (1 + C P).

    Parameters
    ----------
    plant
        Numerator and denominator of P.
    controller
        Numerator and denominator of C, with a negative gain for a plant of negative gain.

    Returns
    -------
    TransferFunction
        The transfer function from reference to output.

    Raises
    ------
    InputError
        As for `transfer_function`.
    """
    top, bottom = transfer_function(*plant)
    ctop, cbottom = transfer_function(*controller)
    forward = np.polymul(top, ctop)
    return transfer_function(forward, np.polyadd(np.polymul(bottom, cbottom), forward))


def steady_gain(plant: tuple[ArrayLike, ArrayLike], Ts: float | None = None) -> float:
    """Steady-state gain: output per input at rest.

    Parameters
    ----------
    plant
        Numerator and denominator.
    Ts
        Sampling time, s, of a plant in q; None for one in s.

    Returns
    -------
    float
        The value at s = 0, or at q = 1; infinite if the plant has a pole there.

    Raises
    ------
    InputError
        As for `transfer_function`.
    """
    top, bottom = transfer_function(*plant)
    at = 0.0 if Ts is None else 1.0
    below = np.polyval(bottom, at)
    return float(np.polyval(top, at) / below) if below else float("inf")


@dataclass(frozen=True, eq=False, repr=False)
class RootLocus(Record):
    """gains (n,); poles (n, order): column k is one branch."""

    gains: Array
    poles: NDArray[np.complexfloating[Any]]

    @property
    def stable(self) -> NDArray[np.bool_]:
        """Whether all poles lie inside the unit circle, per gain (n,)."""
        return np.all(np.abs(self.poles) < 1.0, axis=1)


def root_locus(
    plant: tuple[ArrayLike, ArrayLike],
    controller: tuple[ArrayLike, ArrayLike],
    gains: ArrayLike,
    *,
    steps: int = 64,
) -> RootLocus:
    """Roots of 1 + gain * C P = 0 in q.

    Poles are matched from one gain to the next with the smallest sum of moves. Branches stay separate, but
    may be exchanged where two of them meet.

    Parameters
    ----------
    plant
        Numerator and denominator of P.
    controller
        Numerator and denominator of C at gain 1, with its sign.
    gains
        The gains, which must rise (or fall).
    steps
        Number of further gains between two of the given ones.

    Returns
    -------
    RootLocus
        Poles at every gain.

    Raises
    ------
    InputError
        For gains that do not rise or fall, and as for `transfer_function`.

    Examples
    --------
    >>> locus = root_locus(([1.0], [1.0, -1.0]), ([1.0], [1.0]), [0.5, 1.5, 2.5])  # an integrator
    >>> locus.poles.real.ravel().tolist(), locus.stable.tolist()
    ([0.5, -0.5, -1.5], [True, True, False])
    """
    models = transfer_function(*plant), transfer_function(*controller)
    top, bottom = (np.polymul(*each) for each in zip(*models, strict=True))
    wanted = np.atleast_1d(check_signal("root_locus(gains)", gains))
    moves = np.diff(wanted)
    ordered = wanted.ndim == 1 and wanted.size > 0 and bool((moves > 0).all() or (moves < 0).all())
    check(ordered, "root_locus(gains)", "must rise, or fall", wanted.tolist(), "sort the gains")
    poles: list[NDArray[Any]] = [np.sort_complex(np.roots(np.polyadd(bottom, wanted[0] * top)))]
    for start, end in pairwise(wanted):
        branch = poles[-1]
        for found in _roots(bottom, top, np.linspace(start, end, steps + 2)[1:]):
            # If the leading coefficient vanishes, a pole is at infinity.
            every = np.pad(found, (0, branch.size - found.size), constant_values=1e300)
            moved = np.minimum(np.abs(branch[:, None] - every), 1e6)
            branch = every[scipy.optimize.linear_sum_assignment(moved)[1]]
        poles.append(branch)
    return RootLocus(wanted, np.array(poles, dtype=complex))


def _roots(bottom: NDArray[Any], top: NDArray[Any], gains: Array) -> list[NDArray[Any]]:
    """np.roots of bottom + gain * top for every gain: eigenvalues of all companion matrices in one call."""
    each = np.pad(top, (bottom.size - top.size, 0)) * gains[:, None] + bottom
    if bottom.size < 3 or not each[:, [0, -1]].all():
        return [np.roots(one) for one in each]
    companions = np.zeros((gains.size, bottom.size - 1, bottom.size - 1))
    companions[:, 1:, :-1] = np.eye(bottom.size - 2)
    companions[:, 0] = -each[:, 1:] / each[:, :1]
    return list(np.linalg.eigvals(companions))


def filter_response(numerator: ArrayLike, denominator: ArrayLike, signal: ArrayLike, axis: int = -1) -> Array:
    """The response of a sampled transfer function to a signal, from rest.

    Parameters
    ----------
    numerator, denominator
        Polynomials in 1/q, as scipy's lfilter takes them.
    signal
        The signal.
    axis
        Its axis of time.

    Returns
    -------
    Array
        The response, in the shape of the signal.
    """
    # Imported on use: scipy.signal loads scipy.stats. Both take a second, and reading a scenario needs neither.
    from scipy.signal import lfilter

    return np.asarray(lfilter(numerator, denominator, signal, axis=axis))


def check_model(
    where: str, model: tuple, inputs: int | None = None, outputs: int | None = None
) -> tuple[Array, Array, Array, Array]:
    """Check that matrices are finite and fit each other.

    Parameters
    ----------
    where
        Name of the caller, for messages.
    model
        A, B, C and D; None for C or D takes the identity or zeros.
    inputs, outputs
        Required numbers of these; any number unless given.

    Returns
    -------
    tuple[Array, Array, Array, Array]
        A, B, C and D.

    Raises
    ------
    InputError
        For matrices that do not fit.
    """
    A = check_matrix(f"{where}(A)", model[0], (None, None))
    order = A.shape[0]
    A = check_matrix(f"{where}(A)", A, (order, order))
    B = check_matrix(f"{where}(B)", model[1], (order, inputs))
    C = np.eye(order) if model[2] is None else check_matrix(f"{where}(C)", model[2], (outputs, order))
    shape = (C.shape[0], B.shape[1])
    D = np.zeros(shape) if model[3] is None else check_matrix(f"{where}(D)", model[3], shape)
    return A, B, C, D
