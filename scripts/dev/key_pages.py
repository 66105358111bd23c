"""Write docs/keys: every key of every file that people write, one row each, from the schemas of the readers.

    python scripts/dev/key_pages.py

Type, unit, default and meaning come from the schema. The example comes from a shipped file, a page or a test that has
the key, or else from the default or the first choice. A test checks that the pages are up to date.
"""

import re
import tomllib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, Any, Literal, get_args, get_origin

from pydantic import BaseModel, Discriminator, Tag, TypeAdapter, ValidationError
from pydantic.fields import FieldInfo

from fieldmap.device.patterns import Image, Repeat
from fieldmap.inputs.document import Document
from fieldmap.inputs.kinds import MARKS, FileKind
from fieldmap.inputs.tables import LARGEST_LENGTH_MM, LARGEST_NUMBER, UNITS
from fieldmap.io.json_schema import FILE_KINDS, _WithoutTitles
from fieldmap.shipped import shipped_folder

ROOT = Path(__file__).parents[2]
FOLDER = ROOT / "docs" / "keys"
TITLES = {
    "device": "Keys of device files",
    "material": "Keys of material files",
    "planar device": "Keys of planar device files",
    "recipe": "Keys of map recipes",
    "study": "Keys of study files",
    "fit": "Keys of fit files",
    "scenario": "Keys of scenario files",
}
ABOUT = {
    "device": "[Device files](../device_files.md) explains the tables, with examples of whole files.",
    "material": "A material file holds one measured B-H curve; a material of a [device file](device.md) names it.",
    "planar device": "[Machines in two dimensions](../planar.md) explains the tables.",
    "recipe": "[Map recipes](../recipes.md) explains what a map is asked for.",
    "study": "[Parameter studies](../studies.md) explains what is varied and recorded.",
    "fit": "[A machine's unknown numbers](../fit_machine.md) explains what is fitted to what.",
    "scenario": "[Simulation](../dynamics.md) explains what a run is.",
}
# Tables with a page of their own, by kind of file and outermost key; no page is longer than ten screens.
PARTS: dict[str, dict[str, tuple[str, ...]]] = {
    "device": {
        "coils": ("coil", "background"),
        "bodies": ("body", "joint", "section"),
        "materials": ("material",),
        "payload": ("payload",),
    },
    "scenario": {"control": ("control",)},
}
# Unit of a key without a stated unit: the longest ending that is a unit, because A_per_m also ends in m.
UNIT = re.compile(r"(?:^|_)(" + "|".join(sorted((*UNITS, "A_mm2"), key=len, reverse=True)) + r")$")
FACES = [[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]]
CORNERS = [[0, 0, 0], [10, 0, 0], [0, 10, 0], [0, 0, 10]]
# Examples by meaning, for keys that no file, page or test has. A changed meaning needs a new entry.
EXAMPLES: dict[str, Any] = {
    "[[i, j, k], ...] numbers of corners from 0, counter-clockwise from outside": FACES,
    "[x, y, z] of the centre of its lower face": [0.0, 0.0, -110.0],
    '"key.path" = "source of the number"; * means any one step': {"coil.*.turns": "drawing 12"},
    "how far the reference is pushed": 0.05,
    "[[i, j, k, l], ...] numbers of nodes from 0": [[0, 1, 2, 3]],
    "the coil's current in the original model": 2.5,
    "thickness, cut out of the body whose end the joint is; 0: no joint": 0.1,
    "for key paths, such as joint.NAME.gap_mm": "core ends",
    "names of the two bodies, with * and ? as wildcards. A pair takes the last joint that names it. Without"
    " this key: all contacts that no other joint names": ["core *", "disk"],
    "relative permeability of the material in the gap": 1.0,
    "diameter of the round wire of loops and polylines, for their self-inductance": 0.5,
    "current, in a coil that for 1 A in the coil": 1.0,
    "of a Circle or Sphere": 30.0,
    "of a Cuboid [x, y, z], a Cylinder [diameter, height], a CylinderSegment [inner radius, outer radius, height]": [
        10.0, 20.0, 5.0,
    ],
    "of a CylinderSegment, [first, last]": [0.0, 90.0],
    "[[i, j, k], ...], numbers of vertices from 0": [[0, 1, 2]],
    "of a TriangleSheet, [x, y, z] for each face, in a coil those for 1 A in the coil": [[100.0, 0.0, 0.0]],
    "[x, y, z] of a magnet": [0.0, 0.0, 1.2],
    "[x, y, z] of a Dipole": [0.0, 0.0, 0.8],
    "[x, y, z] remanence in the device's frame": [0.0, 0.0, 1.2],
    "field strengths, strictly increasing": [200.0, 1000.0, 20000.0],
    "flux densities, one for each field strength, strictly increasing": [0.8, 1.4, 2.0],
    'with "towards saturation": value to which B - mu0 H rises past the last point': 2.15,
    "path of the STEP file, relative to the device file": "yoke.step",
    "relative reluctivity at B = 0": 2e-4,
    "constant relative permeability, instead of a material": 1000.0,
    "[x, y, z] lengths of its axes": [2.0, 2.0, 6.0],
    "half the exponent of B": 5.5,
    "B^(2 alpha) at the middle of the knee, B in T": 5e4,
    "relative reluctivity that the formula tends to": 1.0,
    "[width, height] of rectangular conductors": [20.0, 40.0],
    "coils that carry one current, by name: lower_A and upper_A are those of the groups then": [["1", "3"], ["2"]],
    "map recipe, whose device and iron are taken": "workspace",
    '"key.path" = value': {"body.disk.radius_mm": 50.0},
    "one current for all coils, or one per coil": 1.5,
    "of each coil, where the currents are looked for": [1.0, 1.0, 0.5],
    "of every coil; the driver's if left out": 3.5,
    "mean current; left out where it is looked for": 1.5,
    "numbers of nodes of that table for u, x and y, each at least 4; as many as it needs unless given": [7, 21, 21],
    "depth of the magnet's centre below the sensed point; the device's unless given": 15.0,
    "z of a floor": -120.0,
    "z of a ceiling": -10.0,
    "lowest voltage at a winding; minus the supply's unless given": -24.0,
    "of the input converter": 12,
    "bits of the output converter": 12,
    "averages with which deviation_mm was measured; `averages` unless given": 4,
    "frequency": 2.0,
    "path, relative to the scenario": "path.csv",
    "value; that of the equilibrium at the start unless given": 4.4,
    "how many; as many as the lists have values if left out": 6,
    "axis that they are turned about": "z",
    "from one to the next; a full turn divided by count if left out": 60.0,
    "[x, y, z] of a point of the axis": [0.0, 0.0, 10.0],
    "[x, y, z] from one to the next": [20.0, 0.0, 0.0],
    "where the mirror crosses that axis": 10.0,
    "of the image; {name} stands for the name of the table": "{name} left",
    "deviation of the readings of x, y and depth; by default from [sensors]": [0.02, 0.02, 0.02],
}  # fmt: skip


