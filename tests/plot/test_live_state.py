"""The state of a window with sliders, without a window; and the page in a browser, if there is one."""

import asyncio
import json
import os
import re
import shutil
import signal
import socket
import subprocess
import sys
import time
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

from fieldmap.device import read_device
from fieldmap.errors import FieldmapError, InputError
from fieldmap.lookup import open_map
from fieldmap.plot.live_window import LiveMap, LiveWindow
from fieldmap.plot.words import force_in_words
from tests.plot.conftest import needs_opengl

BROWSERS = ("chromium-headless-shell", "chromium", "chromium-browser", "google-chrome")


@pytest.fixture(scope="module")
def payload():
    return read_device("drive_unit").payload


@pytest.fixture
def make(six_coils, payload):
    """make(states_file): the map of six dipoles behind sliders."""
    points = np.zeros((1, 3)) - [0, 0, 0.1]
    return lambda file: LiveMap(open_map(six_coils), payload, points, 5.0, states_file=file)


@pytest.fixture
def state(make, tmp_path):
    return make(tmp_path / "six.states.json")


def test_moved_reset_and_clipped(state):
    begin = state.answer
    values = state.initial.copy()
    values[0] += 0.3
    moved = state.move(values)
    np.testing.assert_array_equal(state.answer_at(values).force, moved.force)
    assert not np.allclose(moved.force, begin.force)
    assert "force at" in state.words["force"]
    assert state.words["currents"].count(":") == 1 + len(state.field_map.coil_names)
    np.testing.assert_allclose(state.reset().force, begin.force, rtol=1e-12)
    state.move(state.initial + 1e3)
    assert state.values.tolist() == [control.upper for control in state.controls]


def test_saved_states_outlive_the_window(state, make):
    values = state.initial.copy()
    values[1] -= 0.2
    state.move(values)
    assert state.save(" lower left ") == ("lower left",)
    state.reset()
    again = make(state.states_file)
    np.testing.assert_array_equal(again.restore("lower left").currents, state.currents(values))
    np.testing.assert_array_equal(again.values, values)
    # A map with other controls uses the values that it has sliders for.
    content = json.loads(state.states_file.read_text())
    name = state.controls[0].name
    content["states"]["lower left"] = {name: 1.25, "coil elsewhere": 4.0}
    state.states_file.write_text(json.dumps(content))
    other = make(state.states_file)
    other.restore("lower left")
    np.testing.assert_array_equal(other.values, [1.25, *state.initial[1:]])


def test_wrong_names_and_files(state, make, tmp_path):
    with pytest.raises(InputError):
        state.save("  ")
    with pytest.raises(InputError):
        state.restore("never saved")
    bad = "no json", "[]", '{"format": 2, "states": {}}', '{"format": 1, "states": {"a": {"b": "c"}}}'
    for content in bad:
        wrong = tmp_path / "wrong.json"
        wrong.write_text(content)
        with pytest.raises(InputError) as error:
            make(wrong)
        assert error.value.problems[0].where == str(wrong)
        assert wrong.read_text() == content


WEB = [
    ("trame.app", "trame (extra `web`)"),
    ("trame.widgets.vuetify3", "trame-vuetify (extra `web`)"),
    ("aiohttp", "aiohttp (comes with the extra `web`)"),
]


@needs_opengl
def test_the_page_follows_its_state(six_coils, payload, tmp_path):
    """The page's object, used without a browser."""
    for library, name in WEB[:2]:
        pytest.importorskip(library, reason=f"{name} is not installed")
    from fieldmap.plot.live_web import LivePage

    options = {"off_screen": True, "window": (300, 240), "sliders": False}
    window = LiveWindow(open_map(six_coils), payload, 5.0, **options, states_file=tmp_path / "states.json")
    page = LivePage(window, "six", name="test of a page")
    shown = page.server.state
    assert window.sliders == []
    begin = list(shown.values)
    values = [begin[0] + 0.5, *begin[1:]]
    page._moved(values)
    expected = window.live.answer_at(values)
    assert force_in_words(expected.force) in shown.force
    np.testing.assert_array_equal(window.values, values)
    drawn = np.concatenate([plane["B, mT"] for plane in window.planes])
    np.testing.assert_allclose(drawn, 1e3 * np.linalg.norm(expected.flux_density, axis=1))
    page.save()
    assert shown.problem
    shown.name = shown.chosen = "half an ampere more"
    page.save()
    assert (shown.saved, shown.problem) == (["half an ampere more"], "")
    page.reset()
    assert shown.values == begin
    page.restore()
    assert shown.values == values
    window.scene.close()


