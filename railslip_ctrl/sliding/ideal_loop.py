"""The loop the proof is about, simulated: the derived law acting at once on the plant, without the actuator.

The law is the generated one (`code.python_law`), its `control` called for each run. The torque is computed once a step
and held; the plant is integrated by Heun's method; runs that differ by their seed
are integrated together. A relay's s chatters within (one step) * K0 of zero.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from itertools import repeat
from types import ModuleType
from typing import Any

import numpy as np
import sympy as sp
from numpy.typing import NDArray

from railslip_ctrl import plant
from railslip_ctrl.adhesion import AdhesionLaw, published_law
from railslip_ctrl.errors import DomainError
from railslip_ctrl.numeric import NumericPlant, numeric_plant, plant_parameters
from railslip_ctrl.parameters import INITIAL_SPEED_KMH, Rail, Resistance, Vehicle
from railslip_ctrl.units import KMH

from .code import generate, python_law
from .derivation import derive
from .gains import LawGains, gain_parameters
from .reaching_bound import ADHESION_NOISE, TORQUE_DECAY, TORQUE_FRACTION, TORQUE_FREQUENCY
from .symbols import sliding_symbol

Floats = NDArray[np.float64]

STEP = 0.002  # s
END_SPEED = 5.0 * KMH  # the stop ends here ([Park2008] p. 56)
_NOISE_HELD = 0.02  # s, for which a value of the random adhesion force lasts


@dataclass(frozen=True)
class Disturbances:
    """What acts on a run.

    Attributes
    ----------
    random_force : float
        Standard deviation of the random adhesion force, N, cut at three of them; a value lasts 0.02 s.
    torque : bool
        Td = 0.05 Tb exp(-4t) sin(10 pi t).
    resistance : bool
        The vehicle's travelling resistance.
    slip_noise : float
        Standard deviation of the noise on the measured slip velocity, m/s, white over the steps.
    """

    random_force: float = 0.0
    torque: bool = False
    resistance: bool = False
    slip_noise: float = 0.0


UNDISTURBED = Disturbances()
PUBLISHED = Disturbances(random_force=ADHESION_NOISE, torque=True, resistance=True)
"""The published run's."""


@dataclass(frozen=True)
class IdealRun:
    """Signals of the runs, arrays (steps, seeds); NaN after the end of a stop.

    time (s, steps only), speed, sigma, s (m/s, s as measured), V (m^2/s^2; NaN without adaptation gains), theta_hat
    (steps, seeds, 2), disturbance: (J/r) d (N*m), torque (N*m); theta: true values at the end, (2,).
    """

    time: Floats
    speed: Floats
    sigma: Floats
    s: Floats
    V: Floats
    theta_hat: Floats
    disturbance: Floats
    torque: Floats
    theta: Floats