# Examples for other keys without one: the first value that the reader accepts.
USUAL: tuple[Any, ...] = (10.0, 1, 0.5, "name", [10.0, 20.0], [10.0, 20.0, 5.0], CORNERS)


@dataclass(frozen=True)
class Variant:
    """One of the tables allowed at a place. tag: value that selects it, empty without a choice."""

    tag: str
    model: type[BaseModel]


@dataclass(frozen=True)
class Place:
    """A table of the file. title: its heading; path: keys that lead to it, `*` for names."""

    title: str
    path: tuple[str, ...]
    key: str
    variants: tuple[Variant, ...]


@dataclass
class Examples:
    """Values of keys in files, by model and key."""

    values: dict[tuple[type[BaseModel], str], list[Any]] = field(default_factory=dict)

    def add(self, model: type[BaseModel], key: str, value: Any) -> None:
        """Add a value of a key of a table."""
        self.values.setdefault((model, key), []).append(value)

    def of(self, model: type[BaseModel], key: str) -> Any:
        """The value with the shortest text, from this table or from another table with the same key and type."""
        found = list(self.values.get((model, key), []))
        about = model.model_fields[key]
        if not found:
            for (other, name), values in self.values.items():
                shared = other.model_fields.get(key) if name == key else None
                if shared is not None and shared.annotation == about.annotation:
                    found += values
        # Sorted first, because the check whether a value fits takes most of the time.
        found.sort(key=lambda value: (len(toml(value)), toml(value)))
        return next((value for value in found if fits(about, value)), None)


