"""The derived law sampled: assignments in order, which `code` prints as programs.

Sampling, with period h: the integral of e and the filter s/(tau s + 1) that estimates v' by backward Euler (it cannot
ring, whatever h/tau is), the adhesion state of a dynamic law too; the estimates theta_hat by forward Euler, used from
the next sample on. Each update is solved from its differential equation. sgn s is s/boundary, held to -1 .. 1, where
`boundary` > 0. The torque is held to torque_min .. torque_max.

The parameters of `OPTIONS` are the robust variants' (`gains.LawGains`; see `gains.gain_parameters`) and anti-windup; at
their default 0 the law is the paper's:

- leak: theta_hat_i' = k_i s phi_i - leak theta_hat_i;
- dead_zone 1: the adaptation is driven by s - boundary sat(s/boundary) in place of s;
- theta_i_min < theta_i_max: theta_hat_i is held between them (projection);
- anti_windup 1: while the torque is at a limit the estimates rest, and so does the integral where e would drive the
  torque, which grows with s, farther beyond the limit.

Defined for every measurement: one that is not finite is a sample left out (state unchanged, s = 0, a torque of 0 held
to its limits), which `valid` tells the caller beforehand. What is measured, kept or put out is held to +-`LARGEST`, no
number becomes 0, the inverse of 0 is `LARGEST`^2, of parameters too. So finite measurements of any size give finite
numbers, the same in Python and C.
"""

from __future__ import annotations

from dataclasses import dataclass

import sympy as sp

from railslip_ctrl import plant
from railslip_ctrl.adhesion import law_class
from railslip_ctrl.notation import NOTATION

from .derivation import Derivation
from .symbols import SLIDING_NOTATION, sliding_symbol

PERIOD, FILTER = sp.Symbol("period", positive=True), sp.Symbol("filter_time", positive=True)
SWITCHING = sp.Symbol("switching", real=True)
"""What stands for sgn s."""

_V_FILTERED = sp.Symbol("v_filtered", real=True)
_DRIVE, _BOUNDARY = sp.Symbol("drive", real=True), sp.Symbol("boundary", nonnegative=True)
_LEAK, _DEAD_ZONE = sp.Symbol("leak", nonnegative=True), sp.Symbol("dead_zone", nonnegative=True)

LARGEST = 1e12
"""What numbers of the generated code are held to, SI: far beyond a train's, far from overflow in products of them."""

_OWN_MEANINGS = {
    "period": ("s", "sampling period, > 0"),
    "filter_time": ("s", "time constant of the filter of v', > 0"),
    "boundary": ("m/s", "half width of the boundary layer; 0: sgn"),
    "torque_min": ("N*m", "least torque"),
    "torque_max": ("N*m", "largest torque"),
    "v_filtered": ("m/s", "state of the filter of v'"),
    "leak": ("1/s", "rate at which the estimates leak; 0: none"),
    "dead_zone": ("1", "1: the adaptation rests within the boundary layer; 0: it does not"),
    "theta1_min": ("1/(kg*m)", "least theta1_hat, in force where below the largest"),
    "theta1_max": ("1/(kg*m)", "largest theta1_hat"),
    "theta2_min": ("m/s", "least theta2_hat, in force where below the largest"),
    "theta2_max": ("m/s", "largest theta2_hat"),
    "anti_windup": ("1", "1: integral and estimates rest while the torque is at a limit; 0: they do not"),
}
_LIMITS = ("boundary", "torque_min", "torque_max", "period")
OPTIONS = ("leak", "dead_zone", "theta1_min", "theta1_max", "theta2_min", "theta2_max", "anti_windup")
"""Parameters that have a default, 0: with it the law is the paper's."""

PREFIX = "adhesion_"
"""Before the names of an adhesion law's parameters."""

Assignment = tuple[str, sp.Expr]


@dataclass(frozen=True)
class SampledLaw:
    """The law as assignments in order, before it is printed in a language.

    Attributes
    ----------
    measured : tuple of str
        Arguments of a step: v, omega, and Ta where no adhesion law is put in.
    parameters, states : tuple of str
        Names, in order, the `OPTIONS` last. A state starts at 0, `v_filtered` at v.
    prepare : tuple of assignments
        From measured values and states to e, e_integral, v_rate, Ta; what is a state is its new value.
    surface : Expr
        s.
    control : tuple of assignments
        torque, drive (what stands for s in the adaptation), theta1_hat_rate, theta2_hat_rate; `SWITCHING` for sgn s.
    control_arguments : tuple of str
        What the continuous law is a function of, besides the parameters.
    note : str
        What the reader must know of Ta.
    """

    measured: tuple[str, ...]
    parameters: tuple[str, ...]
    states: tuple[str, ...]
    prepare: tuple[Assignment, ...]
    surface: sp.Expr
    control: tuple[Assignment, ...]
    control_arguments: tuple[str, ...]
    note: str


