"""Logs: files and headers, columns and units by name, lines that are no rows, time stamps, outliers, bounded memory."""

from __future__ import annotations

import bz2
import functools
import gzip
import math
import os
import sys
import tracemalloc
from pathlib import Path

import numpy as np
import pytest
from log_texts import HEADER, log_text, read, with_stamps, write
from rig_logs import rig_rows, write_log

from railslip_ctrl.core.errors import InputError
from railslip_ctrl.identification import curves, log_checks, observed
from railslip_ctrl.identification.cleaning import BESIDE, FAR, OutlierFilter, StampFilter
from railslip_ctrl.identification.curves import Options, read_curve
from railslip_ctrl.identification.logs import LONGEST_LINE, NAMES, UNITS, Log, Rows, find_columns
from railslip_ctrl.identification.observed import Recorder
from railslip_ctrl.model.adhesion import published_law
from railslip_ctrl.model.vehicle import PARK2008, Rail

BARE = "time,train speed,wheel speed,brake torque"
UNIT_ROW = "s,km/h,km/h,kN*m"
SHORT = "time_s train_speed_kmh wheel_speed_kmh brake_torque_kNm"
ROWS = 120  # lines 2 to 121

at_any_block = pytest.mark.parametrize("block_bytes", [60, 1 << 20])  # some two rows, and all


@pytest.fixture(scope="module")
def expected(tmp_path_factory):
    return read(write(tmp_path_factory.mktemp("plain"), log_text(60)))[0]


def same(rows, expected, *, lines_more=0):
    """Whether rows are those of the plain log, some lines further down."""
    # some roundings: of the decimal mark, and of the unit
    close = all(np.allclose(rows.columns[name], values, rtol=1e-14) for name, values in expected.columns.items())
    return close and np.array_equal(rows.line, expected.line + lines_more)


def rows_below(header, convert=lambda line: line):
    """The plain log with another header, its rows converted."""
    return header + "\n" + "".join(convert(line) + "\n" for line in log_text(60).splitlines()[1:])


def lost(rows, count):
    """The lines of a log of so many rows that are not among those read."""
    return sorted(set(range(2, count + 2)) - set(rows.line.tolist()))


def in_blocks(row_filter, rows, borders):
    """What a filter leaves of rows that come in blocks: their lines."""
    blocks = (rows.part(start, stop) for start, stop in zip([0, *borders], [*borders, len(rows)], strict=True))
    return np.concatenate([part.line for part in row_filter.rows(blocks)])


# --- files, separators, headers ------------------------------------------------------------------------------------


def test_rows_are_si_and_know_their_lines(expected):
    assert expected.line.tolist() == list(range(2, 62))
    assert expected.columns["time"] == pytest.approx(0.01 * np.arange(60), abs=1e-15)
    assert expected.columns["train_speed"] == pytest.approx((100 - 0.01 * np.arange(60)) / 3.6, rel=1e-13)
    assert expected.columns["brake_torque"] == pytest.approx(np.full(60, 1500.0))


