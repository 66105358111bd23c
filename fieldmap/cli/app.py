"""`fieldmap app`: a map with sliders."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from fieldmap.cli.options import Json, MapArgument, PayloadOf

if TYPE_CHECKING:
    from fieldmap.device.model import Payload
    from fieldmap.lookup import FieldMap

PAGE_WINDOW = (900, 700)


def app(
    map_file: MapArgument,
    current_limit: Annotated[
        float | None,
        typer.Option(
            "--current-limit",
            metavar="A",
            help="Ends of the sliders of a linear map, A. Default: the driver's limit. A map of saturating iron "
            "has its own.",
        ),
    ] = None,
    force_scale: Annotated[
        float,
        typer.Option(
            "--force-scale", metavar="NUMBER", help="Multiply every force by this, from a calibration."
        ),
    ] = 1.0,
    payload_of: PayloadOf = None,
    web: Annotated[
        bool, typer.Option("--web", help="Serve a page for a browser instead of a window.")
    ] = False,
    port: Annotated[
        int, typer.Option("--port", metavar="N", min=0, max=65535, help="Of the page; 0: any free one.")
    ] = 8080,
    states: Annotated[
        Path | None,
        typer.Option(
            "--states", metavar="FILE", help="Saved states of the page, JSON. Default: MAP.states.json."
        ),
    ] = None,
    save: Annotated[
        Path | None,
        typer.Option("--save", metavar="FILE", help="Save a picture (.png) of the start; no window."),
    ] = None,
    json: Json = False,
) -> None:
    """Open a window, or a page, with sliders for the currents of a map: field, force and equilibrium are updated."""
    from fieldmap.device import recorded_device
    from fieldmap.io import existing_map, named_device
    from fieldmap.lookup import open_map
    from fieldmap.plot.live_window import LiveWindow
    from fieldmap.plot.scenes import check_format
    from fieldmap.plot.style import save_screenshot

    if save is not None:
        check_format(save, (".png",))
    opened = open_map(existing_map(map_file))
    record = opened.info.provenance
    recorded = recorded_device(record.device_text) if record.device_text else None
    payload = None if recorded is None else recorded.payload
    payload = payload if payload_of is None else named_device(payload_of).payload
    driver = None if recorded is None else recorded.driver
    limit = current_limit or (3.0 if driver is None else driver.current_limit)
    scaled = "" if force_scale == 1.0 else f", forces times {force_scale:g} (calibration)"
    title = f"{Path(map_file).name}: {record.title}{scaled}"
    if web:
        _serve(
            opened,
            payload,
            limit,
            force_scale,
            title,
            port,
            states or Path(map_file).with_suffix(".states.json"),
        )
        return
    window = LiveWindow(opened, payload, limit, force_scale, title, off_screen=save is not None)
    if save is None:
        window.show()
    else:
        save.parent.mkdir(parents=True, exist_ok=True)
        save_screenshot(window.scene, save)
        window.scene.close()
    if json:
        from fieldmap.cli.printing import print_json

        print_json({"source": map_file, "saved": save} | window.as_numbers())
    elif save is not None:
        print(save)


def _serve(
    opened: "FieldMap",
    payload: "Payload | None",
    limit: float,
    force_scale: float,
    title: str,
    port: int,
    states: Path,
) -> None:
    import os

    from fieldmap.extras import require
    from fieldmap.plot.live_web import WHERE, LivePage
    from fieldmap.plot.live_window import LiveWindow

    require("trame.app", "web", WHERE)
    window = LiveWindow(
        opened, payload, limit, force_scale, "", True, PAGE_WINDOW, sliders=False, states_file=states
    )
    LivePage(window, title).serve(port, open_browser=bool(os.environ.get("DISPLAY")))
