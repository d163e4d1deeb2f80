"""The published law in discrete time, as a sequence of assignments that `code` prints as Python.

The sampling period is h. The integral of the slip error e, the filter with time constant tau that estimates v', and the
state of a dynamic adhesion law use backward Euler, which does not oscillate for any h/tau. The estimates theta_hat use
forward Euler, and take effect at the next sample. If `boundary` > 0, sgn s of the sliding variable s is replaced by
s/boundary, limited to -1 .. 1. The torque is limited to torque_min .. torque_max.

A locked wheel is outside the domain of the bristle law, whose state would diverge. Therefore the slip velocity that
drives the adhesion state is limited to +-`DOMAIN_SHARE` times the law's `sigma_limit`. The adhesion state is limited to
+-`state_limit`, which is Fs/alpha. The limits are symmetric because the laws are odd functions.

The parameters of `OPTIONS` belong to the robust variants (`law.LawGains`) and to anti-windup. With their default 0 the
law is that of [Park2008]. Other values change it as follows:

- leak: theta_hat_i' = k_i s phi_i - leak theta_hat_i;
- dead_zone 1: s - boundary sat(s/boundary) drives the adaptation instead of s;
- theta_i_min < theta_i_max: theta_hat_i is limited to this range (projection);
- anti_windup 1: while the torque is at a limit, the estimates are constant. The integral is constant too if e would
  drive the torque farther beyond the limit.

Inputs, states and outputs are limited to +-`LARGEST`, NaN becomes 0, and 1/0 is `LARGEST`^2, so that measurements of
any size give finite numbers. The guard (`controllers.guard`) handles invalid samples and parameters.
"""

from __future__ import annotations

import inspect
from collections.abc import Mapping
from pathlib import Path

import sympy as sp

from railslip_ctrl.core.notation import NOTATION
from railslip_ctrl.core.records import dataclass
from railslip_ctrl.model import plant
from railslip_ctrl.model.adhesion import AdhesionLaw, law_class

from .derivation import Derivation
from .law import file_hash
from .proof import CODE_NOTATION, SLIDING_NOTATION, sliding_symbol

PERIOD, FILTER = sp.Symbol("period", positive=True), sp.Symbol("filter_time", positive=True)
SWITCHING = sp.Symbol("switching", real=True)  #: switching function: sgn s, or its saturated form
LIMITED = sp.Function("limited")  #: limited(x, limit): x limited to -limit .. limit
DOMAIN_SHARE = 0.999  #: largest |sigma| as a ratio to a law's `sigma_limit`; the bristle force is then still Fs/1000

_V_FILTERED = sp.Symbol("v_filtered", real=True)
_DRIVE, _BOUNDARY = sp.Symbol("drive", real=True), sp.Symbol("boundary", nonnegative=True)
_LEAK, _DEAD_ZONE = sp.Symbol("leak", nonnegative=True), sp.Symbol("dead_zone", nonnegative=True)

LARGEST = 1e12  #: limit of numbers in the generated code, SI: far above a train's values, and products do not overflow

EXPLAINED = ("from_adhesion", "from_friction", "s_drift", "Ueq", "Ur", "drive", "z_decay", "z_limit")
"""Intermediate values that have a comment in the generated code."""

_LIMITS = ("boundary", "torque_min", "torque_max", "period")
OPTIONS = ("leak", "dead_zone", "theta1_min", "theta1_max", "theta2_min", "theta2_max", "anti_windup")
"""Optional parameters; with their default 0 the law is that of [Park2008]."""

_MAY_BE_ZERO = ("Bn", "K", "k1", "k2", "boundary", "leak", "dead_zone", "anti_windup")
RULES: Mapping[str, tuple[str, ...]] = {
    **dict.fromkeys(_MAY_BE_ZERO, (">= 0.0",)),
    **{f"theta{i}_{side}": () for i in (1, 2) for side in ("min", "max")},
    "lambda_d": ("> 0.0", "< 1.0"),
    "torque_min": ("<= 0.0",),
}
"""Bounds of parameters. A parameter that is not listed must be > 0."""

_SIGNS = (("gt", ">"), ("ge", ">="), ("lt", "<"), ("le", "<="))
PREFIX = "adhesion_"  #: prefix of the names of an adhesion law's parameters
Assignment = tuple[str, sp.Expr]


