"""Figures drawn in two processes: each once, the same files as one process makes."""

from __future__ import annotations

from functools import partial

import pytest

from railslip_ctrl.plots import style
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


def test_what_cannot_be_drawn_there_is_said_here():
    with drawing_room(helped=True) as room:
        room.take({"square": partial(square, "no number")})  # type: ignore[dict-item]
        with pytest.raises(ValueError, match="format code"):
            room.files()
