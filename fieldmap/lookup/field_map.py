"""Opened maps: field, gradient and wrench at any point of a map, for any currents."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable
from copy import copy
from dataclasses import replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from fieldmap.arguments import check, check_positive, checked_vectors, raise_all
from fieldmap.core.caller import caller
from fieldmap.core.current_table import CoreTable
from fieldmap.core.iron import IronState
from fieldmap.currents import CurrentParametrisation
from fieldmap.errors import InputError, Problem
from fieldmap.field import Bounds, Field, MagneticLoad, coil_currents, of_any_shape, require_affine
from fieldmap.histories import HISTORIES, history_of_currents
from fieldmap.interpolants import INTERPOLANTS, OUTSIDE_RULES, Form, Jump, known_interpolants
from fieldmap.lookup.actuation import Actuation, Limits, actuation
from fieldmap.lookup.current_model import OUTSIDE_CURRENTS, CurrentModel
from fieldmap.lookup.current_table import CurrentTable, tabulate
from fieldmap.lookup.demand import demand_of
from fieldmap.lookup.evaluation import (
    ONE_POINT,
    Box,
    CompiledEvaluator,
    Evaluator,
    MapAtCurrents,
    MapFields,
    MapReaction,
    in_chunks,
)
from fieldmap.lookup.field_sensors import MapSensors
from fieldmap.lookup.flux_linkage import back_emf, payload_linkage
from fieldmap.lookup.inverse import least_power_currents
from fieldmap.lookup.inverse_problem import SumOfFields
from fieldmap.lookup.magnetic_body import MagneticBody, loaded
from fieldmap.records import card, count_of
from fieldmap.store import (
    FieldError,
    LargeMap,
    MapData,
    MapInfo,
    StoredLinkage,
    read_for_lookup,
    warn_of_missed_accuracy,
)
from fieldmap.threads import most_threads
from fieldmap.typing import Array, PathLike

if TYPE_CHECKING:
    import xarray

    from fieldmap.device.drawing import Outline
    from fieldmap.device.payload import Payload


MOST_SUMMED = 1 << 30
"""Most bytes of coefficients of a large map that are summed for given currents. A larger map superposes at each
point."""


def _usual_level(model: CurrentModel) -> Array:
    """Currents (c,), A, about which the currents of the training swung."""
    return np.asarray(model.model.known_currents[0])


def _of_usual_history(model: CurrentModel) -> CurrentModel:
    """The model after the default history, for iron with hysteresis; otherwise the model itself."""
    if not model.model.remembers:
        return model
    return model.along(history_of_currents(HISTORIES[0], _usual_level(model)))


def check_choices(kind: str, outside: str, outside_currents: str) -> None:
    """Raise InputError, all at once, for a kind or an outside rule that does not exist."""
    choices = {
        "kind": (kind, known_interpolants(kind)),
        "outside": (outside, list(OUTSIDE_RULES)),
        "outside_currents": (outside_currents, OUTSIDE_CURRENTS),
    }
    remedy = "choose one that exists"
    raise_all(
        Problem(f"open_map, {name}", 'is "' + '" or "'.join(allowed) + '"', repr(value), remedy)
        for name, (value, allowed) in choices.items()
        if value not in allowed
    )


class FieldMap(Field, own_shapes=ONE_POINT):
    """A map ready for lookups: the unit fields of its coils, superposed at given currents.

    kind: "harmonic", a polynomial of degree 5 of the potential in each cell, free of curl and divergence to
    rounding, with jumps between cells of the size of its error (`jump`); "hermite", tricubic through the stored
    values and gradients, once continuously differentiable; "global", one harmonic polynomial of degree 16 for the
    whole box, infinitely smooth. docs/lookup.md says which to take when. In every form `gradient` is the exact
    derivative of `field`. Superposition is exact for coils with linear iron or none; a map of saturating iron solves
    a small model of the iron once for every change of the currents (docs/theory/current_dependence.md).
    outside_currents is the rule for currents beyond its domain: "raise", "nan", or "evaluate" without a known error.
    A map of iron with hysteresis has a memory: `memory`, `step`. follow_currents, tabulate_currents: see `open_map`.

    Points (3,), (n, 3) or of any leading shape (..., 3) in m; currents (n_coils,) for all points or (n, n_coils), in A,
    in the order of `coil_names`, one number for all coils, or by name, coils left out at 0. Results have the leading
    shape of the points. Outside the box from `lower` to `upper`: OutsideMapError, or with outside="nan" NaN, or with
    outside="clamp" the result at the nearest point of the box. NaN or infinity in a point, or NaN in a current, gives
    NaN in its row. Arguments of another shape: InputError. `out` takes a contiguous float64 array of the result's
    shape. Batches of more than 30 000 points run on `threads` threads, by default one per processor. Objects can be
    pickled and used from several threads at once. evaluator: function that makes the `fieldmap.lookup.Evaluator` of the
    coefficients; the interpolant's own unless given. reaction: whether forces on magnets include the iron's reaction to
    them (docs/theory/reaction.md), if the map holds it.

    >>> from fieldmap.store import Grid
    >>> grid = Grid([0, 0, 0], [0.01, 0.01, 0.01], (3, 3, 3))
    >>> flux, slope = np.tile([0, 0, 1e-3], (1, 3, 3, 3, 1)), np.zeros((1, 3, 3, 3, 3, 3))
    >>> uniform = MapData(grid, ("coil",), [1.0], flux_density=flux, gradient=slope)
    >>> print(f"{FieldMap(uniform).field([0.005, 0.01, 0.02], [2.0])[2]:.6f} T")
    0.002000 T
    """

    def __init__(
        self,
        data: MapData | LargeMap,
        outside: str = "raise",
        kind: str = "harmonic",
        threads: int | None = None,
        outside_currents: str = "raise",
        follow_currents: bool = False,
        tabulate_currents: bool = False,
        evaluator: Callable[[Form], Evaluator] | None = None,
        reaction: bool = True,
    ) -> None:
        check_choices(kind, outside, outside_currents)
        self._info = MapInfo(**{name: getattr(data, name) for name in MapInfo.__dataclass_fields__})
        grid = data.lookup_grid if isinstance(data, LargeMap) else data.grid
        lower, upper = np.array(data.grid.lower), np.array(data.grid.upper)
        self._box = Box(lower, upper, outside, most_threads() if threads is None else max(1, int(threads)))
        # A field of weight 1 after the fields of the coils. A model of the iron includes it in its weights.
        self._constant = data.constant_field and data.reduced_model is None
        self._form: Form = replace(INTERPOLANTS[kind].form(data, outside), constant=self._constant)
        self._linkage = data.linkage
        self._reaction: MapReaction | None = None
        if reaction and data.reaction is not None:
            cells = data.reaction_cells if isinstance(data, LargeMap) else None
            self._reaction = MapReaction(data.reaction, grid, kind, self._box, cells)
        self._sensors: MapSensors | None = None
        if data.sensors is not None:
            answers = data.sensors.answers
            of_iron = None if answers is None else MapFields(answers, grid, kind, self._box)
            self._sensors = MapSensors(data.sensors, of_iron)
        made = evaluator or INTERPOLANTS[kind].evaluator
        self._evaluator: Evaluator = (
            CompiledEvaluator(self._form, reaction=self._reaction) if made is None else made(self._form)
        )
        reduced = data.reduced_model
        rules = (outside_currents, follow_currents)
        self._model = (
            None if reduced is None else _of_usual_history(CurrentModel(reduced, data.coil_names, *rules))
        )
        self._table: CurrentTable | None = None
        if tabulate_currents:
            self._table = tabulate(self._model, self._evaluator, grid, data.current_error)
        # Up to about this number of points, superposing at each point is cheaper than summing the coefficients first.
        self._few = max(self._evaluator.places // 4, 1)
        if isinstance(data, LargeMap) and self._form.unit.nbytes > MOST_SUMMED:
            self._few = sys.maxsize
        self._last: tuple[bytes, MapAtCurrents | None] = (b"", None)
        self._last_weights: tuple[bytes, Array] = (b"", np.empty(0))

    @property
    def info(self) -> MapInfo:
        """Grid, coil names, reference currents, provenance and errors of the map."""
        return self._info

    @property
    def reaction(self) -> MapReaction | None:
        """The reaction of the iron to magnets, which forces and torques include; None if the map does not hold it, or
        was opened with reaction=False."""
        return self._reaction

    @property
    def sensors(self) -> MapSensors | None:
        """The field sensors of the device; None for a device without sensors, and for maps of earlier versions."""
        return self._sensors

    @property
    def has_iron(self) -> bool:
        """Whether the device of the map has iron."""
        return bool(self._info.provenance.solver_report.get("magnetic_bodies"))

    @property
    def parametrisation(self) -> CurrentParametrisation | None:
        """The current parametrisation for which a map of saturating iron was made; None for any other map."""
        reduced = self._info.reduced_model
        return None if reduced is None else reduced.domain.parametrisation

    @property
    def payload(self) -> Payload | None:
        """The payload of the device that the map was made of; None if its file states none."""
        from fieldmap.device.reader import recorded_device

        text = self._info.provenance.device_text
        return recorded_device(text).payload if text else None

    @property
    def kind(self) -> str:
        """Form of the interpolant."""
        return self._form.kind

    @property
    def coil_names(self) -> tuple[str, ...]:
        """Names of the coils, in the order of their currents."""
        return self._info.coil_names

    @property
    def bounds(self) -> Bounds:
        """Lower and upper corner of the box in which the map holds, m."""
        return self._info.grid.lower, self._info.grid.upper

    @property
    def proportional(self) -> bool:
        """Whether the field is the sum of its coils' fields: True for a map without saturating iron and fixed
        sources."""
        return self._model is None and not self._constant

    @property
    def affine(self) -> bool:
        """Whether the field is the sum of its coils' fields and a constant field: True without saturating iron."""
        return self._model is None

    @property
    def remembers(self) -> bool:
        """Whether the iron has hysteresis, so that the field depends on earlier currents too: see `memory`."""
        return self._model is not None and self._model.model.remembers

    def memory(self, history: str = HISTORIES[0], currents: Any = None) -> FieldMap:
        """This map with its iron after a history. `step` continues from there.

        A map of iron with hysteresis always has a memory, at first after the history "shaken". Its field at given
        currents is the field after a straight path from the currents of the memory. A lookup does not change the
        memory.

        Parameters
        ----------
        history
            "shaken": all currents have swung about a level with decreasing amplitude, as when a controller catches its
            magnet; "demagnetised": the iron was never magnetised (fieldmap.histories).
        currents
            Level at which the history ends, A: (n_coils,), one number for all coils, or a mapping by name;
            the level of the map's training unless given.

        Returns
        -------
        FieldMap
            A map with the same fields.

        Raises
        ------
        InputError
            For a map of iron without hysteresis, and for a history that is not known.
        NotConverged
            If the model has no solution.

        Examples
        --------
        >>> m = open_map("maps/out/remembering.h5")                                   # doctest: +SKIP
        >>> memory = m.memory("shaken", currents=1.55)                                # doctest: +SKIP
        >>> memory = memory.step([1.6, 1.5, 1.5, 1.6, 1.5, 1.5])                      # doctest: +SKIP
        >>> memory.field([0, 0, -0.09], memory.last_currents)                         # doctest: +SKIP
        """
        model = self._remembering("memory")
        level = _usual_level(model) if currents is None else self._amperes(currents)
        never = model.remembering(np.zeros(0))
        return self._with(never.along(history_of_currents(history, level)))

    def step(self, currents: Any) -> FieldMap:
        """This map after a straight path of the currents, which its iron remembers. A path that turns back needs a step
        to the turning point.

        Parameters
        ----------
        currents
            End of the path, A: (n_coils,), one number for all coils, or a mapping by name.

        Returns
        -------
        FieldMap
            A map with the same fields; this one keeps its memory.

        Raises
        ------
        InputError
            For a map of iron without hysteresis.
        OutsideMapError
            For currents beyond the domain, unless the map was opened with outside_currents="evaluate".
        NotConverged
            If the model has no solution.
        """
        return self._with(self._remembering("step").stepped(self._amperes(currents)))

    def after_loop(self, currents: Any, swing: ArrayLike) -> FieldMap:
        """This map in the middle of the second of two loops about currents, after a straight path to these currents.

        The memory is at the currents plus `swing`. The fields there and at the currents minus `swing`, the other end of
        the loop, give the slope of the loop: docs/theory/hysteresis.md (6).

        Parameters
        ----------
        currents
            Middle of the loops, A: (n_coils,), one number for all coils, or a mapping by name.
        swing
            Change (n_coils,) of the currents to either side, A.

        Returns
        -------
        FieldMap
            A map with the same fields; this one if its iron has no hysteresis.

        Raises
        ------
        NotConverged
            If the model has no solution.

        Examples
        --------
        >>> m = open_map("maps/out/remembering.h5")                                   # doctest: +SKIP
        >>> looped, place = m.after_loop(1.55, 6 * [0.02]), [0, 0, -0.09]             # doctest: +SKIP
        >>> slope = (looped.field(place, 1.57) - looped.field(place, 1.53)) / 0.04    # doctest: +SKIP
        """
        if self._model is None or not self.remembers:
            return self
        return self._with(self._model.after_loop(self._amperes(currents), self._amperes(swing)))

    @property
    def last_currents(self) -> Array:
        """Currents (n_coils,), A, of the memory: of the last step, or at the end of the history. Raises InputError for
        a map of iron without hysteresis."""
        return self._remembering("last_currents").last_currents

    @property
    def dissipated(self) -> float:
        """Hysteresis loss, J: heat in the iron since it was demagnetised, including its history.

        Each step adds equation (5) of docs/theory/hysteresis.md, which is never negative. The heat of a path is the
        difference between two memories; over a closed cycle it is the energy that the coils deliver. Eddy-current
        losses are not included. Raises InputError for a map of iron without hysteresis.

        Examples
        --------
        >>> m = open_map("maps/out/remembering.h5")                                   # doctest: +SKIP
        >>> before = m.memory("shaken")                                               # doctest: +SKIP
        >>> after = before.step(2.0).step(before.last_currents)                       # doctest: +SKIP
        >>> print(f"{after.dissipated - before.dissipated:.2g} J")                    # doctest: +SKIP
        """
        return self._remembering("dissipated").dissipated

    @property
    def remembered(self) -> Array:
        """The memory as numbers (n,), which `recalled` restores bit for bit. Raises InputError for a map of iron
        without hysteresis."""
        return self._remembering("remembered").remembered.copy()

    def recalled(self, remembered: ArrayLike) -> FieldMap:
        """This map with a memory that was stored.

        Parameters
        ----------
        remembered
            Numbers (n,) of `remembered`, of this map or of another opened from the same file.

        Returns
        -------
        FieldMap
            A map with the same fields.

        Raises
        ------
        InputError
            For a map of iron without hysteresis, and for numbers of another map.
        """
        model, numbers = self._remembering("recalled"), np.array(remembered, dtype=np.float64)
        wanted = model.remembered.shape
        good = numbers.shape == wanted and bool(np.isfinite(numbers).all())
        remedy = "store `remembered` of a map that was opened from the same file"
        check(good, "recalled(remembered)", f"finite numbers {wanted}", f"numbers {numbers.shape}", remedy)
        return self._with(model.remembering(numbers))

    def _remembering(self, name: str) -> CurrentModel:
        if self._model is None or not self.remembers:
            must_hold = "a map of iron with hysteresis"
            remedy = 'make one: model = "hysteresis" under [iron], of materials with coercive_field_A_per_m'
            raise InputError.of(f"FieldMap.{name}", must_hold, "a map without", remedy)
        return self._model

    def _with(self, model: CurrentModel) -> FieldMap:
        # A copy keeps nothing of the last call: see __getstate__.
        other = copy(self)
        other._model = model
        return other

    @property
    def fixed_sources(self) -> tuple[str, ...]:
        """Names of the sources without current: bodies that are magnets, and "background"."""
        return self._info.fixed_sources

    @property
    def assumptions(self) -> tuple[str, ...]:
        """The assumptions of the map, recorded when it was made."""
        return tuple(self._info.provenance.assumptions)

    @property
    def error_bound(self) -> FieldError | None:
        """Certified bound on B (T) and gradient (T/m) against the solver, anywhere in the box, for currents up to the
        reference currents; docs/theory/lookup.md (13). For saturating iron it holds in the domain of the currents, and
        leaves out the error of the model of the iron, `current_error`.

        None for the Hermite form, and if sources are too near for a certificate. `interpolation_error` needs no
        certificate, but is only the largest of sampled differences.
        """
        return self._info.error_bounds.get(self.kind)

    @property
    def interpolation_error(self) -> FieldError | None:
        """Largest difference found, T and T/m, summed over all coils, each at its reference current.

        Hermite form: to the solver at points sampled when the map was made, None if unknown. Harmonic forms:
        to the map at all of its nodes, or the step between cells (`jump`) if it is larger: the fits of two cells can
        err in opposite directions on their common face. The error of the map at its nodes is not included.
        """
        misfit = self._form.misfit
        if misfit is None:
            return self._info.interpolation_error
        jump = self._jump
        return FieldError(max(misfit.flux_density, jump.flux_density), max(misfit.gradient, jump.gradient))

    @property
    def nbytes(self) -> int:
        """Size of the coefficients of all coils, bytes."""
        return self._form.unit.nbytes

    def jump(self) -> Jump:
        """Largest step of B and gradient between neighbouring cells: sampled, and a bound on all of a face.

        Zero for the Hermite and the global form, whose field and gradient are continuous.
        """
        return self._jump

    @cached_property
    def _jump(self) -> Jump:
        jump = INTERPOLANTS[self.kind].jump
        return Jump() if jump is None else jump(self._form, self._info)

    @property
    def current_error(self) -> FieldError | None:
        """Saturating iron: largest difference, T and T/m, between the model of the currents and the solver at all
        tested states; in maps of earlier versions only at states outside the training. None if the field is linear in
        the currents."""
        return self._info.current_error

    @property
    def current_table(self) -> CurrentTable | None:
        """The table that replaces the model of the currents, with its own error; None unless asked for."""
        return self._table

    def gradient_jump(self, currents: Array) -> float:
        """Bound on the step of the gradient from cell to cell.

        Parameters
        ----------
        currents
            Currents (n_coils,), A.

        Returns
        -------
        float
            The bound, T/m.
        """
        share = np.abs(currents / self._info.reference_current).max(initial=1.0)
        return self._jump.gradient_bound * float(share)

    def at(self, currents: Any) -> MapAtCurrents:
        """The field at these currents, summed once. The last result is cached.

        Parameters
        ----------
        currents
            Currents, A: (n_coils,) in the order of `coil_names`, one number for all coils, or a mapping by
            name.

        Returns
        -------
        MapAtCurrents
            The field, a function of points alone.

        Raises
        ------
        OutsideMapError
            For currents beyond the domain of a map of saturating iron, by the rule `outside_currents`.
        """
        amperes = self._amperes(currents)
        key = amperes.tobytes()
        known, fixed = self._last
        if known != key or fixed is None:
            weights, evaluator = self._weights(amperes), self._evaluator
            each = self._few == sys.maxsize
            about = self.assumptions, weights[None] if each else None, self._reaction
            summed = evaluator if each else evaluator.at(weights)
            fixed = MapAtCurrents(summed, self._box, self.coil_names, amperes.copy(), *about)
            # One assignment of one tuple: another thread sees the old pair or the new one, never a mixture.
            self._last = (key, fixed)
        return fixed

    def outlines(self) -> tuple[Outline, ...]:
        """The box of the map; windings and iron, as convex shapes, of the device that the map was made of."""
        from fieldmap.device.drawing import body_outlines, box_outline, winding_outline
        from fieldmap.device.reader import recorded_device

        text = self._info.provenance.device_text
        device = recorded_device(text, solids=True) if text else None
        around = (
            box_outline(f"map of {self._info.provenance.device_name or 'a field'}", self.lower, self.upper),
        )
        if device is None:
            return around
        return body_outlines(device.bodies) + tuple(winding_outline(coil) for coil in device.coils) + around

    def as_magpylib(self, currents: Any, **options: Any) -> Any:
        """The map at these currents as a magpylib source, NaN outside: see `FieldAtCurrents.as_magpylib`.

        Parameters
        ----------
        currents
            Currents, A: (n_coils,) in the order of `coil_names`, one number for all coils, or a mapping by
            name.
        **options
            Position, orientation and style of the source.

        Returns
        -------
        Any
            The source.

        Raises
        ------
        InputError
            For options that magpylib refuses.
        """
        from fieldmap.magpylib_source import source_of_field

        return source_of_field(self.at(currents), self.bounds, self.outlines, **options)

    def compiled(self, currents: Any = None) -> tuple[Any, Any]:
        """The lookup for your own numba functions, without Python objects.

        B is a tuple of three in T, G a tuple of three rows, `G[i][j]` = dB_i/dx_j in T/m. Outside the box the result is
        NaN, or with outside="clamp" that of the nearest point; a compiled function cannot raise OutsideMapError.

        `data` holds the address of the map and keeps the map alive: keep it as long as the function that uses it. It is
        valid in this process only. In another one, for example as a global of a function that numba caches, results are
        NaN. For saturating iron without given currents `data` stores the last state, at which the next solve begins:
        call `compiled` once in each thread. Errors exceed those of `field` by at most a fifth of `current_error`.
        Currents beyond the domain give NaN, unless outside_currents="evaluate". With tabulate_currents `data` stores no
        state, and currents beyond the table give NaN.

        Parameters
        ----------
        currents
            Fixed currents, as for `field`; None for currents that change from call to call.

        Returns
        -------
        tuple[Any, Any]
            (function, data). With currents: B, G = function(data, x, y, z). Without: B, G = function(data,
            currents, x, y, z), the currents a float64 array (n_coils,).

        Raises
        ------
        InputError
            For a map whose evaluator is not the C core.
        """
        if currents is not None:
            return self.at(currents).compiled()
        words = caller(self._evaluator.core(), self._weights_of_callers())
        # Imported here: numba is needed only for compiled functions.
        from fieldmap.lookup.compiled import at_currents

        return at_currents, words

    def _weights_of_callers(self) -> IronState | CoreTable | None:
        """The model or table that gives compiled callers the weights; None if the currents are the weights."""
        if self._table is not None:
            return self._table.core
        return None if self._model is None else self._model.state_of_caller()

    def field(self, points: ArrayLike, currents: Any, out: Array | None = None) -> Array:
        """Flux density at points.

        Parameters
        ----------
        points
            Positions (3,), (n, 3) or (..., 3) in the frame of the field, m.
        currents
            Currents, A: (n_coils,) in the order of `coil_names` for all points, or (n, n_coils), a row for
            each; one number for all coils, or a mapping by name, with zero for coils left out.
        out
            Array of the result's shape, float64 and C order, that is filled and returned; a new one unless
            given.

        Returns
        -------
        Array
            B (..., 3), T.

        Raises
        ------
        OutsideMapError
            For points outside the box and currents beyond the domain, by the rules given to `open_map`.
        """
        if out is None and getattr(points, "ndim", 0) == 1:
            return self.field_and_gradient(points, currents)[0]
        return self._pair(points, currents, out, None, gradient=False)[0]

    def gradient(self, points: ArrayLike, currents: Any, out: Array | None = None) -> Array:
        """Gradient of the flux density: the exact derivative of `field`.

        Parameters
        ----------
        points
            Positions (3,), (n, 3) or (..., 3) in the frame of the field, m.
        currents
            Currents, A: (n_coils,) in the order of `coil_names` for all points, or (n, n_coils), a row for
            each; one number for all coils, or a mapping by name, with zero for coils left out.
        out
            Array of the result's shape, float64 and C order, that is filled and returned; a new one unless
            given.

        Returns
        -------
        Array
            G (..., 3, 3), G[..., i, j] = dB_i/dx_j, T/m.

        Raises
        ------
        OutsideMapError
            As for `field`.
        """
        if out is None and getattr(points, "ndim", 0) == 1:
            return self.field_and_gradient(points, currents)[1]
        return self._pair(points, currents, None, out)[1]

    def field_and_gradient(
        self, points: ArrayLike, currents: Any, out: tuple[Array, Array] | None = None
    ) -> tuple[Array, Array]:
        """Flux density and its gradient in one pass.

        Parameters
        ----------
        points
            Positions (3,), (n, 3) or (..., 3) in the frame of the field, m.
        currents
            Currents, A: (n_coils,) in the order of `coil_names` for all points, or (n, n_coils), a row for
            each; one number for all coils, or a mapping by name, with zero for coils left out.
        out
            Two arrays of the results' shapes that are filled and returned; new ones unless given.

        Returns
        -------
        tuple[Array, Array]
            B (..., 3), T, and G (..., 3, 3), T/m.

        Raises
        ------
        OutsideMapError
            As for `field`.
        """
        weights = currents if self._model is None else self._known_weights(currents)
        quick = out is None and weights is not None
        found = self._evaluator.field_at(points, weights) if quick else None
        if found is not None:
            return found
        return self._pair(points, currents, *((None, None) if out is None else out))

    @of_any_shape
    def _pair(
        self,
        points: ArrayLike,
        currents: Any,
        flux: Array | None,
        slope: Array | None,
        gradient: bool = True,
    ) -> tuple[Array, Array]:
        """As `MapAtCurrents._pair`, at points of any shape and currents for all of them or for each."""
        return self._lookup(points, currents)._pair(points, flux, slope, gradient)

    def second_gradient(self, points: ArrayLike, currents: Any) -> Array:
        """Second derivatives of the flux density.

        Hermite form: error O(spacing^2), discontinuous across the faces of the cells. Harmonic: O(spacing^3).

        Parameters
        ----------
        points
            Positions (3,), (n, 3) or (..., 3) in the frame of the field, m.
        currents
            Currents, A: (n_coils,) in the order of `coil_names` for all points, or (n, n_coils), a row for
            each; one number for all coils, or a mapping by name, with zero for coils left out.

        Returns
        -------
        Array
            (..., 3, 3, 3), [..., i, j, k] = d2B_i/dx_j dx_k, T/m^2.

        Raises
        ------
        OutsideMapError
            As for `field`.
        """
        return self._lookup(points, currents).second_gradient(points)

    def potential(self, points: ArrayLike, currents: Any) -> Array | float:
        """Scalar potential U with B = -grad U; zero near the middle of the box.

        Harmonic forms: -grad U is `field` to rounding. Hermite form: an interpolant of its own, -grad U is
        `field` to the interpolation error.

        Parameters
        ----------
        points
            Positions (3,), (n, 3) or (..., 3) in the frame of the field, m.
        currents
            Currents, A: (n_coils,) in the order of `coil_names` for all points, or (n, n_coils), a row for
            each; one number for all coils, or a mapping by name, with zero for coils left out.

        Returns
        -------
        Array | float
            U (...), T m.

        Raises
        ------
        OutsideMapError
            As for `field`.
        """
        return self._lookup(points, currents).potential(points)

    def wrench(
        self,
        positions: ArrayLike,
        moments: ArrayLike | MagneticLoad,
        currents: Any,
        orientations: ArrayLike | None = None,
    ) -> Array:
        """Force and torque on point dipoles, or on a body, about their own positions.

        T = m x B and F = grad(m . B) = (grad B)^T m, docs/theory/wrench.md (1) and (2) for a point, (5)..(10)
        for a body. F is (m . grad) B for a curl-free B. For a fixed moment F is conservative even if the interpolant is
        not exactly curl-free. Force and torque are finite everywhere in the box.

        Parameters
        ----------
        positions
            Positions of the dipoles or of the body's centre (3,), (n, 3) or (..., 3) in the frame of the
            field, m.
        moments
            Moments (3,) or (n, 3), A m^2, in the frame of the field; or a `MagneticBody`: soft iron, several magnets,
            or a magnet of finite size.
        currents
            Currents, A: (n_coils,) in the order of `coil_names` for all points, or (n, n_coils), a row for
            each; one number for all coils, or a mapping by name, with zero for coils left out.
        orientations
            Rotations (3, 3) or (n, 3, 3) of a body, with its axes as columns; upright unless given.

        Returns
        -------
        Array
            Force, N, and torque, N m (..., 6).

        Raises
        ------
        OutsideMapError
            As for `field`.
        """
        if orientations is None:
            weights = currents if self._model is None else self._known_weights(currents)
            load = None if weights is None else self._evaluator.dipole_wrench_at(positions, moments, weights)
            if load is not None:
                return load
        return super().wrench(positions, moments, currents, orientations)

    def readings(
        self,
        positions: ArrayLike,
        moments: ArrayLike | MagneticBody,
        currents: Any,
        orientations: ArrayLike | None = None,
    ) -> Array:
        """Readings of the field sensors of the device: docs/field_sensors.md (1).

        Parameters
        ----------
        positions, moments, currents, orientations
            As for `wrench`.

        Returns
        -------
        Array
            Flux densities along the axes of the sensors (..., s), T.

        Raises
        ------
        InputError
            For a map without sensors.
        OutsideMapError
            As for `field`.

        Examples
        --------
        >>> m.readings([0, 0, -0.09], [0, 0, 0.8], currents=1.5)                             # doctest: +SKIP
        """
        return self._read(positions, moments, currents, orientations, slopes=False)[0]

    def readings_and_slopes(
        self,
        positions: ArrayLike,
        moments: ArrayLike | MagneticBody,
        currents: Any,
        orientations: ArrayLike | None = None,
    ) -> tuple[Array, Array]:
        """`readings`, and their derivatives by the pose: the sensitivity of the sensors.

        Parameters
        ----------
        positions, moments, currents, orientations
            As for `readings`; a body of magnets alone.

        Returns
        -------
        tuple[Array, Array]
            Readings (..., s), T, and derivatives (..., s, 6) by the place, T/m, and by a rotation about the axes of the
            field through the given position, T/rad.

        Raises
        ------
        InputError
            As for `readings`, and for a body with soft iron.
        OutsideMapError
            As for `field`.
        """
        if isinstance(moments, MagneticBody) and moments.soft:
            must_hold, remedy = (
                "a body of magnets alone",
                "leave the soft iron out, or take differences of `readings`",
            )
            raise InputError.of("readings_and_slopes, moments", must_hold, "soft iron", remedy)
        return self._read(positions, moments, currents, orientations, slopes=True)

    def _read(
        self, positions: ArrayLike, moments: Any, currents: Any, orientations: ArrayLike | None, slopes: bool
    ) -> tuple[Array, Array]:
        if self._sensors is None:
            remedy = "give the device [[sensor]] tables and make the map with this version"
            raise InputError.of("readings", "a map with field sensors", "a map without", remedy)
        where, single = checked_vectors("positions", positions)
        if isinstance(moments, MagneticBody):
            arms, dipoles = moments.dipoles(self, where, currents, orientations)
        else:
            arms = np.zeros((len(where), 1, 3))
            dipoles = np.broadcast_to(checked_vectors("moments", moments)[0], where.shape)[:, None]
        own = self._sensors.of_currents(self._weights(self._amperes(currents, len(where))))
        read, by_pose = self._sensors.of_magnets(where, arms, dipoles, slopes)
        return (read[0] + own, by_pose[0]) if single else (read + own, by_pose)

    def actuation(
        self,
        position: ArrayLike,
        currents: Any,
        moment: ArrayLike | MagneticBody | None = None,
        orientation: ArrayLike | None = None,
        loop: float | None = None,
    ) -> Actuation:
        """Actuation matrix at a position, for linear or saturating iron.

        `matrix @ i + constant` is the map to first order about the currents. It is exact if the map superposes and the
        body has no soft iron: docs/theory/actuation.md.

        Parameters
        ----------
        position
            Position (3,) in the frame of the field, m.
        currents
            Currents about which the matrix holds, A, as for `field`.
        moment
            Moment of a dipole (3,), A m^2, or a `MagneticBody`; None for the rows of the field alone.
        orientation
            Rotation (3, 3) of a body, with its axes as columns; upright unless given.
        loop
            Size of current loops, A, whose slopes replace the derivatives, as for `by_currents`.

        Returns
        -------
        Actuation
            Rows: flux density, T/A, and five entries of its gradient, T/(m A); with a moment force, N/A, and
            torque, N m/A, below them.

        Raises
        ------
        OutsideMapError
            As for `field`.
        InputError
            For a loop that is not positive.
        """
        return actuation(self, position, currents, moment, orientation, loop)

    def flux_linkage(
        self,
        currents: Any,
        position: ArrayLike | None = None,
        moment: ArrayLike | MagneticBody | None = None,
        orientation: ArrayLike | None = None,
    ) -> Array:
        """Flux linkages of the coils, all turns, including the linkages with a payload if one is given.

        Linkages, force and torque are derivatives of one co-energy, docs/theory/flux_linkage.md. The iron's `reaction`
        to the payload does not depend on the currents, so the linkages do not contain it.

        Parameters
        ----------
        currents
            Currents, A: (n_coils,), one number for all coils, or a mapping by name.
        position
            Position (3,) of a payload in the frame of the field, m; no payload unless given.
        moment
            Moment of a dipole (3,), A m^2, or a `MagneticBody`.
        orientation
            Rotation (3, 3) of a body, with its axes as columns; upright unless given.

        Returns
        -------
        Array
            Linkages (n_coils,), Wb.

        Raises
        ------
        InputError
            For a map without linkages, with the reason; for a position without a moment, or the other way round.
        OutsideMapError
            For currents beyond the domain of a map of saturating iron, and for a position outside the box.

        Examples
        --------
        >>> m = open_map("maps/out/desk_levitator.h5")                                # doctest: +SKIP
        >>> m.flux_linkage(1.0), m.flux_linkage(0.0, [0, 0, -0.02], [0, 0, 1.2])      # doctest: +SKIP
        """
        both = (position is None) == (moment is None)
        must_hold, remedy = "both must be given, or neither", "give the payload's place and its moment"
        check(both, "flux_linkage(position, moment)", must_hold, "one of them", remedy)
        amperes, known = coil_currents(currents, self.coil_names), self._linkages()
        found = known.constant + known.inductance @ amperes
        if self._model is not None:
            found = found + self._model.linkages(amperes)[0]
        if position is None or moment is None:
            return np.asarray(found)
        return np.asarray(found + payload_linkage(self, position, amperes, moment, orientation))

    def inductance(self, currents: Any = 0.0) -> Array:
        """Incremental inductances: the derivatives of `flux_linkage`, without a payload, by the currents.

        For iron with hysteresis they belong to infinitesimal loops from the memory.

        Parameters
        ----------
        currents
            Currents, A: (n_coils,), one number for all coils, or a mapping by name. Not used for linear iron.

        Returns
        -------
        Array
            (n_coils, n_coils), H, symmetric.

        Raises
        ------
        InputError, OutsideMapError
            As for `flux_linkage`.
        """
        known = self._linkages()
        if self._model is None:
            return known.inductance
        added = self._model.linkages(coil_currents(currents, self.coil_names), inductance=True)[1]
        return np.asarray(known.inductance + added)

    def back_emf(
        self,
        position: ArrayLike,
        currents: Any,
        moment: ArrayLike | MagneticBody,
        velocity: ArrayLike,
        angular_velocity: ArrayLike = (0.0, 0.0, 0.0),
        orientation: ArrayLike | None = None,
    ) -> Array:
        """Voltages that the motion of a payload induces in the coils at constant currents: see
        `fieldmap.lookup.back_emf`.

        Parameters
        ----------
        position, currents, moment, orientation
            As for `flux_linkage`.
        velocity
            Velocity of the position (3,), m/s.
        angular_velocity
            (3,), rad/s, in the frame of the field.

        Returns
        -------
        Array
            Voltages (n_coils,), V.

        Raises
        ------
        OutsideMapError
            As for `flux_linkage`.
        """
        return back_emf(self, position, currents, moment, velocity, angular_velocity, orientation)

    @property
    def linkage(self) -> StoredLinkage | None:
        """Linkages of the coils in the file, to which saturating iron adds its own; None if the file has none."""
        return self._linkage

    def _linkages(self) -> StoredLinkage:
        if self._linkage is not None:
            return self._linkage
        lacking = self._info.provenance.solver_report.get("without_linkage")
        received = f"one without: {lacking}" if lacking else "one of an earlier version, without"
        must_hold, remedy = "a map with the flux linkages of its coils", "make the map again"
        if lacking:
            remedy = "correct the device and make the map again"
        raise InputError.of("flux linkages", must_hold, received, remedy)

    def currents_for(
        self,
        position: ArrayLike,
        force: ArrayLike | None = None,
        moment: ArrayLike | MagneticBody | None = None,
        limits: Limits = None,
        *,
        torque: ArrayLike | None = None,
        field: ArrayLike | None = None,
        gradient: ArrayLike | None = None,
        resistance: ArrayLike | None = None,
        start: ArrayLike | None = None,
        orientation: ArrayLike | None = None,
        direction: ArrayLike | None = None,
        least_field: float = 0.0,
    ) -> Array:
        """Currents of least power, sum(resistance currents^2), that meet a demand at a position.

        At a place of symmetry currents may meet more components than there are coils. A component that no currents meet
        to 1e-4 of the largest component of its unit is refused.

        With saturating iron in the map, or soft iron in a body, the problem is nonlinear, and a search finds a local
        optimum within 500 evaluations of the field. In a map over a current parametrisation the search varies the
        signals within their domain, and the power is least if each coil follows one signal.

        Parameters
        ----------
        position
            (3,), m, of the dipole, or of the centre of the body.
        force, torque
            (3,), N and N m. NaN leaves a component free, here and in `field` and `gradient`.
        moment
            (3,), A m^2, of a dipole, or a `MagneticBody`; with `direction` the size of the moment, one number.
        limits
            A; a number for both directions, or (lower, upper), each a number or one per coil.
        field
            (3,), T.
        gradient
            (3, 3), T/m, of which the five independent entries count.
        resistance
            A number, or (n_coils,), of each coil if they differ.
        start
            Currents (n_coils,), A, from which a search begins.
        orientation
            (3, 3), whose columns are the axes of the body; upright without.
        direction
            (3,), for a magnet that follows the field: B points along it, with any magnitude, and the force acts on a
            moment along it.
        least_field
            With `direction`: least B along it, T; any positive B unless given.

        Returns
        -------
        Array
            Currents (n_coils,), A.

        Raises
        ------
        Infeasible
            The message names the limits that bind and the share of the demand that is possible. After a search it says
            where the search ended, which is no proof that no currents exist. With `direction` also if B points against
            it at the currents of least power, so that the magnet would turn over.
        OutsideMapError, InputError, NotConverged
            For a place outside the box, for arguments that do not fit, and for a search that does not converge.

        Examples
        --------
        >>> m = open_map("workspace.h5")                                                     # doctest: +SKIP
        >>> m.currents_for([0, 0, -0.1], force=[0, 0, 0.11], moment=[0, 0, 0.8], limits=3.5)  # doctest: +SKIP
        """
        load = moment if direction is not None or moment is None else loaded(self, moment)
        demand = demand_of(force, load, torque, field, gradient, direction, least_field)
        fields = self._fields_of_currents()
        return least_power_currents(fields, position, demand, limits, resistance, start, orientation)

    def _fields_of_currents(self) -> SumOfFields:
        """The field in the form that `least_power_currents` takes."""
        each = self._evaluator.each_field
        return SumOfFields(each, self.coil_names, self._constant, self._model, self._reaction)

    def to_xarray(self, currents: Any = None) -> xarray.Dataset:
        """B and gradient on the nodes, with coordinates, units and attributes.

        Parameters
        ----------
        currents
            Currents as for `field`; None for the fields per ampere.

        Returns
        -------
        xarray.Dataset
            At currents `flux_density` (x, y, z, component), T, `gradient` (x, y, z, component, direction) =
            dB_component/dx_direction, T/m, and `current` (coil). Without: `unit_flux_density` and
            `unit_gradient`, per ampere, with the dimension `coil` after z, and, for a map with fixed sources,
            `constant_flux_density` and `constant_gradient`.

        Raises
        ------
        FieldmapError
            If xarray is not installed.
        InputError
            For a map of saturating iron without currents.
        """
        from fieldmap.lookup.data_set import data_set

        nodes = np.clip(self.info.grid.points(), self.lower, self.upper)
        if currents is None:
            off = self.at(0.0).field_and_gradient(nodes) if self._constant else None
            unit = self.unit_field(nodes), self.unit_gradient(nodes)
            return data_set(self.info, self.kind, None, *unit, off)
        amperes = coil_currents(currents, self.coil_names)
        return data_set(self.info, self.kind, amperes, *self.at(amperes).field_and_gradient(nodes))

    def unit_field(self, points: ArrayLike) -> Array:
        """Flux density per ampere in each coil.

        Parameters
        ----------
        points
            Positions (3,), (n, 3) or (..., 3) in the frame of the field, m.

        Returns
        -------
        Array
            B per ampere (..., n_coils, 3), T/A.

        Raises
        ------
        InputError
            For a map of saturating iron.
        """
        flux, _, single = self._units(points, 0)
        return flux[0] if single else flux

    def unit_gradient(self, points: ArrayLike) -> Array:
        """Gradient per ampere in each coil.

        Parameters
        ----------
        points
            Positions (3,), (n, 3) or (..., 3) in the frame of the field, m.

        Returns
        -------
        Array
            dB_i/dx_j per ampere (..., n_coils, 3, 3), T/(m A).

        Raises
        ------
        InputError
            For a map of saturating iron.
        """
        _, slope, single = self._units(points, 3)
        return slope[0] if single else slope

    def by_currents(
        self, points: ArrayLike, currents: Any, loop: float | None = None
    ) -> tuple[Array, Array, Array, Array]:
        """Flux density and gradient, and their derivatives by the currents.

        For a map that superposes, the derivatives are `unit_field` and `unit_gradient` at any currents. For saturating
        iron they are derivatives of the model, and the map's stated error does not cover them. For the shipped drive
        unit they are within 3 % of the solver's along the signals of its division, typically 1 %. The training of a map
        for divided currents has no state of a single coil, so derivatives by the current of one coil have errors of up
        to 42 %, typically 5 % (docs/theory/current_dependence.md).

        For iron with hysteresis they are, at the currents of the memory, the reversible slopes, of infinitesimal loops;
        at other currents they are the derivatives at the end of the straight path. With `loop` they are slopes between
        the ends of the second of two loops about the currents, after a straight path from the memory
        (docs/theory/hysteresis.md, (6)). For iron without hysteresis these slopes are central differences.

        Parameters
        ----------
        points
            Positions (n, 3) in the frame of the map, m.
        currents
            Currents (n_coils,), A.
        loop
            Amplitude of the loops, A, of the current that changes most. One signal of the map's parametrisation swings
            at a time; with independent currents one coil. Derivatives unless given.

        Returns
        -------
        tuple[Array, Array, Array, Array]
            B (n, 3), T; G (n, 3, 3), T/m; dB/dI (n, n_coils, 3), T/A; dG/dI (n, n_coils, 3, 3), T/(m A).

        Raises
        ------
        OutsideMapError
            As for `field`, and for loops beyond the domain.
        InputError
            For a loop that is not positive.
        """
        amperes = self._amperes(currents)
        if loop is not None:
            check_positive("by_currents", loop=loop)
        if self._model is None:
            both = self.field_and_gradient(points, amperes)
            return *both, self.unit_field(points), self.unit_gradient(points)
        weights, slopes = self._model.weights_and_slopes(amperes, loop)
        where, single = checked_vectors("points", points)
        n, coils = len(where), len(amperes)
        flux, slope = np.empty((n, len(slopes), 3)), np.empty((n, len(slopes), 3, 3))
        in_chunks(self._evaluator.each_field, where, [flux, slope], self._box)
        # The weights themselves and their derivatives by every coil.
        mix = np.vstack([weights, slopes.T])
        all_flux, all_slope = mix @ flux, (mix @ slope.reshape(n, -1, 9)).reshape(n, coils + 1, 3, 3)
        found = all_flux[:, 0], all_slope[:, 0], all_flux[:, 1:], all_slope[:, 1:]
        return (found[0][0], found[1][0], found[2][0], found[3][0]) if single else found

    def _units(self, points: ArrayLike, wanted: int) -> tuple[Array, Array, bool]:
        require_affine(self, "unit_field")
        where, single = checked_vectors("points", points)
        coils = len(self.coil_names)
        shape = (len(where), coils + self._constant)
        flux, slope = np.empty((*shape, 3)), np.empty((*shape, wanted, wanted))
        in_chunks(self._evaluator.each_field, where, [flux, slope], self._box)
        return flux[:, :coils], slope[:, :coils], single

    def _lookup(self, points: ArrayLike, currents: Any) -> MapAtCurrents:
        """The field at these currents, or at a row of currents for each of n points.

        For many points at one set of currents the fields are summed first (`at`). For few points they are superposed at
        each point. The choice depends on the sizes alone, so that equal calls give equal bits.
        """
        count = len(checked_vectors("points", points)[0])
        amperes = self._amperes(currents, count)
        if amperes.ndim == 1 and count > self._few:
            return self.at(currents)
        weights = np.atleast_2d(self._weights(amperes))
        return MapAtCurrents(
            self._evaluator, self._box, self.coil_names, amperes, (), weights, self._reaction
        )

    def _amperes(self, currents: Any, points: int | None = None) -> Array:
        # NaN gives NaN in its row.
        return coil_currents(currents, self.coil_names, points, finite=False)

    def _weights(self, currents: Array) -> Array:
        """Weights (..., n_fields) of the map's fields at currents (..., n_coils): the currents, with 1 after them for a
        constant field, or the weights by the model of saturating iron. The last single set is cached."""
        model = self._table or self._model
        if model is None:
            if not self._constant:
                return currents
            return np.concatenate([currents, np.ones((*currents.shape[:-1], 1))], axis=-1)
        if currents.ndim == 2:
            return model.weights(currents)
        key = currents.tobytes()
        known, weights = self._last_weights
        if known != key:
            weights = model.weights(currents)
            self._last_weights = (key, weights)
        return weights

    def _known_weights(self, currents: Any) -> Array | None:
        """For saturating iron the weights at the currents of the last call; None for other currents."""
        known, weights = self._last_weights
        if isinstance(currents, np.ndarray) and currents.dtype == np.float64 and currents.tobytes() == known:
            return weights
        return None

    def __getstate__(self) -> dict[str, object]:
        return {**self.__dict__, "_last": (b"", None), "_last_weights": (b"", np.empty(0))}

    def _repr_html_(self) -> str:
        bound = self.error_bound
        corners = (" x ".join(f"{1e3 * x:g}" for x in corner) for corner in self.bounds)
        rows = {
            "of": self.info.provenance.title or self.info.provenance.device_name,
            "coils": ", ".join(self.coil_names),
            "iron": "linear: any currents" if self.affine else "saturating: the currents of its domain",
            "without currents": ", ".join(self.fixed_sources) or "no field",
            "box": " to ".join(corners) + " mm",
            "size": f"{self.info.grid.size} nodes, {self.nbytes / 1e6:.1f} MB of coefficients",
            **_errors_in_words(bound, self.current_error),
        }
        return card(f"FieldMap, {self.kind}", rows)

    def __repr__(self) -> str:
        corners = ", ".join(
            f"{low * 1e3:g} to {high * 1e3:g}" for low, high in zip(self.lower, self.upper, strict=True)
        )
        size = self._info.grid.size
        coils = count_of(len(self.coil_names), "coil", "coils")
        return f"FieldMap({self.kind}, {coils}, box {corners} mm, {size} nodes)"


