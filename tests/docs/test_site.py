"""The built site: titles, formulas and the search index without a browser; widths and the search in a browser."""

import functools
import html
import http.server
import importlib.util
import json
import os
import re
import shutil
import signal
import subprocess
import sys
import threading
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
HERE = Path(__file__).parent
NEEDED = ("mkdocs", "material", "mkdocstrings", "mkdocstrings_handlers.python")
BROWSERS = ("chromium-headless-shell", "chromium", "chromium-browser", "google-chrome")
# Columns of code that fit on a page of 1400 px between the two navigation lists.
COLUMNS = 118
TABS = ["Home", "User guide", "How-to", "Reference", "Theory", "Thesis"]


@pytest.fixture(scope="module")
def site(tmp_path_factory) -> Path:
    """Folder of the site, built as by `make docs`."""
    missing = [name for name in NEEDED if importlib.util.find_spec(name.split(".")[0]) is None]
    if missing:
        pytest.skip(f"the extra docs is not installed: {', '.join(missing)}")
    folder = tmp_path_factory.mktemp("site")
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "--quiet", "--site-dir", str(folder)]
    environment = {**os.environ, "NO_MKDOCS_2_WARNING": "1"}
    built = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True, check=False)
    assert built.returncode == 0, built.stderr
    return folder


def pages(site: Path) -> dict[str, str]:
    """Text of every page, by its path in the site."""
    found = {str(path.relative_to(site)): path.read_text() for path in sorted(site.rglob("*.html"))}
    return {name: text for name, text in found.items() if name != "404.html" and "<article" in text}


def article(text: str) -> str:
    """The content of a page, without navigation."""
    return text.split("<article", 1)[1].split("</article>", 1)[0]


def plain(text: str) -> str:
    return html.unescape(re.sub(r"<[^>]+>", "", text))


def index(site: Path) -> dict[str, object]:
    """The search index, from the script that pages opened from disk read."""
    script = (site / "search" / "search_index.js").read_text()
    found: dict[str, object] = json.loads(script.removeprefix("var __index = ").rstrip("; \n"))
    return found


def test_the_parts_are_tabs(site):
    tabs = re.findall(
        r'<li class="md-tabs__item.*?<a [^>]*>(.*?)</a>', (site / "index.html").read_text(), re.DOTALL
    )
    assert [plain(tab).strip() for tab in tabs] == TABS


def test_nothing_is_fetched_from_elsewhere(site):
    for name, text in pages(site).items():
        loaded = re.findall(r'<(?:script|img|iframe)[^>]* src="([^"]+)"', text)
        loaded += re.findall(r'<link[^>]* rel="(?:stylesheet|preload|preconnect)"[^>]* href="([^"]+)"', text)
        assert [place for place in loaded if "//" in place] == [], name
        assert [
            place for place in loaded if not ((site / name).parent / re.split("[?#]", place)[0]).exists()
        ] == [], name
    for style in site.rglob("*.css"):
        assert not re.search(r"url\(['\"]?https?:", style.read_text()), style


def test_pictures_have_their_dark_variant_beside_them(site):
    """Pictures with a dark variant are both on the page, marked for their scheme; the stylesheet shows one of them."""
    pairs = 0
    for name, text in pages(site).items():
        shown = re.findall(r'<img[^>]* src="([^"]*images/[^"]+)"', article(text))
        light = [place for place in shown if not place.endswith("#only-dark")]
        for place in light:
            dark = place.split("#")[0].replace(".png", "_dark.png")
            if ((site / name).parent / dark).exists():
                assert place.endswith("#only-light"), place
                assert shown[shown.index(place) + 1] == f"{dark}#only-dark"
                pairs += 1
    assert pairs >= 12
    styles = "".join(style.read_text() for style in site.rglob("*.css"))
    assert 'img[src$="#only-dark"]' in styles


def test_every_formula_reaches_the_site(site):
    """Each math block of the pages is typeset by the script; none remains as a listing."""
    count = 0
    for source in sorted((ROOT / "docs").rglob("*.md")):
        blocks = len(re.findall(r"^```math$", source.read_text(), re.MULTILINE))
        name = str(source.relative_to(ROOT / "docs").with_suffix(".html"))
        text = article(pages(site)[name])
        assert len(re.findall(r'<div class="arithmatex">\s*\\\[', text)) == blocks, name
        count += blocks
    assert count > 100


def test_no_listing_is_wider_than_a_page(site):
    """Columns of code, without a browser. Program output and signatures wrap."""
    wide = []
    for name, text in pages(site).items():
        for language, code in re.findall(
            r'<div class="language-(\w+) highlight">.*?<code>(.*?)</code>', article(text), re.DOTALL
        ):
            if language in ("text", "console"):
                continue
            lines = plain(code).splitlines()
            wide += [
                f"{name}: {line}" for line in lines if len(line) > COLUMNS and name.split("/")[0] != "api"
            ]
    assert wide == []