def sampled_law(derivation: Derivation) -> SampledLaw:
    """The derivation's law with its integrals and filters made discrete."""
    own = _own_expressions(derivation)
    torque = derivation.adaptive_law_control.replace(sp.sign, lambda _: SWITCHING)
    s = sliding_symbol("s")
    rates = (
        (f"theta{i}_hat_rate", rate.subs(s, _DRIVE) - _LEAK * sliding_symbol(f"theta{i}_hat"))
        for i, rate in enumerate(derivation.adaptation_matrix, 1)
    )
    control = (("torque", torque), ("drive", s - _DEAD_ZONE * _BOUNDARY * SWITCHING), *rates)
    used = set().union(*(e.free_symbols for _, e in (*own.prepare, *control))) | derivation.s.free_symbols
    names = {str(symbol) for symbol in used}
    order = ("J", "r", "Mn", "Bn", "lambda_d", "sigma_d", "rho", "D", "K", "k1", "k2", "filter_time", "N")
    plain = tuple(name for name in order if name in names)
    adhesion = tuple(sorted(name for name in names if name.startswith(PREFIX)))
    arguments = ("e", "e_integral", "omega", "Ta", "v_rate", "theta1_hat", "theta2_hat")
    return SampledLaw(
        measured=("v", "omega") if own.has_torque else ("v", "omega", "Ta"),
        parameters=(*plain, *adhesion, *_LIMITS, *OPTIONS),
        states=(*own.states, "theta1_hat", "theta2_hat"),
        prepare=own.prepare,
        surface=derivation.s,
        control=control,
        control_arguments=tuple(name for name in arguments if name != "v_rate" or plant.v_rate in torque.free_symbols),
        note=own.note,
    )


@dataclass(frozen=True)
class _Own:
    prepare: tuple[Assignment, ...]
    states: tuple[str, ...]
    has_torque: bool
    note: str


def _own_expressions(derivation: Derivation) -> _Own:
    """Assignments up to what the continuous law takes."""
    sigma = plant.SLIP_VELOCITY.rhs
    error = derivation.error.subs(plant.sigma, sigma)
    e, integral = sliding_symbol("e"), sliding_symbol("e_integral")
    prepare: list[Assignment] = [("e", error), ("e_integral", _backward_euler(integral, e))]
    states = ["e_integral"]
    if plant.v_rate in derivation.adaptive_law_control.free_symbols:
        low_pass = (plant.v - _V_FILTERED) / FILTER  # v_filtered' ; it is also v' seen through s/(filter_time s + 1)
        prepare += [("v_filtered", _backward_euler(_V_FILTERED, low_pass)), ("v_rate", low_pass)]
        states.append("v_filtered")
    if derivation.adhesion is None or derivation.adhesion_torque is None:
        return _Own(tuple(prepare), tuple(states), False, "Ta is an argument: an observer's or a model's estimate.")
    law = law_class(derivation.adhesion)
    if law.statement().functions:
        note = f"Ta is an argument: the adhesion law {law.name!r} has no closed form; evaluate it outside."
        return _Own(tuple(prepare), tuple(states), False, note)
    renamed = {symbol: sp.Symbol(PREFIX + symbol.name, **symbol.assumptions0) for symbol in law.symbols()}
    if derivation.adhesion_state_rate is not None:
        # the slip velocity of the moment; z' is linear in z for every law here, so the implicit step is solved for z
        rate = derivation.adhesion_state_rate.xreplace(renamed)
        prepare += [("sigma", sigma), ("z", _backward_euler(plant.z, rate))]
        states.append("z")
    else:
        prepare.append(("sigma", sigma))
    torque = derivation.adhesion_torque.xreplace(renamed)
    note = f"Ta comes from the adhesion law {law.name!r} at the measured slip velocity, inside its domain."
    return _Own((*prepare, ("Ta", torque)), tuple(states), True, note)


def _backward_euler(state: sp.Symbol, rate: sp.Expr) -> sp.Expr:
    """The new value of a state: x_new = x + h rate(x_new), solved; the rate must be linear in the state."""
    slope = sp.diff(rate, state)
    constant = rate.subs(state, 0)
    return (state + PERIOD * constant) / (1 - PERIOD * slope)


def meaning(name: str) -> str:
    """Unit and meaning of a parameter, state or argument."""
    if name in _OWN_MEANINGS:
        unit, text = _OWN_MEANINGS[name]
        return f"{text}, {unit}"
    if name.startswith(PREFIX):
        return f"{name.removeprefix(PREFIX)} of the adhesion law, SI"
    entry = SLIDING_NOTATION.get(name) or NOTATION[name]
    return f"{entry.meaning}, {entry.unit}"
