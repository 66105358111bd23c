"""Line numbers against a second method: mark each key in the text and find the mark."""

import tomllib

from fieldmap.inputs.document import line_numbers, nearest_line

AWKWARD = '''\
# a comment with [header] and key = 1
top = "a # no comment, [no header]"  # a comment with "quotes
"quoted = key" = 'literal \\'
multi = """
[not.a.header]
key = 3 \\""" still inside
"""   # ends here
raw = \'\'\'
fake = 1\'\'\'
[table]
array = [
  [1, 2],  # ] not the end
  [3, 4],
]
inline = { a = 1, b = [2, 3] }
a.b.c = 1
a.b.d = 2

[[list]]   # first
x = 1
[[list.inner]]
y = 1
[[list.inner]]
y = 2
[list.sub]
z = 1
[[list]]
x = 2
[[list.inner]]
y = 3
'''


def test_awkward_toml_is_indexed():
    tomllib.loads(AWKWARD)
    lines = line_numbers(AWKWARD)
    rows = AWKWARD.split("\n")

    def text_of(*location):
        return rows[lines[location] - 1]

    assert text_of("top").startswith("top")
    assert text_of("quoted = key").startswith('"quoted')
    assert text_of("multi").startswith("multi")
    assert text_of("raw").startswith("raw")
    assert text_of("table", "array").startswith("array")
    assert text_of("table", "inline").startswith("inline")
    assert text_of("table", "a", "b", "d") == "a.b.d = 2"
    assert text_of("list", 0, "inner", 1, "y") == "y = 2"
    assert text_of("list", 0, "sub", "z") == "z = 1"
    assert text_of("list", 1, "x") == "x = 2"
    assert text_of("list", 1, "inner", 0, "y") == "y = 3"
    assert not any("fake" in location or "key" in location for location in lines)


def test_things_without_a_line_take_that_of_what_holds_them():
    lines = line_numbers(AWKWARD)
    assert nearest_line(lines, ("table", "inline", "a")) == lines[("table", "inline")]
    assert nearest_line(lines, ("table", "missing")) == lines[("table",)]
    assert nearest_line(lines, ("nowhere",)) is None


def test_every_key_of_a_whole_file_has_its_line(valid_text):
    rows = valid_text.split("\n")
    lines = line_numbers(valid_text)
    waiting = [((), tomllib.loads(valid_text))]
    seen = 0
    while waiting:
        location, here = waiting.pop()
        if isinstance(here, dict):
            waiting += [((*location, key), value) for key, value in here.items()]
        elif isinstance(here, list) and here and isinstance(here[0], dict):
            waiting += [((*location, k), value) for k, value in enumerate(here)]
        else:
            key, _, written = rows[lines[location] - 1].partition("=")
            assert key.strip().strip('"') == location[-1]
            assert tomllib.loads(f"x = {written}")["x"] == here
            seen += 1
    assert seen > 100