def test_no_table_is_wider_than_a_page(site):
    """The sum of the longest unbreakable words in each column, without a browser."""
    most = 135
    for name, text in pages(site).items():
        for table in re.findall(r"<table>(.*?)</table>", article(text), re.DOTALL):
            rows = [re.findall(r"<t[hd][^>]*>(.*?)</t[hd]>", row, re.DOTALL) for row in table.split("</tr>")]
            cells = [[re.sub(r"<code>.*?</code>", "code", cell) for cell in row] for row in rows if row]
            words = [[max(map(len, plain(cell).split()), default=0) for cell in row] for row in cells]
            columns = [max(column) for column in zip(*words, strict=True)]
            assert sum(columns) + 2 * len(columns) < most, f"{name}: {plain(table)[:60]}"


def test_every_table_has_a_head(site):
    for name, text in pages(site).items():
        for head in re.findall(r"<thead>(.*?)</thead>", article(text), re.DOTALL):
            assert plain(head).strip(), name


def test_the_index_of_the_search_has_every_page(site):
    documents = index(site)["docs"]
    assert isinstance(documents, list)
    listed = {str(document["location"]).split("#")[0] for document in documents}
    assert {name for name in pages(site) if name not in listed} - {"index.html"} == set()
    found = [document["location"] for document in documents if "hysteresis" in str(document).lower()]
    assert "theory/hysteresis.html" in {str(place).split("#")[0] for place in found}


# -- in a browser


class Answers(http.server.SimpleHTTPRequestHandler):
    """Serves a folder, and stores the posted data."""

    def do_POST(self) -> None:
        server = self.server
        body = self.rfile.read(int(self.headers["Content-Length"])).decode()
        self.send_response(200)
        self.end_headers()
        server.answer = body  # type: ignore[attr-defined]
        server.answered.set()  # type: ignore[attr-defined]

    def log_message(self, *_: object) -> None:
        """Nothing is printed."""


@pytest.fixture
def served(site):
    """A local server for the folder of the site."""
    handler = functools.partial(Answers, directory=str(site))
    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), handler) as server:
        server.answered, server.answer = threading.Event(), ""  # type: ignore[attr-defined]
        thread = threading.Thread(target=server.serve_forever, daemon=True)
        thread.start()
        yield server
        server.shutdown()
        thread.join()


@pytest.fixture
def browse(served, tmp_path):
    """browse(address, seconds): opens the address in Chromium and returns the data that the page posts."""
    browser = next(filter(None, map(shutil.which, BROWSERS)), None)
    if browser is None:
        pytest.skip("no Chromium on this machine (Debian: chromium-headless-shell)")

    def answer(address: str, seconds: float) -> str:
        options = ["--headless", "--no-sandbox", "--disable-gpu", f"--user-data-dir={tmp_path / 'profile'}"]
        # The debugging port keeps the browser open; it is not used.
        command = [browser, *options, "--remote-debugging-port=0", "--window-size=1500,1000", address]
        quiet = subprocess.DEVNULL
        # A process group, because the command may be a script whose end would leave the browser running.
        with subprocess.Popen(command, stdout=quiet, stderr=quiet, start_new_session=True) as process:
            try:
                assert served.answered.wait(seconds), f"no answer from {address}"
            finally:
                os.killpg(process.pid, signal.SIGTERM)
        served.answered.clear()
        return str(served.answer)

    return answer


def test_pages_fit_into_1400_and_400_pixels(site, served, browse):
    """At 1400 px no table, listing, formula or picture is wider than its column. At 400 px the page does not scroll
    sideways; wider elements scroll by themselves. Formulas are typeset, and pictures are loaded."""
    names = list(pages(site))
    harness = (HERE / "measure_pages.html").read_text().replace("PAGES", json.dumps(names))
    (site / "measure.html").write_text(harness)
    results = json.loads(browse(f"http://127.0.0.1:{served.server_port}/measure.html", 600.0))
    (site / "measure.html").unlink()
    assert len(results) == 2 * len(names)
    cut = [
        (result["page"], result["width"], found)
        for result in results
        for found in result["found"]
        if result["width"] == 1400 or not found["scrolls"]
    ]
    assert cut == []
    assert [(r["page"], r["page_width"]) for r in results if r["page_width"] > r["width"] + 1] == []
    assert [(r["page"], r["wrong"], r["formulas"] - r["typeset"]) for r in results if r["wrong"]] == []
    assert [r["page"] for r in results if r["formulas"] != r["typeset"]] == []
    # Numbers of more than three digits and percentages, which a line must not break.
    assert [(r["page"], r["loose"]) for r in results if r["loose"]] == []
    assert [(r["page"], r["broken"]) for r in results if r["broken"]] == []
    assert sum(r["formulas"] for r in results) > 1000


@pytest.mark.parametrize(
    ("word", "page"),
    [
        ("hysteresis", "theory/hysteresis.html"),
        ("current_limit_A", "keys/device.html"),
        ("openPMD", "map_file.html"),
    ],
)
def test_the_search_finds_pages_on_disk(site, served, browse, word, page):
    """The site is opened as a file, as from an unpacked archive."""
    script = (HERE / "search_site.js").read_text()
    script = script.replace("WORD", word).replace("PLACE", f"http://127.0.0.1:{served.server_port}/")
    probe = site / "probe.html"
    probe.write_text(
        (site / "index.html").read_text().replace("</body>", f"<script>{script}</script></body>")
    )
    found = browse(probe.as_uri(), 180.0)
    probe.unlink()
    assert page in {
        place.split("?")[0].split("#")[0].removeprefix(site.as_uri() + "/") for place in found.split("\n")
    }
