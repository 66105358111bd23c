"""A levitated magnet as an environment of Gymnasium, `fieldmap/Levitation-v0` (pip install "fieldmap[gymnasium]").

`gymnasium.make("fieldmap.interop.levitation_env:fieldmap/Levitation-v0")`; the part after the colon is enough after
an import.

`fieldmap.dynamics` simulates the motion, with one compiled call per step. Without a map the environment is an example
rig: six loops without iron in a ring above a magnet of 11 g.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from functools import partial
from importlib import import_module
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from fieldmap import dynamics
from fieldmap.arguments import check, check_choice, check_not_negative, check_positive, check_signal
from fieldmap.core.machine import INSIDE
from fieldmap.currents import IndependentCurrents
from fieldmap.dynamics import CoilDrive, Drag, RigidBody, WeightBalance, linearised
from fieldmap.errors import InputError, OutsideMapError
from fieldmap.extras import require
from fieldmap.field import as_field
from fieldmap.instruments import Amplifier
from fieldmap.lookup import FieldMap, FiniteMagnet, interpolate, open_map
from fieldmap.store import Grid, MapData
from fieldmap.typing import Array

Env: Any = object
try:
    _gymnasium: Any = import_module("gymnasium")
except ImportError:
    # `LevitationEnv` raises the error (`require`).
    _gymnasium = None
else:
    Env = _gymnasium.Env

ENVIRONMENT = "fieldmap/Levitation-v0"
ACTIONS = ("currents", "signals")
IRON: Mapping[str, Callable[..., dynamics.FieldOfCurrents]] = {
    "model": dynamics.modelled,
    "table": dynamics.tabled,
    "linearised": linearised,
}
EFFORT = 0.01
"""Weight of the mean square of the actions in the reward."""
SECONDS = 10.0
"""Length of an episode of `gymnasium.make` with the default period, s, unless max_episode_steps is given."""

_PERIOD = 2e-3
# The example rig: radius and height of the ring, radius of a loop, m; turns. Its body: 16 x 20 mm, 0.8 A m^2.
_RING, _ABOVE, _LOOP, _TURNS = 0.044, 0.026, 0.016, 1e4
_MASS, _RADIUS, _HEIGHT, _MOMENT = 0.01119, 0.008, 0.02, 0.8
_TARGET = (0.0, 0.0, -0.09)
_AIR = Drag(linear=(1e-3,) * 3, turning=(1e-8,) * 3)


class LevitationEnv(Env):
    """Hold a magnet at a target by the currents of coils.

    Observation (12 + n,): position minus target (3), m; velocity (3), m/s; the body's z axis in the map (3); angular
    velocity (3), rad/s, frame of the body; currents (n,), A. Noise is added to the position.

    Action in -1..1, n currents or 3 signals. "currents": currents at rest + span * action, span in A. "signals": an
    additional force along x, y and z, span * weight * action, by the least changes of the currents at the target.
    Currents at rest are those of least power that carry the body at the target. For a map over a current
    parametrisation, such as a division, its variables replace the currents: variables at rest + span * half of their
    ranges * action, within these ranges; a force comes from the least changes of these variables.

    info of a step: `unsolved`, number of solves of the iron's model that did not converge and left the iron
    unchanged, and `outside`, number at currents outside the map's domain, where the error of the model is unknown.

    Reward of a step: 1 - (distance from the target / limit)^2 - 0.01 mean(action^2). An episode ends at a distance of
    `limit`, or outside the map, with a reward of 0 for that step. It starts at rest, with each coordinate off the
    target by up to `start`, m, and a rotation about x and y by up to `tilt`, rad.

    field: a map, its path, or any field with a box; body: with its magnet; target (3,): of its centre of mass, m. If
    all three are left out, the environment is the example rig. iron, for a map of saturating iron: "model", solved
    whenever currents change, "table" over a division, or "linearised" about the currents at rest, accurate only near
    them. span: by default the largest current at rest, 1 of the ranges, or 0.5 of the weight. period, step: s, as in
    `fieldmap.dynamics.Schedule`. noise: standard deviations (3,), m. drive: of the coils; by default currents follow
    at once. With a "current_controller" the flux linkages of the map couple the coils, and currents of the action are
    references of the controller. drag: none by default, some air in the example rig. Raises FieldmapError without
    Gymnasium, InputError for invalid arguments, Infeasible if no currents of the drive carry the body.

    >>> env = gymnasium.make("fieldmap/Levitation-v0", action="signals")                  # doctest: +SKIP
    """

    metadata: Mapping[str, Any] = {"render_modes": []}

    def __init__(
        self,
        field: Any = None,
        body: RigidBody | None = None,
        target: ArrayLike | None = None,
        *,
        action: str = "currents",
        span: float | None = None,
        iron: str = "model",
        period: float = _PERIOD,
        step: float = 2e-4,
        noise: ArrayLike = (0.0, 0.0, 0.0),
        start: float = 5e-4,
        tilt: float = 0.02,
        limit: float = 5e-3,
        drive: CoilDrive | None = None,
        drag: Drag | None = None,
        render_mode: str | None = None,
    ) -> None:
        require("gymnasium", "gymnasium", "LevitationEnv")
        check_choice("LevitationEnv(action)", action, ACTIONS)
        check_choice("LevitationEnv(iron)", iron, IRON)
        check_positive("LevitationEnv", period=period, step=step, limit=limit)
        check_not_negative("LevitationEnv", start=start, tilt=tilt)
        self.render_mode = render_mode
        if field is None and drag is None:
            drag = _AIR
        field, body, target = _rig(field, body, target)
        self.target = np.array(check_signal("LevitationEnv(target)", target, columns=3))
        self._noise = np.array(check_signal("LevitationEnv(noise)", noise, columns=3))
        self.field, self.body, self.period = field, body, float(period)
        self._steps = max(round(period / step), 1)
        self._step = self.period / self._steps
        self._start, self._tilt, self._limit = float(start), float(tilt), float(limit)
        n, place = len(field.coil_names), self.target + body.magnet_at
        drive = CoilDrive(Amplifier(1.0, -1e9, 1e9), n) if drive is None else drive
        must, remedy = (
            "must take currents, as the environment gives them",
            "use RunningMachine for other drives",
        )
        check(not drive.gives_voltage, "LevitationEnv(drive)", must, drive.mode, remedy)
        balance = WeightBalance(field, body, drive.steady)
        self.rest = balance.currents(place)
        self._known = linearised(field, self.rest) if iron == "linearised" else IRON[iron](field)
        self._changed, slopes, reach, widest = _variables(field, self.rest)
        self._from_action = reach * (widest if span is None else float(span))
        if action == "signals":
            share = 0.5 if span is None else float(span)
            # The least changes for a force of 1 N along each axis.
            by_reach = balance.force_per_ampere(place, self.rest) @ slopes @ reach
            self._from_action = share * balance.weight * (reach @ np.linalg.pinv(by_reach))
        self._limits = drive.steady
        # A Machine checks that the map has the flux linkages that coupled coils need.
        machine = dynamics.Machine(
            self._known,
            body,
            drive,
            dynamics.Sensors(),
            dynamics.MatrixAllocation(np.eye(n), np.zeros(n)),
            drag,
        )
        self._core = partial(machine.core, self._step)
        self._begin()
        self._state, self._currents, self._load = np.empty(13), np.empty(n), np.empty(6)
        self.action_space = _gymnasium.spaces.Box(-1.0, 1.0, (self._from_action.shape[1],), np.float64)
        self.observation_space = _gymnasium.spaces.Box(-np.inf, np.inf, (12 + n,), np.float64)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Array, dict[str, Any]]:
        """Begin a new episode.

        Parameters
        ----------
        seed
            Seed of the episode's random numbers.
        options
            `state` (13,) at the start.

        Returns
        -------
        tuple[Array, dict[str, Any]]
            Observation and info, see the class.
        """
        super().reset(seed=seed)
        begin = None if options is None else options.get("state")
        if begin is None:
            off = self.np_random.uniform(-self._start, self._start, 3)
            half = self.np_random.uniform(-self._tilt, self._tilt, 2) / 2
            begin = dynamics.state_of(self.target + off, quaternion=(1.0, *np.tan(half), 0.0))
        self._state[:] = check_signal("LevitationEnv.reset(state)", begin, columns=13)
        self._currents[:] = self.rest
        self._begin()
        self._machine.follow(self._currents)
        status, _ = self._machine.load(self._state, self._load)
        if status != INSIDE:
            must_hold = "the magnet must begin in the map"
            raise OutsideMapError.of("LevitationEnv.reset", must_hold, f"{self._state[:3]}", "move it")
        return self._observed(), self._solves()

    def step(self, action: Any) -> tuple[Array, float, bool, bool, dict[str, Any]]:
        """Run one control period.

        Parameters
        ----------
        action
            See the class.

        Returns
        -------
        tuple[Array, float, bool, bool, dict[str, Any]]
            Observation, reward, terminated, truncated, info.
        """
        given = np.minimum(np.maximum(action, -1.0), 1.0)
        wanted = self._changed(self._from_action @ given)
        commands = np.minimum(np.maximum(wanted, self._limits[0]), self._limits[1])
        status = self._machine.advance(
            self._step, self._steps, commands, self._state, self._currents, self._load
        )
        off = self._state[:3] - self.target
        share = float(off @ off) / self._limit**2
        if status != INSIDE or not share < 1.0:
            return self._observed(), 0.0, True, False, self._solves()
        reward = 1.0 - share - EFFORT * float(given @ given) / len(given)
        return self._observed(), reward, False, False, self._solves()

    @property
    def state(self) -> Array:
        """Position, velocity, quaternion (w, x, y, z) and angular velocity (13,), without noise, a copy."""
        return self._state.copy()

    @property
    def currents(self) -> Array:
        """Currents of the coils (n,), A, a copy."""
        return self._currents.copy()

    def _begin(self) -> None:
        """Make a machine with a new state of the iron, so that equal seeds give equal episodes."""
        self._machine = self._core()
        self._counted = self._machine.solves

    def _solves(self) -> dict[str, int]:
        """The info of the class since the last call."""
        before, now = self._counted, self._machine.solves
        self._counted = now
        return {"unsolved": now.unsolved - before.unsolved, "outside": now.outside - before.outside}

    def _observed(self) -> Array:
        out, state, q = np.empty(12 + len(self._currents)), self._state, self._state[6:10]
        out[:3] = state[:3] - self.target
        if self._noise.any():
            out[:3] += self._noise * self.np_random.standard_normal(3)
        out[3:6] = state[3:6]
        w, x, y, z = q.tolist()
        out[6], out[7], out[8] = 2.0 * (x * z + w * y), 2.0 * (y * z - w * x), 1.0 - 2.0 * (x * x + y * y)
        out[9:12] = state[10:13]
        out[12:] = self._currents
        return out


def _variables(field: FieldMap, rest: Array) -> tuple[Callable[[Array], Array], Array, Array, float]:
    """Variables of the actions: currents of the coils, or signals of the map's parametrisation within their ranges.

    Returns a function from a change (k,) to the coils' currents (n,), A; their derivatives (n, k) by the change; the
    change of an action of 1 at a span of 1 (k, k); and the default span.
    """
    reduced = field.info.reduced_model
    if reduced is None or isinstance(reduced.domain.parametrisation, IndependentCurrents):
        every = np.eye(len(rest))
        return lambda change: rest + change, every, every, float(np.abs(rest).max())
    made, lower, upper = reduced.domain.parametrisation, reduced.domain.lower, reduced.domain.upper
    signals = made.nearest(rest).values

    def currents(change: Array) -> Array:
        return made.currents(np.minimum(np.maximum(signals + change, lower), upper))

    return currents, made.derivative(signals), np.diag(0.5 * (upper - lower)), 1.0


def _rig(
    field: Any, body: RigidBody | None, target: ArrayLike | None
) -> tuple[FieldMap, RigidBody, ArrayLike]:
    """The given rig, or the example rig."""
    given = [each is not None for each in (field, body, target)]
    if any(given) and not all(given):
        must_hold = "field, body and target must all be given"
        raise InputError.of("LevitationEnv", must_hold, f"{sum(given)} of them", "or none")
    if body is not None and target is not None:
        opened = (
            open_map(field)
            if isinstance(field, str | os.PathLike)
            else dynamics.sampled_field(as_field(field))
        )
        return opened, body, target
    across = _MASS * (_RADIUS**2 / 4 + _HEIGHT**2 / 12)
    inertia = np.array([across, across, _MASS * _RADIUS**2 / 2])
    magnet = FiniteMagnet(np.zeros((1, 3)), np.array([[0.0, 0.0, _MOMENT]]))
    return _six_loops(), RigidBody(_MASS, inertia, magnet), _TARGET


def _six_loops() -> FieldMap:
    # Imported here, so that nothing is compiled for a given map.
    from fieldmap.kernels.coils.loop import loop_flux_density_and_gradient

    grid = Grid(np.array([-0.02, -0.02, -0.12]), np.full(3, 0.005), (9, 9, 13))
    angles = np.arange(6) * np.pi / 3
    centres = np.stack([_RING * np.cos(angles), _RING * np.sin(angles), np.full(6, _ABOVE)], axis=1)
    found = [loop_flux_density_and_gradient(grid.points() - centre, _LOOP) for centre in centres]
    flux = _TURNS * np.stack([one[0] for one in found]).reshape(6, *grid.shape, 3)
    slope = _TURNS * np.stack([one[1] for one in found]).reshape(6, *grid.shape, 3, 3)
    names = tuple(f"loop {k + 1}" for k in range(6))
    return interpolate(MapData(grid, names, np.ones(6), flux_density=flux, gradient=slope))


if _gymnasium is not None and ENVIRONMENT not in _gymnasium.registry:
    _gymnasium.register(ENVIRONMENT, f"{__name__}:LevitationEnv", max_episode_steps=round(SECONDS / _PERIOD))
