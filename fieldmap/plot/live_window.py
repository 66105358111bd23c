"""A map with sliders: the answer to each move of a slider, and a window with field, force and equilibrium. Lengths of
drawings in mm."""

import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pyvista as pv
from numpy.typing import ArrayLike
from pydantic import BaseModel, ConfigDict, ValidationError

from fieldmap.arguments import check_positive
from fieldmap.currents import IndependentCurrents
from fieldmap.device.model import Payload
from fieldmap.errors import FieldmapError, InputError, NoEquilibrium, OutsideMapError
from fieldmap.levitation import GRAVITY, Equilibrium, find_equilibrium
from fieldmap.levitation.balance import held_at, magnet_balance
from fieldmap.lookup import FieldMap
from fieldmap.lookup.payload import check_payload
from fieldmap.plot.device_drawing import FLUX, MAGNET, VIEW, add_planes
from fieldmap.plot.picture import look_at
from fieldmap.plot.places import MM, grid_points, plane_grids, pose
from fieldmap.plot.rendering import new_scene, require_window
from fieldmap.plot.scales import add_rulers, add_words, colour_bar
from fieldmap.plot.solids import box_edges, extent, magnet_surface
from fieldmap.plot.style import INK, text_properties
from fieldmap.plot.words import fixed, force_in_words
from fieldmap.records import Record
from fieldmap.store.whole_files import write_whole
from fieldmap.typing import Array, PathLike


@dataclass(frozen=True, repr=False)
class Control(Record):
    """One slider. unit: "A", "1" or "mm"; value: initial value."""

    name: str
    unit: str
    lower: float
    upper: float
    value: float


@dataclass(frozen=True, eq=False, repr=False)
class LiveAnswer(Record):
    """Results at currents (n_coils,), A.

    flux_density (n, 3), T, at the points of the map; force (3,), N, on the magnet at `place` (3,), m; held: direction
    of its moment there and whether it turns, in words; lift: vertical force over the weight; equilibrium, or None;
    words: its position, or why there is none.
    """

    currents: Array
    flux_density: Array
    place: Array
    force: Array
    held: str
    lift: float
    equilibrium: Equilibrium | None
    words: str