@needs_opengl
def test_the_page_has_all_elements_and_is_served_where_it_was_asked_for(
    six_coils, payload, monkeypatch, capsys
):
    """Sliders have 200 steps, three decimals for amperes and one for millimetres; they are beside the picture on a wide
    screen, below it on a narrow one."""
    for library, name in WEB[:2]:
        pytest.importorskip(library, reason=f"{name} is not installed")
    from fieldmap.plot.live_web import LivePage

    window = LiveWindow(open_map(six_coils), payload, 5.0, off_screen=True, window=(300, 240), sliders=False)
    page = LivePage(window, "six coils", name="test of its elements")
    template = page.server.state["trame__template_main"]
    attributes = [
        dict(re.findall(r'([:@\w-]+)="([^"]*)"', one)) for one in re.findall("<VSlider [^\n]*>", template)
    ]
    for k, (slider, control) in enumerate(zip(attributes, window.live.controls, strict=True)):
        ends = [float(slider[key]) for key in ("min", "max", "step")]
        assert ends == pytest.approx([control.lower, control.upper, (control.upper - control.lower) / 200])
        assert (slider["id"], slider[":modelValue"]) == (f"slider{k}", f"values[{k}]")
        assert slider["@update:modelValue"] == f"values = values.map((v, k) => k == {k} ? $event : v)"
        decimals, unit = (1, "mm") if control.name == "magnet z" else (3, "A")
        assert f"{control.name}: {{{{ values[{k}].toFixed({decimals}) }}}} {unit}\n" in template
    assert template.count("hideDetails") == len(attributes) + 2
    columns = [dict(re.findall(r'(\w+)="([^"]*)"', one)) for one in re.findall("<VCol [^\n]*>", template)]
    assert [int(one["cols"]) for one in columns] == [12, 12]
    wide = [int(one["md"]) for one in columns]
    assert sum(wide) == 12
    assert wide[0] > wide[1]
    # The picture has full resolution, also while it moves.
    assert 'interactiveRatio="1"' in template
    assert all(flag in template for flag in ("fluid>", "noGutters>", "<VRow dense>"))
    assert re.search(r"six coils\s*</div>", template)
    assert (page.server.state.name, page.server.state.chosen, page.server.state.problem) == ("", None, "")
    given, argv = {}, sys.argv
    monkeypatch.setattr(sys, "argv", ["fieldmap", "app", "--web"])

    def start(**options):
        given.update(options, argv=sys.argv)
        page.server.controller.on_server_ready()

    monkeypatch.setattr(page.server, "start", start)
    monkeypatch.setattr(type(page.server), "port", 1234)
    page.serve()
    usual = {
        "port": 8080,
        "host": "localhost",
        "open_browser": True,
        "show_connection_info": False,
        "timeout": 0,
    }
    assert given == usual | {"argv": ["fieldmap"]}
    assert capsys.readouterr().out == "http://localhost:1234/\n"
    assert sys.argv == ["fieldmap", "app", "--web"] != argv
    page.serve(5, "elsewhere", False)
    assert given == usual | {"argv": ["fieldmap"], "port": 5, "host": "elsewhere", "open_browser": False}
    window.scene.close()


def test_what_is_missing_is_named(monkeypatch):
    from fieldmap.plot.live_web import LivePage

    monkeypatch.setitem(sys.modules, "trame.app", None)
    with pytest.raises(FieldmapError) as error:
        LivePage(None, "")
    assert "[web]" in str(error.value)


@contextmanager
def running(words, **options):
    """A program that runs inside the block, with all its child processes."""
    process = subprocess.Popen(words, text=True, start_new_session=True, **options)
    try:
        yield process
    finally:
        os.killpg(process.pid, signal.SIGKILL)
        process.communicate()


def port_of(path, seconds=60.0):
    """The port that a browser writes when it listens."""
    end = time.monotonic() + seconds
    while not (path.is_file() and path.read_text()):
        assert time.monotonic() < end, path
        time.sleep(0.1)
    return path.read_text().splitlines()[0]


