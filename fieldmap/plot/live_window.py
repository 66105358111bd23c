"""A map to play with: sliders for the currents; field, force and equilibrium follow. Lengths in mm."""

from typing import Any

import numpy as np
import pyvista as pv

from fieldmap.device.model import Payload
from fieldmap.lookup import FieldMap
from fieldmap.plot.colours import colour_bar
from fieldmap.plot.device_drawing import COLOUR_MAP, MAGNET, MM, magnet_surface
from fieldmap.plot.live_answers import LiveAnswer, LiveMap
from fieldmap.plot.live_state import answer_in_words
from fieldmap.plot.picture import look_at
from fieldmap.plot.rendering import require_renderer, require_window
from fieldmap.plot.rulers import add_rulers
from fieldmap.plot.style import INK
from fieldmap.plot.volumes import planes_of_box
from fieldmap.typing import Array

WINDOW = (1500, 950)
TITLE = "B, mT"
FORCE = "#D55E00"
_NUMBER = {"A": "%.3f A", "1": "%.3f", "mm": "%.1f mm"}


class LiveWindow:
    """A window with one slider for each of `live.controls`: `.show()` opens it, `.move(values)` does what sliders do.

    field_map, payload, current_limit, force_scale: as for `LiveMap`. title: a line above. off_screen: draw without a
    window, for pictures. sliders: without them there are no words either, both stand elsewhere. Red: where the magnet
    floats. Orange: the force on it where the height slider puts it, as long as a fifth of the box where it carries the
    weight. planes: grids with |B| in mT; magnet_at: where the magnet is drawn, mm, or None; values: of the sliders.
    Raises FieldmapError on a machine without OpenGL.
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
    ) -> None:
        require_renderer()
        self.planes = planes_of_box(field_map.lower, field_map.upper)
        points = np.clip(
            np.vstack([plane.points for plane in self.planes]) / MM, field_map.lower, field_map.upper
        )
        self.live = LiveMap(field_map, payload, points, current_limit, force_scale)
        self.values = np.array([control.value for control in self.live.controls])
        self._magnet = None if payload is None else magnet_surface(payload.magnet)
        self._arrow_length = 0.2 * MM * float((field_map.upper - field_map.lower)[2])
        self.scene = pv.Plotter(off_screen=off_screen, window_size=list(window))
        # Smoothed edges cost a processor that draws by itself seven times as long.
        self.scene.disable_anti_aliasing()
        self._build(title)
        self.sliders = [self._add_slider(k) for k in range(len(self.values) if sliders else 0)]
        self._told = sliders
        self.move(self.values)

    def show(self) -> None:
        """Open the window, until it is closed. Raises FieldmapError without a screen."""
        require_window(self.scene)
        self.scene.show()

    def move(self, values: Any) -> LiveAnswer:
        """Answer at new values of all controls, and show it."""
        values = np.array(values, dtype=float)
        answer = self.live.answer(values)
        self.show_answer(values, answer)
        return answer

    def show_answer(self, values: Array, answer: LiveAnswer) -> None:
        """Show what `live` answered to values."""
        self.values = values
        self._colour(1e3 * np.linalg.norm(answer.flux_density, axis=1))
        self._place_magnet(answer)
        self._place_force(answer)
        words = answer_in_words(answer, self.live.field_map.coil_names)
        lines = (
            words.currents,
            ", ".join(text for text in (words.force, words.lift) if text),
            words.equilibrium,
        )
        self.scene.add_text(
            "\n".join(line for line in lines if line) if self._told else "",
            position=(0.02, 0.02),
            viewport=True,
            font_size=11,
            color=INK,
            name="words",
            render=False,
        )
        self.scene.render()

    def as_numbers(self) -> dict[str, Any]:
        """The sliders and the answer at their values, as they are now. SI units, sliders in theirs."""
        answer = self.live.answer(self.values)
        sliders = [
            {"name": c.name, "unit": c.unit, "lower": c.lower, "upper": c.upper, "value": float(value)}
            for c, value in zip(self.live.controls, self.values, strict=True)
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

    def _build(self, title: str) -> None:
        """Everything that does not move."""
        scene, (low, high) = self.scene, (MM * self.live.field_map.lower, MM * self.live.field_map.upper)
        scene.background_color = pv.Color("white")
        settings = colour_bar(TITLE, [0.0, 1.0])
        settings["scalar_bar_args"] |= {"position_x": 0.03, "position_y": 0.35}
        self._actors = []
        for plane in self.planes:
            plane[TITLE] = np.zeros(plane.n_points)
            first = plane is self.planes[0]
            self._actors.append(
                scene.add_mesh(
                    plane,
                    scalars=TITLE,
                    cmap=COLOUR_MAP,
                    lighting=False,
                    nan_color="white",
                    show_scalar_bar=first,
                    **settings,
                )
            )
        scene.add_mesh(
            pv.Box(tuple(np.column_stack([low, high]).ravel())).extract_all_edges(), color=INK, line_width=2
        )
        add_rulers(scene, spread=1.3)
        look_at(scene, np.array(scene.bounds).reshape(3, 2), margin=0.55)
        scene.add_text(title, position=(0.02, 0.95), viewport=True, font_size=12, color=INK)
        body = pv.Sphere(radius=3.0) if self._magnet is None else self._magnet
        self._floating = scene.add_mesh(
            body, color=MAGNET, ambient=0.3, smooth_shading=True, split_sharp_edges=True
        )
        self._force = scene.add_mesh(pv.Arrow(), color=FORCE, ambient=0.4)

    def _add_slider(self, k: int) -> Any:
        control, count = self.live.controls[k], len(self.live.controls)
        height = 0.88 - 0.8 * k / max(count - 1, 6)

        def moved(value: float) -> None:
            # Making the slider calls this before there is anything to move.
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
        settings = colour_bar(TITLE, known if known.size else [0.0, 1.0])
        start = 0
        for plane, actor in zip(self.planes, self._actors, strict=True):
            plane[TITLE] = strength[start : start + plane.n_points]
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
    """Matrix (4, 4) that lays the arrow of pyvista, from 0 to x = 1, along a direction."""
    other = np.eye(3)[int(np.argmin(np.abs(direction)))]
    side = np.cross(direction, other) / np.linalg.norm(np.cross(direction, other))
    matrix = np.eye(4)
    matrix[:3, :3] = length * np.column_stack([direction, side, np.cross(direction, side)])
    matrix[:3, 3] = at
    return matrix