class LiveMap:
    """A map with sliders for the currents of its coils, or for the signals of its division, and for a height.

    field_map: an opened map. payload: the magnet. points (n, 3), m: where to evaluate the field. current_limit: ends of
    the sliders of a linear map, A; a map of saturating iron uses its domain. force_scale: factor of every force except
    the force of the iron's reaction, from a calibration. states_file: JSON file of saved states, read if it exists.
    Raises InputError without a payload, for a limit that is not positive, and for a file without saved states.

    `values` of `controls`, and the `answer` to them, follow `move`, `reset` and `restore`.

    >>> live = LiveMap(open_map("maps/out/division.h5"), device.payload, points)       # doctest: +SKIP
    >>> live.answer.lift                                                               # doctest: +SKIP
    """

    def __init__(
        self,
        field_map: FieldMap,
        payload: Payload | None,
        points: ArrayLike,
        current_limit: float = 3.0,
        force_scale: float = 1.0,
        states_file: PathLike | None = None,
    ) -> None:
        check_positive("LiveMap", current_limit=current_limit, force_scale=force_scale)
        if payload is None:
            remedy = "add a [payload] table to the device, or name one with --payload-of"
            raise InputError.of("LiveMap(payload)", "must be a payload", "none", remedy)
        check_payload(payload, "LiveMap")
        self.field_map, self.points = field_map, np.asarray(points, dtype=float)
        self.weight = payload.mass * GRAVITY
        self._payload, self._scale = payload, force_scale
        low, high = field_map.lower[2], field_map.upper[2]
        height = Control("magnet z", "mm", 1e3 * low, 1e3 * high, 1e3 * (0.4 * low + 0.6 * high))
        begin = self._start(1e-3 * height.value)
        self._currents, driven = _controls(field_map, begin, current_limit)
        self.controls = (*driven, height)
        self.initial = np.array([control.value for control in self.controls])
        self._ends = np.array([(control.lower, control.upper) for control in self.controls]).T
        self._last: Array | None = None
        # Cached by the map; needed if there is no equilibrium.
        field_map.jump()
        self.states_file = None if states_file is None else Path(states_file)
        self.saved: dict[str, dict[str, float]] = {}
        if self.states_file is not None and self.states_file.is_file():
            self.saved = _read_states(self.states_file)
        self.reset()

    def _place(self, height: float) -> Array:
        lower, upper = self.field_map.lower, self.field_map.upper
        return np.array([*(0.5 * (lower + upper))[:2], np.clip(height, lower[2], upper[2])])

    def _start(self, height: float) -> Array:
        """The map's reference currents; in a linear map multiplied so that they carry the weight at a height, together
        with the force without currents."""
        reference = np.array(self.field_map.info.reference_current, dtype=float)
        if self.field_map.info.reduced_model is not None:
            return reference
        place = self._place(height)
        lift, off = (
            magnet_balance(self.field_map, amperes, self._payload, place, "fixed").scaled_force(
                place[None], self._scale
            )[0, 2]
            for amperes in (reference, 0.0 * reference)
        )
        return reference * (self.weight - off) / (lift - off) if lift != off else reference

    def currents(self, values: ArrayLike) -> Array:
        """Currents (n_coils,), A, at the values of `controls`."""
        return self._currents(np.asarray(values, dtype=float)[:-1])

    def answer_at(self, values: ArrayLike) -> LiveAnswer:
        """Results at the values of `controls`; the field is NaN beyond a map's currents, with an explanation in words.

        The search for the equilibrium starts at the last one.
        """
        amperes, height = self.currents(values), 1e-3 * float(np.asarray(values, dtype=float)[-1])
        place = self._place(height)
        try:
            flux = self.field_map.at(amperes).field(self.points)
            balance = magnet_balance(self.field_map, amperes, self._payload, place)
            force = balance.scaled_force(place[None, :], self._scale)[0]
        except OutsideMapError as error:
            nothing = np.full(3, np.nan)
            flux, held = np.full(self.points.shape, np.nan), self._payload.held()
            return LiveAnswer(amperes, flux, place, nothing, held, np.nan, None, _short(error))
        held, _ = held_at(balance, self._payload, place)
        found, words = self._equilibrium(amperes)
        return LiveAnswer(amperes, flux, place, force, held, float(force[2]) / self.weight, found, words)

    def _equilibrium(self, amperes: Array) -> tuple[Equilibrium | None, str]:
        try:
            about = self.field_map, amperes, self._payload, self._last
            found = find_equilibrium(*about, field_scale=self._scale)
        except NoEquilibrium as error:
            self._last = None
            return None, _short(error)
        self._last = found.position
        at = ", ".join(fixed(1e3 * x, 2) for x in found.position)
        held = [axis for axis, stable in found.stable_axes.items() if stable]
        return found, f"floats at ({at}) mm, stable along {', '.join(held) or 'no axis'}"

    def move(self, values: ArrayLike) -> LiveAnswer:
        """Answer at new values of all controls, clipped to their limits."""
        self.values = np.clip(np.asarray(values, dtype=float), *self._ends)
        self.answer = self.answer_at(self.values)
        return self.answer

    def reset(self) -> LiveAnswer:
        """Answer at the initial values."""
        return self.move(self.initial)

    def save(self, name: str) -> tuple[str, ...]:
        """Save the values under a name, and write the file if there is one. Returns the names of all saved states.

        Raises InputError for an empty name, and for a file that cannot be written.
        """
        chosen = name.strip()
        if not chosen:
            raise InputError.of("save", "a state must have a name", "none", "type one")
        names = [control.name for control in self.controls]
        self.saved[chosen] = dict(zip(names, self.values.tolist(), strict=True))
        if self.states_file is not None:
            content = {"format": FORMAT, "states": self.saved}
            write_whole(self.states_file, json.dumps(content, indent=1) + "\n", "saved states")
        return tuple(self.saved)

    def restore(self, name: str) -> LiveAnswer:
        """Answer at a saved state; controls without a value are reset. Raises InputError for an unknown name."""
        if name not in self.saved:
            known = ", ".join(self.saved) or "none saved"
            raise InputError.of("restore", f"must be one of: {known}", name, "choose one of these")
        values = self.saved[name]
        return self.move([values.get(c.name, c.value) for c in self.controls])

    @property
    def words(self) -> dict[str, str]:
        """The answer as text: currents, force, lift and equilibrium, one line each; force and lift are empty beyond a
        map's currents."""
        answer, names = self.answer, self.field_map.coil_names
        amperes = ", ".join(
            f"{name}: {fixed(value, 3)}" for name, value in zip(names, answer.currents, strict=True)
        )
        force = lift = ""
        if np.isfinite(answer.lift):
            at = ", ".join(fixed(1e3 * x, 1) for x in answer.place)
            force = f"{answer.held}, force at ({at}) mm: {force_in_words(answer.force)}"
            lift = f"lift {100 * answer.lift:.1f} % of the weight"
        return {
            "currents": f"currents, A: {amperes}",
            "force": force,
            "lift": lift,
            "equilibrium": answer.words,
        }