async def visit(port, address, steps):
    """Open the page, and run `steps(ask, evaluate, until)`."""
    import aiohttp

    async with aiohttp.ClientSession() as session:
        async with session.get(f"http://127.0.0.1:{port}/json/list") as response:
            target = next(one for one in await response.json() if one["type"] == "page")
        async with session.ws_connect(target["webSocketDebuggerUrl"], max_msg_size=0) as socket_:
            count = 0

            async def ask(method, **params):
                nonlocal count
                count += 1
                await socket_.send_json({"id": count, "method": method, "params": params})
                while True:
                    message = await socket_.receive_json()
                    if message.get("id") == count:
                        return message["result"]

            async def evaluate(text):
                result = await ask("Runtime.evaluate", expression=text, returnByValue=True)
                return result["result"].get("value")

            async def until(text, wanted):
                for _ in range(300):
                    found = await evaluate(text)
                    if wanted(found):
                        return found
                    await asyncio.sleep(0.1)
                raise TimeoutError(f"{text}: {found}")

            await ask("Page.navigate", url=address)
            await steps(ask, evaluate, until)


@needs_opengl
def test_the_page_in_a_browser(six_map_with_payload, payload, tmp_path):
    """Sliders, reset and saved states by their elements; the picture has content."""
    for library, name in WEB:
        pytest.importorskip(library, reason=f"{name} is not installed")
    program = next((path for name in BROWSERS if (path := shutil.which(name))), None)
    if program is None:
        pytest.skip(f"no browser: none of {', '.join(BROWSERS)}")
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    words = f"-m fieldmap app {six_map_with_payload} --web --port {port} --limit 5".split()
    flags = (
        "--headless --no-sandbox --disable-gpu --disable-quic --no-first-run --disable-background-networking"
    )
    flags += " --disable-component-update --disable-sync --window-size=1400,900 --remote-debugging-port=0"
    folder = tmp_path / "browser"
    seen = {}

    async def steps(ask, evaluate, until):
        text = "document.getElementById('{}')?.innerText"
        seen["begin"] = await until(text.format("force"), lambda found: found and "N" in found)
        seen["sliders"] = await evaluate("document.querySelectorAll('[role=slider]').length")
        drawn = "document.querySelector('img')?.naturalWidth || 0"
        assert await until(drawn, lambda width: width and width > 100) > 100
        await evaluate("document.querySelector('[role=slider]').focus()")
        for _ in range(5):
            await ask("Input.dispatchKeyEvent", type="keyDown", key="ArrowRight", code="ArrowRight")
        seen["moved"] = await until(text.format("force"), lambda found: found != seen["begin"])
        await evaluate("document.querySelector('#name').focus()")
        await ask("Input.insertText", text="five steps")
        # Five steps of 50 mA, which reach the server one by one.
        seen["currents"] = await until(text.format("currents"), lambda found: found and "1: 2.500" in found)
        await evaluate("document.getElementById('save').click()")
        states = Path(six_map_with_payload).with_suffix(".states.json")
        await until("1", lambda _: states.is_file())
        seen["saved"] = json.loads(states.read_text())["states"]
        await evaluate("document.getElementById('reset').click()")
        seen["reset"] = await until(text.format("force"), lambda found: found == seen["begin"])

    shows = {"stdout": subprocess.PIPE, "env": {**os.environ, "DISPLAY": ""}}
    quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    browser = [program, *flags.split(), f"--user-data-dir={folder}", "about:blank"]
    with running([sys.executable, *words], **shows) as server, running(browser, **quiet):
        address = server.stdout.readline().strip()
        assert address == f"http://localhost:{port}/"
        asyncio.run(visit(port_of(folder / "DevToolsActivePort"), address, steps))
    opened = open_map(six_map_with_payload)
    assert seen["sliders"] == len(opened.coil_names) + 1
    (values,) = seen["saved"].values()
    assert list(seen["saved"]) == ["five steps"]
    amperes = [values[f"coil {name}"] for name in opened.coil_names]
    assert f"{opened.coil_names[0]}: {amperes[0]:.3f}" in seen["currents"]
    start = 1e-3 * values["magnet z"]
    moment = np.array([0.0, 0.0, payload.moment])
    place = np.array([*(0.5 * (opened.lower + opened.upper))[:2], start])
    force = np.abs(opened.gradient(place, amperes).T @ moment)
    shown = np.abs([float(one) for one in re.findall(r"-?[\d.]+", seen["moved"].split(":")[-1])])
    assert np.argmax(shown) == np.argmax(force)


@pytest.fixture
def six_map_with_payload(circle_of_six, dipole_map, tmp_path, rig, payload):
    """The map of six dipoles, which records a device with a payload."""
    text = rig(mass_g=1e3 * payload.mass, moment_A_m2=payload.moment)
    return dipole_map(circle_of_six, tmp_path / "six.h5", text, title="Six dipoles")
