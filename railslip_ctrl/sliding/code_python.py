"""The sampled law as Python source: plain functions of floats, as the ideal loop runs them and Numba can compile."""

from __future__ import annotations

import re
import textwrap

import sympy as sp
from sympy.printing.precedence import PRECEDENCE
from sympy.printing.pycode import PythonCodePrinter

from railslip_ctrl import __version__

from .law import HOLD_TIME, KEPT, sources_hash
from .sampled_law import EXPLAINED, LARGEST, LIMITED, OPTIONS, Assignment, SampledLaw

WIDTH = 99
"""Largest length of a line of generated code."""

NOT_HOLDING = (
    *("V' <= 0, disturbed", "invariant-set theorem", "theta_hat converges", "scalar gain k"),
    *("reaching condition (40)", "s s' < -eta |s| over the box", "sliding reached and kept", "boundary layer with K"),
    *("theta constant", "theta_hat bounded under noise", "sliding exists behind the actuator"),
    *("the law behind the actuator spares the wheel", "the adaptive loop is stable behind the actuator"),
)
"""Conditions that `joint_verification` finds not to hold for the published law; deciding them takes half a minute."""


HELPERS = ("reciprocal", "exponential", "limited")
"""Functions of the generated code: x^-1 and exp where an argument may be anything, and a number held to limits."""

_HIGHEST_PRODUCT = 4  # powers up to it are written as products, which overflow to infinity where Python's ** raises


class ProductPowers:
    """Printer part: small whole powers as products, the same arithmetic in every language."""

    def _print_Pow(self, expression: sp.Expr, **options: object) -> str:
        base, exponent = expression.as_base_exp()
        if exponent.is_Integer and 1 < exponent <= _HIGHEST_PRODUCT:
            factor = self.parenthesize(base, PRECEDENCE["Pow"])  # type: ignore[attr-defined]
            return "(" + "*".join([factor] * int(exponent)) + ")"
        return str(super()._print_Pow(expression, **options))  # type: ignore[misc]


class _PythonPrinter(ProductPowers, PythonCodePrinter):  # type: ignore[misc]
    """sgn 0 is 0 here and in C; SymPy prints copysign, for which it is 1."""

    def _print_sign(self, expression: sp.Expr) -> str:
        argument = self._print(expression.args[0])
        return f"(({argument} > 0.0) - ({argument} < 0.0))"


_USAGE = (
    "`init` once for every braking, then `step` every period. A sample with a measurement that is not finite is left "
    f"out: the last command is held for {HOLD_TIME:g} s, then the brake is released, a torque of 0, until the next "
    "valid sample; `valid` tells beforehand."
)

_HEAD = f'''"""{{head}}
"""

import math
from typing import NamedTuple

HOLD_TIME = {HOLD_TIME!r}  # s, for which the last command is held without a valid sample
'''

_SWITCHING = '''
def switching(s, boundary):
    """sgn s, or s/boundary held to -1 .. 1."""
    if boundary > 0.0:
        return min(max(s / boundary, -1.0), 1.0)
    if s > 0.0:
        return 1.0
    return -1.0 if s < 0.0 else 0.0
'''

_BOUNDED = f'''
def bounded(x):
    """x held to -{LARGEST:.0e} .. {LARGEST:.0e}; 0 for what is no number."""
    if -{LARGEST:.1e} <= x <= {LARGEST:.1e}:
        return x
    if x != x:
        return 0.0
    return {LARGEST:.1e} if x > 0.0 else -{LARGEST:.1e}
'''

_OPTIONAL = {
    "reciprocal": f'''
def reciprocal(x):
    """1/x; {LARGEST**2:.0e} for 0."""
    return 1.0 / x if x != 0.0 else {LARGEST**2:.1e}
''',
    "exponential": '''
def exponential(x):
    """exp(x), held below what overflows."""
    return math.exp(x) if x < 700.0 else math.exp(700.0)
''',
    "limited": '''
def limited(x, limit):
    """x held to -limit .. limit."""
    if x > limit:
        return limit
    return -limit if x < -limit else x
''',
}


def python_source(law: SampledLaw) -> str:
    """A module with `Parameters`, `State`, `init`, `control`, `valid` and `step`."""
    functions = [_control(law), _valid(law), _step(law)]
    parts = [
        _HEAD.format(head="\n".join(head_lines(law.note, _USAGE, WIDTH - 3))),
        _record(law, "Parameters", law.parameters),
        _record(law, "State", (*law.states, *KEPT)),
        _SWITCHING,
        _BOUNDED,
        _init(law),
        *(text for name, text in _OPTIONAL.items() if any(f"{name}(" in function for function in functions)),
        *functions,
    ]
    return "\n".join(parts)


