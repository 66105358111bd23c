"""Pictures: `fieldmap show` draws a device, a map or a run; `fieldmap app` has sliders for the currents."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from fieldmap.arguments import check, raise_all
from fieldmap.cli import options, page
from fieldmap.cli.arguments import parse_currents, parse_points, positive_problems
from fieldmap.cli.options import option
from fieldmap.errors import Problem
from fieldmap.progress import Progress

if TYPE_CHECKING:
    from fieldmap.plot.shown import Shown

PAGE_WINDOW = (900, 700)
CURVES = "curves"
"""Value of `--what` for runs drawn over time."""


def show(
    sources: Annotated[list[str], options.file_argument("DEVICE_OR_MAP_OR_RUN", "geometry")],
    what: Annotated[str, option("--what", "NAME")] = "",
    currents: options.Currents = None,
    quantity: Annotated[str, option("--quantity", "NAME")] = "",
    minus: Annotated[str | None, option("--minus", "DEVICE_OR_MAP")] = None,
    height_mm: options.HeightMm = None,
    at_mm: options.AtMm = None,
    limit: options.Limit = None,
    save: Annotated[
        Path | None,
        options.SAVE,
        options.writes("picture", "web page", "ParaView scene", "film", "figure"),
    ] = None,
    changes: options.Changes = None,
    mu_r: options.MuR = None,
    nonlinear: options.Nonlinear = False,
    refinement: options.Refinement = 1.0,
    json: options.Json = False,
) -> None:
    """Draw a device, its iron, its field, or a simulated run; a window opens unless --save names a file.

    The file is .png, .html (for a browser, no server) or .vtm (ParaView); for a run also .gif or .mp4. Several files of
    runs are laid over one another, with a legend of their names (.png, .svg, .pdf). Without --currents every coil
    carries 1 A. For shift, --height-mm is where the magnet is held, by default where it floats.
    For reachable, --at-mm is the point, by default the middle of the workspace.

    Example: fieldmap show drive_unit --what iron --currents 1.5 --save iron.png

    Parameters
    ----------
    sources
        Device file or name, map file, or one or several files that `fieldmap simulate -o RUN.h5` wrote.
    what
        What to draw: device, mesh, iron, lines, slices, surfaces, forces, equilibrium, difference, shift or reachable;
        path or curves for a run, curves for several.
    quantity
        For slices, surfaces and difference: B, Bz or gradB. For shift: x or y. For reachable: force or B.
    minus
        Subtract this field, and draw the difference.
    """
    from fieldmap.io import IronOptions, is_map_file, named_device
    from fieldmap.plot import gather
    from fieldmap.plot.scenes import FORMATS, MOVIES, check_format, check_scene
    from fieldmap.store import is_run_file

    (source, *others) = sources
    if others or what == CURVES:
        beside = {"--currents": currents, "--minus": minus, "--quantity": quantity, "--set": changes}
        _show_curves(sources, what, save, [name for name, there in beside.items() if there], json)
        return
    of_map = is_map_file(source)
    recorded = of_map and is_run_file(source)
    if save is not None:
        check_format(save, (*MOVIES, *FORMATS) if recorded else FORMATS)
    iron, settings = options.of_device(changes, mu_r, nonlinear, refinement)
    usual = "path" if recorded else "difference" if minus else "slices" if of_map else "device"
    chosen = what or usual
    check_scene(chosen, quantity)
    if recorded:
        given = [name for name, there in (("--currents", currents), ("--minus", minus)) if there]
        _refuse_for_runs(chosen, given + options.changed_iron(iron, settings))
        shown = gather.shown_run(source)
    elif chosen in ("device", "mesh") and not of_map:
        device = named_device(source, settings)
        shown = gather.shown_device(device) if chosen == "device" else gather.shown_mesh(device, refinement)
    else:
        points = parse_points(None, at_mm)
        check(len(points) < 2, "--at-mm", "must give one point", f"{len(points)} points", "give it once")
        raise_all(positive_problems("--limit", limit, "give amperes"))
        height, place = None if height_mm is None else 1e-3 * height_mm, points[0] if len(points) else None
        with Progress("show") as progress:
            found, other = options.find_named(source, iron, progress, settings), None
            if minus is not None and chosen == "difference":
                of_other = IronOptions() if is_map_file(minus) else iron
                other = options.find_named(minus, of_other, progress, {})
            amperes = parse_currents(currents or ["1"], found.coil_names)
            shown = gather.shown_field(found, amperes, chosen, other, height, place, limit, quantity)
    if save is not None and save.suffix in MOVIES:
        ranges = _animate(shown, save)
    else:
        ranges = _draw(shown, chosen, quantity, save)
    if json:
        page.print_json({"source": source, "what": chosen, "saved": save, "ranges": ranges} | shown.to_dict())
    elif save is not None:
        print(save)


def _show_curves(sources: list[str], what: str, save: Path | None, given: list[str], json: bool) -> None:
    """Draw files of runs in one figure. Raises InputError with all problems."""
    from fieldmap.plot.runs import read_drawn_runs, run_message, save_run_figure
    from fieldmap.plot.scenes import check_format
    from fieldmap.store import is_run_file

    must, remedy = "must be a file of runs where there are several", "write it by fieldmap simulate -o RUN.h5"
    problems = [Problem(each, must, "another file", remedy) for each in sources if not is_run_file(each)]
    problems += [Problem(name, "must not come with runs", "given", "leave it out") for name in given]
    if what not in ("", CURVES):
        problems.append(Problem("--what", f"must be {CURVES} for several runs", what, "leave it out"))
    if save is None:
        problems.append(Problem("--save", "must name the file of the curves", "none", "add --save runs.png"))
    raise_all(problems)
    assert save is not None
    check_format(save, (".png", ".svg", ".pdf"))
    title, runs = read_drawn_runs(sources)
    save_run_figure(save, title, runs)
    if json:
        names = [str(run.get("varied", {})["run"]) for run in runs]
        page.print_json(
            {"source": sources, "what": CURVES, "saved": save, "runs": names, "message": run_message(runs)}
        )
    else:
        print(save)


def _refuse_for_runs(what: str, given: list[str]) -> None:
    problems = [Problem(name, "must not come with a run", "given", "leave it out") for name in given]
    if what != "path":
        remedy = "leave it out, or name a device or a map"
        problems.append(Problem("--what", "must be path for a run", what, remedy))
    raise_all(problems)


def _draw(shown: Shown, what: str, quantity: str, save: Path | None) -> dict[str, list[float]]:
    """Show or save a scene. Returns the ranges of quantities shown as colour, by title."""
    from fieldmap.plot.rendering import require_window
    from fieldmap.plot.scenes import axes_of, drawn_ranges, make_scene, save_scene, scene_words

    scene = make_scene(shown, what, quantity, off_screen=save is not None)
    ranges = drawn_ranges(scene)
    if save is None:
        require_window(scene)
        scene.show()
    else:
        save_scene(scene, save, scene_words(what, quantity, shown), axes_of(what, quantity, shown))
        scene.close()
    return ranges


def _animate(shown: Shown, save: Path) -> dict[str, list[float]]:
    from fieldmap.plot.animation import CURRENT, save_animation

    assert shown.run is not None
    with Progress("show") as progress:
        save_animation(shown.run, save, progress)
    return {CURRENT: [float(shown.run.currents.min()), float(shown.run.currents.max())]}


def app(
    map_file: options.MapArgument,
    limit: options.Limit = None,
    force_scale: Annotated[float, option("--force-scale", "NUMBER")] = 1.0,
    payload_of: options.PayloadOf = None,
    web: Annotated[bool, typer.Option("--web")] = False,
    port: Annotated[int, option("--port", "N", min=0, max=65535)] = 8080,
    states: Annotated[Path | None, option("--states", "FILE"), options.writes("saved states")] = None,
    save: Annotated[Path | None, options.SAVE, options.writes("picture")] = None,
    json: options.Json = False,
) -> None:
    """Open a window, or a page, with sliders for the currents of a map: field, force and equilibrium are updated.

    --save draws the start as .png without a window. --limit is the end of the sliders of a linear map; a map of
    saturating iron has its own.

    Example: fieldmap app maps/out/workspace.h5

    Parameters
    ----------
    force_scale
        Multiply every force but that of the iron's reaction by this, from a calibration.
    web
        Serve a page for a browser instead of a window.
    port
        Of the page; 0: any free one.
    states
        Saved states of the page, JSON. Default: MAP.states.json.
    """
    from fieldmap.io import existing_map, find_source
    from fieldmap.lookup import FieldMap
    from fieldmap.plot.gather import DEFAULT_LIMIT
    from fieldmap.plot.live_window import LiveWindow
    from fieldmap.plot.style import save_screenshot

    found = find_source(existing_map(map_file))
    assert isinstance(found.field, FieldMap)
    driver = DEFAULT_LIMIT if found.driver is None else found.driver.current_limit
    scaled = "" if force_scale == 1.0 else f", forces times {force_scale:g} (calibration)"
    title = f"{found.name}: {found.field.info.provenance.title}{scaled}"
    about = (found.field, options.payload_of_option(found, payload_of), limit or driver, force_scale)
    if web:
        from fieldmap.extras import require
        from fieldmap.plot.live_web import WHERE, LivePage

        require("trame.app", "web", WHERE)
        file = states or Path(map_file).with_suffix(".states.json")
        window = LiveWindow(*about, "", True, PAGE_WINDOW, sliders=False, states_file=file)
        LivePage(window, title).serve(port, open_browser=bool(os.environ.get("DISPLAY")))
        return
    window = LiveWindow(*about, title, off_screen=save is not None)
    if save is None:
        window.show()
    else:
        save_screenshot(window.scene, save)
        window.scene.close()
    if json:
        page.print_json({"source": map_file, "saved": save} | window.as_numbers())
    elif save is not None:
        print(save)
