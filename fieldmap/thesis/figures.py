"""The figures of the thesis, one by one: what each shows, and which part of a row draws it or why none does."""

from fieldmap.thesis.printed import read_part
from fieldmap.thesis.rows import PARTS

_SKETCH = "sketch"
_PHOTOGRAPH = "photograph"
_DIAGRAM = "block diagram"
_ANIMATION = "photograph; `fieldmap show RUN.h5` shows the magnet of a recorded run in space"

CAPTIONS = {
    "2-1": "a wire loop",
    "2-2": "a stack of loops",
    "2-3": "levitation along one axis",
    "2-4": "Bz of the exact and of the simplified winding",
    "2-5": "its gradient",
    "2-6": "force on the sphere, and where it levitates",
    "2-7": "magnetic suspension",
    "2-8": "the drive unit in two dimensions",
    "2-9": "Bz along x 100 mm below the pole piece, four current ratios",
    "2-10": "the same, close up",
    "2-11": "Bz along x at several depths",
    "2-12": "Bz downwards at x = 0, ratio 1:1",
    "2-13": "Bz in the plane, ratio 1:1.5 (ours along five verticals)",
    "2-14": "free body",
    "2-15": "how the loop turns the plant's negative gain round",
    "3-1": "control loop of the microrobot",
    "3-2": "yoke",
    "3-3": "pole piece",
    "3-4": "electromagnets on the pole piece",
    "3-5": "the assembled unit",
    "3-6": "accuracy of the micrometer over its field",
    "3-7": "local and global frame",
    "3-8": "what two crossed lasers measure",
    "3-9": "channel 1 of the amplifier, input and output",
    "3-10": "microrobot",
    "4-1": "the model in two dimensions",
    "4-2": "vertical force at x = 0, computed and by a line",
    "4-3": "slope of that line over x",
    "4-4": "its intercept over x",
    "4-5": "horizontal force of the left electromagnet",
    "4-6": "vertical force of both at x = 0",
    "4-7": "horizontal force of both, currents 3:1",
    "4-8": "electromagnets on the pole piece",
    "4-9": "horizontal force of electromagnets 1 and 4",
    "4-10": "electromagnet 1, y = 0",
    "4-11": "electromagnet 4, y = 0",
    "4-12": "electromagnet 1, y = 10 mm",
    "4-13": "electromagnet 1, y = 20 mm",
    "4-14": "electromagnet 1, y = 30 mm",
    "4-15": "electromagnet 1, y = -10 mm",
    "4-16": "1 and 4 with quadratic formulas",
    "5-1": "a closed loop",
    "5-2": "closed-loop model by generalised least squares",
    "5-3": "recursive estimates over time, forgetting factor 0.98",
    "5-4": "step of the height from 8 to 9 mm",
    "5-5": "output of the controller meanwhile",
    "5-6": "identified poles over the gain",
    "5-7": "root locus of the preliminary model",
    "5-8": "the same about q = 1",
    "5-9": "step: rig and preliminary model",
    "5-10": "the same at another gain",
    "5-11": "step inside a plastic tube and free",
    "5-12": "pseudo-random binary signal, first controller",
    "5-13": "the same, second controller",
    "5-14": "the same, third controller",
    "5-15": "step, first controller: rig, preliminary and final model",
    "5-16": "the same, second controller",
    "5-17": "the same, third controller",
    "5-18": "step of -2 mm: rig and models",
    "5-19": "steps up and down laid on each other",
    "5-20": "step, fourth controller: rig, models, and one with other gain and zero",
    "5-21": "ramp of 5 mm/s: rig and model",
    "5-22": "the same, second controller",
    "6-1": "open-loop step of x without the block",
    "6-2": "the same above the block",
    "6-3": "vertical step near the block and without it",
    "6-4": "electromagnets and their numbers",
    "6-5": "x over its signal",
    "6-6": "y over its signal",
    "6-7": "open-loop step of x to 1.4 mm: rig and models",
    "6-8": "open-loop step of x to 1.65 mm: rig and models",
    "6-9": "open-loop step of y to 0.75 mm: rig and models",
    "6-10": "open-loop step of y to 1.18 mm: rig and models",
    "6-11": "step of x under PD control: rig and models",
    "6-12": "x under PD control: 0.9, 1.0, 0.9 mm",
    "6-13": "x under PD control: -0.9, -1.0, -0.9 mm",
    "6-14": "step of y under PD control: rig and models",
    "6-15": "y under PD control: 0.9, 1.0, 0.9 mm",
    "6-16": "y under PD control, 0 to 1 mm and back",
    "6-17": "x under PID control, 0 to 0.5 mm",
    "6-18": "x under PID control: 0.4, 0.5, 0.4 mm",
    "6-19": "y under PID control",
    "6-20": "step of x under PID control: rig and models",
    "6-21": "the same with the model's integral time on the rig",
    "6-22": "step of y under PID control: rig and models",
    "6-23": "the same with the model's integral time on the rig",
    "6-24": "step of x from which the ratio of integral times is taken",
    "6-25": "step of x with that ratio",
    "6-26": "step of x at 18 mm: rig and models",
    "6-27": "step of y at 18 mm: rig and models",
    "7-1": "step of x with x alone and with both axes controlled",
    "7-2": "the same of y",
    "7-3": "y while x steps by 0.1 mm",
    "7-4": "y while x goes by steps of 0.01 mm",
    "7-5": "x and y step at once",
    "7-6": "steps of x, gain 1",
    "7-7": "the height meanwhile",
    "7-8": "steps of x with the push",
    "7-9": "the height meanwhile",
    "7-10": "one spike with and without the push",
    "7-11": "x with and without the push",
    "7-12": "steps of x with smaller gains",
    "7-13": "the height meanwhile",
    "7-14": "the height at rest",
    "7-15": "x with smaller gains and with the push",
    "7-16": "steps of the height at (0, 0)",
    "7-17": "x and y meanwhile",
    "7-18": "steps of the height at (1, 1) mm",
    "7-19": "x and y meanwhile",
    "7-20": "the microrobot at (0, 0, 6) mm",
    "7-21": "steps of 0.1 mm at 11 mm",
    "7-22": "the microrobot at (0, 0, 11) and (9, 0, 11) mm",
    "7-23": "the microrobot at (0, 0, 11) and (0, 9, 11) mm",
    "7-24": "circle of 0.5 mm, 0.16 rad/s",
    "7-25": "x and y over time",
    "7-26": "the height meanwhile",
    "7-27": "circle of 3 mm, 0.16 rad/s",
    "7-28": "the height meanwhile",
    "7-29": "half a circle of 3 mm, 0.0502 rad/s",
    "7-30": "the height meanwhile",
    "7-31": "regulator",
    "7-32": "step of -0.1 mm with the regulator: rig and model",
    "7-33": "first estimated state meanwhile",
    "7-34": "second estimated state meanwhile",
    "7-35": "horizontal motion, regulator",
    "7-36": "the height meanwhile",
    "7-37": "horizontal motion, PID",
    "7-38": "the height meanwhile",
}
"""Number -> what it shows, in the order of the thesis; chapter 1 has only sketches and photographs."""