def _errors_in_words(bound: FieldError | None, of_model: FieldError | None) -> dict[str, str]:
    """The certified error, which for saturating iron covers the interpolation alone, and the error of its model."""
    certified = "not certified"
    if bound is not None:
        certified = f"at most {bound.flux_density:.2g} T and {bound.gradient:.2g} T/m"
    if of_model is None:
        return {"error": certified if bound is None else f"{certified} against the solver"}
    found = f"up to {of_model.flux_density:.2g} T and {of_model.gradient:.2g} T/m found at solved states"
    return {"error of the interpolation": certified, "error of the current model": found}


def open_map(
    path: PathLike,
    kind: str = "harmonic",
    outside: str = "raise",
    threads: int | None = None,
    outside_currents: str = "raise",
    follow_currents: bool = False,
    tabulate_currents: bool = False,
    reaction: bool = True,
) -> FieldMap:
    """Read and check a map file, and make it ready for lookups.

    Parameters
    ----------
    path
        Path of the file, or the name of the shipped map ("sample").
    kind
        "harmonic", one harmonic polynomial per cell; "hermite", the tricubic Hermite interpolant, continuous
        from cell to cell; "global", one polynomial for the whole box (docs/lookup.md: which to take when).
    outside
        What a point outside the map's box gives: "raise" (OutsideMapError), "nan", or "clamp" (the nearest
        point of the box).
    threads
        Threads for large batches; one per processor unless given.
    outside_currents
        What currents beyond the domain of a map of saturating iron give: "raise" (OutsideMapError), "nan", or
        "evaluate", without a statement of the error there.
    follow_currents
        For a map of saturating iron: begin each solve at the last state, which is quicker along a trajectory. Results
        then depend on earlier calls, by 1e-6 at most.
    tabulate_currents
        For a map of saturating iron over a current division: tabulate the model once, which takes seconds. A change of
        the currents then costs microseconds, also from compiled code. `current_table.error` is the error of the table.
    reaction
        Whether forces on magnets include the iron's reaction to them, if the map holds it.

    Returns
    -------
    FieldMap
        The map, ready for lookups.

    Raises
    ------
    MapFileError
        If the file is no complete, undamaged map.
    InputError
        For an unknown kind or outside rule, if no single polynomial fits the map ("global"), or if there is nothing to
        tabulate.

    Warns
    -----
    MapAccuracyWarning
        For a map whose current model has more than twice the error that its recipe asks for.

    Examples
    --------
    >>> m = open_map("maps/out/workspace.h5")                                     # doctest: +SKIP
    >>> m.field([0, 0, -0.09], currents=[1, 1, 1, 1, 1, 1])                       # doctest: +SKIP
    """
    if not isinstance(path, str | os.PathLike):
        raise InputError(_no_path(path))
    check_choices(kind, outside, outside_currents)
    rules = outside_currents, follow_currents, tabulate_currents
    data = read_for_lookup(path)
    warn_of_missed_accuracy(path, data.provenance.solver_report, stacklevel=2)
    return interpolate(data, kind, outside, threads, *rules, reaction=reaction)