@dataclass(frozen=True)
class SampledLaw:
    """The law as a sequence of assignments, independent of a programming language.

    - measured: arguments of a step: v, omega, and Ta if no adhesion law computes it.
    - parameters: names of the parameters in order, the `OPTIONS` last.
    - states: names of the states in order; `v_filtered` starts at v, the others at 0.
    - rules: bounds of every parameter, as in `RULES`.
    - meanings: meaning and unit of the adhesion law's parameters.
    - prepare: assignments that come before the law: e, v_rate, Ta and the new values of the states.
    - surface: expression of the sliding variable s.
    - control: assignments of the torque and of the adaptation rates; the symbol `SWITCHING` replaces sgn s.
    - control_arguments: arguments, besides the parameters, of the function `control`, which computes the torque.
    - note: paragraphs that say where Ta comes from.
    """

    measured: tuple[str, ...]
    parameters: tuple[str, ...]
    rules: Mapping[str, tuple[str, ...]]
    meanings: Mapping[str, str]
    states: tuple[str, ...]
    prepare: tuple[Assignment, ...]
    surface: sp.Expr
    control: tuple[Assignment, ...]
    control_arguments: tuple[str, ...]
    note: tuple[str, ...]

    def meaning(self, name: str) -> str:
        """Return meaning and unit of a parameter, of a state, or of an intermediate value that `EXPLAINED` lists."""
        if name in CODE_NOTATION:
            unit, text = CODE_NOTATION[name]
            return f"{text}, {unit}"
        if name in self.meanings:
            return self.meanings[name]
        entry = SLIDING_NOTATION.get(name) or NOTATION[name]
        return f"{entry.meaning}, {entry.unit}"


def sampled_law(derivation: Derivation) -> SampledLaw:
    """Return a derived law in discrete time, with integrals and filters as difference equations."""
    error = derivation.error.subs(plant.sigma, plant.SLIP_VELOCITY.rhs)
    s, e, integral = (sliding_symbol(name) for name in ("s", "e", "e_integral"))
    prepare: list[Assignment] = [("e", error), ("e_integral", _backward_euler(integral, e))]
    states = ["e_integral"]
    if plant.v_rate in derivation.adaptive_law_control.free_symbols:
        low_pass = (plant.v - _V_FILTERED) / FILTER  # v_filtered', which is also v filtered by s/(filter_time s + 1)
        prepare += [("v_filtered", _backward_euler(_V_FILTERED, low_pass)), ("v_rate", low_pass)]
        states.append("v_filtered")
    law = None if derivation.adhesion is None else law_class(derivation.adhesion)
    note: tuple[str, ...] = ("Ta is an argument: an estimate by an observer or a model.",)
    own_rules, meanings, measured = dict[str, tuple[str, ...]](), dict[str, str](), ["v", "omega"]
    if law is not None and derivation.adhesion_torque is not None and not law.statement().functions:
        states += ["z"] if law.has_state else []
        prepare += _adhesion(law, derivation.adhesion_torque, derivation.adhesion_state_rate)
        note = _origin(law)
        for name, unit in law.units().items():  # meaning and unit of the law's fields, and their bounds
            meanings[PREFIX + name] = f"{law.model_fields[name].description}, {unit}"
            bounds = (
                (sign, getattr(one, key, None)) for one in law.model_fields[name].metadata for key, sign in _SIGNS
            )
            own_rules[PREFIX + name] = tuple(f"{sign} {float(bound)!r}" for sign, bound in bounds if bound is not None)
    else:
        measured.append("Ta")
        if law is not None:
            closed = f"the adhesion law {law.name!r} has no closed form; evaluate it outside."
            note = (f"Ta is an argument: {closed}",)
    rates = (
        (f"theta{i}_hat_rate", rate.subs(s, _DRIVE) - _LEAK * sliding_symbol(f"theta{i}_hat"))
        for i, rate in enumerate(derivation.adaptation_matrix, 1)
    )
    control = (*_torque(derivation), ("drive", s - _DEAD_ZONE * _BOUNDARY * SWITCHING), *rates)
    used = set().union(*(one.free_symbols for _, one in (*prepare, *control))) | derivation.s.free_symbols
    names = {str(symbol) for symbol in used}
    order = ("J", "r", "Mn", "Bn", "lambda_d", "sigma_d", "rho", "D", "K", "k1", "k2", "filter_time", "N")
    adhesion = sorted(name for name in names - {name for name, _ in prepare} if name.startswith(PREFIX))
    parameters = (*(name for name in order if name in names), *adhesion, *_LIMITS, *OPTIONS)
    arguments = ("e", "e_integral", "omega", "Ta", "v_rate", "theta1_hat", "theta2_hat")
    return SampledLaw(
        measured=tuple(measured),
        parameters=parameters,
        rules={name: own_rules.get(name, RULES.get(name, ("> 0.0",))) for name in parameters},
        meanings=meanings,
        states=("s", *states, "theta1_hat", "theta2_hat"),
        prepare=tuple(prepare),
        surface=derivation.s,
        control=control,
        control_arguments=tuple(name for name in arguments if name != "v_rate" or plant.v_rate in used),
        note=note,
    )


