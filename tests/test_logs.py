"""Logs: files and headers, columns and units by name, lines that are no rows, time stamps, outliers, bounded memory."""

import bz2
import functools
import gzip
import itertools
import math
import os
import sys
import tracemalloc
from pathlib import Path

import numpy as np
import pytest
from rig_logs import changed, two_runs, write_log

from railslip_ctrl import PARK2008, InputError
from railslip_ctrl.identification import curves, log_checks, observed
from railslip_ctrl.identification.cleaning import BESIDE, OutlierFilter, StampFilter
from railslip_ctrl.identification.curves import Options, read_curve
from railslip_ctrl.identification.logs import LONGEST_LINE, NAMES, UNITS, Log, Rows, find_columns

HEADER = "time [s],train speed [km/h],wheel speed [km/h],brake torque [kN*m]"
ROWS = 120  # lines 2 to 121

at_any_block = pytest.mark.parametrize("block_bytes", [50, 1 << 20])  # some two rows, and all


@functools.cache
def log_text(count: int) -> str:
    """A log with a row every 10 ms; row i, from 0, is in line i + 2."""
    rows = (f"{0.01 * i:.2f},{100 - 0.01 * i:.2f},{99 - 0.02 * i:.2f},1.5\n" for i in range(count))
    return HEADER + "\n" + "".join(rows)


PLAIN = log_text(60)
TIME = 0.01 * np.arange(60)
EXPECTED = {"train_speed": (100 - TIME) / 3.6, "wheel_speed": (99 - 2 * TIME) / 3.6}  # SI
EXPECTED |= {"time": TIME, "brake_torque": np.full(60, 1500.0)}


def with_stamps(count: int, stamps: dict[int, str]) -> str:
    """`log_text` with other time stamps, by line."""
    lines = log_text(count).splitlines(keepends=True)
    for line, stamp in stamps.items():
        lines[line - 1] = stamp + "," + lines[line - 1].split(",", 1)[1]
    return "".join(lines)


def rows_below(header: str, convert=lambda line: line) -> str:
    """The plain log with another header, its rows converted."""
    return header + "\n" + "".join(convert(line) + "\n" for line in PLAIN.splitlines()[1:])


def write(tmp_path: Path, text: str | bytes) -> Path:
    path = tmp_path / "log.csv"
    path.write_bytes(text if isinstance(text, bytes) else text.encode("latin-1"))
    return path


def read(path: Path, **options: object) -> tuple[Rows, Log]:
    """All rows of a log as one, and the log with the filter of its time stamps."""
    log = Log(path, **options)
    log.stamps = StampFilter(log.name)
    return functools.reduce(Rows.then, log.stamps.rows(log.rows())), log


def is_plain(rows: Rows, *, lines_more: int = 0) -> bool:
    """Whether rows are those of the plain log, some lines further down."""
    # some roundings: of the decimal mark, and of the unit
    close = all(np.allclose(rows.columns[name], values, rtol=1e-13) for name, values in EXPECTED.items())
    return close and rows.line.tolist() == list(range(2 + lines_more, 62 + lines_more))


def lost(rows: Rows, count: int) -> list[int]:
    """The lines of a log of so many rows that are not among those read."""
    return sorted(set(range(2, count + 2)) - set(rows.line.tolist()))


DIALECTS = {
    "gzip": gzip.compress(PLAIN.encode()),
    "mark before a comment": b"\xef\xbb\xbf" + rows_below("# " + HEADER).encode(),
    "a separator at the end of every line": "".join(line + ",\n" for line in PLAIN.splitlines()),
    "blanks, decimal comma": rows_below(
        "time_s train_speed_kmh wheel_speed_kmh brake_torque_kNm",
        lambda line: " \t" + line.replace(",", " \t ").replace(".", ","),
    ),
    "tabs": rows_below("time [s]\tv [km/h]\tvw (km/h)\tTb [kN*m]", lambda line: line.replace(",", "\t")),
    "semicolon, decimal comma": PLAIN.replace(",", ";").replace(".", ","),
    "remarks": rows_below((HEADER + ",remark").replace(",", ";"), lambda line: line.replace(",", ";") + ";cold, wet"),
    "quotes": rows_below(
        '"time [s]","v [km/h]","vw [km/h]",Tb [kN*m],"\xb0"', lambda line: f'"0{line},"5, \xb0C"'.replace(",", '",', 1)
    ),
    "carriage return": PLAIN.replace("\n", "\r\n"),
}


