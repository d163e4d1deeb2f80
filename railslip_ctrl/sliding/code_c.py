"""The sampled law as C99 source: no allocation, no recursion, no loop, so the time of a step is bounded."""

from __future__ import annotations

import textwrap

import sympy as sp
from sympy.printing.c import C99CodePrinter

from .code_python import HELPERS, WIDTH, ProductPowers, commented, common_parts, head_lines, short, started
from .law import HOLD_TIME, KEPT
from .sampled_law import EXPLAINED, LARGEST, LIMITED, OPTIONS, Assignment, SampledLaw


class _CPrinter(ProductPowers, C99CodePrinter):  # type: ignore[misc]
    """C99 has no M_PI."""

    def _print_Pi(self, expression: sp.Expr) -> str:
        return "3.14159265358979324"


_USAGE = (
    "C99: no allocation, no recursion, no loop. railslip_asmc_init once for every braking, then railslip_asmc_step "
    "every period. A sample with a measurement that is not finite is left out: the last command is held for "
    f"{HOLD_TIME:g} s, then the brake is released, a torque of 0, until the next valid sample; railslip_asmc_valid "
    f"tells beforehand. Parameters that an initialiser leaves out are 0: of {OPTIONS[0]} to {OPTIONS[-1]} that is the "
    "paper's law."
)

_HEAD = f"""{{head}}
#include <math.h>

/* s, for which the last command is held without a valid sample. */
#define RAILSLIP_ASMC_HOLD_TIME {HOLD_TIME!r}
"""

_SWITCHING = """
/* sgn s, or s/boundary held to -1 .. 1. */
static double railslip_asmc_switching(double s, double boundary)
{
    if (boundary > 0.0) {
        return fmin(fmax(s / boundary, -1.0), 1.0);
    }
    return (double)((s > 0.0) - (s < 0.0));
}
"""

_BOUNDED = f"""
/* x held to -{LARGEST:.0e} .. {LARGEST:.0e}; 0 for what is no number. */
static double railslip_asmc_bounded(double x)
{{
    if (x != x) {{
        return 0.0;
    }}
    return fmin(fmax(x, -{LARGEST:.1e}), {LARGEST:.1e});
}}
"""

_OPTIONAL = {
    "reciprocal": f"""
/* 1/x; {LARGEST**2:.0e} for 0. */
static double railslip_asmc_reciprocal(double x)
{{
    return x != 0.0 ? 1.0 / x : {LARGEST**2:.1e};
}}
""",
    "exponential": """
/* exp(x), held below what overflows. */
static double railslip_asmc_exponential(double x)
{
    return x < 700.0 ? exp(x) : exp(700.0);
}
""",
    "limited": """
/* x held to -limit .. limit. */
static double railslip_asmc_limited(double x, double limit)
{
    if (x > limit) {
        return limit;
    }
    return x < -limit ? -limit : x;
}
""",
}

_RESULTS = ("torque", "s", "theta1_hat_rate", "theta2_hat_rate")

_OUTPUT = """
typedef struct {
    double torque; /* N*m */
    double s; /* m/s */
    double theta1_hat_rate; /* 1/(kg*m*s) */
    double theta2_hat_rate; /* m/s^2 */
} railslip_asmc_output;
"""


def c_source(law: SampledLaw) -> str:
    """A translation unit with the types railslip_asmc_* and the functions _init, _control, _valid and _step."""
    functions = [_control(law), _valid(law), _step(law)]
    parts = [
        _HEAD.format(head="\n".join(_comment(head_lines(law.note, _USAGE, WIDTH - 6)))),
        _record(law, "parameters", law.parameters),
        _record(law, "state", (*law.states, *KEPT)),
        _OUTPUT,
        "\n" + "".join("\n".join(short(f"{one};")) + "\n" for one in _signatures(law).values()),
        _SWITCHING,
        _BOUNDED,
        *(text for name, text in _OPTIONAL.items() if any(f"{name}(" in function for function in functions)),
        _init(law),
        *functions,
    ]
    return "".join(parts)


def _comment(lines: list[str]) -> list[str]:
    return ["/* " + "\n * ".join(lines).replace("* \n", "*\n") + " */"]


def _signatures(law: SampledLaw) -> dict[str, str]:
    """What stands before the body of each function that is called from outside."""
    control, measured = (
        ", ".join(f"double {name}" for name in names) for names in (law.control_arguments, law.measured)
    )
    p, state = "const railslip_asmc_parameters *p", "railslip_asmc_state *state"
    return {
        "init": f"int railslip_asmc_init({state}, double v, {p})",
        "valid": f"int railslip_asmc_valid({measured})",
        "control": f"railslip_asmc_output railslip_asmc_control({control}, {p})",
        "step": f"railslip_asmc_output railslip_asmc_step({state}, {measured}, {p})",
    }


def _function(law: SampledLaw, name: str, about: str, body: list[str]) -> str:
    lines = [*_comment(textwrap.wrap(about, WIDTH - 6)), *short(_signatures(law)[name]), "{", *body, "}"]
    return "\n" + "\n".join(lines) + "\n"


def _record(law: SampledLaw, name: str, fields: tuple[str, ...]) -> str:
    lines = [line for field in fields for line in commented(f"    double {field};", f"/* {law.meaning(field)} */")]
    return "\n" + "\n".join(["typedef struct {", *lines, f"}} railslip_asmc_{name};"]) + "\n"


