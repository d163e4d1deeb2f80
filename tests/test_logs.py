"""Logs: columns and units by name, lines that are no rows, time stamps, outliers, bounded memory."""

from __future__ import annotations

import functools
import math
import tracemalloc

import numpy as np
import pytest
from log_texts import HEADER, log_text, read, write
from rig_logs import rig_rows, write_log

from railslip_ctrl.core.errors import InputError
from railslip_ctrl.identification import cells, observed, outliers, rolling
from railslip_ctrl.identification.columns import NAMES, UNITS, find_columns
from railslip_ctrl.identification.identify import Options, read_curve
from railslip_ctrl.identification.logs import LONGEST_LINE, Log
from railslip_ctrl.identification.outliers import OutlierFilter
from railslip_ctrl.identification.record import Recorder
from railslip_ctrl.identification.rows import Rows
from railslip_ctrl.model.adhesion import published_law
from railslip_ctrl.model.vehicle import PARK2008, Rail

# --- columns -------------------------------------------------------------------------------------------------------

WHOLE = {"time": "time", "train_speed": "v", "wheel_speed": "vw", "brake_torque": "Tb"}


def header_with(quantity, cell):
    return [cell if name == quantity else other for name, other in WHOLE.items()]


@pytest.mark.parametrize(("quantity", "name"), [(q, name) for q, names in NAMES.items() for name in names])
def test_every_accepted_name_is_found(quantity, name):
    header = [cell for q, cell in WHOLE.items() if q != quantity] + [name.upper().replace(" ", "_")]
    if name == "n":  # a letter for two quantities: its unit tells
        header[-1] += f" [{UNITS[quantity]}]"
    assert find_columns(header)[quantity].index == len(header) - 1


@pytest.mark.parametrize(
    ("quantity", "cell", "factor"),
    [
        ("train_speed", "train speed [km/h]", 1 / 3.6),
        ("train_speed", "v (m/s)", 1.0),
        ("train_speed", "v_kmh", 1 / 3.6),
        ("train_speed", "Vehicle-Speed [mph]", 0.44704),
        ("time", "t [ms]", 1e-3),
        ("time", "time_s", 1.0),
        ("brake_torque", "brake torque [kN*m]", 1e3),
        ("brake_torque", "Tb [kNm]", 1e3),
        ("brake_torque", "torque_Nm", 1.0),
        ("wheel_angular_speed", "omega [rpm]", math.pi / 30),
        ("wheel_angular_speed", "rotational speed [1/min]", math.pi / 30),
        ("wheel_angular_speed", "w [deg/s]", math.pi / 180),
        ("wheel_angular_speed", "n [1/min]", math.pi / 30),
        ("wheel_load", "wheel load [kN]", 1e3),
        ("wheel_load", "N [kN]", 1e3),
    ],
)
def test_units_in_the_header(quantity, cell, factor):
    column = find_columns([*(c for q, c in WHOLE.items() if q != quantity), cell])[quantity]
    assert column.unit_given
    assert column.factor == pytest.approx(factor, rel=1e-15)


def test_options_win_over_the_header():
    header = ["a", "v [km/h]", "vw", "Tb [kN*m]"]
    columns = find_columns(header, {"time": "a"}, {"train_speed": "m/s", "wheel_speed": "km/h"})
    assert columns["time"].index == 0
    assert columns["train_speed"].factor == 1.0
    assert columns["wheel_speed"].factor == pytest.approx(1 / 3.6)
    assert columns["brake_torque"].factor == 1e3
    assert not columns["time"].unit_given