def fits(about: FieldInfo, value: Any) -> bool:
    """Whether the reader accepts this value for the key."""
    try:
        TypeAdapter(
            Annotated[about.annotation, *about.metadata] if about.metadata else about.annotation
        ).validate_python(value)
    except ValidationError:
        return False
    return True


def toml(value: Any) -> str:
    """A value as TOML."""
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, str):
        return '"' + value.replace("\\", "\\\\").replace('"', '\\"') + '"'
    if isinstance(value, list | tuple):
        return "[" + ", ".join(toml(one) for one in value) + "]"
    if isinstance(value, Mapping):
        return "{ " + ", ".join(f"{toml_key(key)} = {toml(one)}" for key, one in value.items()) + " }"
    return f"{value:g}" if isinstance(value, float) and abs(value) < 1e15 else str(value)


def toml_key(key: str) -> str:
    """A key, in quotes where TOML asks for them."""
    return key if re.fullmatch(r"[\w-]+", key) else f'"{key}"'


# -- the shape of a schema


def variants_of(annotation: Any, metadata: tuple[Any, ...] = ()) -> tuple[tuple[Variant, ...], Any]:
    """The tables that a value may be, and the discriminator that selects one; none for a value that is not a table."""
    if get_origin(annotation) is Annotated:
        inner, *more = get_args(annotation)
        return variants_of(inner, (*metadata, *more))
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        tag = next((str(one.tag) for one in metadata if isinstance(one, Tag)), "")
        return (Variant(tag, annotation),), None
    chooser = next((one for one in metadata if isinstance(one, Discriminator)), None)
    if get_origin(annotation) in (list, dict):
        return variants_of(get_args(annotation)[-1])
    members = [one for one in get_args(annotation) if one is not type(None)]
    if get_origin(annotation) in (None, Literal) or not members:
        return (), None
    found: tuple[Variant, ...] = ()
    for member in members:
        inside, below = variants_of(member)
        found += inside
        chooser = chooser or below
    return found, chooser


def form(annotation: Any) -> str:
    """How a table is written: "list", "names" or "table"."""
    if get_origin(annotation) is Annotated:
        return form(get_args(annotation)[0])
    if get_origin(annotation) is list:
        return "list"
    if get_origin(annotation) is dict:
        return "names"
    forms = [form(one) for one in get_args(annotation) if one is not type(None)]
    return forms[0] if forms and get_origin(annotation) is not Literal else "table"


def places(root: type[BaseModel]) -> list[Place]:
    """All tables of a file, outer tables first. A table allowed at several places appears once, with all titles."""
    found = [Place("Top level", (), "", (Variant("", root),))]
    for place in found:
        for variant in place.variants:
            for key, about in variant.model.model_fields.items():
                inside, chooser = variants_of(about.annotation, tuple(about.metadata))
                if not inside:
                    continue
                kind = form(about.annotation)
                steps = (*place.path, key)
                name = ".".join((*steps, "NAME") if kind == "names" else steps)
                title = f"[[{name}]]" if kind == "list" else f"[{name}]"
                new = Place(
                    title, (*steps, "*") if kind == "names" else steps, getattr(chooser, "key", ""), inside
                )
                same = next((old for old in found if old.variants == new.variants), None)
                if same is None:
                    after = [old for old in found if old.path[: len(place.path)] == place.path]
                    found.insert(found.index(after[-1]) + 1, new)
                elif title not in same.title.split(", "):
                    found[found.index(same)] = replace(same, title=f"{same.title}, {title}")
    return found


