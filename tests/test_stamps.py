"""Time stamps of a log: one that stands far off is left out with its line, any other that does not grow refused."""

from __future__ import annotations

import numpy as np
import pytest
from log_texts import log_text, read, with_stamps, write

from railslip_ctrl.core.errors import InputError
from railslip_ctrl.identification.logs import BESIDE, FAR, Log, Rows, StampFilter

ROWS = 120  # lines 2 to 121
BLOCKS = [60, 700, 1 << 20]  # some two rows, thirty, and all

at_any_block = pytest.mark.parametrize("block_bytes", BLOCKS)


@at_any_block
@pytest.mark.parametrize("line", [2, 3, 18, 19, 30, 31, 32, 60, 104, 105, 119, 120])
@pytest.mark.parametrize("stamp", ["1e9", "7"])
def test_a_stamp_far_ahead_is_left_out_and_named(tmp_path, line, stamp, block_bytes):
    """The first row, the last but one, and all around the borders of blocks."""
    rows, log = read(write(tmp_path, with_stamps(ROWS, {line: stamp})), block_bytes=block_bytes)
    assert set(range(2, ROWS + 2)) - set(rows.line.tolist()) == {line}
    assert log.stamps.count == 1
    named = f"line {line}: time {float(stamp):.9g} s stands apart from those beside it; it is left out"
    assert log.stamps.warnings == (named,)
    assert log.broken.count == 0


@at_any_block
@pytest.mark.parametrize("line", [3, 32, 60, 120, 121])
def test_a_stamp_far_behind_is_left_out_and_named(tmp_path, line, block_bytes):
    """In the last line too, where nothing comes after it."""
    rows, log = read(write(tmp_path, with_stamps(ROWS, {line: "-5.5"})), block_bytes=block_bytes)
    assert set(range(2, ROWS + 2)) - set(rows.line.tolist()) == {line}
    assert log.stamps.warnings[0].startswith(f"line {line}: time -5.5 s")


@at_any_block
@pytest.mark.parametrize(("line", "stamp"), [(121, "1e9"), (2, "-1e9")])
def test_at_the_ends_a_stamp_in_order_is_a_gap(tmp_path, line, stamp, block_bytes):
    """Nothing tells it from a pause, which is reported by the line after it (`Survey.gaps`)."""
    rows, log = read(write(tmp_path, with_stamps(ROWS, {line: stamp})), block_bytes=block_bytes)
    assert len(rows) == ROWS
    assert log.stamps.count == 0


@at_any_block
def test_stamps_far_from_each_other_are_all_left_out(tmp_path, block_bytes):
    lines = [2, 2 + BESIDE + 1, 60, 60 + BESIDE + 1, 120]
    rows, log = read(write(tmp_path, with_stamps(ROWS, dict.fromkeys(lines, "1e9"))), block_bytes=block_bytes)
    assert set(range(2, ROWS + 2)) - set(rows.line.tolist()) == set(lines)
    assert log.stamps.count == 5
    many = dict.fromkeys(range(4, ROWS, BESIDE + 1), "1e9")
    _, log = read(write(tmp_path, with_stamps(ROWS, many)), block_bytes=block_bytes)
    assert len(log.stamps.warnings) == 6
    assert log.stamps.warnings[-1] == f"{len(many)} rows with outlying time stamps in all"


@at_any_block
@pytest.mark.parametrize("count", [2, 3])
def test_more_than_one_in_a_row_are_refused_by_the_first(tmp_path, count, block_bytes):
    text = with_stamps(ROWS, {60 + i: f"{1e9 + i}" for i in range(count)})
    message = (
        rf"log.csv: line 60: time jumps from 0.57 s to 1e\+09 s, but line {60 + count} has {0.58 + 0.01 * count} s"
    )
    with pytest.raises(InputError, match=message):
        read(write(tmp_path, text), block_bytes=block_bytes)


@at_any_block
def test_two_nearly_in_a_row_are_a_second_clock(tmp_path, block_bytes):
    for between, named in ((2, 60), (BESIDE, 60 + BESIDE)):  # the first is alone as far as its window goes
        with pytest.raises(InputError, match=f"line {named}: time jumps"):
            read(write(tmp_path, with_stamps(ROWS, {60: "1e9", 60 + between: "1e9"})), block_bytes=block_bytes)


@at_any_block
@pytest.mark.parametrize(
    ("line", "stamp", "word"),
    [
        (60, "0.57", "repeats 0.57 s"),
        (60, "0.05", "goes back from 0.57 s"),
        (121, "1.18", "repeats"),
        (121, "1.0", "goes back"),
        (3, "0.00", "repeats"),
    ],
)
def test_a_stamp_that_repeats_or_steps_back_is_refused_with_its_line(tmp_path, line, stamp, word, block_bytes):
    with pytest.raises(
        InputError, match=f"log.csv: line {line}: time {float(stamp):g} s {word}.*; give times that grow"
    ):
        read(write(tmp_path, with_stamps(ROWS, {line: stamp})), block_bytes=block_bytes)