def _no_path(given: object) -> Problem:
    """The problem of an object that is no path, with a remedy."""
    name = type(given).__name__
    if hasattr(given, "field"):
        remedy = f"a {name} is a field already: ask it for field(points, currents)"
    elif hasattr(given, "coils"):
        remedy = "make the map first: fieldmap.open_map(fieldmap.generate(device, spacing=4e-3))"
    elif isinstance(given, MapData):
        remedy = "use fieldmap.lookup.interpolate(data)"
    else:
        remedy = "give the path of a file that fieldmap.generate has made"
    return Problem("open_map, path", "must be the path of a map file", f"a {name}", remedy)


def interpolate(
    data: MapData | LargeMap,
    kind: str = "harmonic",
    outside: str = "raise",
    threads: int | None = None,
    outside_currents: str = "raise",
    follow_currents: bool = False,
    tabulate_currents: bool = False,
    evaluator: Callable[[Form], Evaluator] | None = None,
    reaction: bool = True,
) -> FieldMap:
    """Make a map in memory ready for lookups.

    Parameters
    ----------
    data
        The map.
    kind, outside, threads, outside_currents, follow_currents, tabulate_currents, reaction
        As for `open_map`.
    evaluator
        Makes the evaluator of a form: see `FieldMap`.

    Returns
    -------
    FieldMap
        The map, ready for lookups.

    Raises
    ------
    InputError
        As for `open_map`.
    """
    rules = outside_currents, follow_currents, tabulate_currents
    return FieldMap(data, outside, kind, threads, *rules, evaluator, reaction)