def _torque(derivation: Derivation) -> tuple[Assignment, ...]:
    equivalent = derivation.adaptive_law_control - derivation.robust_term
    drift = equivalent * plant.r / plant.J
    parts = {
        name: sum(term for term in drift.args if symbol in term.free_symbols)
        for name, symbol in (("from_adhesion", plant.Ta), ("from_friction", plant.omega))
    }
    own = {part: sp.Symbol(name, real=True) for name, part in parts.items()}
    s_drift, Ueq, Ur = sp.Symbol("s_drift", real=True), sliding_symbol("Ueq"), sliding_symbol("Ur")
    return (
        *parts.items(),
        ("s_drift", drift.subs(own)),
        ("Ueq", equivalent.subs(drift, s_drift)),
        ("Ur", derivation.robust_term.replace(sp.sign, lambda _: SWITCHING)),
        ("torque", Ueq + Ur),
    )


def _adhesion(law: type[AdhesionLaw], torque: sp.Expr, state_rate: sp.Expr | None) -> list[Assignment]:
    statement = law.statement()
    renamed = {symbol: sp.Symbol(PREFIX + symbol.name, **symbol.assumptions0) for symbol in law.symbols()}
    named: dict[sp.Expr, sp.Symbol] = {}
    before: list[Assignment] = []
    after: list[Assignment] = []

    def shown(expression: sp.Expr) -> sp.Expr:
        for part, symbol in reversed(named.items()):
            number, rest = part.as_coeff_Mul()  # so that multiples of the part are found too
            expression = expression.subs({rest: symbol / number, sp.Abs(rest): sp.Abs(symbol) / abs(number)})
        return expression.xreplace(renamed)

    for name, part in statement.parts.items():
        (after if plant.z in part.free_symbols else before).append((PREFIX + name, shown(part)))
        named[part] = sp.Symbol(PREFIX + name, real=True)
    sigma: list[Assignment] = [("sigma", plant.SLIP_VELOCITY.rhs)]
    if statement.sigma_limit is not None:
        sigma.append(("sigma", LIMITED(plant.sigma, DOMAIN_SHARE * shown(statement.sigma_limit))))
    state: list[Assignment] = []
    if state_rate is not None:
        # z' is linear in z for every law here, so the implicit step is solved for z
        decay = sp.Symbol("z_decay", real=True)
        slope = sp.diff(state_rate, plant.z)
        rate = state_rate.subs(plant.z, 0) - decay * plant.z
        state = [("z_decay", shown(-slope)), ("z", _backward_euler(plant.z, rate))]
    if statement.state_limit is not None:
        limit = sp.Symbol("z_limit", real=True)
        state += [("z_limit", shown(statement.state_limit)), ("z", LIMITED(plant.z, limit))]
    return [*sigma, *before, *state, *after, ("Ta", shown(torque))]


def _origin(law: type[AdhesionLaw]) -> tuple[str, ...]:
    path, statement = Path(inspect.getfile(law)), law.statement()
    limits = []
    if statement.sigma_limit is not None:
        limits.append(f"the slip velocity in the law is limited to +-{DOMAIN_SHARE:g} {statement.sigma_limit}")
    if statement.state_limit is not None:
        limits.append(f"the adhesion state z is limited to +-{statement.state_limit}")
    return (
        f"Ta comes from the adhesion law {law.name!r} at the measured slip velocity, inside its domain:",
        f"{path.name}, SHA-256 {file_hash(path)}.",
        *([f"So that the law does not diverge if the wheel locks, {' and '.join(limits)}."] if limits else []),
    )


def _backward_euler(state: sp.Symbol, rate: sp.Expr) -> sp.Expr:
    # solution of x_new = x + h rate(x_new) for a rate that is linear in the state
    slope = sp.diff(rate, state)
    constant = rate.subs(state, 0)
    return (state + PERIOD * constant) / (1 - PERIOD * slope)
