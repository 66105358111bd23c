"""The script prints the tables of docs/theory/force_formulas.md."""

from tests.docs.pages import ROOT


def test_tables_are_those_of_the_page(program):
    script = program("force_superposition", "studies")
    page = (ROOT / "docs" / "theory" / "force_formulas.md").read_text()
    printed = [" ".join(line.split()) for line in page.splitlines()]
    rows = script.planar_rows() + script.spatial_rows()
    assert len(rows) == 14
    # Within two units of the last digit, or the effect of another three-dimensional mesh on small errors.
    for row in rows:
        near = [line for line in printed if _words(line) == _words(row)]
        assert any(_close(row, line) for line in near), row


def _numbers(text):
    found = []
    for word in text.replace(",", " ").replace("(", " ").replace(")", " ").split():
        try:
            found.append((float(word), 10.0 ** -len(word.partition(".")[2])))
        except ValueError:
            continue
    return found


def _words(text):
    return [word for word in text.split() if word.isalpha()]


def _close(row, line):
    one, other = _numbers(row), _numbers(line)
    return len(one) == len(other) and all(
        abs(a - b) <= max(2.01 * unit, 0.08 * abs(b)) for (a, unit), (b, _) in zip(one, other, strict=True)
    )