DIALECTS |= {header: rows_below(header) for header in (
    "# " + HEADER,
    "# " + HEADER + "\n#\n# site, A, of, four",
    "# 1, 2, 3, 4\n# " + HEADER.replace(",", ", ") + "\n# halt\n",
    "time,train speed,wheel speed,brake torque\ns,km/h,km/h,kN*m",
    "time,train speed,wheel speed,brake torque\n[s],[km/h],(km/h),kNm",
    "time,train speed [km/h],wheel speed,brake torque [kN*m]\ns,-,km/h,",
)}  # fmt: skip


@at_any_block
@pytest.mark.parametrize("name", DIALECTS)
def test_dialects_are_read_as_the_plain_log_in_si(tmp_path, name, block_bytes):
    """Also where the header is a comment, or units stand below it."""
    rows, log = read(write(tmp_path, DIALECTS[name]), block_bytes=block_bytes)
    assert is_plain(rows, lines_more=name.count("\n"))
    assert (log.broken.count, log.share, log.notes) == (0, 1.0, ())


@pytest.mark.parametrize(("text", "message"), [
    ("\n\n", "empty"),
    (HEADER, "nothing after line 1"),
    (HEADER + "\nx\n", "no rows after the header; line 2: 1 cells"),
    ("t\0i\0m\0e\0\n1\n", "not a text file"),
    ("time,v,vw,pressure\n1,2,3,4\n", "no column for brake_torque"),
    ("# a\n# b\n1,2,3,4\n", "line 3: no header, but numbers; name the columns in a line above"),
    ("# time,v,vw,pressure\n# rig\n1,2,3,4\n", r"header: no column for brake_torque.*has 'time', 'v', 'vw', 'pr"),
    ("# time,v,vw,Tb\n1,2,3,4,5\n", "line 2: no header, but numbers"),
    (PLAIN.replace("\n0.", "\n2026-01-01T00:00:0."), "is a date or a time of day, not a num.*give the time in s"),
    (b"PK\x03\x04" + bytes(100), "is a ZIP archive or an Excel workbook; give a CSV file, gzipped or not"),
    (bz2.compress(PLAIN.encode()), "is packed with bzip2"),
    (gzip.compress(b"PK\x03\x04" + bytes(100), mtime=0), "is a ZIP archive"),
    (PLAIN.encode("utf-16-le"), "not a text file in UTF-8"),
])  # fmt: skip
def test_files_that_are_no_logs(tmp_path, text, message):
    with pytest.raises(InputError, match=message):
        read(write(tmp_path, text))


def test_paths_that_are_no_files(tmp_path, monkeypatch):
    os.mkfifo(tmp_path / "pipe")
    monkeypatch.setattr(sys, "stdin", None)
    for path, message in (
        (tmp_path / "nothing.csv", "no such file"),
        (tmp_path, "is a directory"),
        (tmp_path / "pipe", "pipe: is not a regular file; give a CSV file, or - for standard input"),
        (Path("-"), "standard input: is closed; give a CSV file, or pipe one in"),
        (Path("/proc/self/mem"), r"/proc/self/mem: cannot be read \(Input/output error\)"),
    ):
        with pytest.raises(InputError, match=message):
            Log(path)


