"""Figures drawn in two processes: each once, the same files as one process makes."""

from __future__ import annotations

from functools import partial

import pytest
from matplotlib import rc_context

from railslip_ctrl import kept
from railslip_ctrl.kernels.compilation import CACHE_VARIABLE
from railslip_ctrl.parameters import Actuator
from railslip_ctrl.plots import side_by_side, style
from railslip_ctrl.plots.side_by_side import drawing_room


def square(side: float):
    """A figure that another process can draw too."""
    figure = style.new_figure(2.0, f"a square of side {side:g} m")
    ax = style.panels(figure)[0, 0]
    ax.plot([0, side, side, 0, 0], [0, 0, side, side, 0])
    ax.set_xlabel("x (m)")
    ax.set_ylabel("y (m)")
    return figure


DRAWINGS = {f"square-{i}": partial(square, float(i)) for i in range(1, 6)}


@pytest.fixture(autouse=True)
def own_cache(monkeypatch, tmp_path):
    monkeypatch.setenv(CACHE_VARIABLE, str(tmp_path))
    for name in ("found", "kept"):  # as they are, which `conftest.py` shuts
        monkeypatch.setattr(side_by_side, name, getattr(kept, name))


@pytest.fixture(scope="module")
def alone():
    return {name: style.figure_files(make()) for name, make in DRAWINGS.items()}


def test_two_processes_make_the_files_of_one(alone):
    with drawing_room(helped=True) as room:
        pieces = room.take(DRAWINGS)
        assert len(pieces) == len(DRAWINGS)
        for piece in pieces:
            piece()
        assert room.files() == alone


def test_the_other_process_draws_what_this_one_leaves(alone):
    with drawing_room(helped=True) as room:
        room.take(DRAWINGS)
        assert room.files() == alone


def test_without_help_all_are_drawn_here(alone):
    with drawing_room(helped=False) as room:
        for part in (dict(list(DRAWINGS.items())[:2]), dict(list(DRAWINGS.items())[2:])):
            for piece in room.take(part):
                piece()
        assert room.files() == alone


def test_what_was_drawn_before_is_not_drawn_again(alone, monkeypatch):
    with drawing_room(helped=False) as room:
        for piece in room.take(DRAWINGS):
            piece()
        assert room.from_cache == ()
        room.files()
    monkeypatch.setattr(side_by_side, "figure_files", lambda figure: {"png": b"again"})
    with drawing_room(helped=False) as room:
        other = {"square-3": partial(square, 3.5), "square-9": partial(square, 1.0)}  # other data, another name
        for piece in room.take({**DRAWINGS, **other}):
            piece()
        assert room.from_cache == ("square-1", "square-2", "square-4", "square-5")
        files = room.files()
    assert list(files) == [*DRAWINGS, "square-9"]  # as they were taken
    assert {name: made for name, made in files.items() if name in room.from_cache} == {
        name: made for name, made in alone.items() if name != "square-3"
    }
    assert files["square-3"] == files["square-9"] == {"png": b"again"}
    with drawing_room(helped=False, fresh=True) as room:
        for piece in room.take(DRAWINGS):
            piece()
        assert room.from_cache == ()
        assert set(map(str, room.files().values())) == {str({"png": b"again"})}


def test_what_a_figure_is_of_does_not_depend_on_how_its_records_were_made():
    """Of a record pickle writes which fields were given, a set of strings, whose order changes from run to run."""
    given, left_out = Actuator(dead_time=0.15, lag=0.6), Actuator.model_construct(dead_time=0.15, lag=0.6)
    left_out.__pydantic_fields_set__.clear()
    same, other = (side_by_side._contents(partial(square, one)) for one in (given, Actuator(dead_time=0.15, lag=0.5)))
    assert side_by_side._contents(partial(square, left_out)) == same != other
    with rc_context({"font.size": 7.0}):
        assert side_by_side._contents(partial(square, given)) != same


def test_what_cannot_be_drawn_there_is_said_here():
    with drawing_room(helped=True) as room:
        room.take({"square": partial(square, "no number")})  # type: ignore[dict-item]
        with pytest.raises(ValueError, match="format code"):
            room.files()
