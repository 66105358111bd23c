from pathlib import Path

import numpy as np
import pytest

from fieldmap.control.identification import ROLES, Orders, identify_log, make_log, read_log, write_log
from fieldmap.errors import InputError
from tests.refusals import refused

GOOD = "# rig 1\ntime (ms),position (mm),drive current (mA)\n0,8.0,1500\n2,8.5,1400\n4,9.0,1450\n"


def test_units_become_si(tmp_path):
    path = tmp_path / "log.csv"
    path.write_text(GOOD)
    log = read_log(path)
    assert log.Ts == pytest.approx(2e-3)
    np.testing.assert_allclose(log["position"], [8e-3, 8.5e-3, 9e-3])
    np.testing.assert_allclose(log["drive current"], [1.5, 1.4, 1.45])
    assert log.units == {"position": "m", "drive current": "A"}
    np.testing.assert_allclose(log.deviations(rest=2)["position"], [-0.25e-3, 0.25e-3, 0.75e-3])
    np.testing.assert_allclose(log.time, [0, 2e-3, 4e-3])


@pytest.mark.parametrize("rest", [0, 3])
def test_a_rest_is_shorter_than_the_log(rest):
    log = make_log(1e-3, {"x": [1.0, 2.0, 3.0]}, {"x": "m"})
    with refused(InputError, must_hold="1 to 2 ", received=str(rest)):
        log.deviations(rest=rest)


@pytest.mark.parametrize(("wrong", "told"), [(1, 1), (4, 4), (5, 5), (6, 6), (20, 6)])
def test_of_many_wrong_lines_five_are_told_and_the_rest_counted(wrong, told, tmp_path):
    rows = [f"{0.001 * k:.3f},{'x' if k < wrong else k}" for k in range(30)]
    (tmp_path / "log.csv").write_text("\n".join(["time (s),position (mm)", *rows]))
    with pytest.raises(InputError) as error:
        read_log(tmp_path / "log.csv", {"position": ["position"]})
    problems = error.value.problems
    assert len(problems) == told
    assert [p.where.rsplit(":", 1)[-1] for p in problems[:5]] == [str(2 + k) for k in range(min(wrong, 5))]
    if wrong > 5:
        assert problems[-1].received.split()[0] == str(wrong)


def test_what_is_written_is_read(tmp_path):
    rng = np.random.default_rng(0)
    log = make_log(
        2e-3, {"position": rng.normal(size=50), "u": rng.normal(size=50)}, {"position": "mm", "u": "1"}
    )
    write_log(tmp_path / "a.csv", log, {"position": "um"})
    assert (tmp_path / "a.csv").read_text().splitlines()[1] == "time (s),position (um),u (1)"
    back = read_log(tmp_path / "a.csv")
    for name in log.signals:
        np.testing.assert_allclose(back[name], log[name], rtol=1e-8)
    assert back.Ts == pytest.approx(log.Ts)


@pytest.mark.parametrize("name", ["a.csv", "a.log", "folder.csv"])
def test_a_written_log_replaces_a_written_log_alone(tmp_path, name):
    """A log that a rig measured is kept, even if its headings are the same."""
    log, path = make_log(1e-3, {"x": [1.0, 2.0]}, {"x": "mm"}), tmp_path / name
    if name == "folder.csv":
        path.mkdir()
    elif name == "a.csv":
        for values in ([3.0, 4.0], [1.0, 2.0]):
            write_log(path, make_log(1e-3, {"x": values}, {"x": "mm"}))
        assert read_log(path)["x"] == pytest.approx([1e-3, 2e-3])
        path.write_text("time (s),x (m)\n0,5\n1,6\n")
    before = path.read_text() if path.is_file() else ""
    with refused(InputError, where=str(path)):
        write_log(path, log)
    assert (path.read_text() if path.is_file() else "") == before
    assert len(list(tmp_path.iterdir())) == (name != "a.log")


def test_spreadsheet_marks_and_spaces(tmp_path):
    path = tmp_path / "log.csv"
    path.write_bytes(
        b"\xef\xbb\xbf" + GOOD.replace(",", " , ").replace("# rig 1\n", "").replace("\n", "\r\n").encode()
    )
    assert read_log(path)["position"].size == 3


