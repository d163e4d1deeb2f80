"""What a log's file may look like: packing, encoding, separators, headers; and what is refused in one line."""

from __future__ import annotations

import bz2
import gzip
import os
import sys
from pathlib import Path

import numpy as np
import pytest
from log_texts import HEADER, log_text, read, write

from railslip_ctrl.core.errors import InputError
from railslip_ctrl.identification.logs import Log

BARE = "time,train speed,wheel speed,brake torque"
UNITS = "s,km/h,km/h,kN*m"
SHORT = "time_s train_speed_kmh wheel_speed_kmh brake_torque_kNm"


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


# --- packing and encoding ------------------------------------------------------------------------------------------


@pytest.mark.parametrize("block_bytes", [50, 1 << 20])
@pytest.mark.parametrize(
    "content",
    [
        gzip.compress(log_text(60).encode()),
        gzip.compress(log_text(20).encode()) + gzip.compress("".join(log_text(60).splitlines(True)[21:]).encode()),
        log_text(60).encode("utf-16"),
        b"\xfe\xff" + log_text(60).encode("utf-16-be"),
        gzip.compress(log_text(60).replace("\n", "\r\n").encode("utf-16")),
        b"\xef\xbb\xbf" + rows_below("# " + HEADER).encode(),
    ],
    ids=["gzip", "gzip of two parts", "UTF-16", "UTF-16, big end first", "UTF-16 in gzip", "mark before a comment"],
)
def test_packed_and_encoded_logs_are_read_as_plain_ones(tmp_path, expected, content, block_bytes):
    rows, log = read(write(tmp_path, content), block_bytes=block_bytes)
    assert same(rows, expected)
    assert log.broken.count == 0
    assert log.share == 1.0


def test_names_beyond_ascii_are_read_in_utf_16(tmp_path):
    text = log_text(20, HEADER.replace("time [s]", "Zeit seit Öffnen [s]"))
    rows, _ = read(write(tmp_path, text.encode("utf-16")), columns={"time": "Zeit seit Öffnen"})
    assert len(rows) == 20


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


# --- separators ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "text",
    [
        "".join(line + "," + "\n" for line in log_text(60).splitlines()),
        rows_below(HEADER, lambda line: line + ","),
        rows_below(HEADER + ","),
        "".join(line.replace(",", ";") + ";;;\n" for line in log_text(60).splitlines()),
        rows_below(SHORT, lambda line: "  " + line.replace(",", "    ") + " "),
        rows_below(SHORT, lambda line: " \t" + line.replace(",", " \t ").replace(".", ",")),
        rows_below("time [s]\tv [km/h]\tvw (km/h)\tTb [kN*m]", lambda line: line.replace(",", "\t")),
    ],
    ids=[
        "a separator at the end of every line",
        "at the end of rows",
        "at the end of the header",
        "three at the end of every line",
        "blanks",
        "blanks and decimal commas",
        "tabs, and blanks in names",
    ],
)
@pytest.mark.parametrize("block_bytes", [80, 1 << 20])
def test_separators(tmp_path, expected, text, block_bytes):
    rows, log = read(write(tmp_path, text), block_bytes=block_bytes)
    assert same(rows, expected)
    assert log.broken.count == 0


def test_a_row_that_lost_a_cell_does_not_hide_behind_a_separator_at_the_end(tmp_path):
    """With a comma more it has as many cells as the others."""
    for text in (rows_below(HEADER), rows_below(HEADER, lambda line: line + ",")):
        lines = text.splitlines(keepends=True)
        lines[19] = "0.18,9,9,98," + ("1.5,\n" if text.endswith(",\n") else "\n")
        rows, log = read(write(tmp_path, "".join(lines)))
        assert log.broken.count == 1
        assert log.broken.first[0].startswith("line 20: ")
        assert len(rows) == 59


# --- headers -------------------------------------------------------------------------------------------------------


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