def _init(law: SampledLaw) -> str:
    refused = ["/* The code of railslip_asmc_init. */"]
    refused += ["static int railslip_asmc_refused(double v, const railslip_asmc_parameters *p)", "{"]
    for code, (name, rule) in enumerate((*law.rules.items(), ("v", ())), 1):
        value = name if name == "v" else f"p->{name}"
        asked = " && ".join((f"isfinite({value})", *(one.format(value) for one in rule)))
        refused += [f"    if (!({asked})) {{", f"        return {code};", "    }"]
    refused += ["    return 0;", "}"]
    about = (
        "0 when the brake is applied at speed v, m/s. A parameter not finite or out of its bounds is "
        "refused: then its place in railslip_asmc_parameters, from 1 on, one more for v; railslip_asmc_step then "
        "keeps the brake released, as it does with a state of zeros."
    )
    values = (value.replace("bounded", "railslip_asmc_bounded") for value in started(law))
    body = [
        "    const int code = railslip_asmc_refused(v, p);",
        *(f"    state->{name} = {value};" for name, value in zip((*law.states, *KEPT), values, strict=False)),
        f"    state->{KEPT[-1]} = code == 0;",
        "    return code;",
    ]
    return "\n" + "\n".join(refused) + "\n" + _function(law, "init", about, body)


def _control(law: SampledLaw) -> str:
    body = [
        "    railslip_asmc_output out;",
        *_held(law.control_arguments),
        *_assignments([("s", law.surface)], law),
        "    const double switching_ = railslip_asmc_switching(s, p->boundary);",
        *(line for one in law.control for line in _assignments([one], law)),
        *(f"    out.{name} = railslip_asmc_bounded({name});" for name in _RESULTS),
        "    return out;",
    ]
    return _function(law, "control", "The continuous law.", body)


def _valid(law: SampledLaw) -> str:
    body = [f"    return {' && '.join(f'isfinite({name})' for name in law.measured)};"]
    return _function(law, "valid", "1 where every measurement is finite, else 0: such a sample is left out.", body)


def _step(law: SampledLaw) -> str:
    carried = [name for name in law.states if not name.startswith("theta")]
    call = ", ".join(f"state->{name}" if name.startswith("theta") else name for name in law.control_arguments)
    lines = [
        "    railslip_asmc_output out = {0.0, 0.0, 0.0, 0.0};",
        "    if (state->ready != 1.0) {",
        "        return out;",
        "    }",
        f"    if (!railslip_asmc_valid({', '.join(law.measured)})) {{",
        "        out.torque = state->missing < RAILSLIP_ASMC_HOLD_TIME ? state->command : 0.0;",
        "        state->command = out.torque;",
        "        state->missing += p->period;",
        "        return out;",
        "    }",
        *_held(law.measured),
        *(f"    double {name} = state->{name};" for name in carried),
        *_prepared(law, carried),
        *short(f"    out = railslip_asmc_control({call}, p);"),
        "    const double command = fmin(fmax(out.torque, p->torque_min), p->torque_max);",
        "    if (p->anti_windup > 0.0 && command != out.torque) {",
        "        out.theta1_hat_rate = out.theta2_hat_rate = 0.0;",
        "        if ((out.torque - command) * e > 0.0) {",
        "            e_integral = state->e_integral;",
        "        }",
        "    }",
        "    out.torque = command;",
        "    state->command = command;",
        "    state->missing = 0.0;",
        *(f"    state->{name} = {name};" for name in carried),
    ]
    for i in (1, 2):
        name = f"state->theta{i}_hat"
        lines += [
            f"    {name} = railslip_asmc_bounded({name} + p->period * out.theta{i}_hat_rate);",
            f"    if (p->theta{i}_min < p->theta{i}_max) {{",
            f"        {name} = fmin(fmax({name}, p->theta{i}_min), p->theta{i}_max);",
            "    }",
        ]
    about = "One sample: the command, N*m; s and the rates are 0 where the sample is left out."
    return _function(law, "step", about, [*lines, "    return out;"])


def _held(names: tuple[str, ...]) -> list[str]:
    return [f"    {name} = railslip_asmc_bounded({name});" for name in names]


def _prepared(law: SampledLaw, carried: list[str]) -> list[str]:
    lines, known = [], set(carried)
    for name, value in law.prepare:
        lines += _assignments([(name, value)], law, declare=name not in known)
        if name in carried and value.func is not LIMITED:
            lines += _held((name,))
        known.add(name)
    return lines


def _assignments(targets: list[Assignment], law: SampledLaw, *, declare: bool = True) -> list[str]:
    printer = _CPrinter({"user_functions": {name: f"railslip_asmc_{name}" for name in HELPERS}})
    own = {name for name, _ in targets}
    again = {name for name, value in law.prepare if value.func is LIMITED}
    lines = [f"    /* {law.meaning(name)} */" for name, _ in targets if name in EXPLAINED]
    for name, value in common_parts(targets, {parameter: f"p->{parameter}" for parameter in law.parameters}):
        kind = "" if name in own and not declare else "double " if name in again else "const double "
        text = " ".join(printer.doprint(value).split())  # a case distinction is printed in several lines
        lines += short(f"    {kind}{name} = {text};")
    return lines