def collect(examples: Examples, model: type[BaseModel], data: Any) -> None:
    """Enter the values of a table of a file, and of the tables in it."""
    if not isinstance(data, Mapping):
        return
    for key, value in data.items():
        about = model.model_fields.get(key)
        if about is None:
            continue
        inside, chooser = variants_of(about.annotation, tuple(about.metadata))
        if not inside:
            examples.add(model, key, value)
            continue
        kind = form(about.annotation)
        entries = value if kind == "list" else value.values() if kind == "names" else [value]
        for entry in entries if isinstance(entries, list) else list(entries):
            tag = chooser.discriminator(entry) if chooser is not None and len(inside) > 1 else ""
            for variant in inside:
                if len(inside) == 1 or variant.tag == tag:
                    collect(examples, variant.model, entry)


def sources(kind: FileKind[Any]) -> Iterator[Document]:
    """Shipped files, files of the tests, and blocks of the pages, of one kind of file."""
    files = sorted(shipped_folder(kind.folder).rglob("*.toml")) + sorted((ROOT / "tests").rglob("*.toml"))
    documents = [Document(path, text := path.read_text(), tomllib.loads(text)) for path in files]
    for page in sorted((ROOT / "docs").rglob("*.md")):
        for block in re.findall(r"^```toml\n(.*?)^```$", page.read_text(), re.DOTALL | re.MULTILINE):
            try:
                documents.append(Document(ROOT / "geometry" / page.name, block, tomllib.loads(block)))
            except tomllib.TOMLDecodeError:
                continue
    for document in documents:
        try:
            prepared = kind.prepared(document)
        except Exception:
            # The document is of another kind, or a piece of a file.
            prepared = document
        if (
            prepared.data.keys() & (MARKS[kind.name].keys | {"format"})
            and prepared.data.keys() <= kind.schema.model_fields.keys()
        ):
            yield prepared


# -- words


def number_text(schema: Mapping[str, Any], word: str) -> str:
    """A number and its limits, without those that only keep numbers finite."""
    limits = {"exclusiveMinimum": "> ", "minimum": "≥ ", "exclusiveMaximum": "< ", "maximum": "≤ "}
    said = [
        f"{sign}{schema[name]:g}"
        for name, sign in limits.items()
        if name in schema and abs(schema[name]) not in (LARGEST_LENGTH_MM, LARGEST_NUMBER)
    ]
    return " ".join([word, ", ".join(said)]).strip()


def type_text(schema: Mapping[str, Any]) -> str:
    """The type of a value, from its JSON Schema."""
    if "const" in schema:
        return f"`{toml(schema['const'])}`"
    if "enum" in schema:
        return " or ".join(f"`{toml(one)}`" for one in schema["enum"])
    if "anyOf" in schema or "oneOf" in schema:
        members = [one for one in schema.get("anyOf", schema.get("oneOf", [])) if one.get("type") != "null"]
        if any(one.get("type") == "number" for one in members):
            members = [one for one in members if one.get("type") != "integer"]
        return " or ".join(dict.fromkeys(type_text(one) for one in members))
    kind = schema.get("type")
    if kind == "number":
        return number_text(schema, "number")
    if kind == "integer":
        return number_text(schema, "integer")
    if kind == "boolean":
        return "`true` or `false`"
    if kind == "string":
        return "text" if "pattern" not in schema else "name"
    if kind == "array":
        item = schema.get("items", {})
        count = schema.get("minItems") if schema.get("minItems") == schema.get("maxItems") else None
        inner = type_text(item) if item else "value"
        return f"{count} × {inner}" if count else f"list of {inner}"
    if kind == "object" or "$ref" in schema:
        return "table"
    return "number or text"


def unit_of(key: str, model: type[BaseModel] | None = None) -> str:
    """The unit of a key, as it is printed."""
    declared = getattr(model, "declared", {})
    found = UNIT.search(key)
    unit = declared[key].about.unit if key in declared else found[1] if found else ""
    text = re.sub("^per_", "1_per_", unit).replace("_per_", "/").replace("_", " ").replace("2", "²")
    return {"": "—", "deg": "degree", "ohm": "Ω"}.get(text, text)


def default_text(about: FieldInfo) -> str:
    """Text of the value without an entry."""
    if about.is_required():
        return REQUIRED
    value = about.get_default(call_default_factory=True)
    if value is None or value in ([], {}):
        return "none"
    if isinstance(value, BaseModel):
        return "its defaults"
    return f"`{toml(value)}`"