@pytest.mark.parametrize(
    ("wheel", "columns", "units", "factor"),
    [
        (["wheel speed [rad/s]"], {}, {}, 1.0),
        (["Wheel Speed (1/s)"], {}, {}, 1.0),
        (["vw_rpm"], {}, {}, math.pi / 30),
        (["vw"], {}, {"wheel_speed": "rad/s"}, 1.0),
        (["axle 1 [rpm]"], {"wheel_speed": "axle 1"}, {}, math.pi / 30),
        (["vw [rad/s]", "omega [rpm]"], {"wheel_angular_speed": "omega"}, {}, math.pi / 30),
    ],
)
def test_a_wheel_speed_in_an_angular_unit_is_the_angular_one(wheel, columns, units, factor):
    found = find_columns(["time", "v", "Tb", *wheel], columns, units)
    assert "wheel_speed" not in found
    assert found["wheel_angular_speed"].factor == pytest.approx(factor, rel=1e-15)


@pytest.mark.parametrize(
    ("header", "columns", "units", "message"),
    [
        (["time", "v", "vw"], {}, {}, "no column for brake_torque; call one 'brake torque'"),
        (["time", "v", "Tb"], {}, {}, "no column for wheel_speed"),
        (["time", "v", "speed", "vw", "Tb"], {}, {}, "train_speed may be any of 'v', 'speed'"),
        (list(WHOLE.values()), {"train_speed": "velocity"}, {}, "--column train_speed: no column is called 'velocity'"),
        (list(WHOLE.values()), {"pressure": "v"}, {}, "--column: 'pressure' is not a quantity"),
        (list(WHOLE.values()), {}, {"load": "N"}, "--unit: 'load' is not a quantity"),
        (list(WHOLE.values()), {}, {"time": "kg"}, "--unit time: 'kg' is not a unit of time"),
        (["time", "v [kN]", "vw", "Tb"], {}, {}, r"column 'v \[kN\]': 'kN' is not a unit of train_speed"),
        (["time", "v", "vw [rad/s]", "omega", "Tb"], {}, {}, r"angular_speed may be any of 'vw \[rad/s\]', 'omega'"),
        (["time", "v [wombat]", "vw", "Tb"], {}, {}, "'wombat' is not a unit of train_speed"),
    ],
)
def test_columns_that_cannot_be_told(header, columns, units, message):
    with pytest.raises(InputError, match=message):
        find_columns(header, columns, units)


def test_every_quantity_has_names_and_a_unit():
    assert NAMES.keys() == UNITS.keys()


# --- rows ----------------------------------------------------------------------------------------------------------


def test_rows_are_si_and_know_their_lines(tmp_path):
    rows, log = read(write(tmp_path, log_text(50)))
    assert rows.line.tolist() == list(range(2, 52))
    assert rows.columns["time"] == pytest.approx(0.01 * np.arange(50), abs=1e-15)
    assert rows.columns["train_speed"] == pytest.approx((100 - 0.01 * np.arange(50)) / 3.6, rel=1e-13)
    assert rows.columns["brake_torque"] == pytest.approx(np.full(50, 1500.0))
    assert (log.broken.count, log.notes) == (0, ())


@pytest.mark.parametrize("block_bytes", [40, 333, 1 << 20])
def test_blocks_of_any_size_give_the_same_rows(tmp_path, block_bytes):
    lines = log_text(200).splitlines(keepends=True)
    lines[90] = "rubbish\n"
    lines[120] = "\n"
    path = write(tmp_path, "".join(lines))
    rows, log = read(path, block_bytes=block_bytes)
    assert rows.line.tolist() == [i + 1 for i in range(1, 201) if i not in (90, 120)]
    assert log.broken.first == ("line 91: 1 cells where the header has 4",)
    assert log.share == 1.0


@pytest.mark.parametrize(
    "convert",
    [
        lambda text: text.replace(",", ";").replace(".", ","),
        lambda text: text.replace(",", "\t"),
        lambda text: text.replace("\n", "\r\n"),
        lambda text: text.replace(",", ", "),
    ],
    ids=["semicolon and decimal comma", "tab", "carriage return", "spaces"],
)
def test_dialects(tmp_path, convert):
    expected, _ = read(write(tmp_path, log_text(30)))
    rows, log = read(write(tmp_path, convert(log_text(30)), "other.csv"))
    assert log.broken.count == 0
    for name, values in expected.columns.items():
        assert rows.columns[name] == pytest.approx(values, rel=1e-14, abs=1e-15)


