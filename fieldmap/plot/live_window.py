"""A map to play with: sliders for the currents; field, force and equilibrium follow. Lengths in mm."""

from pathlib import Path
from typing import Any

import numpy as np
import pyvista as pv
from numpy.typing import ArrayLike

from fieldmap.device.model import Payload
from fieldmap.lookup import FieldMap
from fieldmap.plot.device_drawing import FLUX, MAGNET, VIEW, add_planes
from fieldmap.plot.live_answers import LiveAnswer, LiveMap
from fieldmap.plot.picture import look_at
from fieldmap.plot.places import MM, grid_points, plane_grids, pose
from fieldmap.plot.rendering import new_scene, require_window
from fieldmap.plot.scales import add_rulers, add_words, colour_bar
from fieldmap.plot.solids import box_edges, extent, magnet_surface
from fieldmap.plot.style import INK, text_properties
from fieldmap.typing import Array

WINDOW = (1500, 950)
FORCE = "#D55E00"
LEGEND = "red: the magnet where it floats; orange: the force on it at the height of the slider"
_NUMBER = {"A": "%.3f A", "1": "%.3f", "mm": "%.1f mm"}
_SMALL = 700
"""Pixels: in a window that is narrower or lower, words shrink with it."""


class LiveWindow:
    """A window with one slider for each of `live.controls`: `.show()` opens it, `.move(values)` does what sliders do.

    field_map, payload, current_limit, force_scale, states_file: as for `LiveMap`. title: a line above. off_screen: draw
    without a window, for pictures. sliders: without them there are no words either, both stand elsewhere. Red: where
    the magnet floats. Orange: the force on it where the height slider puts it, as long as a fifth of the box where it
    carries the weight. planes: grids with |B| in mT; magnet_at: where the magnet is drawn, mm, or None.
    Raises FieldmapError on a machine without OpenGL, InputError for a file that holds no saved states.
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
        states_file: Path | None = None,
    ) -> None:
        self.scene = new_scene(window, off_screen)
        self._window: Any = self.scene.render_window
        self.planes = plane_grids(field_map.bounds)
        points = np.vstack([grid_points(plane, field_map.bounds) for plane in self.planes])
        self.live = LiveMap(field_map, payload, points, current_limit, force_scale, states_file)
        # Smoothed edges cost a processor that draws by itself seven times as long.
        self.scene.disable_anti_aliasing()
        self._build(field_map, None if payload is None else magnet_surface(payload.magnet), title)
        self.sliders = [self._add_slider(k) for k in range(len(self.live.values) if sliders else 0)]
        self._sizes = [(words, words.GetFontSize()) for words in text_properties(self.scene)]
        self._fit(np.array(VIEW))
        self._window.AddObserver("WindowResizeEvent", self._resized)
        self.show_answer()

    @property
    def values(self) -> Array:
        """Of the sliders."""
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
        """The sliders and the answer at their values, as they are now. SI units, sliders in theirs."""
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
        """Everything that does not move."""
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
        """Camera and words for the size that the window has now, which in a page is the browser's; view (3,): towards
        the viewer."""
        window = self._window.GetSize()
        # Below the box stand four lines where the words are in the window.
        look_at(self.scene, self._room, margin=0.6 if self.sliders else 0.42, view=view, size=window)
        share = min(1.0, min(window) / _SMALL)
        for words, size in self._sizes:
            words.SetFontSize(round(share * size))

    def _resized(self, *_: Any) -> None:
        """The user may have turned the scene."""
        camera = self.scene.camera
        self._fit(np.subtract(camera.position, camera.focal_point))

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
    """Matrix (4, 4) that lays the arrow of pyvista, from 0 to x = 1, along a direction."""
    other = np.eye(3)[int(np.argmin(np.abs(direction)))]
    side = np.cross(direction, other) / np.linalg.norm(np.cross(direction, other))
    return pose(length * np.column_stack([direction, side, np.cross(direction, side)]), at)