@at_any_block
def test_a_clock_set_back_is_refused(tmp_path, block_bytes):
    """By however much: the stamps after it are out of order too."""
    for back in (0.2, 1e6):
        stamps = {line: f"{0.01 * (line - 2) - back:.2f}" for line in range(60, ROWS + 2)}
        with pytest.raises(InputError, match=r"line 60: time .* s goes back from 0.57 s"):
            read(write(tmp_path, with_stamps(ROWS, stamps)), block_bytes=block_bytes)


def test_neighbours_exchanged_are_refused(tmp_path):
    with pytest.raises(InputError, match=r"line 61: time 0.58 s goes back from 0.59 s"):
        read(write(tmp_path, with_stamps(ROWS, {60: "0.59", 61: "0.58"})))


@pytest.mark.parametrize(("share", "left_out"), [(0.9, False), (1.1, True)])
def test_far_is_so_many_usual_intervals_from_the_nearer_neighbour(share, left_out):
    time = 0.01 * np.arange(60.0)
    time[40:] += 30.0  # a pause is no usual interval
    time[30] = time[31] + share * FAR * 0.01
    filtering = StampFilter("log")
    rows = Rows(np.arange(60) + 2, {"time": time})
    if left_out:
        assert len(filtering.add(rows)) + len(filtering.finish()) == 59
    else:
        with pytest.raises(InputError, match=r"line 32: time jumps|line 33: time"):
            filtering.add(rows)


def test_of_two_that_may_be_wrong_the_one_with_two_neighbours_is():
    """Ends of a log: 0, 1, 2, ... with the second or the last but one far off leaves the first and the last alone."""
    for at, stamp in ((1, -1e4), (58, 1e4)):
        time = np.arange(60.0)
        time[at] = stamp
        filtering = StampFilter("log")
        parts = [filtering.add(Rows(np.arange(60), {"time": time})), filtering.finish()]
        assert np.concatenate([part.line for part in parts]).tolist() == [i for i in range(60) if i != at]


def test_too_few_rows_tell_nothing(tmp_path):
    with pytest.raises(InputError, match=r"line 3: time 0.01 s goes back from"):
        read(write(tmp_path, with_stamps(4, {2: "1e9"})))
    assert len(read(write(tmp_path, with_stamps(5, {2: "1e9"})))[0]) == 4


@pytest.mark.parametrize("seed", range(20))
def test_what_is_left_out_does_not_depend_on_the_blocks(seed):
    """Irregular sampling with glitches, in blocks of random sizes: as whole, and all glitches but nothing else."""
    generator = np.random.default_rng(seed)
    time = np.cumsum(generator.exponential(0.01, 2000) + 1e-4)
    glitches = np.arange(int(generator.integers(0, 40)), 1990, 40)
    time[glitches] += generator.choice([-1.0, 1.0], len(glitches)) * 10.0 ** generator.uniform(2, 9, len(glitches))
    if glitches[0] == 0:
        time[0] = abs(time[0])  # else it is a gap
    rows = Rows(np.arange(2000), {"time": time})
    borders = np.sort(generator.choice(np.arange(1, 2000), 30, replace=False))
    filtering, kept = StampFilter("log"), []
    for start, stop in zip([0, *borders], [*borders, 2000], strict=True):
        kept.append(filtering.add(rows.part(start, stop)).line)
    kept.append(filtering.finish().line)
    assert np.array_equal(np.concatenate(kept), np.delete(rows.line, glitches))
    assert filtering.count == len(glitches)


@pytest.mark.parametrize("stamp", ["", "nan", "inf", "-inf", "later"])
def test_a_stamp_that_is_no_number_is_a_broken_line(tmp_path, stamp):
    for line in (2, 60, 121):
        rows, log = read(write(tmp_path, with_stamps(ROWS, {line: stamp})))
        assert set(range(2, ROWS + 2)) - set(rows.line.tolist()) == {line}
        assert log.broken.first[0].startswith(f"line {line}: ")
        assert log.stamps.count == 0


def test_a_time_that_no_clock_shows_is_a_broken_line(tmp_path):
    rows, log = read(write(tmp_path, with_stamps(ROWS, {121: "1e300"})))
    assert len(rows) == ROWS - 1
    assert log.broken.first == ("line 121: time 1e+300 s is beyond any clock; check its unit",)
    milliseconds = with_stamps(ROWS, {line: f"{1.7e12 + 10 * line:.0f}" for line in range(2, ROWS + 2)})
    with pytest.raises(InputError, match=r"no rows after the header; line 2: time 1.7e\+12 s is beyond any clock"):
        list(Log(write(tmp_path, milliseconds)).rows())
    in_ms = milliseconds.replace("time [s]", "time [ms]")
    assert len(read(write(tmp_path, in_ms))[0]) == ROWS


def test_the_plain_log_passes(tmp_path):
    rows, log = read(write(tmp_path, log_text(ROWS)))
    assert (len(rows), log.stamps.count, log.stamps.warnings) == (ROWS, 0, ())