def _controls(
    field_map: FieldMap, begin: Array, limit: float
) -> tuple[Callable[[Array], Array], tuple[Control, ...]]:
    """The function from the sliders' values to currents, and the sliders."""
    model, count = field_map.info.reduced_model, len(field_map.coil_names)
    names, units = tuple(f"coil {name}" for name in field_map.coil_names), ("A",) * count
    lower, upper = np.full(count, -limit), np.full(count, limit)
    currents: Callable[[Array], Array] = np.copy
    if model is not None:
        of, lower, upper = model.parametrisation, model.lower, model.upper
        if not isinstance(of, IndependentCurrents):
            names, units = tuple(f"signal {name}" for name in of.signal_names), of.signal_units
            currents, begin = of.currents, of.nearest(begin).values
    ends = lower.tolist(), upper.tolist(), np.clip(begin, lower, upper).tolist()
    return currents, tuple(Control(*one) for one in zip(names, units, *ends, strict=True))


def _short(error: FieldmapError) -> str:
    problem = error.problems[0]
    if isinstance(error, NoEquilibrium):
        return "no equilibrium in the box: " + problem.received.split(";")[0]
    return f"{problem.where} {problem.must_hold}"


FORMAT = 1


class _File(BaseModel):
    """A file of saved states: names of states -> names of controls -> values."""

    model_config = ConfigDict(strict=True, extra="ignore")
    format: Literal[1]
    states: dict[str, dict[str, float]]


def _read_states(path: Path) -> dict[str, dict[str, float]]:
    try:
        return _File.model_validate_json(path.read_bytes()).states
    except ValidationError as error:
        remedy = "name another file, or delete it"
        must, received = f"must hold saved states of format {FORMAT}", error.errors()[0]["msg"]
        raise InputError.of(str(path), must, received, remedy) from None


WINDOW = (1500, 950)
FORCE = "#D55E00"
LEGEND = "red: the magnet where it floats; orange: the force on it at the height of the slider"
_NUMBER = {"A": "%.3f A", "1": "%.3f", "mm": "%.1f mm"}
_SMALL = 700
"""Width or height, pixels, below which words shrink with the window."""