@pytest.mark.parametrize("block_bytes", [5000, 1 << 20])
def test_a_packed_log_that_is_cut_gives_what_came_before(tmp_path, block_bytes):
    """Numbers of noise, which hardly packs, so that the cut is far from the end."""
    noise = 100.0 + np.random.default_rng(0).random((3000, 3))
    rows = "".join(f"{0.01 * i:.2f},{a!r},{b!r},{c!r}\n" for i, (a, b, c) in enumerate(noise.tolist()))
    packed = gzip.compress(f"{HEADER}\n{rows}".encode(), mtime=0)
    rows, log = read(write(tmp_path, packed[: len(packed) // 2]), block_bytes=block_bytes)
    assert 1000 < len(rows) < 2000
    told = f"line {len(rows) + 2}: the gzipped file ends early: the lines from here on are lost"
    assert log.broken.first == (told,)
    assert rows.columns["train_speed"] == pytest.approx(noise[: len(rows), 0] / 3.6, rel=1e-14)  # a rounding or two


@pytest.mark.parametrize("content", [PLAIN.encode(), gzip.compress(PLAIN.encode())])
def test_standard_input_is_read_where_the_path_is_a_dash(tmp_path, monkeypatch, content):
    with write(tmp_path, content).open() as file:
        monkeypatch.setattr("sys.stdin", file)
        rows, log = read(Path("-"))
        assert not file.closed
    assert is_plain(rows)
    assert (log.name, log.share) == ("standard input", 0.0)


WHOLE = {"time": "time", "train_speed": "v", "wheel_speed": "vw", "brake_torque": "Tb"}
RPM = pytest.approx(math.pi / 30, rel=1e-15)


def test_every_accepted_name_is_found():
    for quantity, names in NAMES.items():
        for name in names:
            header = [cell for q, cell in WHOLE.items() if q != quantity] + [name.upper().replace(" ", "_")]
            if name == "n":  # a letter for two quantities: its unit tells
                header[-1] += f" [{UNITS[quantity]}]"
            assert find_columns(header)[quantity].index == len(header) - 1, name
    assert find_columns(["t", "v", "omega", "Tb", "N"])["wheel_load"].index == 4  # as before n meant anything else


@pytest.mark.parametrize(("quantity", "cell", "factor"), [
    ("train_speed", "train speed [km/h]", pytest.approx(1 / 3.6)),
    ("train_speed", "Vehicle-Speed [mph]", pytest.approx(0.44704)),
    ("train_speed", "v_kmh", pytest.approx(1 / 3.6)),
    ("time", "t [ms]", pytest.approx(1e-3)),
    ("brake_torque", "Tb [kNm]", 1e3),
    ("wheel_load", "wheel load [kN]", 1e3),
    ("wheel_angular_speed", "n [1/min]", RPM),
    ("wheel_angular_speed", "wheel speed [rad/s]", 1.0),  # in an angular unit it is the angular one
    ("wheel_angular_speed", "vw_rpm", RPM),
])  # fmt: skip
def test_units_in_the_header(quantity, cell, factor):
    other = ("wheel_speed", quantity) if quantity == "wheel_angular_speed" else (quantity,)
    found = find_columns([*(c for q, c in WHOLE.items() if q not in other), cell])
    assert (found[quantity].unit_given, found[quantity].factor) == (True, factor)
    assert "wheel_speed" not in found or quantity != "wheel_angular_speed"


def test_options_win_over_the_header():
    found = find_columns(["a", "v [km/h]", "vw", "Tb"], {"time": "a"}, {"train_speed": "m/s", "wheel_speed": "rpm"})
    assert (found["time"].index, found["time"].unit_given, found["train_speed"].factor) == (0, False, 1.0)
    assert ("wheel_speed" in found, found["wheel_angular_speed"].factor) == (False, RPM)
    for cells, quantity, chosen in (
        (["axle 1 [rpm]"], "wheel_speed", "axle 1"),
        (["vw [rad/s]", "w [rpm]"], "wheel_angular_speed", "w"),
        (["omega", "omega [rpm]"], "wheel_angular_speed", "5"),  # by its place
    ):
        assert find_columns(["time", "v", "Tb", *cells], {quantity: chosen})["wheel_angular_speed"].factor == RPM


TWO = ["time", "v", "omega", "omega", "Tb"]


@pytest.mark.parametrize(("header", "columns", "units", "message"), [
    (["time", "v", "vw"], {}, {}, "no column for brake_torque; call one 'brake torque'"),
    (["time", "v", "Tb"], {}, {}, "no column for wheel_speed"),
    (["time", "v", "speed", "vw", "Tb"], {}, {}, "train_speed may be any of 'v', 'speed'"),
    (list(WHOLE.values()), {"train_speed": "velocity"}, {}, "train_speed: no column is called 'velocity'"),
    (list(WHOLE.values()), {"pressure": "v"}, {}, "`columns`: 'pressure' is not a quantity"),
    (list(WHOLE.values()), {}, {"load": "N"}, "`units`: 'load' is not a quantity"),
    (list(WHOLE.values()), {}, {"time": "kg"}, "`units` time: 'kg' is not a unit of time"),
    (["time", "v [kN]", "vw", "Tb"], {}, {}, r"column 'v \[kN\]': 'kN' is not a unit of train_speed"),
    (["time", "v", "vw [rad/s]", "omega", "Tb"], {}, {}, r"angular_speed may be any of 'vw \[rad/s\]', 'omega'"),
    (TWO, {}, {}, "say which with `columns` wheel_angular_speed=HEADER, or by its place: 3 or 4"),
    (TWO, {"wheel_angular_speed": "omega"}, {}, r"2 columns are called 'omega'; .*, or by its place: 3 or 4"),
    (TWO, {"wheel_angular_speed": "6"}, {}, "no column is called '6'"),
])  # fmt: skip
def test_columns_that_cannot_be_told(header, columns, units, message):
    with pytest.raises(InputError, match=message):
        find_columns(header, columns, units)


@pytest.mark.parametrize("block_bytes", [4000, 4 << 20])
@pytest.mark.parametrize("filled_from", [1500, 900])
def test_an_empty_column_that_is_not_needed_is_none(tmp_path, block_bytes, filled_from):
    """Empty in its first thousand rows: else the rows without a load are broken."""
    lines = [line + (",34" if i >= filled_from else ",") for i, line in enumerate(log_text(1500).splitlines()[1:])]
    path = write(tmp_path, "\n".join([HEADER + ",wheel load [kN]", *lines]) + "\n")
    rows, log = read(path, block_bytes=block_bytes)
    empty = filled_from == 1500
    assert ("wheel_load" in rows.columns, log.broken.count) == ((False, 0) if empty else (True, 900))
    assert any("column 'wheel load [kN]' is empty in 1000 rows" in note for note in log.notes) == empty


DAMAGED = [
    ("rubbish", "1 cells where the header has 4"),
    ("0.18,10x,99,1.5", "'10x' is not a number, column 'train speed [km/h]'"),
    *((f"0.18,100,{cell},1.5", "a value is missing or not finite") for cell in ("", "inf")),
    ("0.18,100,99,7,1.5", "5 cells where the header has 4"),
    ("0.18,9\r9,98,1.5", "a control character or a carriage return within the line"),
    ("0.18,99,98,1.5\x001", "a control character"),  # read as 1.5 otherwise
    ("\0" * 50, "a control character, 50 null bytes, which may stand for many rows and count as one line"),
    ("8" * (5 * LONGEST_LINE), "more than 1048576 bytes without a line end, which count as one line"),
    ('0.18,"99,98,1.5', "a quotation mark without its other one"),
    ('0.18,99,98,x"1,5"', "quotation marks within a cell"),
    ('0.18,9"9",98,1.5', "is not a number"),
    ("0.18,9_9,98,1.5", "'9_9' is not a number"),
    *((f"{stamp},99,98,1.5", "") for stamp in ("", "nan", "-inf", "later")),
    ("1e300,99,98,1.5", "time 1e+300 s is beyond any clock; check its unit"),
]


@at_any_block
@pytest.mark.parametrize(("damaged", "reason"), DAMAGED, ids=lambda text: text[:20])
def test_a_line_that_is_no_row_is_named_and_survived(tmp_path, damaged, reason, block_bytes):
    lines = PLAIN.splitlines(keepends=True)
    lines[19] = damaged + "\n"
    lines[40:40] = ["\n", "# 5,6,7,8\n"]  # neither rows nor broken, but lines
    longer = block_bytes if len(damaged) < 100 else 1 << 18
    rows, log = read(write(tmp_path, "".join(lines)), block_bytes=longer)
    if len(damaged) < 100 or block_bytes > 100:
        assert (log.broken.count, log.broken.last) == (1, 20)
    assert log.broken.first[0].startswith("line 20: ")
    assert reason in log.broken.first[0]
    assert lost(rows, 62) == [20, 41, 42]
    assert np.allclose(rows.columns["wheel_speed"], np.delete(EXPECTED["wheel_speed"], 18), rtol=1e-13)


@pytest.mark.parametrize(("cut", "kept"), [(1, True), (4, True), (5, False), (9, False)])
def test_a_last_line_without_its_end_counts_if_it_has_all_cells(tmp_path, cut, kept):
    text = log_text(30).replace(",1.5\n", ",1.50\n")  # the end, 1.50 and its separator: five characters
    rows, log = read(write(tmp_path, text[:-cut]))
    assert (len(rows), log.broken.count) == (29 + kept, not kept)
    assert any("ends without a line end: line 31" in note for note in log.notes) == kept


@at_any_block
@pytest.mark.parametrize(("line", "stamp"), [
    *((line, stamp) for line in (2, 3, 18, 31, 32, 60, 105, 120) for stamp in ("1e9", "7")),
    *((line, "-5.5") for line in (3, 32, 121)),
])  # fmt: skip
def test_a_stamp_far_off_is_left_out_and_named(tmp_path, line, stamp, block_bytes):
    """Ahead: the first row, the last but one, around the borders of blocks; behind: the last row too."""
    rows, log = read(write(tmp_path, with_stamps(ROWS, {line: stamp})), block_bytes=block_bytes)
    assert lost(rows, ROWS) == [line]
    named = f"line {line}: time {float(stamp):.9g} s stands apart from those beside it; it is left out"
    assert (log.stamps.warnings, log.broken.count) == ((named,), 0)


@at_any_block
@pytest.mark.parametrize(("stamps", "message"), [
    ({60: "1e9", 61: "1000000001"}, "60: time jumps from 0.57 s to .* line 62 has 0.6"),
    ({60: "1e9", 62: "1e9"}, "60: time jumps"),
    ({60: "1e9", 60 + BESIDE: "1e9"}, f"{60 + BESIDE}: time jumps"),  # the first is alone as far as its window goes
    ({60: "0.57"}, "60: time 0.57 s repeats 0.57 s"),
    ({60: "0.05"}, "60: time 0.05 s goes back from 0.57 s"),
    ({121: "1.0"}, "121: time 1 s goes back"),
    ({3: "0.00"}, "3: time 0 s repeats"),
    ({60: "0.59", 61: "0.58"}, "61: time 0.58 s goes back from 0.59 s"),
    ({i: f"{0.01 * (i - 2) - 0.2:.2f}" for i in range(60, 122)}, "60: time .* goes back from 0.57"),
])  # fmt: skip
def test_time_that_does_not_grow_is_refused_with_its_line(tmp_path, stamps, message, block_bytes):
    with pytest.raises(InputError, match=f"log.csv: line {message}.*; give times that grow"):
        read(write(tmp_path, with_stamps(ROWS, stamps)), block_bytes=block_bytes)


@pytest.mark.parametrize("borders", [[], [4096, 4099, 4100], [4500], [4999], [1001]])
def test_outliers_are_left_out_and_nothing_else_whatever_the_blocks(borders):
    """The borders are at the step of the torque too, which by itself would look like an outlier."""
    generator, time = np.random.default_rng(3), 0.01 * np.arange(5000)
    wheel = 60.0 - 0.3 * np.maximum(time - 10.0, 0.0) ** 1.2 + 0.02 * generator.standard_normal(5000)
    torque = np.where(time < 10.0, 0.0, 4000.0)
    columns = {"time": time, "train_speed": np.full(5000, 27.0), "wheel_angular_speed": wheel, "brake_torque": torque}
    rows, spikes = Rows(np.arange(5000) + 2, columns), [50, 1200, 1201, 3000, 4097, 4098, 4499, 4999]
    spiked = wheel.copy()
    spiked[spikes] += [3.0, -5.0, 8.0, 200.0, 9.0, 9.0, -4.0, -2.0]
    for values, left_out in ((wheel, []), (spiked, spikes)):
        outliers, given = OutlierFilter(), changed(rows, wheel_angular_speed=values)
        blocks = (given.part(*ends) for ends in itertools.pairwise([0, *borders, 5000]))
        assert np.concatenate([part.line for part in outliers.rows(blocks)]).tolist() == [
            line for line in range(2, 5002) if line - 2 not in left_out
        ]
        assert outliers.count == len(left_out)
    assert outliers.first_line == 52


@pytest.mark.long
def test_memory_is_bounded_through_observer_and_curve(tmp_path, monkeypatch):
    """A log four times as long takes no more, once it is beyond what is kept of it: rows of runs, windows, and sums.

    All are bounded by less than usually; without bounds the sums take a twentieth more, the rows a third.
    """
    recorder = functools.partial(observed.Recorder, 2000)
    lower = ((curves, "_MOST_ENTRIES", 256), (log_checks, "_MOST_WINDOWS", 256), (observed, "Recorder", recorder))
    for where, name, bound in (*lower, (OutlierFilter, "piece", 512)):  # rows wait for a piece
        monkeypatch.setattr(where, name, bound)
    path = tmp_path / "long.csv"

    def peak(times):
        columns = {name: np.tile(values, times) for name, values in two_runs().columns.items()}
        count = columns["time"].size
        write_log(path, Rows(np.arange(count), {**columns, "time": 0.01 * np.arange(count)}))
        tracemalloc.start()
        curve = read_curve(path, PARK2008, Options(block_bytes=1 << 16))
        found = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        assert (curve.survey.rows, curve.stretches.count.size <= 256, len(curve.record) <= 2000) == (count, True, True)
        return found

    peak(1)  # what is imported on the way
    assert peak(24) < 1.02 * peak(6)  # where blocks end in the runs makes a difference of some thousandths
