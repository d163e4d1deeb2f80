"""Results cached from report to report: found again, never stale, never half of one."""

import os

import numpy as np
import pytest

from railslip_ctrl.core import folders as module
from railslip_ctrl.core.folders import CACHE_VARIABLE, cached


@pytest.fixture
def computed(monkeypatch, tmp_path):
    """A result that counts how often it is computed; its list of times, and the folder it is kept in."""
    monkeypatch.setenv(CACHE_VARIABLE, str(tmp_path))
    times: list[int] = []

    def compute():
        times.append(len(times))
        return np.arange(3.0), "text", len(times)

    return compute, times, tmp_path / "results"


def test_a_result_is_computed_once_for_what_it_is_of(computed):
    compute, times, folder = computed
    first, again = cached("name", compute, "vehicle"), cached("name", compute, "vehicle")
    assert (first[0] == again[0]).all()
    assert (first[1:], len(times)) == (again[1:], 1)
    cached("name", compute, "another vehicle")
    cached("other", compute, "vehicle")
    assert len(times) == len(list(folder.iterdir())) == 3
    assert cached("name", compute, "vehicle", fresh=True)[2] == 4
    assert cached("name", compute, "vehicle")[2] == 4  # the fresh one is kept


@pytest.mark.parametrize("spoil", [lambda b: b[:-1], lambda b: b"", lambda b: b.replace(b"text", b"hext")])
def test_a_spoilt_file_is_computed_again(computed, spoil):
    compute, times, folder = computed
    cached("name", compute)
    (path,) = folder.iterdir()
    path.write_bytes(spoil(path.read_bytes()))
    assert (cached("name", compute)[1:], len(times)) == (("text", 2), 2)


def test_other_source_is_another_result(computed, monkeypatch, tmp_path):
    """The hash is of every module's text: one more line anywhere, and nothing kept is found."""
    compute, times, _ = computed
    (tmp_path / "package").mkdir()
    monkeypatch.setattr(module, "_PACKAGE", tmp_path / "package")
    for text, count in (("x = 1\n", 1), ("x = 1\n", 1), ("x = 2\n", 2)):
        (tmp_path / "package" / "module.py").write_text(text)
        module._of_code.cache_clear()
        cached("name", compute)
        assert len(times) == count
    module._of_code.cache_clear()


def test_what_a_folder_that_is_shut_cannot_keep_is_kept_for_the_run(computed, monkeypatch, tmp_path):
    compute, times, _ = computed
    (tmp_path / "file").write_text("")
    monkeypatch.setenv(CACHE_VARIABLE, str(tmp_path / "file"))
    assert cached("name", compute)[2] == cached("name", compute)[2] == len(times) == 1


def test_the_folder_keeps_what_was_asked_for_last(computed, monkeypatch):
    compute, times, folder = computed
    monkeypatch.setattr(module, "_MOST", 3)
    for i, name in enumerate("abcd"):
        cached(name, compute)
        for path in folder.glob(f"{name}-*"):
            os.utime(path, (i, i))
        module.look_up("a")  # which makes it the latest
    assert {path.name[0] for path in folder.iterdir()} == {"a", "c", "d"}
    assert len(times) == 4
