"""Logs: files, headers and lines that are no rows; what a log shows to be wrong; columns that are late or off zero."""

import ast
import bz2
import functools
import gzip
import itertools
import math
import os
import re
import sys
import tracemalloc
from pathlib import Path
from string import Formatter

import numpy as np
import pytest
from project import ROOT, refused
from rig_logs import BEAM, changed, identified, rig_rows, two_runs, write_log

from railslip_ctrl import PARK2008, InputError, Rail
from railslip_ctrl.core.templates import texts
from railslip_ctrl.core.units import KMH
from railslip_ctrl.identification import curves, log_checks, logs, observed
from railslip_ctrl.identification import identify as job
from railslip_ctrl.identification.cleaning import BESIDE, Alignment, OutlierFilter, Resolution, StampFilter, step_of
from railslip_ctrl.identification.curves import Options, curve_of, read_curve
from railslip_ctrl.identification.logs import LONGEST_LINE, NAMES, UNITS, Log, Rows, find_columns
from railslip_ctrl.identification.observer import Encoder, FilterObserver
from railslip_ctrl.identification.virtual_rig import RigTest, run_tests
from railslip_ctrl.model.adhesion import law_class, published_law

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
    lines = log_text(count).splitlines(keepends=True)
    for line, stamp in stamps.items():
        lines[line - 1] = stamp + "," + lines[line - 1].split(",", 1)[1]
    return "".join(lines)


def rows_below(header: str, convert=lambda line: line) -> str:
    return header + "\n" + "".join(convert(line) + "\n" for line in PLAIN.splitlines()[1:])


def write(tmp_path: Path, text: str | bytes) -> Path:
    path = tmp_path / "log.csv"
    path.write_bytes(text if isinstance(text, bytes) else text.encode("latin-1"))
    return path


def read(path: Path, **options: object) -> tuple[Rows, Log]:
    log = Log(path, **options)
    log.stamps = StampFilter(log.name)
    return functools.reduce(Rows.then, log.stamps.rows(log.rows())), log


def is_plain(rows: Rows, *, lines_more: int = 0) -> bool:
    # some roundings: of the decimal mark, and of the unit
    close = all(np.allclose(rows.columns[name], values, rtol=1e-13) for name, values in EXPECTED.items())
    return close and rows.line.tolist() == list(range(2 + lines_more, 62 + lines_more))


def lost(rows: Rows, count: int) -> list[int]:
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
    "bars": PLAIN.replace(",", "|"),
    "carriage returns alone": PLAIN.replace("\n", "\r"),
    "line ends converted twice": PLAIN.replace("\n", "\r\r\n"),
    "decimal comma in quotes": rows_below(HEADER, lambda line: '"' + line.replace(",", '","').replace(".", ",") + '"'),
    "points in columns that are not read": rows_below(
        ("day,a,b,c,d," + HEADER).replace(",", ";"),
        lambda line: "24.10.2023;0.1;0.1;0.1;0.1;" + line.replace(",", ";").replace(".", ","),
    ),
    **{f"thousands parted by {blank!r}": PLAIN.replace("kN", "N").replace("1.5\n", f"1{blank}500\n").encode()
       for blank in " '\xa0\u202f"},
    "the minus sign of a word processor": PLAIN.replace(",1.5", ",15E\N{MINUS SIGN}1").encode(),
    "a wide header": rows_below(HEADER + "".join(f",{i:0100} [V]" for i in range(700)), lambda line: line + 700 * ","),
    "carriage return": PLAIN.replace("\n", "\r\n"),
    **{header: rows_below(header) for header in (
        "# " + HEADER,
        "# " + HEADER + "\n#\n# site, A, of, four",
        "# 1, 2, 3, 4\n# " + HEADER.replace(",", ", ") + "\n# halt\n",
        "time,train speed,wheel speed,brake torque\ns,km/h,km/h,kN*m",
        "time,train speed,wheel speed,brake torque\n[s],[km/h],(km/h),kNm",
        "time,train speed [km/h],wheel speed,brake torque [kN*m]\ns,-,km/h,",
        "time,train speed,wheel speed,brake torque\n\nseconds,KM/H,kmph,kN.m",
        "# time, v, vw, Tb\n# s, km/h, km/h, kNm",
        '"time\n[s]","train speed\n[km/h]",wheel speed [km/h],"brake torque [kNm]"',
        "sep=,\n" + HEADER,
        "t_s,v_km_h,v wheel / (km/h),Tb kN m",
    )},
}  # fmt: skip


