"""The reference pages have the current signatures, for readers of a checkout."""

import importlib

import pytest

from fieldmap.maps import generate


@pytest.fixture
def program(monkeypatch, request):
    monkeypatch.syspath_prepend(str(request.config.rootpath / "scripts" / "dev"))
    return importlib.import_module("api_signatures")


def test_pages_have_the_signatures_of_now(program):
    """`python scripts/dev/api_signatures.py` writes them anew."""
    pages = sorted(program.FOLDER.glob("*.md"))
    assert len(pages) > 12
    for page in pages:
        text = page.read_text(encoding="utf-8")
        assert text == program.with_signatures(text), page.name


def test_a_signature_that_has_changed_is_replaced(program):
    page = "# Maps\n\n<!-- signatures\ngenerate(recipe, old=1)\n-->\n\n::: fieldmap.maps.generate\n    options: {}\n"
    written = program.with_signatures(page)
    assert "old=1" not in written
    assert written.count("<!-- signatures") == written.count("-->") == 1
    assert "generate(recipe, output=None, resume=True, progress=None, workers=1," in written
    assert written.endswith("::: fieldmap.maps.generate\n    options: {}\n")
    told = "".join(written.split("-->")[0].split())
    assert all(f"{name}=" in told for name in list(generate.__annotations__)[1:-1])


def test_methods_stand_below_their_class(program):
    lines = list(program.signatures("fieldmap.lookup.FieldMap"))
    assert any(line.startswith("  .field(points, currents") for line in lines)
    assert not any("._" in line or "self" in line or " at 0x" in line for line in lines)
    assert not list(program.signatures("fieldmap.errors.Infeasible"))
