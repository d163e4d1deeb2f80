"""Generated controllers for tests: parameters of them, and the C compiled and called."""

import ctypes
import shutil
import subprocess

import pytest
from sample_laws import sample_law

from railslip_ctrl.sliding.law import KEPT
from railslip_ctrl.sliding.sampled_law import LARGEST, OPTIONS

COMPILER = shutil.which("cc")
needs_compiler = pytest.mark.skipif(COMPILER is None, reason="no C compiler (cc) on this system")
FLAGS = ("-std=c99", "-Wall", "-Wextra", "-Werror", "-pedantic", "-O2")

RANGES = {
    **{"J": (20.0, 900.0), "r": (0.3, 0.6), "Mn": (1500.0, 2e4), "Bn": (0.0, 1.0), "lambda_d": (0.02, 0.3)},
    **{"sigma_d": (0.1, 5.0), "rho": (0.1, 5.0), "D": (0.1, 500.0), "K": (1.0, 3000.0), "k1": (1e-10, 1e-7)},
    **{"k2": (1e-8, 1e-5), "filter_time": (0.01, 0.5), "N": (2e4, 6e4), "period": (1e-3, 0.05)},
}


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


def begun(module, v, p):
    """The Python state when the brake is applied at speed v."""
    code, state = module.init(v, p)
    assert code == 0
    return state


class Compiled:
    def __init__(self, code, folder, *flags) -> None:
        source, target = folder / "law.c", folder / "law.so"
        source.write_text(code.c)
        command = [COMPILER, *FLAGS, *flags, "-shared", "-fPIC", "-o", target, source, "-lm"]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        assert (done.returncode, done.stderr) == (0, "")
        library = ctypes.CDLL(str(target))
        law = code.law
        self.Parameters = _structure(law.parameters)
        self.State = _structure((*law.states, *KEPT))
        pointer = ctypes.POINTER
        self.init = library.railslip_asmc_init
        self.init.argtypes = [pointer(self.State), ctypes.c_double, pointer(self.Parameters)]
        self.step = library.railslip_asmc_step
        self.step.argtypes = [pointer(self.State)] + [ctypes.c_double] * len(law.measured) + [pointer(self.Parameters)]
        self.step.restype = _structure(("torque", "s", "theta1_hat_rate", "theta2_hat_rate"))
        self.valid = library.railslip_asmc_valid
        self.valid.argtypes = [ctypes.c_double] * len(law.measured)


def _structure(fields):
    return type("Structure", (ctypes.Structure,), {"_fields_": [(name, ctypes.c_double) for name in fields]})


def fields(state):
    return tuple(getattr(state, name) for name, _ in state._fields_)


def same(left, right) -> bool:
    """Equal to 1e-12, relative to the size where that is above 1."""
    return all(abs(a - b) <= 1e-12 * max(1.0, abs(a), abs(b)) for a, b in zip(left, right, strict=True))