@at_any_block
@pytest.mark.parametrize("name", DIALECTS)
def test_dialects_are_read_as_the_plain_log_in_si(tmp_path, name, block_bytes):
    rows, log = read(write(tmp_path, DIALECTS[name]), block_bytes=block_bytes)
    assert is_plain(rows, lines_more=name.count("\n"))
    assert (log.broken.count, log.share, log.notes) == (0, 1.0, ())


@pytest.mark.parametrize(("text", "message"), [
    ("\n\n", "empty"),
    (HEADER, "no rows after the header"),
    (HEADER + "\nx\n", "no rows after the header; line 2: 1 cells"),
    ("t\0i\0m\0e\0\n1\n", "not a text file"),
    ("time,v,vw,pressure\n1,2,3,4\n", "no column for brake_torque"),
    ("# a\n# b\n1,2,3,4\n", "line 3: no header, but numbers; name the columns in a line above"),
    ("# time,v,vw,pressure\n# rig\n1,2,3,4\n", r"header: no column for brake_torque.*has 'time', 'v', 'vw', 'pr"),
    ("# time,v,vw,Tb\n1,2,3,4,5\n", "line 2: no header, but numbers"),
    (PLAIN.replace("\n0.", "\n2026-01-01T00:00:0."), "date or a time of day.*column .* in s"),
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
        (tmp_path / "pipe", "pipe is not a regular file; give a CSV file, or - for standard input"),
        (Path("-"), "standard input is closed; give a CSV file"),
        (Path("/proc/self/mem"), r"/proc/self/mem cannot be read \(Input/output error\)"),
    ):
        with pytest.raises(InputError, match=message):
            Log(path)


@pytest.mark.parametrize("block_bytes", [5000, 1 << 20])
def test_a_packed_log_that_is_cut_gives_what_came_before(tmp_path, block_bytes):
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


def test_lines_above_the_header_are_skipped_with_a_note_or_by_option(tmp_path):
    rows, log = read(write(tmp_path, rows_below('Operator,"X\nRate,100\n\nDate,24.10.2023\n' + HEADER)))
    assert is_plain(rows, lines_more=4)
    assert log.notes == ("the header is in line 5; the lines above it are skipped",)
    of_another_log = write(tmp_path, rows_below("time [h],v [m/s],vw [m/s],Tb [N*m]\n" + HEADER))
    assert read(of_another_log)[1].broken.first == ("line 2: 'time [s]' is not a number, column 'time [h]'",)
    assert is_plain(read(of_another_log, skip_lines=1)[0], lines_more=1)


@pytest.mark.parametrize(("cell", "text"), [
    ("1.024", "'1.024' is not a number, column 'brake torque [kN*m]'; 30 lines have thousands separators"),
    ("é−x", "'é−x' is not a number, column 'brake torque [kN*m]'; "),
])  # fmt: skip
def test_lines_that_could_not_be_read_come_first_in_a_refusal(tmp_path, cell, text):
    lines = PLAIN.replace(",", ";").replace(".", ",").splitlines()
    lines[31:] = [line.replace(";1,5", f";{cell}") for line in lines[31:]]
    with pytest.raises(InputError) as caught:
        read_curve(write(tmp_path, ("\n".join(lines) + "\n").encode()), PARK2008, Options())
    assert f"log.csv: 30 of 60 lines could not be read, first line 32: {text}" in str(caught.value)


def test_a_speed_without_a_unit_that_is_implausible_in_si_is_refused(tmp_path):
    path = write(tmp_path, rows_below("time,v,vw,Tb"))
    with pytest.raises(InputError, match=r"'v' .*100 m/s \(360 km/h\).*; give `units` train_"):
        read(path)
    rows, _ = read(path, units={"train_speed": "m/s"})
    assert rows.columns["train_speed"][0] == 100.0


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
    ("time", "time_ms", pytest.approx(1e-3)),
    ("train_speed", "v_ms", 1.0),
    ("train_speed", "v [m/s] [km/h]", pytest.approx(1 / 3.6)),
    ("train_speed", "v [km/h] (axle 1)", pytest.approx(1 / 3.6)),
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
    (["time", "v", "vw"], {}, {}, "no column for brake_torque; call a column 'brake torque'"),
    (["time", "v", "Tb"], {}, {}, "no column for wheel_speed"),
    (["time", "v", "speed", "vw", "Tb"], {}, {}, "train_speed may be any of 'v', 'speed'"),
    (list(WHOLE.values()), {"train_speed": "velocity"}, {}, "train_speed: no column is called 'velocity'"),
    (list(WHOLE.values()), {"pressure": "v"}, {}, "`columns`: 'pressure' is not a quantity"),
    (list(WHOLE.values()), {}, {"load": "N"}, "`units`: 'load' is not a quantity"),
    (list(WHOLE.values()), {}, {"time": "kg"}, "`units` time: 'kg' has the wrong dimension; give a unit of time"),
    (["time", "v [kN]", "vw", "Tb"], {}, {}, r"column 'v \[kN\]': 'kN' has the wrong dimension; give a unit of tra"),
    (["time", "v [CAN 2]", "vw", "Tb"], {}, {}, r"column 'v \[CAN 2\]': 'CAN 2' is not a unit; give a unit of tra"),
    (["time", "a [km/h", "vw", "Tb"], {"train_speed": "2"}, {}, "a bracket is not closed; give a unit of train_speed"),
    (["time", "v", "omega [1/s]", "Tb"], {}, {}, "'1/s' may mean cycles or radians; give a unit of wheel_angular_spe"),
    (["time", "v", "vw [rad/s]", "omega", "Tb"], {}, {}, r"angular_speed may be any of 'vw \[rad/s\]', 'omega'"),
    (TWO, {}, {}, "`columns` wheel_angular_speed=HEADER, .* 3 or 4"),
    (TWO, {"wheel_angular_speed": "omega"}, {}, r"2 columns are called 'omega'; .* 3 or 4; the header has"),
    (TWO, {"wheel_angular_speed": "6"}, {}, "no column is called '6'"),
])  # fmt: skip
def test_columns_that_cannot_be_told(header, columns, units, message):
    with pytest.raises(InputError, match=message):
        find_columns(header, columns, units)


