"""The command in a terminal, numbers in the derived law, controllers from Python files."""

import os
import re
import struct
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from railslip_ctrl import InputError, Rail, derive
from railslip_ctrl.model.adhesion import law_class, load_law, published_law
from railslip_ctrl.report.derivation import derivation_json, derivation_latex, derivation_markdown, derivation_text
from railslip_ctrl.report.document import WIDTH
from railslip_ctrl.sliding.code import generate, law_numbers, with_numbers

MARGINS = ("margins", "--rail", "dry", "--kp", "190", "--ki", "5")
NUMBER = re.compile(r"(?<![\w.])\d+\.\d+")


def in_a_terminal(width: int) -> str:
    """What `railslip margins` prints to a plain terminal of so many columns."""
    import fcntl
    import pty
    import termios

    master, terminal = pty.openpty()
    fcntl.ioctl(terminal, termios.TIOCSWINSZ, struct.pack("HHHH", 50, width, 0, 0))
    environment = {name: value for name, value in os.environ.items() if name not in ("COLUMNS", "LINES")}
    command = [sys.executable, "-m", "railslip_ctrl", *MARGINS]
    environment["PYTHONIOENCODING"] = "ascii"
    with subprocess.Popen(command, stdout=terminal, stderr=subprocess.PIPE, env=environment) as done:
        os.close(terminal)
        read = b""
        try:
            while chunk := os.read(master, 1 << 16):
                read += chunk
        except OSError:  # the other end is closed, which Linux calls an error
            pass
        os.close(master)
        assert (done.wait(), done.stderr.read()) == (0, b"")
    return read.decode()


@pytest.mark.skipif(sys.platform == "win32", reason="no pseudo-terminals")
def test_a_report_fits_the_terminal_and_says_the_same(railslip):
    status, piped, _ = railslip(*MARGINS)
    assert status == 0
    assert 80 < max(map(len, piped.splitlines())) <= WIDTH
    narrow = in_a_terminal(80)
    assert max(map(len, narrow.splitlines())) <= 80
    assert set(NUMBER.findall(narrow)) == set(NUMBER.findall(piped))  # no number is broken in two
    assert "\x1b" not in narrow


NUMBERS = {"c1": 0.20, "c2": 18.0, "c3": 0.08}


@pytest.fixture
def derived(file):
    """The derivation with Burckhardt's law, its code, the law of a file, and the numbers of that."""
    text = 'law = "burckhardt"\n[parameters]\nc1 = 0.20\nc2 = 18.0\nc3 = 0.08\n'
    derivation, law = derive(law="burckhardt"), load_law(file("leaves.toml", text))
    return derivation, generate(derivation), law, law_numbers(derivation, law)


def told(derivation, code, numbers) -> tuple[str, str, str]:
    in_code = (derivation_markdown(derivation, (), code, numbers), derivation_latex(derivation, (), code, numbers))
    return (derivation_text(derivation, (), numbers), *in_code)


def test_derive_puts_the_numbers_of_a_file_into_the_law_and_the_code(derived):
    derivation, code, law, numbers = derived
    found = derivation_json(derivation, (), code, numbers)["law"]["numbers"]
    assert found["dry"]["parameters"] == NUMBERS
    assert found["wet"]["parameters"] == dict(zip(NUMBERS, law.wet().parameters(), strict=True)) != NUMBERS
    for text in told(derivation, code, numbers):
        assert "Law with the numbers given, dry rail" in text
        assert "c1 = 0.2, c2 = 18, c3 = 0.08 (SI)" in text
    assert "numbers given" not in derivation_text(derivation, ())
    code, namespace = with_numbers(code, numbers, Path("leaves.toml")), {}
    exec(compile(code.python, "law", "exec"), namespace)
    assert namespace["ADHESION_DRY"] == {f"adhesion_{name}": value for name, value in NUMBERS.items()}
    for rail in Rail:
        (line,) = re.findall(rf"^#define RAILSLIP_ASMC_ADHESION_{rail.name} (.*)$", code.c, flags=re.M)
        assert re.fullmatch(r"\.adhesion_c1 = [\d.e-]+, \.adhesion_c2 = [\d.e-]+, \.adhesion_c3 = [\d.e-]+", line)
    assert ".adhesion_c1 = 0.2, .adhesion_c2 = 18.0, .adhesion_c3 = 0.08" in code.c


def test_the_law_with_numbers_is_the_law(derived):
    """Evaluated at a state: to the six digits to which a formula shows its numbers."""
    derivation, _, law, numbers = derived
    for one in numbers:
        symbols = dict(zip(type(law).symbols(), (value for _, value in one.parameters), strict=True))
        rest = sorted(one.torque.free_symbols, key=str)
        state = dict(zip(rest, np.random.default_rng(1).uniform(0.5, 2.0, len(rest)), strict=True))
        expected = derivation.law_in_adhesion.subs(symbols).subs(state)
        assert float(one.torque.subs(state)) == pytest.approx(float(expected), rel=1e-5)
        assert not one.torque.free_symbols & set(symbols)


def test_a_law_without_closed_form_says_so():
    derivation = replace(derive(law="burckhardt"), adhesion="table")  # a table's own takes long, and is not asked for
    law = law_class("table")(slip=(0.0, 0.05, 0.1, 1.0), mu=(0.0, 0.2, 0.25, 0.1))
    numbers = law_numbers(derivation, law)
    assert numbers[0].torque is None
    assert dict(numbers[0].parameters)["mu_3"] == 0.25
    code = generate(derive(law="burckhardt"))
    assert with_numbers(code, numbers, Path("table.toml")) == code  # Ta is an argument: nothing to initialise
    assert derivation_json(derivation, (), code, numbers)["law"]["numbers"]["dry"]["latex"] is None
    for text in told(derivation, code, numbers):
        assert "Ta is evaluated from these numbers outside the control law" in text
    with pytest.raises(InputError, match="'beam' is not the one derived with, 'burckhardt'; derive with it"):
        law_numbers(derive(law="burckhardt"), published_law("beam", Rail.DRY))


def test_derive_takes_a_file_over_the_initial_speed(railslip, file):
    text = 'law = "burckhardt"\n[parameters]\nc2 = 18.0\nc3 = 0.08\n[polynomials]\nc1 = [0.5, -0.0025]\n'
    path = file("model.toml", text)
    for options, c1 in (((), 0.25), (("--initial-speed", "60"), 0.35)):
        status, out, _ = railslip("derive", "--adhesion", path, *options, "--format", "c")
        assert (status, f"ADHESION_DRY .adhesion_c1 = {c1}, .adhesion_c2 = 18.0" in out) == (0, True)