ELSEWHERE = {
    **dict.fromkeys(("2-1", "2-2", "2-3", "2-7", "2-8", "2-14", "3-7", "3-8", "4-1"), _SKETCH),
    **dict.fromkeys(("2-15", "3-1", "5-1", "7-31"), _DIAGRAM),
    **dict.fromkeys(("3-2", "3-3", "3-4"), "drawing; `fieldmap show drive_unit` shows the solids"),
    "3-5": f"{_PHOTOGRAPH}; `fieldmap show drive_unit` shows the solids",
    "3-6": "the maker's data sheet",
    "3-9": "measured, points not printed; row S8 compares gain and limit",
    "3-10": "drawing",
    "4-8": "drawing; `fieldmap show drive_unit_a3` shows the solids",
    "5-11": "friction of a tube whose contact nobody measured",
    "6-4": "drawing; `fieldmap show drive_unit` shows coils with their names",
    **dict.fromkeys(("7-20", "7-22", "7-23"), _ANIMATION),
}
"""Number -> why no row draws it."""

HEAD = """# The thesis's figures

Which figures of the thesis the program draws. Written by `python scripts/figure_table.py` from the rows themselves; a
test holds it to them. A part is drawn with the row it belongs to,

```console
$ fieldmap thesis S16 --report report
```

or all at once by `python scripts/gallery.py` ([commands](commands.md)). Solid lines are ours, dashed lines and squares
computed or printed in the thesis, crosses measured there: most of its figures print no numbers, so that only those with
a table beside them carry measured points. Where the thesis shows its rig, the figure shows the coupled machine on the
computed map ([what it assumes](thesis_dynamics.md)).
"""


def drawn_by() -> dict[str, list[str]]:
    """Number of a figure -> the parts that draw it.

    >>> drawn_by()["2-4"]
    ['S4_levitation']
    """
    parts: dict[str, list[str]] = {}
    for part in PARTS:
        for number in read_part(part).figures:
            parts.setdefault(number, []).append(part)
    return parts


def figure_page() -> str:
    """docs/thesis_figures.md: a table for each chapter."""
    drawn, lines = drawn_by(), [HEAD]
    for chapter in dict.fromkeys(number.partition("-")[0] for number in CAPTIONS):
        lines += [f"## Chapter {chapter}\n", "| figure | shows | drawn by |", "|---|---|---|"]
        for number, caption in CAPTIONS.items():
            if number.startswith(f"{chapter}-"):
                by = ", ".join(f"`{part}`" for part in drawn.get(number, ()))
                lines.append(f"| {number} | {caption} | {by or 'not drawn: ' + ELSEWHERE[number]} |")
        lines.append("")
    return "\n".join(lines)
