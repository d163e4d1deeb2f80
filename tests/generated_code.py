"""Generated controllers for tests: parameters of them, and the C compiled and called."""

import ctypes
import shutil
import subprocess

import pytest
from sample_laws import sample_law

from railslip_ctrl.controllers.guard import Status
from railslip_ctrl.sliding.code import generate
from railslip_ctrl.sliding.law import module_of
from railslip_ctrl.sliding.sampled_law import LARGEST, OPTIONS

COMPILER = shutil.which("cc")
needs_compiler = pytest.mark.skipif(COMPILER is None, reason="no C compiler (cc) on this system")
WARNINGS = ("-Wall", "-Wextra", "-Wconversion", "-Wdouble-promotion", "-pedantic", "-Werror")

RANGES = {
    **{"J": (20.0, 900.0), "r": (0.3, 0.6), "Mn": (1500.0, 2e4), "Bn": (0.0, 1.0), "lambda_d": (0.02, 0.3)},
    **{"sigma_d": (0.1, 5.0), "rho": (0.1, 5.0), "D": (0.1, 500.0), "K": (1.0, 3000.0), "k1": (1e-10, 1e-7)},
    **{"k2": (1e-8, 1e-5), "filter_time": (0.01, 0.5), "N": (2e4, 6e4), "period": (1e-3, 0.05)},
}


def python_law(derivation):
    """The generated Python, ready to call."""
    return module_of(generate(derivation).python)


def parameters(code, generator, adhesion, **given):
    """Random parameters; the adhesion law's own; no boundary layer, limits or options unless given."""
    values = {"boundary": 0.0, "torque_min": -LARGEST, "torque_max": LARGEST, **dict.fromkeys(OPTIONS, 0.0)}
    for name in code.law.parameters:
        if name in RANGES:
            values[name] = generator.uniform(*RANGES[name])
    values |= adhesion_of(adhesion and sample_law(adhesion))
    return [{**values, **given}[name] for name in code.law.parameters]


def adhesion_of(law):
    named = () if law is None else zip(type(law).parameter_names(), law.parameters(), strict=True)
    return {f"adhesion_{name}": value for name, value in named}


class Program:
    """A C program, compiled and called; `flags` choose the precision."""

    def __init__(self, program, folder, *flags):
        self.program = program
        self.single = any(flag.endswith("FLOAT32") for flag in flags)
        prefix, stem = program.prefix, program.prefix.removeprefix("railslip_")
        (folder / f"{stem}.h").write_text(program.header)
        source, sizes, target = folder / f"{stem}.c", folder / "sizes.c", folder / f"{stem}{len(flags)}.so"
        source.write_text(program.source)
        told = f"sizeof({prefix}_parameters), sizeof({prefix}_state)"
        sizes.write_text(f'#include "{stem}.h"\nextern const int sizes[];\nconst int sizes[] = {{{told}}};\n')
        command = [
            COMPILER,
            "-std=c99",
            "-O2",
            *WARNINGS,
            *flags,
            "-shared",
            "-fPIC",
            source,
            sizes,
            "-o",
            target,
            "-lm",
        ]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        assert (done.returncode, done.stderr) == (0, "")
        library, self.number = ctypes.CDLL(str(target)), ctypes.c_float if self.single else ctypes.c_double
        size, of_state = (ctypes.c_int * 2).in_dll(library, "sizes")
        self.default = (ctypes.c_char * size).in_dll(library, f"{prefix}_default")
        self._init, self._step = (getattr(library, f"{prefix}_{name}") for name in ("init", "step"))
        self._init.argtypes = [ctypes.c_void_p, ctypes.c_void_p, self.number]
        self.state = ctypes.create_string_buffer(of_state)

    def init(self, speed, parameters=None):
        self.parameters = self.default if parameters is None else parameters
        return self._init(self.state, self.parameters, speed)

    def step(self, *measured):
        torque = self.number()
        self._step.argtypes = [ctypes.c_void_p, ctypes.c_void_p, *[self.number] * len(measured), ctypes.c_void_p]
        status = self._step(self.state, self.parameters, *measured, ctypes.byref(torque))
        return torque.value, Status(status)

    def numbers(self, *values):
        """An array of numbers of the program's precision."""
        return (self.number * len(values))(*values)

    def first(self, count):
        """The first numbers of the state."""
        return list((self.number * count).from_buffer(self.state))
