"""The map with sliders in a browser: trame serves a page, and this machine draws the scene without a graphics card."""

import sys
from typing import Any

import numpy as np

from fieldmap.errors import FieldmapError
from fieldmap.extras import require
from fieldmap.plot.live_window import LEGEND, LiveWindow

WHERE = "fieldmap app --web"
_SMALL: dict[str, Any] = {"density": "compact", "hide_details": True}


class LivePage:
    """A page with one slider for each of `window.live.controls`, reset, and saved states.

    window: off-screen and without sliders; it draws the picture of the page, and keeps the states. name: of the server.
    `server.state` holds the contents of the page: `values`, the words of the answer, `saved`, `problem`. Raises
    FieldmapError if trame is not installed, InputError for a file without saved states.
    """

    def __init__(self, window: LiveWindow, title: str, name: str = "fieldmap") -> None:
        app = require("trame.app", "web", WHERE)
        self.window, self.title, self.model = window, title, window.live
        self.server = app.get_server(name, client_type="vue3")
        self._put()
        self.server.state.update({"name": "", "chosen": None, "problem": ""})
        self.server.state.change("values")(self._moved)
        self._build()

    def serve(self, port: int = 8080, host: str = "localhost", open_browser: bool = True) -> None:
        """Serve the page until it is stopped (Ctrl+C); port 0: any free one. Prints its address."""
        # Without this the server would read our command line.
        given, sys.argv = sys.argv, sys.argv[:1]
        ready = self.server.controller.on_server_ready

        def tell(**_: Any) -> None:
            print(f"http://{host}:{self.server.port}/", flush=True)

        ready.add(tell)
        try:
            self.server.start(
                port=port, host=host, open_browser=open_browser, show_connection_info=False, timeout=0
            )
        finally:
            sys.argv = given

    def reset(self) -> None:
        """Set the initial values."""
        self._follow(self.model.reset)

    def save(self) -> None:
        """Save the values under the typed name."""
        self._follow(lambda: self.model.save(self.server.state.name))

    def restore(self) -> None:
        """Go to the selected saved state."""
        self._follow(lambda: self.model.restore(self.server.state.chosen or ""))

    def _moved(self, values: list[float], **_: Any) -> None:
        wanted = np.array(values, dtype=float)
        if not np.array_equal(wanted, self.model.values):
            self._follow(lambda: self.model.move(wanted))

    def _follow(self, change: Any) -> None:
        """Make a change and show the result; an error becomes a line on the page."""
        problem = ""
        try:
            change()
        except FieldmapError as error:
            problem = error.problems[0].must_hold
        self._put()
        self.server.state.problem = problem
        self.window.show_answer()
        self._view.update()

    def _put(self) -> None:
        """Update the contents of the page from the model."""
        values, saved = self.model.values.tolist(), list(self.model.saved)
        self.server.state.update({"values": values, "saved": saved} | self.model.words)

    def _build(self) -> None:
        parts = ("ui.vuetify3", "widgets.vuetify3", "widgets.vtk", "widgets.html")
        layouts, v3, vtk, html = (require(f"trame.{part}", "web", WHERE) for part in parts)
        with layouts.VAppLayout(self.server) as layout:
            layout.root.theme = "light"
            with v3.VContainer(fluid=True, classes="pa-2"), v3.VRow(no_gutters=True):
                with v3.VCol(cols=12, md=8):
                    html.Div(self.title, classes="text-subtitle-1", id="title")
                    # Only the picture has a fixed height.
                    with html.Div(style="height: 65vh; min-height: 300px"):
                        self._view: Any = vtk.VtkRemoteView(
                            self.window.scene.render_window, interactive_ratio=1, style="height: 100%"
                        )
                    for name in ("force", "lift", "equilibrium", "currents"):
                        html.Div(f"{{{{ {name} }}}}", id=name, classes="text-body-2")
                    html.Div(LEGEND, classes="text-caption")
                with v3.VCol(cols=12, md=4, classes="pa-2"):
                    self._add_sliders(v3, html)
                    self._add_states(v3, html)

    def _add_sliders(self, v3: Any, html: Any) -> None:
        for k, control in enumerate(self.model.controls):
            unit = "" if control.unit == "1" else f" {control.unit}"
            text = f"{control.name}: {{{{ values[{k}].toFixed({1 if control.unit == 'mm' else 3}) }}}}{unit}"
            html.Div(text, classes="text-caption")
            v3.VSlider(
                model_value=(f"values[{k}]",),
                update_modelValue=f"values = values.map((v, k) => k == {k} ? $event : v)",
                min=control.lower,
                max=control.upper,
                step=(control.upper - control.lower) / 200,
                id=f"slider{k}",
                **_SMALL,
            )

    def _add_states(self, v3: Any, html: Any) -> None:
        v3.VBtn("Reset", click=self.reset, id="reset", size="small", classes="my-2")
        with v3.VRow(dense=True):
            v3.VTextField(v_model=("name",), label="name of a state", id="name", **_SMALL)
            v3.VBtn("Save", click=self.save, id="save", size="small", classes="ma-2")
        with v3.VRow(dense=True):
            v3.VSelect(v_model=("chosen",), items=("saved",), label="saved states", id="states", **_SMALL)
            v3.VBtn("Restore", click=self.restore, id="restore", size="small", classes="ma-2")
        html.Div("{{ problem }}", id="problem", classes="text-error")