def simulate(
    vehicle: Vehicle,
    gains: LawGains,
    *,
    duration: float,
    nominal: Vehicle | None = None,
    rail: Rail = Rail.DRY,
    disturbances: Disturbances = UNDISTURBED,
    seeds: Sequence[int] = (0,),
    held_speed: float | None = None,
    start_estimate: tuple[float, float] = (0.0, 0.0),
    change: tuple[float, Vehicle] | None = None,
) -> IdealRun:
    """Runs on the bristle model for `duration` seconds, or until 5 km/h.

    The law has the parameters of `nominal` (left out: of `vehicle`). A run starts free rolling at 100 km/h; with
    `held_speed`, m/s, v stays there (v' = 0 for wheel and law) and the run starts at the reference slip, at rest.
    `change`: a time, s, from which on the vehicle is another; V then counts theta_hat against that one's theta.
    DomainError where a run diverges beyond the slip the bristle model holds for.
    """
    law = published_law("bristle", rail, wheel_load=vehicle.wheel_load)
    if not disturbances.resistance:
        none = {"resistance": Resistance()}
        vehicle = vehicle.model_copy(update=none)
        change = change and (change[0], change[1].model_copy(update=none))
    loop = _Loop(vehicle, nominal or vehicle, gains, law, rail, disturbances, held_speed, len(seeds))
    steps = round(duration / STEP)
    force, noise = _random(disturbances, seeds, steps)
    start_speed = held_speed if held_speed is not None else INITIAL_SPEED_KMH * KMH
    state = loop.start(start_speed, start_estimate)
    rows = []
    with np.errstate(over="raise", divide="raise", invalid="raise"):  # a run that leaves the range of doubles
        for i in range(steps):
            if change is not None and i == round(change[0] / STEP):
                loop.exchange(change[1])
            _check_slip(law, start_speed, state.sigma)
            rows.append(loop.step(i * STEP, state, force[i // round(_NOISE_HELD / STEP)], noise[i]))
            if not np.any(loop.running(state)):
                break
    return _run(np.array(rows, dtype=np.float64), loop.theta)


def _check_slip(law: AdhesionLaw, speed: float, sigma: Floats) -> None:
    """DomainError where a diverging run has left the law's domain, whose end in slip velocity does not move with v."""
    limit = law.domain_limit(speed)[0] * speed
    if not np.all(np.abs(sigma) < limit):
        raise DomainError(
            f"slip velocity: {np.max(np.abs(sigma)):.4g} m/s in the ideal loop is outside the domain of adhesion "
            f"{law.name!r}, {limit:.4g} m/s; give smaller gains"
        )


def _random(disturbances: Disturbances, seeds: Sequence[int], steps: int) -> tuple[Floats, Floats]:
    """Random forces, N, and slip noise, m/s: one column a seed, each with a generator of its own."""
    held = steps // round(_NOISE_HELD / STEP) + 1
    force, noise = np.empty((held, len(seeds))), np.empty((steps, len(seeds)))
    for column, seed in enumerate(seeds):
        generator = np.random.default_rng(seed)
        force[:, column] = disturbances.random_force * np.clip(generator.standard_normal(held), -3.0, 3.0)
        noise[:, column] = disturbances.slip_noise * generator.standard_normal(steps)
    return force, noise


def _run(rows: Floats, theta: Floats) -> IdealRun:
    time = np.asarray(STEP * np.arange(len(rows)), dtype=np.float64)
    speed, sigma, s, V, theta1, theta2, disturbance, torque = rows.transpose(1, 0, 2)
    return IdealRun(time, speed, sigma, s, V, np.stack((theta1, theta2), axis=-1), disturbance, torque, theta)


@dataclass
class _State:
    v: Floats
    sigma: Floats
    z: Floats
    e_integral: Floats
    theta_hat: Floats  # (2, seeds)


class _Loop:
    """The closed loop of one batch."""

    def __init__(
        self,
        vehicle: Vehicle,
        nominal: Vehicle,
        gains: LawGains,
        law: AdhesionLaw,
        rail: Rail,
        disturbances: Disturbances,
        held_speed: float | None,
        size: int,
    ) -> None:
        slip = law.reference_slip(rail)
        assert slip is not None, "the bristle model has a published reference"
        self.gains, self.disturbances, self.slip, self.held, self.size = gains, disturbances, slip, held_speed, size
        self.plant: NumericPlant = numeric_plant(type(law))
        self.law, self.nominal = law, nominal
        self.exchange(vehicle)
        self.law_parameters = law_parameters(
            **gain_parameters(replace(gains, box=None)),  # the box is kept in `_adapt`, as the generated step does
            J=self.J,
            r=self.r,
            Mn=nominal.effective_mass,
            Bn=nominal.effective_viscous_friction,
            lambda_d=slip,
        )
        self.rates = np.array([gains.k1, gains.k2])

    def exchange(self, vehicle: Vehicle) -> None:
        """The vehicle the law acts on; its resistance counts where the run has one."""
        self.p = plant_parameters(self.law, vehicle)
        self.M, self.J, self.r = vehicle.effective_mass, vehicle.effective_inertia, vehicle.wheel.radius
        self.theta = true_theta(vehicle, self.nominal)
        self.resistance = vehicle.resistance

    def start(self, speed: float, estimate: tuple[float, float]) -> _State:
        ones = np.ones(self.size)
        v, sigma = speed * ones, (0.0 if self.held is None else self.slip * speed) * ones
        z = 0.0 * ones if self.held is None else self.plant.rest_state(v, sigma, 0.0, 0.0, 0.0, 0.0, self.p) * ones
        return _State(v, sigma, z, 0.0 * ones, np.outer(np.array(estimate), ones))

    def running(self, state: _State) -> Any:
        return state.v > END_SPEED

    def step(self, t: float, state: _State, force: Floats, noise: Floats) -> Floats:
        """The row of signals at t; moves `state` on by one step."""
        Tr = self.r * force
        v_rate = self._plant_rates(state.v, state.sigma, state.z, 0.0, 0.0, Tr)[0]
        Ta = self._measured_torque(state, noise)
        measured = state.sigma + noise
        e = self.slip * state.v - measured
        signals = {"e": e, "e_integral": state.e_integral, "omega": (state.v - measured) / self.r, "Ta": Ta}
        signals |= {"v_rate": v_rate, "theta1_hat": state.theta_hat[0], "theta2_hat": state.theta_hat[1]}
        Tb, s, *rates = generated_control(signals, repeat(self.law_parameters))
        Td = self._disturbance_torque(t, Tb)
        fr = self.resistance.constant + self.resistance.linear * state.v + self.resistance.quadratic * state.v**2
        d = disturbance_function()(Tr, fr, Td, self.M, self.J, self.r) * self.J / self.r
        running = self.running(state)
        row = np.array([state.v, state.sigma, s, self._lyapunov(s, state.theta_hat), *state.theta_hat, d, Tb])
        self._move(state, running, e, noise, (Tb, Td, Tr))
        self._adapt(state, np.where(running, np.array(rates), 0.0))
        return np.where(running, row, np.nan)

    def _plant_rates(self, *arguments: Any) -> tuple[Any, Any, Any]:
        v_rate, sigma_rate, z_rate = self.plant.rates(*arguments, self.p)
        if self.held is not None:
            v_rate = 0.0 * v_rate
        return v_rate, sigma_rate, z_rate

    def _measured_torque(self, state: _State, noise: Floats) -> Any:
        """Ta of the law: the true one, moved by what the noise moves the model at rest."""
        Ta = self.r * self.plant.force(state.v, state.sigma, state.z, 0.0, 0.0, 0.0, self.p)
        if self.disturbances.slip_noise == 0.0:
            return Ta
        at_rest = [
            self.plant.force(state.v, x, self.plant.rest_state(state.v, x, 0.0, 0.0, 0.0, 0.0, self.p), 0, 0, 0, self.p)
            for x in (state.sigma + noise, state.sigma)
        ]
        return Ta + self.r * (at_rest[0] - at_rest[1])

    def _disturbance_torque(self, t: float, Tb: Floats) -> Any:
        if not self.disturbances.torque:
            return 0.0 * Tb
        return TORQUE_FRACTION * Tb * np.exp(-TORQUE_DECAY * t) * np.sin(TORQUE_FREQUENCY * t)

    def _lyapunov(self, s: Floats, theta_hat: Floats) -> Floats:
        if not np.all(self.rates > 0):
            return np.full_like(s, np.nan)
        error = self.theta[:, None] - theta_hat
        return np.asarray(lyapunov_function()(s, *error, *self.rates))

    def _move(self, state: _State, running: Any, e: Floats, noise: Floats, torques: tuple[Any, Any, Any]) -> None:
        first = self._plant_rates(state.v, state.sigma, state.z, *torques)
        ahead = [x + STEP * rate for x, rate in zip((state.v, state.sigma, state.z), first, strict=True)]
        second = self._plant_rates(*ahead, *torques)
        h = np.where(running, 0.5 * STEP, 0.0)
        state.v = state.v + h * (first[0] + second[0])
        state.sigma = state.sigma + h * (first[1] + second[1])
        state.z = state.z + h * (first[2] + second[2])
        state.e_integral = state.e_integral + h * (e + self.slip * state.v - state.sigma - noise)

    def _adapt(self, state: _State, rates: Floats) -> None:
        theta_hat = state.theta_hat + STEP * rates
        if self.gains.box is not None:
            low, high = np.array(self.gains.box).T
            theta_hat = np.clip(theta_hat, low[:, None], high[:, None])
        state.theta_hat = theta_hat


# --- the derived expressions as functions ---------------------------------------------------------------------------


def _symbols(*names: str) -> list[sp.Symbol]:
    return [sliding_symbol(name) for name in names]


_SWITCH = sp.Symbol("switch", real=True)


@cache
def control_function() -> Callable[..., Any]:
    """The derived (45) for arrays: Tb of (s, switch, e, v_rate, Ta, omega, theta1_hat, theta2_hat, J, r, D, K, rho,
    lambda_d, Mn, Bn); `switch` stands for sgn s. For searches over many points; a loop runs `generated_control`.
    """
    s = sliding_symbol("s")
    law = derive().adaptive_law_control.subs(sp.sign(s), _SWITCH)
    arguments = [s, _SWITCH, *_symbols("e"), plant.v_rate, plant.Ta, plant.omega]
    arguments += [*_symbols("theta1_hat", "theta2_hat"), plant.J, plant.r]
    return _function([*arguments, *_symbols("D", "K", "rho", "lambda_d", "Mn", "Bn")], law)


@cache
def _generated() -> tuple[ModuleType, tuple[str, ...]]:
    """The generated law and the arguments of its `control`; kept, as looking it up by its derivation takes time."""
    return python_law(derive()), generate(derive()).law.control_arguments


def law_parameters(**values: float) -> Any:
    """Parameters of the generated law: those of `values`; no layer and no limits unless given."""
    free = {"boundary": 0.0, "torque_min": -np.inf, "torque_max": np.inf, "period": STEP, "filter_time": STEP}
    return _generated()[0].Parameters(**{**free, **values})


def generated_control(signals: Mapping[str, Floats], parameters: Iterable[Any]) -> Floats:
    """The generated law at every column of its arguments: rows of (4, n), torque (N*m), s (m/s), rates of theta_hat.

    `parameters`: as of `law_parameters`, one for each column.
    """
    module, names = _generated()
    control, columns = module.control, (signals[name].tolist() for name in names)
    return np.array([control(*row) for row in zip(*columns, parameters, strict=False)]).T


@cache
def disturbance_function() -> Callable[..., Any]:
    """d, m/s^2, of (Tr, Fr, Td, M, J, r)."""
    return _function([plant.Tr, plant.Fr, plant.Td, plant.M, plant.J, plant.r], derive().disturbance)


@cache
def lyapunov_function() -> Callable[..., Any]:
    """V of (s, theta1_tilde, theta2_tilde, k1, k2), the matrix gain's."""
    return _function(_symbols("s", "theta1_tilde", "theta2_tilde", "k1", "k2"), derive().V_matrix)


@cache
def _theta_function() -> Callable[..., Any]:
    names = [plant.r, plant.J, *_symbols("Mn", "Mp", "Bp")]
    return _function(names, sp.Matrix(derive().theta))


def true_theta(vehicle: Vehicle, nominal: Vehicle) -> Floats:
    """theta, (44) corrected, of a vehicle against the nominal one: 1/(kg m), m/s."""
    Mn, Bn = nominal.effective_mass, nominal.effective_viscous_friction
    known = (vehicle.wheel.radius, vehicle.effective_inertia)
    perturbation = (vehicle.effective_mass - Mn, vehicle.effective_viscous_friction - Bn)
    return np.asarray(_theta_function()(*known, Mn, *perturbation), dtype=float).ravel()


def _function(arguments: list[sp.Symbol], expression: Any) -> Callable[..., Any]:
    made: Callable[..., Any] = sp.lambdify(arguments, expression, "numpy", cse=True)
    return made