@pytest.mark.parametrize("block_bytes", [50, 1 << 20])
@pytest.mark.parametrize(
    "content",
    [
        gzip.compress(log_text(60).encode()),
        gzip.compress(log_text(20).encode()) + gzip.compress("".join(log_text(60).splitlines(True)[21:]).encode()),
        b"\xef\xbb\xbf" + rows_below("# " + HEADER).encode(),
        "".join(line + ",\n" for line in log_text(60).splitlines()),
        rows_below(HEADER, lambda line: line + ","),
        rows_below(HEADER + ","),
        "".join(line.replace(",", ";") + ";;;\n" for line in log_text(60).splitlines()),
        rows_below(SHORT, lambda line: "  " + line.replace(",", "    ") + " "),
        rows_below(SHORT, lambda line: " \t" + line.replace(",", " \t ").replace(".", ",")),
        rows_below("time [s]\tv [km/h]\tvw (km/h)\tTb [kN*m]", lambda line: line.replace(",", "\t")),
        log_text(60).replace(",", ";").replace(".", ","),
        log_text(60).replace(",", "\t").replace(".", ","),
        rows_below((HEADER + ",remark").replace(",", ";"), lambda line: line.replace(",", ";") + ";cold, wet"),
        log_text(60).replace("\n", "\r\n"),
        log_text(60).replace(",", ", "),
    ],
    ids=[
        *("gzip", "gzip of two parts", "mark before a comment", "a separator at the end of every line", "of rows"),
        *("of the header", "three of every line", "blanks", "blanks and decimal commas", "tabs, and blanks in names"),
        *("semicolon and decimal comma", "tab and decimal comma", "commas in remarks", "carriage return", "spaces"),
    ],
)
def test_dialects_are_read_as_the_plain_log(tmp_path, expected, content, block_bytes):
    rows, log = read(write(tmp_path, content), block_bytes=block_bytes)
    assert same(rows, expected)
    assert (log.broken.count, log.share) == (0, 1.0)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "empty"),
        ("\n\n", "empty"),
        (HEADER, "nothing after line 1"),
        (HEADER + "\n", "no rows after the header"),
        (HEADER + "\nx\n", "no rows after the header; line 2: 1 cells"),
        ("1,2,3,4\n5,6,7,8\n", "line 1: no header, but numbers"),
        ("t\0i\0m\0e\0\n1\n", "not a text file"),
        ("time,v,vw,pressure\n1,2,3,4\n", "no column for brake_torque"),
        ("# a\n# b\n1,2,3,4\n", "line 3: no header, but numbers; name the columns in a line above, with their units"),
        ("# time,v,vw,pressure\n# rig\n1,2,3,4\n", r"header: no column for brake_torque.*has 'time', 'v', 'vw', 'pr"),
        ("# time,v,vw,Tb\n1,2,3,4,5\n", "line 2: no header, but numbers"),
        ("# time,v,vw,Tb\n1,2,3,4", "nothing after line 2"),
        ("# time,v,vw,Tb\n", "the file is empty or has no header"),
        (b"PK\x03\x04" + bytes(100), "is a ZIP archive or an Excel workbook; give a CSV file, gzipped or not"),
        (bz2.compress(log_text(9).encode()), "is packed with bzip2"),
        (gzip.compress(b"PK\x03\x04" + bytes(100), mtime=0), "is a ZIP archive"),
        (log_text(9).encode("utf-16-le"), "not a text file in UTF-8"),
        (gzip.compress(b"", mtime=0), "the file is empty"),
    ],
)
def test_files_that_are_no_logs(tmp_path, text, message):
    with pytest.raises(InputError, match=message):
        read(write(tmp_path, text))


def test_paths_that_are_no_files(tmp_path, monkeypatch):
    with pytest.raises(InputError, match="no such file"):
        Log(tmp_path / "nothing.csv")
    with pytest.raises(InputError, match="is a directory"):
        Log(tmp_path)
    if hasattr(os, "mkfifo"):
        os.mkfifo(tmp_path / "pipe")
        with pytest.raises(InputError, match="pipe: is not a regular file; give a CSV file, or - for standard input"):
            Log(tmp_path / "pipe")
    monkeypatch.setattr(sys, "stdin", None)
    with pytest.raises(InputError, match="standard input: is closed; give a CSV file, or pipe one in"):
        Log(Path("-"))