def test_quotes_bytes_of_latin_1_and_columns_of_text_do_no_harm(tmp_path):
    text = (
        '"time [s]","v [km/h]","vw [km/h]","Tb [kN*m]","remark \xb0"\n0.0,"100",99,1,"cold, 5 \xb0C"\n0.1,100,98,1,\n'
    )
    rows, log = read(write(tmp_path, text))
    assert rows.columns["wheel_speed"] == pytest.approx([99 / 3.6, 98 / 3.6])
    assert log.broken.count == 0


def test_a_byte_order_mark_is_no_part_of_a_name(tmp_path):
    path = tmp_path / "log.csv"
    path.write_bytes(b"\xef\xbb\xbf" + log_text(5).encode())
    assert len(read(path)[0]) == 5


def test_a_cut_file_loses_its_last_line_alone(tmp_path):
    text = log_text(40)
    rows, log = read(write(tmp_path, text[:-4]))
    assert len(rows) == 39
    assert log.broken.first == ("line 41: the file ends within this line, which is left out",)


def test_corrupted_lines_are_named_and_the_others_kept(tmp_path):
    lines = log_text(40).splitlines(keepends=True)
    lines[5] = "0.04,10x,99,1.5\n"
    lines[9] = "0.08,100,,1.5\n"
    lines[15] = "0.14,100,99,1.5,7\n"
    lines[20] = "\x00\x01\x02\n"
    lines[25] = "0.24,100,inf,1.5\n"
    rows, log = read(write(tmp_path, "".join(lines)))
    assert len(rows) == 35
    assert log.broken.count == 5
    assert [text.split(":")[0] for text in log.broken.first] == ["line 6", "line 10", "line 16", "line 21", "line 26"]
    assert "'10x' is not a number, column 'train speed [km/h]'" in log.broken.first[0]
    assert "missing" in log.broken.first[1]
    assert set(range(2, 42)) - set(rows.line.tolist()) == {6, 10, 16, 21, 26}


@pytest.mark.parametrize("block_bytes", [40, 1 << 20])
@pytest.mark.parametrize("which", [slice(None), slice(20, 21)], ids=["all", "one"])
def test_line_ends_translated_twice_are_read_and_told(tmp_path, which, block_bytes):
    expected, _ = read(write(tmp_path, log_text(30)))
    lines = log_text(30).splitlines(keepends=True)
    lines[which] = [line.replace("\n", "\r\r\n") for line in lines[which]]
    rows, log = read(write(tmp_path, "".join(lines), "other.csv"), block_bytes=block_bytes)
    assert rows.line.tolist() == expected.line.tolist()
    for name, values in expected.columns.items():
        assert np.array_equal(rows.columns[name], values)
    first = 2 if which.start is None else which.start + 1
    assert log.notes == (f"line {first}: its end was translated twice (\\r\\r\\n); such lines are read all the same",)


@pytest.mark.parametrize(
    ("damaged", "reason"),
    [
        ("0.18,9\r9,98,1.5", "a control character or a carriage return within the line"),
        ("0.18,99,98,1.5\x001", "a control character"),  # read as 1.5 otherwise
        ('0.18,"99,98,1.5', "a quotation mark without its other one"),
        ('0.18,99,98,x"1,5"', "quotation marks within a cell"),
        ('0.18,9"9",98,1.5', "is not a number"),
        ('0.18,"9"9,9x,1.5', "quotation marks within a cell"),
        ("0.18,9_9,98,1.5", "'9_9' is not a number"),
    ],
)
def test_what_no_parser_of_csv_takes_is_named_and_survived(tmp_path, damaged, reason):
    lines = log_text(40).splitlines(keepends=True)
    lines[19] = damaged + "\n"
    rows, log = read(write(tmp_path, "".join(lines)))
    assert log.broken.count == 1
    assert log.broken.first[0].startswith("line 20: ")
    assert reason in log.broken.first[0]
    assert set(range(2, 42)) - set(rows.line.tolist()) == {20}