def example_text(examples: Examples, model: type[BaseModel], key: str, schema: Mapping[str, Any]) -> str:
    """One line of TOML with the key."""
    about = model.model_fields[key]
    value = next(iter(about.examples or ()), EXAMPLES.get(about.description or ""))
    if value is None:
        value = examples.of(model, key)
    if value is None and not about.is_required():
        value = about.get_default(call_default_factory=True)
        value = None if value in ([], {}) else value
    if value is None:
        value = written_here(schema, about)
    return f"`{toml_key(key)} = {toml(value)}`"


def written_here(schema: Mapping[str, Any], about: FieldInfo) -> Any:
    """The first choice, or the first usual value that the reader takes, for a key that no file has."""
    choices = [schema["const"]] if "const" in schema else list(schema.get("enum", []))
    for value in (*choices, *USUAL):
        if fits(about, value):
            return value
    raise LookupError(f"EXAMPLES needs an entry for {about}")


Row = tuple[str, str, str, str, str, str]
REQUIRED = "**required**"
HEAD = "| key | type | unit | default | meaning | example |\n|---|---|---|---|---|---|"


def cell(text: str) -> str:
    """A text escaped for a cell of a table."""
    return text.replace("|", "\\|").replace("\n", " ")


def rows_of(model: type[BaseModel], examples: Examples) -> dict[str, Row]:
    """One row for each key of a table."""
    properties = plain_schema(model)
    rows: dict[str, Row] = {}
    for key, about in model.model_fields.items():
        schema = properties[key]
        inside, _ = variants_of(about.annotation, tuple(about.metadata))
        kind = form(about.annotation)
        if inside:
            written = {"list": f"`[[{key}]]`", "names": f"`[{key}.NAME]`", "table": f"`[{key}]`"}[kind]
            what, example = ("tables" if kind == "list" else "table"), written
        else:
            what, example = type_text(schema), example_text(examples, model, key, schema)
        meaning = about.description or ""
        rows[key] = f"`{key}`", what, unit_of(key, model), default_text(about), cell(meaning), cell(example)
    return rows


def plain_schema(model: type[BaseModel]) -> dict[str, Any]:
    """JSON Schema of the keys of a table, without short forms, references filled in one level deep."""
    schema = BaseModel.model_json_schema.__func__(model, schema_generator=_WithoutTitles)  # type: ignore[attr-defined]
    properties: dict[str, Any] = schema["properties"]
    return properties


def table_text(rows: Mapping[str, Row]) -> str:
    """Rows as a table of Markdown."""
    return "\n".join([HEAD, *("| " + " | ".join(row) + " |" for row in rows.values())])


def place_text(place: Place, examples: Examples, told: dict[frozenset[Row], str]) -> str:
    """The section of one table: keys of all variants, then keys of each variant."""
    every = [rows_of(variant.model, examples) for variant in place.variants]
    shared = common_rows(place, every)
    lines = [f"## `{place.title}`" if place.path else f"## {place.title}"]
    if shared:
        lines.append(table_text(shared))
    if len(every) == 1:
        return "\n\n".join(lines)
    for variant, rows in zip(place.variants, every, strict=True):
        own = {key: row for key, row in rows.items() if key not in shared}
        first = place.title.split(", ")[0]
        name = f"`{first}`, {chosen_text(place, variant, rows)}"
        lines.append(f"### {name}\n\n{(variant.model.__doc__ or '').strip().splitlines()[0]}")
        known = told.setdefault(frozenset(own.values()), name)
        lines.append(table_text(own) if known == name else f"The same keys as under {known}.")
    return "\n\n".join(lines)