class LiveWindow:
    """A window with one slider for each of `live.controls`: `.show()` opens it, `.move(values)` moves the sliders.

    field_map, payload, current_limit, force_scale, states_file: as for `LiveMap`. title: a line above. off_screen: draw
    without a window, for pictures. sliders: whether the window has sliders and words. The red magnet is in equilibrium.
    The orange arrow is the force on the magnet at the height of the slider; a force equal to the weight is as long as a
    fifth of the box. planes: grids with |B| in mT; magnet_at: position of the drawn magnet, mm, or None.
    Raises FieldmapError on a machine without OpenGL, InputError for a file without saved states.
    """

    def __init__(
        self,
        field_map: FieldMap,
        payload: Payload | None,
        current_limit: float = 3.0,
        force_scale: float = 1.0,
        title: str = "",
        off_screen: bool = False,
        window: tuple[int, int] = WINDOW,
        sliders: bool = True,
        states_file: PathLike | None = None,
    ) -> None:
        self.scene = new_scene(window, off_screen)
        self._window: Any = self.scene.render_window
        self.planes = plane_grids(field_map.bounds)
        points = np.vstack([grid_points(plane, field_map.bounds) for plane in self.planes])
        self.live = LiveMap(field_map, payload, points, current_limit, force_scale, states_file)
        # Without a graphics card, anti-aliasing would take seven times as long.
        self.scene.disable_anti_aliasing()
        self._build(field_map, None if payload is None else magnet_surface(payload.magnet), title)
        self.sliders = [self._add_slider(k) for k in range(len(self.live.values) if sliders else 0)]
        self._sizes = [(words, words.GetFontSize()) for words in text_properties(self.scene)]
        self._fit(np.array(VIEW))
        self._window.AddObserver("WindowResizeEvent", self._resized)
        self.show_answer()

    @property
    def values(self) -> Array:
        """Values of the sliders."""
        return self.live.values

    def show(self) -> None:
        """Open the window, until it is closed. Raises FieldmapError without a screen."""
        require_window(self.scene)
        self.scene.show()

    def move(self, values: ArrayLike) -> LiveAnswer:
        """Answer at new values of all controls, and show it."""
        answer = self.live.move(values)
        self.show_answer()
        return answer

    def show_answer(self) -> None:
        """Show the answer of `live`."""
        answer, words = self.live.answer, self.live.words
        self._colour(MM * np.linalg.norm(answer.flux_density, axis=1))
        self._place_magnet(answer)
        self._place_force(answer)
        if self.sliders:
            acting = ", ".join(text for text in (words["force"], words["lift"]) if text)
            lines = (words["currents"], acting, words["equilibrium"], LEGEND)
            add_words(self.scene, "\n".join(line for line in lines if line), (0.02, 0.02), 11, name="words")
        self.scene.render()

    def as_numbers(self) -> dict[str, Any]:
        """The present values of the sliders, in their units, and the answer, in SI units."""
        answer = self.live.answer
        sliders = [
            control.to_dict() | {"value": float(value)}
            for control, value in zip(self.live.controls, self.values, strict=True)
        ]
        return {
            "sliders": sliders,
            "currents": answer.currents,
            "place": answer.place,
            "force": answer.force,
            "lift": answer.lift,
            "equilibrium": None if answer.equilibrium is None else answer.equilibrium.position,
            "words": answer.words,
        }

    def _build(self, field_map: FieldMap, magnet: pv.PolyData | None, title: str) -> None:
        """Draw everything that does not move."""
        scene = self.scene
        for plane in self.planes:
            plane[FLUX] = np.linspace(0.0, 1.0, plane.n_points)
        self._actors = add_planes(scene, self.planes, FLUX, bar_at=(0.03, 0.35))
        scene.add_mesh(box_edges(field_map.bounds), color=INK, line_width=2)
        add_rulers(scene, spread=1.3)
        self._room = extent(scene)
        add_words(scene, title, (0.02, 0.98), 12)
        body = pv.Sphere(radius=3.0) if magnet is None else magnet
        self._floating = scene.add_mesh(
            body, color=MAGNET, ambient=0.3, smooth_shading=True, split_sharp_edges=True
        )
        self._force = scene.add_mesh(pv.Arrow(), color=FORCE, ambient=0.4)
        self._arrow_length = 0.2 * MM * float((field_map.upper - field_map.lower)[2])

    def _fit(self, view: Array) -> None:
        """Fit camera and words to the present size of the window, or of the browser. view (3,): towards the viewer."""
        window = self._window.GetSize()
        # Words in the window take four lines below the box.
        look_at(self.scene, self._room, margin=0.6 if self.sliders else 0.42, view=view, size=window)
        share = min(1.0, min(window) / _SMALL)
        for words, size in self._sizes:
            words.SetFontSize(round(share * size))

    def _resized(self, *_: Any) -> None:
        """Fit again after a change of size, in the present view, which the user may have changed."""
        camera = self.scene.camera
        self._fit(np.subtract(camera.position, camera.focal_point))

    def _add_slider(self, k: int) -> Any:
        control, count = self.live.controls[k], len(self.live.controls)
        height = 0.88 - 0.8 * k / max(count - 1, 6)

        def moved(value: float) -> None:
            # The constructor of the slider already calls this.
            if value != self.values[k]:
                self.move(np.where(np.arange(count) == k, value, self.values))

        callback: Any = moved
        slider = self.scene.add_slider_widget(
            callback,
            (control.lower, control.upper),
            value=control.value,
            title=control.name,
            pointa=(0.76, height),
            pointb=(0.97, height),
            color=INK,
            interaction_event="always",
            fmt=_NUMBER[control.unit],
            style="modern",
            title_height=0.018,
            slider_width=0.02,
            tube_width=0.004,
        )
        representation = slider.GetRepresentation()
        representation.SetLabelHeight(0.016)
        for words in (representation.GetTitleProperty(), representation.GetLabelProperty()):
            words.SetShadow(False)
        return slider

    def _colour(self, strength: Array) -> None:
        known = strength[np.isfinite(strength)]
        settings = colour_bar(FLUX, known if known.size else [0.0, 1.0])
        start = 0
        for plane, actor in zip(self.planes, self._actors, strict=True):
            plane[FLUX] = strength[start : start + plane.n_points]
            start += plane.n_points
            actor.mapper.scalar_range = settings["clim"]
        bar = next(iter(self.scene.scalar_bars.values()))
        bar.GetLookupTable().SetTableRange(*settings["clim"])
        bar.SetNumberOfLabels(settings["scalar_bar_args"]["n_labels"])
        bar.SetLabelFormat(settings["scalar_bar_args"]["fmt"])

    def _place_magnet(self, answer: LiveAnswer) -> None:
        found = answer.equilibrium
        self.magnet_at = None if found is None else MM * found.position
        self._floating.visibility = found is not None
        if self.magnet_at is not None:
            self._floating.position = self.magnet_at

    def _place_force(self, answer: LiveAnswer) -> None:
        self._force.visibility = bool(np.isfinite(answer.lift))
        if self._force.visibility:
            size = float(np.linalg.norm(answer.force))
            length = self._arrow_length * size / self.live.weight
            direction = answer.force / size if size else np.array([0.0, 0.0, 1.0])
            self._force.user_matrix = _along(direction, length, MM * answer.place)


def _along(direction: Array, length: float, at: Array) -> Array:
    """Matrix (4, 4) that moves the arrow of pyvista, from x = 0 to 1, to a direction, length and start."""
    other = np.eye(3)[int(np.argmin(np.abs(direction)))]
    side = np.cross(direction, other) / np.linalg.norm(np.cross(direction, other))
    return pose(length * np.column_stack([direction, side, np.cross(direction, side)]), at)