@pytest.mark.parametrize(
    ("text", "says"),
    [
        (GOOD.replace("position (mm)", "position"), "name \\(mm\\)"),
        (GOOD.replace("(mm)", "(furlong)"), "furlong"),
        (GOOD.replace("time (ms)", "clock (ms)"), "which column is the time"),
        (GOOD.replace("time (ms)", "time (mm)"), "column time: must be a time"),
        (GOOD.replace("drive current (mA)", "position (mm)"), "once"),
        (GOOD.replace("8.5", "nan"), "log.csv:4: must be 3 cells, with finite"),
        (GOOD.replace("8.5,", ""), "log.csv:4: must be 3 cells, with finite"),
        (GOOD.replace("\n4,", "\n5,"), "evenly sampled"),
        (GOOD.replace("\n4,", "\n2,"), "evenly sampled"),
        (GOOD.replace("\n2,", "\n-2,"), "evenly sampled"),
        ("time (s),x (m)\n3,1\n3,2\n3,4\n", "evenly sampled"),
        ("time (s),x (m)\n0,1\n", "2 rows"),
        ("time (s)\n0\n1\n", "columns between"),
        ("", "2 rows"),
    ],
)
def test_broken_logs(tmp_path, text, says):
    (tmp_path / "log.csv").write_text(text)
    with pytest.raises(InputError, match=says):
        read_log(tmp_path / "log.csv")


def test_a_file_that_is_not_there(tmp_path):
    with pytest.raises(InputError, match="can be read"):
        read_log(tmp_path / "none.csv")


def test_wrong_units_and_names(tmp_path):
    log = make_log(1e-3, {"x": [1.0, 2.0]}, {"x": "mm"})
    with pytest.raises(InputError, match="length"):
        write_log(tmp_path / "a.csv", log, {"x": "A"})
    assert not (tmp_path / "a.csv").exists()
    with refused(InputError, received="y"):
        log["y"]


@pytest.mark.parametrize(
    ("Ts", "signals", "says"),
    [
        (0.0, {"x": [1.0, 2.0]}, "Ts"),
        (1e-3, {"x": [1.0, float("nan")]}, "finite"),
        (1e-3, {"x": [1.0, 2.0], "y": [1.0]}, "all of one length"),
        (1e-3, {}, "all of one length"),
    ],
)
def test_a_log_that_cannot_be(Ts, signals, says):
    with pytest.raises(InputError, match=says):
        make_log(Ts, signals, dict.fromkeys(signals, "m"))


def test_a_number_behind_a_name_is_no_unit(tmp_path):
    """u_1 and y_1 are channels; a 1 means "no unit" only in brackets."""
    (tmp_path / "log.csv").write_text("time_s,u_1,y_mm,v (1)\n0,1,2,3\n0.1,2,3,4\n")
    found = read_log(
        tmp_path / "log.csv", {"u": ["u_1"], "y": ["y"], "v": ["v"]}, units={"u_1": "V"}, whole_names=True
    )
    assert {role: (column.name, column.unit) for role, column in found.columns.items()} == {
        "time": ("time", "s"),
        "u": ("u_1", "V"),
        "y": ("y", "mm"),
        "v": ("v", "1"),
    }


BROKEN = "time (s),control (V),position (furlong)\n0,1,2\n0.1,x,3\n0.2,1\n0.3,nan,3\n0.9,1,2\n"


@pytest.mark.parametrize(
    ("text", "wheres"),
    [
        (BROKEN, ["log.csv: column position", "log.csv:3", "log.csv:4", "log.csv:5"]),
        ("time (s),u (V),y (m)\n0,1,1\n1,1,1\n2,1,1\n3,1,1\n9,1,1\n", ["log.csv:6"]),
        ("time,u (furlong),y\n0,1,2\n1,2,3\n", [f"log.csv: column {name}" for name in ("time", "u", "y")]),
        ("a (s),u (V),y (m)\n0,1,1\n1,1,1\n", ["log.csv: time"]),
        ("time (m),u (V),y (m)\n0,1,1\n1,1,1\n", ["log.csv: column time"]),
        ("time (s),u (V),u2 (V)\n0,1,1\n1,1,1\n", ["log.csv: output"]),
        ("time (s),u (V),Y (m),y (m)\n0,1,1,1\n1,1,1,1\n", ["log.csv: output"]),
        ("one\ntwo\nthree\n", ["log.csv:1"]),
        ("one\n", ["log.csv"]),
    ],
)
def test_logs_that_cannot_be_read(tmp_path, text, wheres):
    (tmp_path / "log.csv").write_text(text)
    with pytest.raises(InputError) as error:
        read_log(tmp_path / "log.csv", ROLES, required=("input", "output"))
    found = [problem.where for problem in error.value.problems]
    assert [Path(where).name if "/" in where else where for where in found] == wheres