def test_what_numpy_writes_is_read(tmp_path, expected):
    """With its own separator, the blank, and with a comma; the header as it is given."""
    table = np.column_stack([expected.columns[name] for name in ("time", "train_speed", "wheel_speed", "brake_torque")])
    for options in ({"header": "time train_speed wheel_speed brake_torque"}, {"header": BARE, "delimiter": ","}):
        np.savetxt(tmp_path / "log.txt", table, **options)
        assert same(read(tmp_path / "log.txt")[0], expected)
    np.savetxt(tmp_path / "log.txt", table, header="a rig\n" + BARE)  # its names apart by commas, its rows by blanks
    assert same(read(tmp_path / "log.txt")[0], expected, lines_more=1)


def test_broken_rows_below_a_comment_keep_their_lines(tmp_path):
    lines = ("# rig\n# " + log_text(40)).splitlines(keepends=True)
    lines[20] = "0.18,9x,98,1.5\n"
    rows, log = read(write(tmp_path, "".join(lines)))
    assert log.broken.first == ("line 21: '9x' is not a number, column 'train speed [km/h]'",)
    assert rows.line[0] == 3


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("# a\n# b\n1,2,3,4\n", "line 3: no header, but numbers; name the columns in a line above, with their units"),
        ("# time,v,vw,pressure\n# rig\n1,2,3,4\n", r"header: no column for brake_torque.*has 'time', 'v', 'vw', 'pr"),
        ("# time,v,vw,Tb\n1,2,3,4,5\n", "line 2: no header, but numbers"),
        ("# time,v,vw,Tb\n1,2,3,4", "nothing after line 2"),
        ("# time,v,vw,Tb\n", "the file is empty or has no header"),
    ],
)
def test_comments_that_name_no_columns(tmp_path, text, message):
    with pytest.raises(InputError, match=message):
        Log(write(tmp_path, text))


@pytest.mark.parametrize(
    "header",
    [
        f"{BARE}\n{UNITS}",
        f"{BARE}\n[s],[km/h],(km/h),kNm",
        f"{HEADER}\n{UNITS}",
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


def test_a_first_row_of_words_is_broken_not_units(tmp_path):
    rows, log = read(write(tmp_path, rows_below(f"{HEADER}\nstart,of,the,run")))
    assert log.broken.first == ("line 2: 'start' is not a number, column 'time [s]'",)
    assert len(rows) == 60


# --- files that are none -------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"PK\x03\x04" + bytes(100), "is a ZIP archive or an Excel workbook; give a CSV file, gzipped or not"),
        (bz2.compress(log_text(9).encode()), "is packed with bzip2"),
        (b"MDF     4.10" + bytes(100), "is an MDF recording"),
        (gzip.compress(b"PK\x03\x04" + bytes(100), mtime=0), "is a ZIP archive"),
        (log_text(9).encode("utf-16-le"), "not a text file in UTF-8, UTF-16 with its mark"),
        (log_text(9).encode("utf-32"), "not a text file"),
        (gzip.compress(b"", mtime=0), "the file is empty"),
    ],
)
def test_other_formats_are_named(tmp_path, content, message):
    with pytest.raises(InputError, match=message):
        Log(write(tmp_path, content))


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="this system has no named pipes")
def test_a_pipe_is_not_waited_for(tmp_path):
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(InputError, match="pipe: is not a regular file; give a CSV file, or - for standard input"):
        Log(tmp_path / "pipe")


def test_standard_input_that_is_closed(tmp_path, monkeypatch):
    monkeypatch.setattr(sys, "stdin", None)
    with pytest.raises(InputError, match="standard input: is closed; give a CSV file, or pipe one in"):
        Log(Path("-"))


def test_a_disk_that_fails_is_told_with_the_file(tmp_path, monkeypatch):
    log = Log(write(tmp_path, log_text(60)))

    def fails(_):
        raise OSError(5, "Input/output error")

    monkeypatch.setattr(
        log._file, "_file", type("Bad", (), {"read": staticmethod(fails), "close": lambda self: None})()
    )
    with pytest.raises(InputError, match=r"log.csv: cannot be read \(Input/output error\)"):
        list(log.rows())


@pytest.mark.skipif(not Path("/proc/self/mem").exists(), reason="a file of Linux that opens but cannot be read")
def test_a_file_that_cannot_be_read():
    with pytest.raises(InputError, match=r"/proc/self/mem: cannot be read \(Input/output error\)"):
        Log(Path("/proc/self/mem"))