@pytest.mark.parametrize("block_bytes", [5000, 1 << 20])
def test_a_packed_log_that_is_cut_gives_what_came_before(tmp_path, block_bytes):
    """Numbers of noise, which hardly packs, so that the cut is far from the end."""
    noise = np.random.default_rng(0).random((3000, 3)) + 100.0
    text = HEADER + "\n" + "".join(f"{0.01 * i:.2f},{a!r},{b!r},{c!r}\n" for i, (a, b, c) in enumerate(noise.tolist()))
    packed = gzip.compress(text.encode(), mtime=0)
    rows, log = read(write(tmp_path, packed[: len(packed) // 2]), block_bytes=block_bytes)
    assert 1000 < len(rows) < 2000
    line = len(rows) + 2
    assert log.broken.first == (f"line {line}: the gzipped file ends early: the lines from here on are lost",)
    assert rows.columns["train_speed"] == pytest.approx(noise[: len(rows), 0] / 3.6, rel=1e-14)  # a rounding or two


def test_a_packed_log_with_other_bytes_in_it_is_told(tmp_path):
    packed = gzip.compress(log_text(60).encode())
    checksum = packed[:-8] + b"\0\0\0\0" + packed[-4:]
    rows, log = read(write(tmp_path, checksum))
    assert len(rows) == 60
    assert "line 62: the gzipped file is damaged (CRC check failed" in log.broken.first[0]
    with pytest.raises(InputError, match=r"line 2: the gzipped file is damaged \(|the file is empty or has no header"):
        read(write(tmp_path, packed[:30] + b"\xff" * 200 + packed[230:]))


def test_standard_input_is_read_where_the_path_is_a_dash(tmp_path, monkeypatch, expected):
    for content in (log_text(60).encode(), gzip.compress(log_text(60).encode())):
        with write(tmp_path, content).open() as file:
            monkeypatch.setattr("sys.stdin", file)
            rows, log = read(Path("-"))
            assert not file.closed
        assert same(rows, expected)
        assert (log.name, log.share) == ("standard input", 0.0)


@pytest.mark.parametrize("block_bytes", [60, 1 << 20])
@pytest.mark.parametrize(
    ("above", "below"),
    [
        ("# " + HEADER, ""),
        ("#" + HEADER, ""),
        ("# Rig A, 2008\n\n# four, more, words, here\n# " + HEADER, ""),
        ("# " + HEADER + "\n#\n# site, A, of, four", ""),
        ("# 1, 2, 3, 4\n# " + HEADER.replace(",", ", "), "# halt\n\n"),
    ],
    ids=["NumPy's", "without a blank", "after others", "before another", "before a comment and an empty line"],
)
def test_a_header_may_be_a_comment(tmp_path, expected, above, below, block_bytes):
    rows, log = read(write(tmp_path, above + "\n" + below + rows_below("").removeprefix("\n")), block_bytes=block_bytes)
    assert same(rows, expected, lines_more=above.count("\n") + below.count("\n"))
    assert log.broken.count == 0


@pytest.mark.parametrize(
    "header",
    [
        f"{BARE}\n{UNIT_ROW}",
        f"{BARE}\n[s],[km/h],(km/h),kNm",
        f"{HEADER}\n{UNIT_ROW}",
        "time,train speed [km/h],wheel speed,brake torque [kN*m]\ns,-,km/h,",
    ],
    ids=["units", "in brackets", "given twice", "some in the header"],
)
def test_units_may_stand_below_the_header(tmp_path, expected, header):
    rows, log = read(write(tmp_path, rows_below(header)))
    assert same(rows, expected, lines_more=1)
    assert (log.broken.count, log.notes) == (0, ())


def test_a_row_of_units_that_are_none_of_theirs_is_refused(tmp_path):
    with pytest.raises(InputError, match=r"column 'brake torque \[bar\]': 'bar' is not a unit of brake_torque"):
        Log(write(tmp_path, rows_below(f"{BARE}\ns,km/h,km/h,bar")))


@pytest.mark.skipif(not Path("/proc/self/mem").exists(), reason="a file of Linux that opens but cannot be read")
def test_a_file_that_cannot_be_read():
    with pytest.raises(InputError, match=r"/proc/self/mem: cannot be read \(Input/output error\)"):
        Log(Path("/proc/self/mem"))


# --- columns -------------------------------------------------------------------------------------------------------

WHOLE = {"time": "time", "train_speed": "v", "wheel_speed": "vw", "brake_torque": "Tb"}


def test_every_accepted_name_is_found():
    for quantity, names in NAMES.items():
        for name in names:
            header = [cell for q, cell in WHOLE.items() if q != quantity] + [name.upper().replace(" ", "_")]
            if name == "n":  # a letter for two quantities: its unit tells
                header[-1] += f" [{UNITS[quantity]}]"
            assert find_columns(header)[quantity].index == len(header) - 1, name


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


def test_a_column_without_a_unit_is_si_and_said_so(tmp_path):
    _, log = read(write(tmp_path, log_text(5, "time [s],v [km/h],omega,Tb [kN*m]")))
    assert log.notes == ("column 'omega' names no unit: rad/s is taken for wheel_angular_speed",)
    assert find_columns(["t", "v", "omega", "Tb", "N"])["wheel_load"].index == 4  # as before n meant anything else


# --- lines that are no rows ----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("damaged", "reason"),
    [
        ("rubbish", "1 cells where the header has 4"),
        ("0.18,10x,99,1.5", "'10x' is not a number, column 'train speed [km/h]'"),
        ("0.18,100,,1.5", "a value is missing or not finite"),
        ("0.18,100,inf,1.5", "a value is missing or not finite"),
        ("0.18,100,99,1.5,7", "5 cells where the header has 4"),
        ("\x00\x01\x02", "a control character"),
        ("0.18,9\r9,98,1.5", "a control character or a carriage return within the line"),
        ("0.18,99,98,1.5\x001", "a control character"),  # read as 1.5 otherwise
        ('0.18,"99,98,1.5', "a quotation mark without its other one"),
        ('0.18,99,98,x"1,5"', "quotation marks within a cell"),
        ('0.18,9"9",98,1.5', "is not a number"),
        ('0.18,"9"9,9x,1.5', "quotation marks within a cell"),
        ("0.18,9_9,98,1.5", "'9_9' is not a number"),
        *((f"{stamp},99,98,1.5", "") for stamp in ("", "nan", "-inf", "later")),
        ("1e300,99,98,1.5", "time 1e+300 s is beyond any clock; check its unit"),
    ],
)
@pytest.mark.parametrize("block_bytes", [40, 1 << 20])
def test_a_line_that_is_no_row_is_named_and_survived(tmp_path, expected, damaged, reason, block_bytes):
    lines = log_text(60).splitlines(keepends=True)
    lines[19] = damaged + "\n"
    lines[40:40] = ["\n", "# 5,6,7,8\n"]  # neither rows nor broken, but lines
    rows, log = read(write(tmp_path, "".join(lines)), block_bytes=block_bytes)
    assert (log.broken.count, log.broken.last) == (1, 20)
    assert log.broken.first[0].startswith("line 20: ")
    assert reason in log.broken.first[0]
    assert lost(rows, 62) == [20, 41, 42]
    assert np.array_equal(rows.columns["wheel_speed"], np.delete(expected.columns["wheel_speed"], 18))


@pytest.mark.parametrize("seed", range(6))
def test_no_damage_costs_more_than_the_lines_it_is_in(tmp_path, expected, seed):
    """Random bytes, quotes and returns in some lines: the others are read as they were, or time is refused."""
    generator = np.random.default_rng(seed)
    lines = [line.encode() for line in log_text(60).splitlines(keepends=True)]
    damaged = generator.choice(np.arange(1, 60), size=4, replace=False)
    for i in damaged:
        bits = [generator.bytes(30).replace(b"\n", b""), b'"', b"\r", b"1_0", b",", b"\0"]
        at = generator.integers(len(lines[i]))
        lines[i] = lines[i][:at] + bits[seed % len(bits)] + lines[i][at:]
    try:
        rows, _ = read(write(tmp_path, b"".join(lines)))
    except InputError as error:
        assert "give times that grow" in str(error)  # noqa: PT017 - the other outcome is the usual one
        return
    kept = dict(zip(rows.line.tolist(), rows.columns["train_speed"], strict=True))
    for i in set(range(1, 61)) - set(damaged.tolist()):
        assert kept[i + 1] == pytest.approx(expected.columns["train_speed"][i - 1], rel=1e-13)


def test_a_row_that_lost_a_cell_does_not_hide_behind_a_separator_at_the_end(tmp_path):
    """With a comma more it has as many cells as the others."""
    for text in (rows_below(HEADER), rows_below(HEADER, lambda line: line + ",")):
        lines = text.splitlines(keepends=True)
        lines[19] = "0.18,9,9,98," + ("1.5,\n" if text.endswith(",\n") else "\n")
        rows, log = read(write(tmp_path, "".join(lines)))
        assert log.broken.count == 1
        assert lost(rows, 60) == [20]


def test_quotes_bytes_of_latin_1_and_columns_of_text_do_no_harm(tmp_path):
    text = (
        '"time [s]","v [km/h]","vw [km/h]","Tb [kN*m]","remark \xb0"\n0.0,"100",99,1,"cold, 5 \xb0C"\n0.1,100,98,1,\n'
    )
    rows, log = read(write(tmp_path, text))
    assert rows.columns["wheel_speed"] == pytest.approx([99 / 3.6, 98 / 3.6])
    assert log.broken.count == 0


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


LOADED = "time [s],train speed [km/h],wheel speed [km/h],brake torque [kN*m],wheel load [kN]"


@pytest.mark.parametrize("block_bytes", [4000, 4 << 20])
def test_an_empty_column_that_is_not_needed_is_none(tmp_path, block_bytes):
    plain = log_text(1500).splitlines()[1:]
    path = write(tmp_path, "\n".join([LOADED, *(line + "," for line in plain)]) + "\n")
    rows, log = read(path, block_bytes=block_bytes)
    assert len(rows) == 1500
    assert "wheel_load" not in rows.columns
    assert log.broken.count == 0
    assert "column 'wheel load [kN]' is empty in 1000 rows" in log.notes[0]
    filled = write(tmp_path, "\n".join([LOADED, *(line + (",34" if i > 900 else ",") for i, line in enumerate(plain))]))
    rows, log = read(filled, block_bytes=block_bytes)
    assert "wheel_load" in rows.columns
    assert log.broken.count == 901


def test_a_date_for_a_time_is_told(tmp_path):
    path = write(tmp_path, log_text(30).replace("\n0.", "\n2026-01-01T00:00:0."))
    with pytest.raises(InputError, match=r"is a date or a time of day, not a number.*give the time in s"):
        read(path)


@pytest.mark.parametrize(("cut", "kept"), [(1, True), (4, True), (5, False), (9, False)])
def test_a_last_line_without_its_end_counts_if_it_has_all_cells(tmp_path, cut, kept):
    text = log_text(30).replace(",1.5\n", ",1.50\n")  # the end, 1.50 and its separator: five characters
    rows, log = read(write(tmp_path, text[:-cut]))
    assert len(rows) == 29 + kept
    assert log.broken.count == (not kept)
    assert any("ends without a line end: line 31" in note for note in log.notes) == kept


def test_columns_of_one_name_are_told_apart_by_their_place(tmp_path):
    lines = [f"{0.01 * k:.2f},10,20,21,0" for k in range(50)]
    path = write(tmp_path, "\n".join(["time,train speed,omega,omega,brake torque", *lines, ""]))
    with pytest.raises(InputError, match="say which with --column wheel_angular_speed=HEADER, or by its place: 3 or 4"):
        read(path)
    with pytest.raises(InputError, match=r"2 columns are called 'omega'; .*, or by its place: 3 or 4"):
        read(path, columns={"wheel_angular_speed": "omega"})
    for place, value in (("3", 20.0), ("4", 21.0)):
        rows, _ = read(path, columns={"wheel_angular_speed": place})
        assert set(rows.columns["wheel_angular_speed"]) == {value}
    with pytest.raises(InputError, match="no column is called '6'"):
        read(path, columns={"wheel_angular_speed": "6"})


# --- time stamps ---------------------------------------------------------------------------------------------------


@at_any_block
@pytest.mark.parametrize(
    ("lines", "stamp"),
    [
        *((line, stamp) for line in (2, 3, 18, 31, 32, 60, 105, 120) for stamp in ("1e9", "7")),
        *((line, "-5.5") for line in (3, 32, 121)),
    ],
)
def test_a_stamp_far_off_is_left_out_and_named(tmp_path, lines, stamp, block_bytes):
    """Ahead: the first row, the last but one, around the borders of blocks; behind: the last row too."""
    rows, log = read(write(tmp_path, with_stamps(ROWS, {lines: stamp})), block_bytes=block_bytes)
    assert lost(rows, ROWS) == [lines]
    named = f"line {lines}: time {float(stamp):.9g} s stands apart from those beside it; it is left out"
    assert (log.stamps.warnings, log.broken.count) == ((named,), 0)


@at_any_block
def test_stamps_far_from_each_other_are_all_left_out(tmp_path, block_bytes):
    lines = [2, 2 + BESIDE + 1, 60, 60 + BESIDE + 1, 120]
    rows, log = read(write(tmp_path, with_stamps(ROWS, dict.fromkeys(lines, "1e9"))), block_bytes=block_bytes)
    assert (lost(rows, ROWS), log.stamps.count) == (lines, 5)
    many = dict.fromkeys(range(4, ROWS, BESIDE + 1), "1e9")
    _, log = read(write(tmp_path, with_stamps(ROWS, many)), block_bytes=block_bytes)
    assert len(log.stamps.warnings) == 6
    assert log.stamps.warnings[-1] == f"{len(many)} rows with outlying time stamps in all"


@at_any_block
@pytest.mark.parametrize(
    ("stamps", "message"),
    [
        *(
            (
                {60 + i: f"{1e9 + i}" for i in range(n)},
                f"60: time jumps from 0.57 s to .* line {60 + n} has {0.58 + 0.01 * n:g}",
            )
            for n in (2, 3)
        ),
        ({60: "1e9", 62: "1e9"}, "60: time jumps"),
        ({60: "1e9", 60 + BESIDE: "1e9"}, f"{60 + BESIDE}: time jumps"),  # the first is alone as far as its window goes
        ({60: "0.57"}, "60: time 0.57 s repeats 0.57 s"),
        ({60: "0.05"}, "60: time 0.05 s goes back from 0.57 s"),
        ({121: "1.18"}, "121: time 1.18 s repeats"),
        ({121: "1.0"}, "121: time 1 s goes back"),
        ({3: "0.00"}, "3: time 0 s repeats"),
        ({60: "0.59", 61: "0.58"}, "61: time 0.58 s goes back from 0.59 s"),
        *(
            (
                {line: f"{0.01 * (line - 2) - back:.2f}" for line in range(60, ROWS + 2)},
                "60: time .* goes back from 0.57",
            )
            for back in (0.2, 1e6)
        ),
    ],
)
def test_time_that_does_not_grow_is_refused_with_its_line(tmp_path, stamps, message, block_bytes):
    with pytest.raises(InputError, match=f"log.csv: line {message}.*; give times that grow"):
        read(write(tmp_path, with_stamps(ROWS, stamps)), block_bytes=block_bytes)


@pytest.mark.parametrize(("line", "stamp"), [(121, "1e9"), (2, "-1e9")])
def test_at_the_ends_a_stamp_in_order_is_a_gap(tmp_path, line, stamp):
    """Nothing tells it from a pause, which is reported by the line after it (`Survey.gaps`)."""
    rows, log = read(write(tmp_path, with_stamps(ROWS, {line: stamp})))
    assert (len(rows), log.stamps.count) == (ROWS, 0)


@pytest.mark.parametrize(("share", "left_out"), [(0.9, False), (1.1, True)])
def test_far_is_so_many_usual_intervals_from_the_nearer_neighbour(share, left_out):
    time = 0.01 * np.arange(60.0)
    time[40:] += 30.0  # a pause is no usual interval
    time[30] = time[31] + share * FAR * 0.01
    rows = Rows(np.arange(60) + 2, {"time": time})
    if left_out:
        assert len(in_blocks(StampFilter("log"), rows, [])) == 59
    else:
        with pytest.raises(InputError, match=r"line 32: time jumps|line 33: time"):
            in_blocks(StampFilter("log"), rows, [])


@pytest.mark.parametrize("seed", range(3))
def test_what_is_left_out_does_not_depend_on_the_blocks(seed):
    """Irregular sampling with glitches, in blocks of random sizes: as whole, and all glitches but nothing else."""
    generator = np.random.default_rng(seed)
    time = np.cumsum(generator.exponential(0.01, 2000) + 1e-4)
    glitches = np.arange(int(generator.integers(0, 40)), 1990, 40)
    time[glitches] += generator.choice([-1.0, 1.0], len(glitches)) * 10.0 ** generator.uniform(2, 9, len(glitches))
    if glitches[0] == 0:
        time[0] = abs(time[0])  # else it is a gap
    rows, filtering = Rows(np.arange(2000), {"time": time}), StampFilter("log")
    borders = np.sort(generator.choice(np.arange(1, 2000), 30, replace=False))
    assert np.array_equal(in_blocks(filtering, rows, borders), np.delete(rows.line, glitches))
    assert filtering.count == len(glitches)


def test_too_few_rows_tell_nothing(tmp_path):
    with pytest.raises(InputError, match=r"line 3: time 0.01 s goes back from"):
        read(write(tmp_path, with_stamps(4, {2: "1e9"})))
    assert len(read(write(tmp_path, with_stamps(5, {2: "1e9"})))[0]) == 4


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


def test_outliers_are_left_out_and_nothing_else():
    rows, outliers = speeds(), OutlierFilter()
    spikes = [50, 1200, 1201, 3000, 4999]
    rows.columns["wheel_angular_speed"][spikes] += [3.0, -5.0, 8.0, 200.0, -2.0]
    assert np.array_equal(in_blocks(outliers, rows, []), np.delete(rows.line, spikes))
    assert (outliers.count, outliers.first_line) == (5, 52)
    for seed in range(5):
        assert len(in_blocks(OutlierFilter(), speeds(seed=seed), [])) == 5000


@pytest.mark.parametrize("borders", [[4096, 4099, 4100], [4500], [4999], [1001]])
def test_outliers_do_not_depend_on_the_blocks(borders):
    """The borders are at the step of the torque too, which by itself would look like an outlier."""
    rows = speeds()
    rows.columns["train_speed"][[10, 4097, 4098, 4499, 4998]] = 90.0
    whole = in_blocks(OutlierFilter(), rows, [])
    assert len(whole) == len(rows) - 5
    assert np.array_equal(in_blocks(OutlierFilter(), rows, borders), whole)


# --- memory ----------------------------------------------------------------------------------------------------------


@pytest.mark.long
def test_memory_is_bounded_through_observer_and_curve(tmp_path, monkeypatch):
    """A log four times as long takes no more, once it is beyond what is kept of it: rows of runs, windows, and sums.

    All are bounded here by less than usually, so that a short log is beyond. Without
    bounds the sums take a twentieth more, the rows a third.
    """
    monkeypatch.setattr(curves, "_MOST_ENTRIES", 256)
    monkeypatch.setattr(observed, "Recorder", functools.partial(Recorder, 2000))
    monkeypatch.setattr(OutlierFilter, "piece", 512)  # rows wait for a piece, which is to be short beside either log
    monkeypatch.setattr(log_checks, "_MOST_WINDOWS", 256)
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
