"""Names of devices, recipes and scenarios in page code that is too slow to run exist, and `generate` gets device
options only with a device."""

import ast
import inspect
import re
from pathlib import Path

import pytest

import fieldmap as fm
from fieldmap.shipped import shipped_file, shipped_names

ROOT = Path(__file__).parents[2]
PAGES = sorted([ROOT / "README.md", *(ROOT / "docs").glob("**/*.md")])
FENCED = re.compile(r"^```python\n(.*?)^```$", re.DOTALL | re.MULTILINE)
INLINE = re.compile(r"`(fm\.\w+\([^`\n]*\))`")
KINDS = {
    "read_device": ("geometry", ""),
    "generate": ("maps", ""),
    "simulate": ("maps", "scenarios/"),
    "open_machine": ("maps", "scenarios/"),
    "read_scenario": ("maps", "scenarios/"),
}
KEYWORDS = {
    name for name, each in inspect.signature(fm.generate).parameters.items() if each.kind == each.KEYWORD_ONLY
}
OF_A_DEVICE = KEYWORDS - {"changes"}


def calls(text: str):
    """(name of the function, call) in the blocks of a page and in its inline code."""
    for code in FENCED.findall(text) + INLINE.findall(text):
        try:
            tree = ast.parse(code)
        except SyntaxError:
            continue
        for node in ast.walk(tree):
            if isinstance(node, ast.Call):
                name = (
                    node.func.attr if isinstance(node.func, ast.Attribute) else getattr(node.func, "id", "")
                )
                if name in KINDS and node.args:
                    yield name, node


def fault(name: str, call: ast.Call) -> str:
    """The problem with the name given to a call; "" if there is none."""
    given = call.args[0]
    if not (isinstance(given, ast.Constant) and isinstance(given.value, str)):
        return ""
    if name == "generate" and {word.arg for word in call.keywords} & OF_A_DEVICE:
        return f"generate({given.value!r}) with words of a device"
    folder, below = KINDS[name]
    if given.value.endswith((".toml", ".h5")) or "\n" in given.value:
        return ""
    return "" if shipped_file(folder, below + given.value) else f"{name}({given.value!r}): no such file"


def test_what_it_looks_for_is_what_python_says():
    assert {"spacing", "box", "currents"} <= OF_A_DEVICE
    assert {"eight_coils_bead"} <= set(shipped_names("maps"))
    page = '`fm.generate("eight_coils_bead", "b.h5", spacing=4e-3)` and `fm.simulate("hoold")`, `fm.simulate("hold")`\n'
    found = [fault(*each) for each in calls(page)]
    assert [bool(each) for each in found] == [True, True, False]
    with pytest.raises(fm.errors.RecipeError):
        fm.generate("eight_coils_bead", "b.h5", spacing=4e-3)


@pytest.mark.parametrize("path", PAGES, ids=lambda path: str(path.relative_to(ROOT)))
def test_names_in_python(path):
    assert [text for each in calls(path.read_text()) if (text := fault(*each))] == []