def _record(law: SampledLaw, name: str, fields: tuple[str, ...]) -> str:
    lines = [f"class {name}(NamedTuple):"]
    for field in fields:
        default = " = 0.0" if field in OPTIONS else ""
        lines += commented(f"    {field}: float{default} ", f"# {law.meaning(field)}")
    return "\n" + "\n".join(lines) + "\n"


def started(law: SampledLaw) -> list[str]:
    """Values of the state's fields, but for the last, when the brake is applied at a speed v."""
    return ["bounded(v)" if state == "v_filtered" else "0.0" for state in (*law.states, *KEPT[:-1])]


def _init(law: SampledLaw) -> str:
    lines = [
        "def init(v, p):",
        '    """(0, state) when the brake is applied at speed v, m/s.',
        "",
        "    A parameter not finite or out of its bounds is refused: then (code, a state that",
        "    keeps the brake released), the code its place in `Parameters`, from 1 on, one more for v.",
        '    """',
        "    code = refused(v, p)",
        f"    return code, State({', '.join(started(law))}, float(code == 0))",
        "",
        "",
        "def refused(v, p):",
        '    """The code of `init`."""',
    ]
    for code, (name, rule) in enumerate((*law.rules.items(), ("v", ())), 1):
        value = name if name == "v" else f"p.{name}"
        asked = " and ".join((f"math.isfinite({value})", *(one.format(value) for one in rule)))
        lines += [f"    if not ({asked}):", f"        return {code}"]
    return "\n" + "\n".join([*lines, "    return 0"]) + "\n"


def _control(law: SampledLaw) -> str:
    results = ("torque", "s", "theta1_hat_rate", "theta2_hat_rate")
    lines = [
        f"def control({', '.join(law.control_arguments)}, p):",
        '    """The continuous law: (torque, s, theta1_hat_rate, theta2_hat_rate); a pure function."""',
        *(f"    {name} = bounded({name})" for name in law.control_arguments),
        *assignments([("s", law.surface)], law),
        "    switching_ = switching(s, p.boundary)",
        *(line for one in law.control for line in assignments([one], law)),
        f"    return {', '.join(f'bounded({name})' for name in results)}",
    ]
    return "\n" + "\n".join(lines) + "\n"


def _valid(law: SampledLaw) -> str:
    lines = [
        f"def valid({', '.join(law.measured)}):",
        '    """Whether a sample is used: every measurement is finite. `step` leaves another one out."""',
        f"    return {' and '.join(f'math.isfinite({name})' for name in law.measured)}",
    ]
    return "\n" + "\n".join(lines) + "\n"


def _step(law: SampledLaw) -> str:
    lines = [
        f"def step(state, {', '.join(law.measured)}, p):",
        '    """One sample: (torque, s, new state); s is 0 where the sample is left out."""',
        f"    {', '.join((*law.states, *KEPT))} = state",
        "    if ready != 1.0:",
        "        return 0.0, 0.0, state",
        f"    if not valid({', '.join(law.measured)}):",
        "        command = command if missing < HOLD_TIME else 0.0",
        "        missing = missing + p.period",
        *short(f"        return command, 0.0, State({', '.join((*law.states, *KEPT))})"),
        *(f"    {name} = bounded({name})" for name in law.measured),
        *_prepared(law),
        *short(f"    torque, s, theta1_hat_rate, theta2_hat_rate = control({', '.join(law.control_arguments)}, p)"),
        "    command = min(max(torque, p.torque_min), p.torque_max)",
        "    if p.anti_windup > 0.0 and command != torque:",
        "        theta1_hat_rate = theta2_hat_rate = 0.0",
        "        if (torque - command) * e > 0.0:",
        "            e_integral = state.e_integral",
    ]
    for i in (1, 2):
        lines += [
            f"    theta{i}_hat = bounded(theta{i}_hat + p.period * theta{i}_hat_rate)",
            f"    if p.theta{i}_min < p.theta{i}_max:",
            f"        theta{i}_hat = min(max(theta{i}_hat, p.theta{i}_min), p.theta{i}_max)",
        ]
    lines += short(f"    return command, s, State({', '.join(law.states)}, command, 0.0, ready)")
    return "\n" + "\n".join(lines) + "\n"


def _prepared(law: SampledLaw) -> list[str]:
    lines = []
    for name, value in law.prepare:
        lines += assignments([(name, value)], law)
        if name in law.states and value.func is not LIMITED:
            lines.append(f"    {name} = bounded({name})")
    return lines


