"""What a linear machine does by itself: poles, the axes they move, controllability, observability, coupling."""

from dataclasses import dataclass

import numpy as np
import scipy

from fieldmap.dynamics.linearisation.machine import LinearMachine
from fieldmap.records import Record
from fieldmap.typing import Array

# Units in which deviations are of a size: a millimetre, a tenth of a radian, and what they are in a tenth of a second.
_UNITS = {"turn": 0.1, "angular_velocity": 1.0, "velocity": 1e-2, "i": 0.1}
_MILLI = 1e-3
# What a velocity is the velocity of.
_AXIS_OF = {f"velocity_{k}": k for k in "xyz"} | {f"angular_velocity_{k}": f"turn_{k}" for k in "xyz"}


@dataclass(frozen=True, eq=False, repr=False)
class Mode(Record):
    """A pole, 1/s, with the shares (states,) that its states have in it (sum 1), and how it is coupled to both sides.

    input_gains (inputs,), output_gains (outputs,): sizes of its left vector times B and of C times its right vector,
    both vectors of length 1 in units of 1 mm, 0.1 rad, 10 mm/s, 1 rad/s, 0.1 A: zeros where an input cannot move it, an
    output not show it.
    """

    pole: complex
    shares: Array
    input_gains: Array
    output_gains: Array

    @property
    def frequency(self) -> float:
        """Hz, of its oscillation."""
        return float(abs(self.pole.imag) / (2.0 * np.pi))

    @property
    def damping(self) -> float:
        """Ratio: 1 and more does not swing, negative grows."""
        size = abs(self.pole)
        return float(-self.pole.real / size) if size else 1.0

    def named_shares(self, linear: LinearMachine, least: float = 0.05) -> dict[str, float]:
        """Shares by x, y, z and turn_x..: positions with their velocities, those above `least`."""
        found: dict[str, float] = {}
        for name, share in zip(linear.states, self.shares, strict=True):
            key = _AXIS_OF.get(name, name)
            found[key] = found.get(key, 0.0) + float(share)
        return {name: share for name, share in found.items() if share >= least}


def modes(linear: LinearMachine) -> list[Mode]:
    """The modes of a linear machine, the most unstable first."""
    units = _units(linear)
    A = linear.A / units[:, None] * units
    B, C = linear.B / units[:, None], linear.C * units / _MILLI
    poles, left, right = scipy.linalg.eig(A, left=True)
    found = []
    for k in np.lexsort((-poles.imag, -poles.real.round(9))):
        shares = np.abs(left[:, k].conj() * right[:, k])
        total = shares.sum()
        found.append(
            Mode(
                complex(poles[k]),
                shares / total if total else shares,
                np.abs(left[:, k].conj() @ B),
                np.abs(C @ right[:, k]),
            )
        )
    return found


def _units(linear: LinearMachine) -> Array:
    return np.array(
        [
            next((unit for start, unit in _UNITS.items() if name.startswith(start)), _MILLI)
            for name in linear.states
        ]
    )


@dataclass(frozen=True, eq=False, repr=False)
class Controllability(Record):
    """Whether every mode can be moved by the inputs and is shown by the outputs (Popov, Belevitch and Hautus).

    controllability, observability: smallest singular value of [A - s, B] and [A - s; C] over the modes with a real part
    above `above`, in the units of `Mode`: 0 where a mode is not controllable, or not observable. worst_input,
    worst_output: the poles.
    """

    controllability: float
    observability: float
    worst_input: complex
    worst_output: complex


def controllability(linear: LinearMachine, above: float = -np.inf) -> Controllability:
    """Controllability and observability of the modes with a real part above a bound, 1/s."""
    units = _units(linear)
    A = linear.A / units[:, None] * units
    B, C = linear.B / units[:, None], linear.C * units / _MILLI
    poles = [p for p in scipy.linalg.eigvals(A) if p.real > above]
    smallest = [
        (
            float(np.linalg.svd(np.hstack([A - p * np.eye(len(A)), B]), compute_uv=False)[-1]),
            float(np.linalg.svd(np.vstack([A - p * np.eye(len(A)), C]), compute_uv=False)[-1]),
            complex(p),
        )
        for p in poles
    ]
    if not smallest:
        return Controllability(np.inf, np.inf, 0j, 0j)
    inputs, outputs = min(smallest, key=lambda s: s[0]), min(smallest, key=lambda s: s[1])
    return Controllability(inputs[0], outputs[1], inputs[2], outputs[2])


@dataclass(frozen=True, eq=False, repr=False)
class Coupling(Record):
    """How the outputs answer the inputs at one frequency, Hz (0: constant inputs, as if it were stable).

    gain (outputs, inputs): m per unit, complex sizes taken; relative (outputs, inputs): relative gains, real parts:
    each output's answer to an input with the others' inputs still, over that with the other outputs held. The identity
    (with rows and columns in their order) means that the axes do not know of each other (Bristol 1966).
    """

    frequency: float
    gain: Array
    relative: Array


def coupling(linear: LinearMachine, frequency: float = 0.0) -> Coupling:
    """Gains and relative gains of a machine with as many inputs as outputs. Inputs are taken in the order of x, y, z
    where they are lift, x and y."""
    s = 2j * np.pi * frequency
    # A magnet may turn about its axis as it likes: at rest that is a state of pole zero which no input moves. The
    # shortest of all solutions leaves it still; an elimination would divide rounding by rounding.
    states = np.linalg.lstsq(s * np.eye(len(linear.A)) - linear.A, linear.B, rcond=None)[0]
    answer = linear.C @ states + linear.D
    if linear.inputs[:1] == ("lift_V",):
        answer = answer[:, [1, 2, 0]]
    # The pseudo-inverse is the inverse, and takes an input that moves nothing (a coil less than axes) for none.
    relative = answer * np.linalg.pinv(answer).T
    return Coupling(frequency, np.abs(answer) if frequency else answer.real, relative.real)