@pytest.mark.parametrize("seed", range(60))
def test_no_damage_costs_more_than_the_lines_it_is_in(tmp_path, seed):
    """Random bytes, quotes and returns in some lines: the others are read as they were, or time is refused."""
    generator = np.random.default_rng(seed)
    lines = [line.encode() for line in log_text(60).splitlines(keepends=True)]
    damaged = generator.choice(np.arange(1, 60), size=4, replace=False)
    for i in damaged:
        bits = [generator.bytes(30).replace(b"\n", b""), b'"', b"\r", b"1_0", b",", b"\0"]
        at = generator.integers(len(lines[i]))
        lines[i] = lines[i][:at] + bits[seed % len(bits)] + lines[i][at:]
    path = tmp_path / "log.csv"
    path.write_bytes(b"".join(lines))
    try:
        rows, _ = read(path)
    except InputError as error:
        assert "give times that grow" in str(error)  # noqa: PT017 - the other outcome is the usual one
        return
    kept = dict(zip(rows.line.tolist(), rows.columns["train_speed"], strict=True))
    for i in set(range(1, 61)) - set(damaged.tolist()):
        assert kept[i + 1] == pytest.approx((100 - 0.01 * (i - 1)) / 3.6, rel=1e-13)


def test_a_comma_is_the_decimal_mark_where_it_is_one(tmp_path):
    expected, _ = read(write(tmp_path, log_text(30)))
    tabs, _ = read(write(tmp_path, log_text(30).replace(",", "\t").replace(".", ","), "tabs.csv"))
    lines = log_text(30, HEADER + ",remark").replace(",", ";").splitlines()
    remarks = "\n".join([lines[0], *(line + ";cold, wet" for line in lines[1:])]) + "\n"
    remarked, _ = read(write(tmp_path, remarks, "remarks.csv"))
    for rows in (tabs, remarked):
        assert rows.columns["wheel_speed"] == pytest.approx(expected.columns["wheel_speed"], rel=1e-14)


def test_comments_are_passed_over_and_counted_as_lines(tmp_path):
    lines = log_text(20).splitlines(keepends=True)
    text = "".join(["# Rig A, 2008\n", "\n", "# 5,6,7,8\n", *lines[:10], "# halt, 1, 2, 3\n", *lines[10:]])
    rows, log = read(write(tmp_path, text))
    assert log.broken.count == 0
    assert rows.line.tolist() == [*range(5, 14), *range(15, 26)]


@pytest.mark.parametrize(
    ("block", "broken", "reason"),
    [
        (
            b"\0" * 50,
            1,
            "line 21: a control character, 50 null bytes, which may stand for many rows and count as one line",
        ),
        (b"\0" * (2 * LONGEST_LINE), 1, "line 21: "),
        (b"8" * (5 * LONGEST_LINE) + b"\n", 1, "line 21: more than 1048576 bytes without a line end"),
        (bytes(range(256)) * 3, 4, "line 21: a control character"),
    ],
    ids=["zeros", "many zeros", "no line end", "bytes with three line ends"],
)
def test_a_damaged_block_costs_the_lines_it_is_in(tmp_path, block, broken, reason):
    lines = [line.encode() for line in log_text(40).splitlines(keepends=True)]
    rows, log = read(write(tmp_path, b"".join([*lines[:20], block, *lines[20:]])), block_bytes=1 << 18)
    assert log.broken.count == broken
    assert log.broken.first[0].startswith(reason)
    own_line = block.endswith(b"\n")
    lost = [] if own_line else [19]  # else the block is one line with the row after it
    expected, _ = read(write(tmp_path, log_text(40)))
    assert np.array_equal(rows.columns["time"], np.delete(expected.columns["time"], lost))
    assert rows.line[-1] == 41 + block.count(b"\n")