def assignments(targets: list[Assignment], law: SampledLaw) -> list[str]:
    """Lines that assign the targets, common parts first; parameters are read from `p`."""
    printer = _PythonPrinter({"fully_qualified_modules": True, "user_functions": {name: name for name in HELPERS}})
    lines = [f"    # {law.meaning(name)}" for name, _ in targets if name in EXPLAINED]
    for name, expression in common_parts(targets, {name: f"p.{name}" for name in law.parameters}):
        text = printer.doprint(expression)
        if len(line := f"    {name} = {text}") <= WIDTH:
            lines.append(line)
        else:
            lines += [f"    {name} = (", *short(f"        {text}", WIDTH), "    )"]
    return lines


def common_parts(targets: list[Assignment], names: dict[str, str]) -> list[Assignment]:
    """Targets after `cse`, temporaries before them, parameters renamed by `names`; the same for every language.

    Divided by and exponentiated with the `HELPERS`, so that a parameter of 0 does in every language the same.
    """
    temporaries, values = sp.cse([value for _, value in targets], symbols=sp.numbered_symbols(f"{targets[0][0]}_part"))
    renamed = {**names, "switching": "switching_"}
    lines = [(symbol.name, value) for symbol, value in temporaries]
    lines += zip((name for name, _ in targets), values, strict=True)
    return [(name, _renamed(_guarded(value), renamed)) for name, value in lines]


def _guarded(expression: sp.Expr) -> sp.Expr:
    """x^-n as reciprocal(x^n) and exp as exponential, but of numbers."""
    reciprocal, exponential = (sp.Function(name) for name in HELPERS[:2])
    guarded = expression.replace(
        lambda x: x.is_Pow and x.exp.is_Number and x.exp.is_negative and not x.base.is_Number,
        lambda x: reciprocal(x.base**-x.exp),
    )
    return guarded.replace(lambda x: isinstance(x, sp.exp), lambda x: exponential(x.args[0]))


def _renamed(expression: sp.Expr, renamed: dict[str, str]) -> sp.Expr:
    return expression.xreplace(
        {
            symbol: sp.Symbol(renamed[symbol.name], **symbol.assumptions0)
            for symbol in expression.free_symbols
            if symbol.name in renamed
        }
    )


# --- what every language shares: head and lines -----------------------------------------------------------------------


def head_lines(note: tuple[str, ...], usage: str, width: int) -> list[str]:
    """The head's text in lines of at most `width` characters; `note` as of `SampledLaw`, `usage` for a language."""
    paragraphs = (
        "Adaptive sliding-mode slip controller, sampled. Generated by `railslip derive`: do not edit.",
        "",
        f"Law: [Park2008] (45), (49), derived and sampled by railslip_ctrl {__version__}",
        f"from sources of SHA-256 {sources_hash()}.",
        *note,
        "",
        "Units: SI throughout (m, kg, s, N, rad), those of each number beside it.",
        "",
        "Conditions that do NOT hold for this law, with the published vehicle, gains and disturbances (railslip verify "
        "tells why, and decides them for other numbers):",
    )
    paragraphs += (*(f"- {name}" for name in NOT_HOLDING), "", usage)
    return [line for one in paragraphs for line in (textwrap.wrap(one, width) or [""])]


def commented(line: str, comment: str) -> list[str]:
    """A line with its comment behind it, or before it where that is too long."""
    both = f"{line} {comment}"
    return [both] if len(both) <= WIDTH else ["    " + comment, line]


def short(line: str, width: int = WIDTH) -> list[str]:
    """A line of code in lines of `width`, broken at blanks, before an operator; from the second on indented farther."""
    indent = line[: len(line) - len(line.lstrip())]
    if len(line) <= width:
        return [line]
    spaced = re.sub(r"(?<=[\w)])([*/])(?=[\w(])", r" \1 ", line)
    together = re.sub(r" = | [-+*/] |const ", _unbreakable, spaced)
    further = indent + 4 * " "
    lines = textwrap.wrap(together, width, subsequent_indent=further, break_long_words=False, break_on_hyphens=False)
    return [one.replace("\N{NO-BREAK SPACE}", " ") for one in lines]


def _unbreakable(found: re.Match[str]) -> str:
    """An operator stays with what follows it; `=` and `const` with both sides."""
    blank, text = "\N{NO-BREAK SPACE}", found[0]
    return text.replace(" ", blank) if "=" in text or "const" in text else text[:-1] + blank