def test_a_log_without_a_reference_is_at_rest_at_its_first_sample(tmp_path):
    rng = np.random.default_rng(3)
    control, position = rng.normal(4.2, 0.1, 500), 8.0 + np.cumsum(rng.normal(0.0, 0.01, 500))
    rows = (
        f"{0.002 * k:.3f},{u:.6f},{y:.6f}" for k, (u, y) in enumerate(zip(control, position, strict=True))
    )
    (tmp_path / "log.csv").write_text("time (s),control (V),position (mm)\n" + "\n".join(rows))
    found = identify_log(read_log(tmp_path / "log.csv", ROLES), Orders(2, 1))
    assert found.rest == 1
    assert found.operating_point["output"] == pytest.approx(position[0], abs=1e-6)


def test_what_cuts_every_line_alike_is_the_delimiter(tmp_path):
    """Even where a decimal comma would cut most lines; one line has no comma in its numbers."""
    rows = "".join(f"{k} {k},5\n" for k in range(9)) + "9 10\n"
    path = tmp_path / "log.txt"
    path.write_text("u,in_mV y_mV\n" + rows)
    log = read_log(path, {"input": ("u,in",), "output": ("y",)}, sampling_time=0.1)
    assert (log.delimiter, log.decimal) == ("blanks", ",")
    assert log["output"] == pytest.approx(1e-3 * np.array([*np.arange(9) + 0.5, 10.0]))


@pytest.mark.parametrize("text", ["1,5", "-1,5", "+1,5", ",5", "-,5", "1,5e-3", "-1,5E+3", "12,"])
def test_a_decimal_comma_in_any_form_of_number(tmp_path, text):
    """One such number in a column of whole ones; a trailing comma alone decides nothing, so that file has another."""
    beside = "2,25" if text == "12," else "7"
    rows = ["time (ms);position (mm)", f"0;{text}", f"2;{beside}", "4;8"]
    (tmp_path / "log.csv").write_text("\n".join(rows))
    log = read_log(tmp_path / "log.csv")
    assert log.decimal == ","
    assert log["position"][0] == pytest.approx(1e-3 * float(text.replace(",", ".")))


@pytest.mark.parametrize("column", [0, 1, 2])
def test_a_decimal_comma_in_one_column_alone(tmp_path, column):
    rows = [["0", "3", "-4"], ["2", "5", "-6"], ["4", "7", "-8"]]
    for row in rows:
        row[column] += ",5"
    head = "time (ms);x (mm);y (mm)"
    (tmp_path / "log.csv").write_text("\n".join([head, *map(";".join, rows)]))
    log = read_log(tmp_path / "log.csv")
    exact = np.array([[3.0, -4.0], [5.0, -6.0], [7.0, -8.0]])
    if column:
        exact[:, column - 1] += 0.5 * np.sign(exact[:, column - 1])
    np.testing.assert_allclose(np.column_stack([log["x"], log["y"]]), 1e-3 * exact)


@pytest.mark.parametrize(
    ("late", "even"), [(0.0195, True), (0.0205, False), (-0.0195, True), (-0.0205, False)]
)
def test_a_step_may_be_two_percent_off_the_mean(tmp_path, late, even):
    """One sample in the middle is late or early: the step before it is longer by `late`, the next one shorter."""
    times = np.arange(11.0)
    times[5] += late
    rows = "\n".join(f"{time!r},{k}" for k, time in enumerate(times.tolist()))
    (tmp_path / "log.csv").write_text(f"time (ms),x (mm)\n{rows}\n")
    if even:
        assert read_log(tmp_path / "log.csv").Ts == pytest.approx(1e-3)
        return
    with refused(InputError, must_hold="evenly sampled", where=f"{tmp_path / 'log.csv'}:7"):
        read_log(tmp_path / "log.csv")


@pytest.mark.parametrize(("drift", "even"), [(0.45, True), (0.55, False)])
def test_times_may_drift_by_half_a_step(tmp_path, drift, even):
    """Every step is within 2 %, but the second half is faster than the first: the middle is off by `drift` steps."""
    half = 40
    first, second = 1.0 + drift / half, 1.0 - drift / half
    times = np.concatenate([[0.0], np.cumsum([first] * half + [second] * half)])
    rows = "\n".join(f"{time!r},{k}" for k, time in enumerate(times.tolist()))
    (tmp_path / "log.csv").write_text(f"time (ms),x (mm)\n{rows}\n")
    if even:
        read_log(tmp_path / "log.csv")
        return
    with refused(InputError, must_hold="evenly sampled"):
        read_log(tmp_path / "log.csv")