def test_a_file_that_ends_without_line_ends_takes_no_memory(tmp_path):
    """What a disk leaves after a power cut: zeros to the end."""
    read(write(tmp_path, log_text(40)))  # what is imported on the way
    path = write(tmp_path, log_text(40).encode() + b"\0" * (20 * LONGEST_LINE))
    tracemalloc.start()
    rows, log = read(path, block_bytes=1 << 18)
    found = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert found < 5 * LONGEST_LINE
    assert len(rows) == 40
    assert log.broken.first == ("line 42: more than 1048576 bytes without a line end, which count as one line",)


def test_a_cell_missing_from_a_line_on_is_told_with_the_last_line(tmp_path):
    lines = log_text(40).splitlines(keepends=True)
    rows, log = read(write(tmp_path, "".join([*lines[:20], *(line.split(",", 1)[1] for line in lines[20:])])))
    assert len(rows) == 19
    assert (log.broken.count, log.broken.last) == (21, 41)
    assert log.broken.first[0] == "line 21: 3 cells where the header has 4"


def test_words_in_many_places_of_a_long_log_are_all_found(tmp_path):
    """Longer than the pieces that are gone through by themselves."""
    lines = log_text(3500).splitlines(keepends=True)
    bad = [2, 1000, 1001, 1002, 2500, 3501]
    for line in bad:
        lines[line - 1] = lines[line - 1].replace(",", ",x", 1)
    rows, log = read(write(tmp_path, "".join(lines)))
    assert log.broken.count == len(bad)
    assert sorted(set(range(2, 3502)) - set(rows.line.tolist())) == bad
    expected, _ = read(write(tmp_path, log_text(3500)))
    kept = np.isin(expected.line, rows.line)
    assert np.array_equal(rows.columns["wheel_speed"], expected.columns["wheel_speed"][kept])


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "empty"),
        ("\n\n", "empty"),
        (HEADER, "nothing after line 1"),
        (HEADER + "\n", "no rows after the header"),
        (HEADER + "\nx\n", "no rows after the header; line 2: 1 cells"),
        (log_text(3).replace("\n", "\r"), r"nothing after line 1.*lines must end in \\n, not in \\r"),
        ("1,2,3,4\n5,6,7,8\n", "line 1: no header, but numbers"),
        ("t\0i\0m\0e\0\n1\n", "not a text file"),
        ("time,v,vw,pressure\n1,2,3,4\n", "no column for brake_torque"),
    ],
)
def test_files_that_are_no_logs(tmp_path, text, message):
    with pytest.raises(InputError, match=message):
        read(write(tmp_path, text))


def test_paths_that_are_no_files(tmp_path):
    with pytest.raises(InputError, match="no such file"):
        Log(tmp_path / "nothing.csv")
    with pytest.raises(InputError, match="is a directory"):
        Log(tmp_path)


def test_a_column_without_a_unit_is_si_and_said_so(tmp_path):
    _, log = read(write(tmp_path, log_text(5, "time [s],v [km/h],omega,Tb [kN*m]")))
    assert log.notes == ("column 'omega' names no unit: rad/s is taken for wheel_angular_speed",)
    assert find_columns(["t", "v", "omega", "Tb", "N"])["wheel_load"].index == 4  # as before n meant anything else


def test_what_was_assumed_is_told_with_the_error_it_may_be_the_cause_of(tmp_path):
    path = write(tmp_path, log_text(30, "time [s],v,omega,Tb [kN*m]"))
    with pytest.raises(InputError, match=r"rows are under brake.*; column 'v' names no unit: m/s is taken"):
        read_curve(path, PARK2008, Options())


def test_memory_does_not_grow_with_the_log(tmp_path):
    """A log eight times as long; blocks of 64 kB, so that both are many of them."""

    def peak(count):
        path = write(tmp_path, log_text(count))
        tracemalloc.start()
        for _ in Log(path, block_bytes=1 << 16).rows():
            pass
        found = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        return found

    peak(100)  # what is imported on the way
    assert peak(80_000) < 1.1 * peak(10_000)


