"""Energy balance of coils on saturating iron near a swinging magnet: electrical input, heat, field energy and work.

The C core steps the coils and the magnet, and adds up the input energy and the heat. The field energy is computed from
the map's reduced model, solved here in numpy.
"""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.interpolate import PPoly
from scipy.spatial.transform import Rotation

from fieldmap.constants import MU0
from fieldmap.dynamics import CoilDrive, Machine, MatrixAllocation, RigidBody, Sensors, modelled, state_of
from fieldmap.instruments import Amplifier
from fieldmap.lookup import FieldMap, MagneticBody
from fieldmap.typing import Array

STEP, TIME, EVERY = 1e-4, 10.0, 500
MOMENT, INERTIA, LEAN = 0.813, 1e-6, 0.3
"""Moment, A m^2, inertia, kg m^2, and initial tilt, rad, of a magnet that only turns, towards upright."""
SWAY, RATE = 6.0, 40.0
"""Amplitude, V, and angular frequency, rad/s, of the voltages about constant ones."""


@dataclass(frozen=True)
class Balance:
    """Energies, J: largest error of the balance, input, range of the field energy, range of the kinetic energy."""

    miss: float
    given: float
    field: float
    kinetic: float


def balance(opened: FieldMap, ohms: float, level: float, step: float = STEP, time: float = TIME) -> Balance:
    """Balance of coils with voltages that oscillate about those of a current level, A."""
    n, place = len(opened.coil_names), np.mean(opened.bounds, axis=0)
    # A mass so large that the body does not move.
    body = RigidBody(1e9, [INERTIA] * 3, MagneticBody.dipole([0, 0, MOMENT]), gravity=0.0)
    amplifier = Amplifier(1.0, current_lower=-1e9, current_upper=1e9)
    drive = CoilDrive(amplifier, n, resistance=ohms, mode="voltage", supply=(-1e3, 1e3))
    of = modelled(opened)
    core = Machine(of, body, drive, Sensors(), MatrixAllocation(np.eye(n), np.zeros(n))).core(step)
    lean = [np.cos(LEAN / 2), np.sin(LEAN / 2), 0.0, 0.0]
    state, currents, load = state_of(place, quaternion=lean), np.full(n, level), np.zeros(6)
    core.follow(currents)
    core.load(state, load)
    unit = np.empty((of.map.sets, 1, 3))
    of.map.each_field(place[None], unit, None)
    model, rows = _Model(opened), []
    phases = np.arange(n)
    for k in range(round(time / step)):
        if k % round(EVERY * STEP / step) == 0:
            rows.append(_energies(model, core, state, currents, unit[:, 0]))
        volts = ohms * level + SWAY * np.sin(RATE * (k + 0.5) * step + phases)
        core.advance(step, 1, volts, state, currents, load)
    rows.append(_energies(model, core, state, currents, unit[:, 0]))
    left, field, kinetic, given = np.array(rows).T
    miss = np.abs(left - (field + kinetic) + (field + kinetic)[0]).max()
    return Balance(float(miss), float(given[-1]), float(np.ptp(field)), float(np.ptp(kinetic)))


def _energies(model: "_Model", core, state: Array, currents: Array, unit: Array) -> tuple[float, ...]:
    """Energies: input less heat; field energy of coils, magnet and iron; kinetic energy; input."""
    _, x, y, z = quaternion = state[6:10]
    moment = Rotation.from_quat([x, y, z, quaternion[0]]).apply([0, 0, MOMENT])
    counted = core.coil_state
    kinetic = 0.5 * INERTIA * float(np.sum(state[10:13] ** 2))
    given = float(counted.input.sum())
    return given - float(counted.heat.sum()), model.energy(currents, unit @ moment), kinetic, given


class _Model:
    """The reduced equation of a map in numpy."""

    def __init__(self, opened: FieldMap) -> None:
        of, air = opened.info.reduced_model, opened.linkage
        assert of is not None
        assert air is not None
        self.of, self.air = of, air.inductance
        self.gradients = of.gradients.astype(np.float32).astype(float)
        self.amplitudes = of.known_amplitudes[0]
        ends = list(pairwise(of.law_offset))
        self.laws = [PPoly(of.law_coefficients[a:b].T, np.append(of.law_knots[a:b], 1e3)) for a, b in ends]

    def law(self, size: Array, order: int) -> Array:
        """B(h) of all points (order 0), its integral (order -1) or its slope (order 1)."""
        found = np.empty_like(size)
        for number, law in enumerate(self.laws):
            at = self.of.law == number
            curve = law.antiderivative() if order < 0 else law.derivative(order) if order else law
            found[at] = curve(size[at])
        return found

    def moments(self, applied: Array, amplitudes: Array) -> tuple[Array, Array, Array]:
        """Fields at the points, moments of the points, and the residual."""
        of = self.of
        h = (applied - self.gradients @ amplitudes).reshape(-1, 3)
        size = np.linalg.norm(h, axis=1)
        moments = (of.weights * (self.law(size, 0) / size - 1.0))[:, None] * h
        return h, moments, self.gradients.T @ moments.ravel() + of.constant - of.air @ amplitudes

    def tangent(self, h: Array, fields: Array) -> Array:
        """Derivatives of the residual by amplitudes of fields (3 p, m) at the points."""
        size = np.linalg.norm(h, axis=1)
        chord, slope = self.law(size, 0) / size - 1.0, self.law(size, 1) - 1.0
        fields = fields.reshape(len(h), 3, -1)
        turned = chord[:, None, None] * fields
        turned += (
            ((slope - chord) / size**2)[:, None, None]
            * h[:, :, None]
            * np.einsum("pi,pik->pk", h, fields)[:, None]
        )
        return self.gradients.T @ (self.of.weights[:, None, None] * turned).reshape(h.size, -1)

    def energy(self, currents: Array, along: Array) -> float:
        """Field energy, J. along: moment of the payload times each unit field, Wb or J."""
        of, n = self.of, len(currents)
        applied, amplitudes = of.source @ currents, self.amplitudes
        for _ in range(100):
            h, moments, residual = self.moments(applied, amplitudes)
            whole = of.air + self.tangent(h, self.gradients)
            change, share = np.linalg.solve(whole, residual), 1.0
            while self.moments(applied, amplitudes + share * change)[2] @ change < -0.3 * (residual @ change):
                share /= 2.0
            amplitudes = amplitudes + share * change
            if np.abs(change).max() < 1e-12 * np.abs(amplitudes).max():
                break
        else:
            raise ArithmeticError("the reduced equation has no solution")
        self.amplitudes = amplitudes
        h, moments, _ = self.moments(applied, amplitudes)
        size = np.linalg.norm(h, axis=1)
        stored = np.sum(moments * h) - of.weights @ (self.law(size, -1) - size**2 / 2.0)
        iron = (stored + 0.5 * amplitudes @ of.air @ amplitudes) / MU0
        # The payload's part of sum I dW'/dI - W', which is zero for weights proportional to the currents.
        slopes = of.output @ np.linalg.solve(whole, self.tangent(h, of.source))
        payload = along[n:] @ (slopes @ currents - of.output @ amplitudes)
        return float(iron + 0.5 * currents @ self.air @ currents + payload)