@pytest.mark.parametrize("block_bytes", [4000, 4 << 20])
@pytest.mark.parametrize("filled_from", [1500, 900])
def test_an_empty_column_that_is_not_needed_is_none(tmp_path, block_bytes, filled_from):
    lines = [line + (",34" if i >= filled_from else ",") for i, line in enumerate(log_text(1500).splitlines()[1:])]
    path = write(tmp_path, "\n".join([HEADER + ",wheel load [kN]", *lines]) + "\n")
    rows, log = read(path, block_bytes=block_bytes)
    empty = filled_from == 1500
    assert ("wheel_load" in rows.columns, log.broken.count) == ((False, 0) if empty else (True, 900))
    assert any("'wheel load [kN]'" in note and "1000 rows" in note for note in log.notes) == empty


DAMAGED = [
    ("rubbish", "1 cells where the header has 4"),
    ("0.18,10x,99,1.5", "'10x' is not a number, column 'train speed [km/h]'"),
    *((f"0.18,100,{cell},1.5", "a value is missing or not finite") for cell in ("", "inf")),
    ("0.18,100,99,7,1.5", "5 cells where the header has 4"),
    ("0.18,9\r9,98,1.5", "a control character or a carriage return within the line"),
    ("0.18,99,98,1.5\x001", "a control character"),  # read as 1.5 otherwise
    ("\0" * 50, "a control character, 50 null bytes"),
    ("8" * (5 * LONGEST_LINE), "more than 1048576 bytes"),
    ('0.18,"99,98,1.5', "quotation mark"),
    ('0.18,99,98,x"1,5"', "quotation marks within a cell"),
    ('0.18,9"9",98,1.5', "is not a number"),
    ("0.18,9_9,98,1.5", "'9_9' is not a number"),
    *((f"{stamp},99,98,1.5", "") for stamp in ("", "nan", "-inf", "later")),
    ("1e300,99,98,1.5", "time 1e+300 s"),
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
    assert any("line, 31, has no line end" in note for note in log.notes) == kept


@at_any_block
@pytest.mark.parametrize(("line", "stamp"), [
    *((line, stamp) for line in (2, 3, 18, 31, 32, 60, 105, 120) for stamp in ("1e9", "7")),
    *((line, "-5.5") for line in (3, 32, 121)),
])  # fmt: skip
def test_a_stamp_far_off_is_left_out_and_named(tmp_path, line, stamp, block_bytes):
    rows, log = read(write(tmp_path, with_stamps(ROWS, {line: stamp})), block_bytes=block_bytes)
    assert lost(rows, ROWS) == [line]
    (named,) = log.stamps.warnings
    assert named.startswith(f"line {line}: time {float(stamp):.9g} s ")
    assert log.broken.count == 0


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
    with pytest.raises(InputError, match=f"log.csv: line {message}.*; give increasing times"):
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
    recorder = functools.partial(observed.Recorder, 2000)
    lower = ((curves, "_MOST_ENTRIES", 256), (log_checks, "_MOST_WINDOWS", 256), (observed, "Recorder", recorder))
    lower += ((logs, "LONGEST_LINE", 1 << 16), (OutlierFilter, "piece", 512))  # rows wait for a piece
    for where, name, bound in lower:
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


# --- what does not fit ---------------------------------------------------------------------------------------------


BURCKHARDT = law_class("burckhardt").model_validate({"c1": 0.31, "c2": 24.0, "c3": 0.11})
RADIUS, LOAD = PARK2008.wheel.radius, PARK2008.wheel_load


@functools.cache
def rig(name: str = "burckhardt", speed_kmh: float = 100.0, *, tests: int = 2, seed: int = 0, **measured) -> Rows:
    law = BURCKHARDT if name == "burckhardt" else published_law(name, Rail.DRY, speed_kmh, LOAD)
    return run_tests(RigTest(PARK2008, law, speed_kmh * KMH, **measured), tests=tests, seed=seed)


def told(rows: Rows, about: str = "", **options) -> list[str]:
    warnings = curve_of(rows, PARK2008, Options(**options)).warnings
    return [text for text in warnings if "gap of 30" not in text and about in text]


def scaled(rows: Rows, **factors: float) -> Rows:
    return changed(rows, **{name: factor * rows.columns[name] for name, factor in factors.items()})


def test_the_step_of_values_is_found_where_there_is_one():
    noise, time = np.random.default_rng(0).standard_normal(4096), 0.01 * np.arange(4096)
    for values in (noise, 4000.0 * np.maximum(time - 1.0, 0.0), np.sin(time), np.zeros(4096)):
        assert step_of(values) == 0.0
    assert step_of(np.round(50.0 + noise, 1)) == pytest.approx(0.1)
    coarse, resolution = np.round(10.0 * np.sin(time)), Resolution()
    for values in (coarse, 3.0 * coarse, np.zeros(9)):
        resolution.add("train_speed", values)
    assert (resolution["train_speed"], resolution["brake_torque"]) == (pytest.approx(1.0), 0.0)


@pytest.mark.parametrize(("speed", "counts", "interval"), [(30.0, 512, 0.01), (100.0, 100, 0.01), (100.0, 8192, 0.002)])
def test_the_rarer_counts_of_an_encoder_are_its_step_and_no_outliers(speed, counts, interval):
    """Hundreds of rows were left out, and the others gave a wheel radius 1.4 to 2.5 % off."""
    rows = rig(speed_kmh=speed, encoder=Encoder(counts), interval=interval)
    omega, step = rows.columns["wheel_angular_speed"], Encoder(counts).angle_step / interval
    assert step_of(omega) == pytest.approx(step, rel=1e-6)  # of time stamps that are rounded
    glitched, spiked = omega.copy(), omega.copy()
    glitched[::97] += 0.3 * step  # four in a hundred of the differences are no steps then
    assert step_of(glitched) == pytest.approx(step, rel=0.05)
    spiked[20] += 8.0 * step
    for values, count in ((omega, 0), (spiked, 1)):
        outliers = OutlierFilter()
        list(outliers.rows(iter([changed(rows, wheel_angular_speed=values)])))
        assert outliers.count == count
    (text,) = told(rows)
    share = 100.0 * RADIUS * step / (speed * KMH)
    assert f"'wheel_angular_speed [rad/s]' in steps of {step:.4g}, {share:.2g} % of slip at the initial speed" in text


def test_nothing_is_said_of_a_log_without_fault():
    for name, speed in (("beam", 30.0), ("bristle", 100.0), ("burckhardt", 30.0), ("polach", 100.0)):
        assert told(rig(name, speed)) == [], name


@pytest.mark.parametrize(("offset", "zeros", "words"), [
    (-2000.0, {}, " -2000 N.m .*`zeros` brake_torque=-2000 "),
    (0.0, {"brake_torque": 500.0}, "leave.*`zeros` brake_torque"),
    (800.0, {"brake_torque": 500.0}, " 300 N.m .* 500 N.m.*`zeros` brake_torque=800 "),
    (0.0, {"wheel_angular_speed": 0.5}, "`zeros` wheel_angular_speed=0.5: leave out"),
    (0.0, {"train_speed": -0.3}, "`zeros` train_speed=-0.3: leave out"),
])  # fmt: skip
def test_a_zero_that_is_wrong_is_told(offset, zeros, words):
    three = rig(tests=3)
    texts = told(changed(three, brake_torque=three.columns["brake_torque"] + offset), zeros=zeros)
    assert sum(re.search(words, text) is not None for text in texts) == 1


@pytest.mark.parametrize("factor", [0.5, 0.9, 1.003, 2.0, 3.6])
def test_a_wrong_radius_or_unit_is_told_as_one(factor):
    try:
        text = " ".join(told(scaled(rig(tests=3), wheel_angular_speed=factor)))
    except InputError as error:
        text = str(error)
    if 0.8 < factor < 1.2:
        radius = float(text.split("the wheel radius may be ")[1].split(" m")[0])
        # four digits are told; the slip without brake is known to 3 of 10 000 here, and some 1e-4 more from friction
        assert radius == pytest.approx(RADIUS / factor, rel=6e-4)
    else:
        assert f"the wheel's speed is {factor:.3g} times the train's: check the units of wheel_angular_speed" in text
        assert ("(km/h and m/s are 3.6 apart)" in text) == (factor == 3.6)


def test_free_rolling_is_as_sure_as_a_median_and_not_seen_while_the_train_is_braked():
    slip, time, found = np.random.default_rng(0).normal(-0.013, 0.002, 5000), 0.002 * np.arange(5000), []
    # 3000 N*m on the rig's flywheels are 2 m/s^2; the same reading on a train that only coasts is a torque's zero
    for torque, deceleration in ((0.0, 0.0), (3000.0, 3000.0 / (RADIUS * PARK2008.mass)), (3000.0, 0.14)):
        rolling, speed = log_checks.FreeRolling(PARK2008), 100.0 * KMH - deceleration * time
        rolling.add(np.stack([time, speed, (1.0 - slip) * speed / RADIUS, 0.0 * time + torque, 0.0 * time + LOAD]))
        found.append(rolling.result())
    free, braked, coasting = found
    assert (free.slip, free.torque) == (pytest.approx(-0.013, abs=5 * free.slip_error), 0.0)
    # of a median of means: 1.25 sigma over root n, and windows that lie half over each other
    assert free.slip_error == pytest.approx(1.25 * 0.002 / np.sqrt(5000), rel=0.3)
    assert (braked, coasting.torque) == (None, pytest.approx(3000.0))


@pytest.mark.parametrize(("late", "log", "known"), [
    (0.1, {}, 0.003),
    # of more rows than a lag is looked for in
    pytest.param(0.05, {"tests": 1, "interval": 1e-3, "rate": 2300.0}, 0.006, marks=pytest.mark.long),
    pytest.param(-0.02, {}, 0.003, marks=pytest.mark.long),
    # of itself: half an interval, as the counts of an encoder of 1024 lines are a mean over it
    pytest.param(0.0, {"tests": 6, "encoder": Encoder(4096), "seed": 3}, 0.003, marks=pytest.mark.long),
])  # fmt: skip
def test_a_lag_is_found_however_large(late, log, known):
    rows = rig(**log)
    time, omega = rows.columns["time"], rows.columns["wheel_angular_speed"]
    found = identified(changed(rows, wheel_angular_speed=np.interp(time - late, time, omega)), "burckhardt")
    assert found.delay is not None
    (text,) = (text for text in found.warnings if "`delays`" in text)
    error = float(text.split(" ± ")[1].split(" ")[0])
    assert error < known
    remedy = float(text.split("`delays` wheel_angular_speed=")[1].split(" ")[0])
    assert remedy == pytest.approx(late or 0.005, abs=3.0 * error if late else 0.0)
    assert ("half an interval" in text) == (late == 0.0)


def test_a_model_that_does_not_fit_is_named_first_and_no_delay_rests_on_it(monkeypatch):
    rows, asked = rig("beam", random_force=0.0, wheel_noise=0.0), []
    monkeypatch.setattr(job, "lag_of", lambda fit, *_, **__: asked.append(fit.model.name))
    found = identified(rows, "burckhardt")
    assert found.warnings[0].startswith("log: burckhardt does not fit this log (lack-of-fit test at level 0.01)")
    assert not any("fit this log" in text for text in identified(rows, "beam").warnings)
    assert asked == ["table", "beam"]


@pytest.mark.parametrize("cuts", [[], [3, 4, 500, 1990], list(range(5, 2000, 5))])
def test_columns_are_brought_to_the_wheel_s_time_and_zero_however_a_log_is_cut(cuts):
    """Parabolas of time, each late by its delay; the torque reads 35 too much."""
    time, late = np.sort(np.random.default_rng(0).uniform(0.0, 10.0, 2000)), 0.03
    delays = {"wheel_angular_speed": late, "brake_torque": 0.2, "train_speed": -0.05}
    columns = {name: (time - delay) ** 2 for name, delay in delays.items()}
    rows = Rows(np.arange(2000), {"time": time, **columns, "brake_torque": columns["brake_torque"] + 35.0})
    blocks = (rows.part(a, b) for a, b in itertools.pairwise([0, *cuts, 2000]))
    parts = list(Alignment(delays, {"brake_torque": 35.0}, "log").rows(blocks))
    found = {name: np.concatenate([part.columns[name] for part in parts]) for name in rows.columns}
    assert np.concatenate([part.line for part in parts]).tolist() == rows.line.tolist()
    assert (found["wheel_angular_speed"] == columns["wheel_angular_speed"]).all()  # its noise stays as it was
    inside = (time > 0.3) & (time < 9.7)  # beyond, the ends are held
    for name in ("train_speed", "brake_torque"):
        # straight between rows up to 0.05 s apart: off by less than 2 * 0.05^2 / 8
        assert found[name][inside] == pytest.approx((time[inside] - late) ** 2, abs=7e-4)


@pytest.mark.parametrize(("option", "value", "text"), [
    ("--delay", "time=0.1", "--delay: 'time' is not a quantity of a log; choose one of train_speed, "),
    ("--delay", "brake_torque=3", "--delay brake_torque: 3 s is not allowed; give -2 to 2 (s)"),
    ("--skip-lines", "2", "log.csv: empty, or no header from line 3 on; give a CSV"),
    ("--skip-lines", "-1", "--skip-lines: '-1' is not allowed; give a whole number from 0"),
    ("--zero", "wheel_load=10", "log.csv: no column wheel_load, which --zero should correct; "),
])  # fmt: skip
def test_corrections_that_cannot_be_are_refused(tmp_path, railslip, option, value, text):
    (tmp_path / "log.csv").write_text("time [s],v [m/s],omega [rad/s],torque [N*m]\n0,30,69,0\n")
    assert text in refused(railslip("identify", tmp_path / "log.csv", option, value))


@pytest.mark.parametrize("cut", [500, 153, 156])
def test_a_wheel_regrips_while_its_slip_falls_under_a_torque_let_go(cut):
    time = 0.01 * np.arange(500)
    torque = np.where(time < 1.5, 4000.0, 4000.0 * np.exp(-(time - 1.5) / 0.05))
    slip = np.where(time < 1.55, 0.3 * time / 1.55, 0.3 * np.exp(-(time - 1.55) / 0.1))
    low_pass, cuts = FilterObserver.of(PARK2008, 0.05), sorted({0, cut, 500})
    readhesion, signals = observed.Readhesion(low_pass), (time, slip, torque)
    found = np.concatenate([readhesion.add(*(x[a:b] for x in signals)) for a, b in itertools.pairwise(cuts)])
    assert not found[:155].any()  # the slip still grows
    assert found[165:220].all()  # two time constants later it is seen to fall
    held = observed.Readhesion(low_pass).add(time, 0.1 + 0.02 * np.sin(time), 4000.0 + 300.0 * np.sin(time))
    assert not held.any()  # torque and slip go up and down by a brake that is moved, not let go


@pytest.mark.parametrize("factors", [(0.9, 1.1), pytest.param((0.6, 1.4, 1.0), marks=pytest.mark.long)])
def test_a_law_that_depends_on_the_load_is_taken_at_the_load_of_each_row(factors):
    """Beam: at the mean load of the log its highest mu came out 2 % off, beyond its interval."""
    found = identified(rig_rows(BEAM, loads=factors, seed=4))
    for p in found.chosen.fit.parameters:
        assert p.interval[0] <= getattr(BEAM, p.name) <= p.interval[1]
        assert p.stderr < 0.1 * p.value


def test_wheel_loads_that_differ_are_told():
    three = rig(tests=3)
    factor = np.where(three.columns["time"] > three.columns["time"][len(three) // 2], 1.2, 1.0)
    loads = {"wheel_load": factor * three.columns["wheel_load"], "brake_torque": factor * three.columns["brake_torque"]}
    (text,) = told(changed(three, **loads), "wheel load")
    assert re.search(r"3\.45e\+04 .* 4\.14e\+04 N", text)
    (text,) = job.different_loads([("a.csv", 3.0e4), ("b.csv", 3.1e4), ("c.csv", 4.0e4)])
    assert "3e+04 N (a.csv) to 4e+04 N (c.csv)" in text
    assert "mean load, 3.367e+04 N" in text
    assert job.different_loads([("a.csv", 3.0e4), ("b.csv", 3.1e4)]) == ()


def test_adhesion_that_steel_does_not_have_is_told():
    (text,) = told(scaled(two_runs(), brake_torque=9.80665), "the highest mean adhesion coefficient is ")
    assert 2.0 < float(text.split("coefficient is ")[1].split(",")[0]) < 10.0
    assert not told(two_runs(), "adhesion coefficient is")
    assert "is 0.004," in next(log_checks.mu_findings(np.array([0.004]), {})).text


def test_one_log_of_several_speeds_says_which_v0_it_is_taken_at():
    fast, slow = (rig_rows(BEAM, runs=1, seed=k, initial_speed=v * KMH) for k, v in ((0, 100.0), (1, 50.0)))
    slow.columns["time"] = slow.columns["time"] + 30.0
    (text,) = told(fast.then(slow), "braking begins")
    # the train has lost a little when the slip comes to 0.005
    assert re.search(r"between (4[5-9]|50)[.\d]* and (9[5-9]|100)[.\d]* km/h.* v0.* 100 km/h", text)
    assert not told(fast, "braking begins")


@pytest.mark.long
def test_what_gaps_cost_is_told():
    """0.06 s of every 0.8 s are missing: of 0.74 s under brake the observer settles for 0.25 s."""
    rows = rig_rows(BEAM, runs=2, interval=0.0025, seed=5)  # irregular sampling has short intervals too
    time = rows.columns["time"]
    survey = curve_of(rows.where(time % 0.8 > 0.06), PARK2008, Options()).survey
    assert survey.lost_share == pytest.approx(0.25 / 0.74, abs=0.05)  # some ten stretches under brake, two of them cut
    assert told(rows.where(time % 0.8 > 0.06), f"{100 * survey.lost_share:.2g} % of the braking data")
    with pytest.raises(InputError, match=r"rows under brake can be used: .* each of \d+ gaps"):
        told(rows.where(time % 0.3 > 0.06))


BACKWARD = "train speed is negative in 1800 rows and positive in 0 rows; .*sign"


@pytest.mark.parametrize(("unit", "second"), [("s", "ms"), ("h", "s"), ("ms", "s"), ("us", "ms"), ("ks", "s")])
def test_a_time_in_another_unit_than_it_is_read_in_is_told(tmp_path, unit, second):
    rows = two_runs()
    path = write_log(tmp_path / "log.csv", changed(rows, time=rows.columns["time"] * {"s": 1.0, "ms": 1e3}[second]))
    read = {"ks": "units of 1e\\+03 s"}.get(unit, unit)
    with pytest.raises(InputError, match=f"the time is read in {read}, but seems to be in {second}; .*time={second}"):
        read_curve(path, PARK2008, Options(units={"time": unit}))


@pytest.mark.parametrize(("factors", "options", "message"), [
    ({"time": 1e3}, {}, "the time .* seems to be in ms; give `units` time=ms$"),
    ({"train_speed": 3.6}, {}, r"times the train's: .* \(km/h and m/s are 3.6 apart\), and that no .* swapped$"),
    ({"train_speed": -1.0}, {}, BACKWARD),
    ({"train_speed": -1.0, "wheel_angular_speed": -1.0}, {}, BACKWARD),
    ({"brake_torque": -1.0}, {}, "negative in .* rows with slip and positive in 0 rows; .*reverse its sign"),
    ({"brake_torque": 1e300}, {}, r"brake torque 1.*e\+30. N\*m .*1e\+06 N\*m \(\d+ such rows\); check"),
    ({}, {"delays": {"brake_torque": 0.1}, "zeros": {"train_speed": 30.0}}, "the rows are corrected by `delays` br"),
    ({}, {"time_constant": 50.0}, "the observer settles for 250 s after .*; give a smaller `time_constant`"),
])  # fmt: skip
def test_what_leaves_no_row_is_refused_with_its_cause(recwarn, factors, options, message):
    with pytest.raises(InputError, match=message):
        told(scaled(two_runs(), **factors), **options)
    assert not list(recwarn)


def test_every_sentence_is_used_and_has_its_numbers():
    sentences = texts("railslip_ctrl.identification", "messages.toml")
    sources = [path.read_text("utf-8") for path in (ROOT / "railslip_ctrl" / "identification").glob("*.py")]
    calls = [node for text in sources for node in ast.walk(ast.parse(text)) if isinstance(node, ast.Call)]
    used = set()
    for call in (call for call in calls if getattr(call.func, "id", "") == "message"):
        given = {keyword.arg for keyword in call.keywords}
        for name in {part.value for part in ast.walk(call.args[0]) if isinstance(part, ast.Constant)}:
            wanted = {re.split(r"[.\[]", field)[0] for _, field, *_ in Formatter().parse(sentences[name]) if field}
            assert None in given or wanted <= given, name  # None: a mapping of numbers
            used.add(name)
    others = [name for name in sentences.keys() - used if not any(f'"{name}"' in text for text in sources)]
    assert not others