def test_memory_is_bounded_through_observer_and_curve(tmp_path, monkeypatch):
    """A log four times as long takes no more, once it is beyond what is kept of it: rows of runs, windows, and sums.

    All are bounded here by less than usually, so that a short log is beyond. Without
    bounds the sums take a twentieth more, the rows a third.
    """
    monkeypatch.setattr(cells, "_MOST_ENTRIES", 256)
    monkeypatch.setattr(observed, "Recorder", functools.partial(Recorder, 2000))
    monkeypatch.setattr(outliers, "PIECE", 512)  # rows wait for a piece, which is to be short beside either log
    monkeypatch.setattr(rolling, "_MOST_WINDOWS", 256)
    rows = rig_rows(published_law("beam", Rail.DRY), runs=2, seed=3)[0]
    path, options = tmp_path / "long.csv", Options(block_bytes=1 << 16)

    def peak(times):
        columns = {name: np.tile(values, times) for name, values in rows.columns.items()}
        columns["time"] = 0.01 * np.arange(times * len(rows))
        write_log(path, Rows(np.arange(times * len(rows)) + 2, columns))
        tracemalloc.start()
        curve = read_curve(path, PARK2008, options)
        found = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        assert curve.survey.rows == times * len(rows)
        assert curve.stretches.count.size <= 256
        assert len(curve.record) <= 2000
        return found

    peak(1)  # what is imported on the way
    assert peak(24) < 1.02 * peak(6)  # where blocks end in the runs makes a difference of some thousandths


# --- outliers ------------------------------------------------------------------------------------------------------


def speeds(count=5000, seed=3):
    generator = np.random.default_rng(seed)
    time = 0.01 * np.arange(count)
    wheel = 60.0 - 0.3 * np.maximum(time - 10.0, 0.0) ** 1.2 + 0.02 * generator.standard_normal(count)
    torque = np.where(time < 10.0, 0.0, 4000.0)  # a step is no outlier
    return Rows(
        np.arange(count) + 2,
        {"time": time, "train_speed": np.full(count, 27.0), "wheel_angular_speed": wheel, "brake_torque": torque},
    )


def filtered(rows, sizes):
    outliers, kept, start = OutlierFilter(), [], 0
    for size in sizes:
        kept.append(outliers.add(rows.part(start, start + size)))
        start += size
    kept.append(outliers.finish())
    return outliers, np.concatenate([part.line for part in kept])


def test_outliers_are_left_out_and_nothing_else():
    rows = speeds()
    spikes = [50, 1200, 1201, 3000, 4999]
    rows.columns["wheel_angular_speed"][spikes] += [3.0, -5.0, 8.0, 200.0, -2.0]
    outliers, lines = filtered(rows, [len(rows)])
    assert sorted(set(rows.line.tolist()) - set(lines.tolist())) == [i + 2 for i in spikes]
    assert (outliers.count, outliers.first_line) == (5, 52)


def test_clean_noise_and_steps_have_no_outliers():
    for seed in range(5):
        outliers, lines = filtered(speeds(seed=seed), [5000])
        assert outliers.count == 0
        assert len(lines) == 5000


@pytest.mark.parametrize("sizes", [[4096, 3, 1, 900], [4500, 500], [4999, 1], [1001, 3999]])
def test_outliers_do_not_depend_on_the_blocks(sizes):
    """The last sizes part the blocks at the step of the torque, which by itself would look like an outlier."""
    rows = speeds()
    rows.columns["train_speed"][[10, 4097, 4098, 4499, 4998]] = 90.0
    _, whole = filtered(rows, [len(rows)])
    _, lines = filtered(rows, sizes)
    assert lines.tolist() == whole.tolist()
    assert len(whole) == len(rows) - 5