def common_rows(place: Place, every: list[dict[str, Row]]) -> dict[str, Row]:
    """Rows of the keys that all variants have, or all but a few, which are named."""
    shared: dict[str, Row] = {}
    for key in dict.fromkeys(key for rows in every for key in rows):
        having = [rows[key] for rows in every if key in rows]
        alike = len({row[1:5] for row in having}) == 1
        missing = [
            variant.tag for variant, rows in zip(place.variants, every, strict=True) if key not in rows
        ]
        if not alike or len(missing) > len(every) // 3 or (len(every) > 1 and key == place.key):
            continue
        what, kind, unit, default, meaning, example = having[0]
        without = f" (not of {', '.join(missing)})" if missing else ""
        shared[key] = what, kind, unit, default, meaning + without, example
    return dict(sorted(shared.items(), key=lambda entry: len(every) > 1 and entry[1][3] != REQUIRED))


def chosen_text(place: Place, variant: Variant, rows: Mapping[str, Row]) -> str:
    """How this variant is selected in a file."""
    kind = rows[place.key][1] if place.key in rows else ""
    if re.fullmatch(r"`[^`]*`", kind):
        value = kind.strip("`")
        more = variant.tag.removeprefix(value.strip('"')).strip()
        return f"`{place.key} = {value}`" + (f", {more}" if more else "")
    return variant.tag


def short_forms_text() -> str:
    """Keys of device files that reading expands: copies, mirrors, base files."""

    def row(key: str, what: str, unit: str, default: str, meaning: str, example: str) -> str:
        return "| " + " | ".join((f"`{key}`", what, unit, default, cell(meaning), f"`{example}`")) + " |"

    listed = "`[defaults.body]`, `[defaults.coil]`: keys of all tables of this file that lack them"
    paths = "text or list of text"
    begins = "device files that this one begins with, relative to it, or shipped ones"
    left_out = "key paths of included files that are left out"
    top = [
        row("include", paths, "—", "none", begins, 'include = "drive_unit.toml"'),
        row("without", paths, "—", "none", left_out, 'without = ["body.centre core"]'),
        row("defaults", "table", "—", "none", listed, "[defaults.body]"),
    ]
    parts = [
        "## Short forms",
        "These are written out when the file is read. A text that begins with `=` stands for a number in any key: "
        "[short forms](../device_files.md#short-forms).",
        "\n".join([HEAD, *top]),
    ]
    for name, model in (("repeat", Repeat), ("mirror", Image)):
        parts += [f"### `{name}` of `[[body]]` and `[[coil]]`", table_text(rows_of(model, Examples()))]
    return "\n\n".join(parts)


def pages_of(kind: FileKind[Any]) -> dict[str, str]:
    """The pages of one kind of file, by name. The first page has the tables that no other page has."""
    examples = Examples()
    for document in sources(kind):
        collect(examples, kind.schema, document.data)
    told: dict[frozenset[Row], str] = {}
    name = kind.name.replace(" ", "_")
    parts = PARTS.get(kind.name, {})
    links = [f"[{part}]({name}_{part}.md)" for part in parts]
    title = TITLES[kind.name]
    sections = {
        name: [
            f"# {title}",
            f"After this page you can look up every key of a {kind.name} file: its type and limits, its unit, what "
            f"holds without it, what it means, and how it is written. {ABOUT[kind.name]}"
            + (f" More tables are on pages of their own: {', '.join(links)}." if links else ""),
            "Written by `python scripts/dev/key_pages.py` from the classes that read the file. The unit of a number "
            "is the last part of its key. Other keys are errors.",
        ]
    }
    for part in parts:
        about = f"[{title}]({name}.md) explains the columns and has the other tables."
        sections[f"{name}_{part}"] = [f"# {title}: {part}", about]
    for place in places(kind.schema):
        part = next((part for part, keys in parts.items() if place.path[:1] and place.path[0] in keys), None)
        sections[name if part is None else f"{name}_{part}"].append(place_text(place, examples, told))
    if kind.short_forms:
        sections[name].append(short_forms_text())
    return {name: "\n\n".join(texts) + "\n" for name, texts in sections.items()}


def pages() -> dict[Path, str]:
    """All pages, by their files."""
    return {FOLDER / f"{name}.md": text for kind in FILE_KINDS for name, text in pages_of(kind).items()}


if __name__ == "__main__":
    FOLDER.mkdir(exist_ok=True)
    for path, text in pages().items():
        path.write_text(text, encoding="utf-8")
        print(path)
