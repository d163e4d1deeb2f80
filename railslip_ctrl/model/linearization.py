"""Operating points of braking at constant slip, and the plant linearised there."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from railslip_ctrl.core.arguments import Complexes, Floats, checked, number
from railslip_ctrl.core.errors import DomainError, InputError, KinkError
from railslip_ctrl.core.records import dataclass
from railslip_ctrl.core.units import KMH

from .adhesion import AdhesionLaw
from .numeric import NumericPlant, numeric_plant, plant_parameters
from .vehicle import Rail, Vehicle

if TYPE_CHECKING:
    import control

STATES = ("v", "sigma", "z")
INPUTS = ("brake_torque",)
OUTPUTS = ("sigma", "lambda", "error")

_LARGEST_RESIDUAL = 1e-12  # rounding gives a few 1e-16
_KINK_TOLERANCE = 1e-9  # relative distance of a slip from a kink; rounding is far smaller
_SAME_LOAD = 1e-6  # relative difference within which two wheel loads are equal; loads in files may be rounded
_NEXT_TO_ZERO = 1e-7  # slip ratio for the extrapolation of the Jacobian to slip 0; the error is of order slip^2
_LIMIT_TOLERANCE = 1e-6  # largest relative difference between the Jacobian at slip 0 and its limit


@dataclass(frozen=True)
class OperatingPoint:
    """Operating point of braking at constant slip; the train speed falls, so that it is not an equilibrium.

    - law, vehicle, rail: adhesion law, quarter car and rail condition of the point.
    - speed: v, m/s.
    - slip: lambda, slip ratio, 0 <= lambda < 1.
    - adhesion_state: z in steady state (z' = 0), m; None for a static law.
    - adhesion_force: Fa, N.
    - brake_torque: Tb at which lambda' = 0, N*m, without disturbance torque and random adhesion torque.
    - initial_speed_kmh: initial speed v0 of the law's parameters, km/h; None if they do not depend on it.
    - gain: (acting/commanded torque) times (measured/true slip velocity), a ratio; 1 without errors.
    - residual: largest relative rounding error of lambda' = 0 and z' = 0, a ratio.
    """

    law: AdhesionLaw
    vehicle: Vehicle
    rail: Rail
    speed: float
    slip: float
    adhesion_state: float | None
    adhesion_force: float
    brake_torque: float
    residual: float
    initial_speed_kmh: float | None = None
    gain: float = 1.0

    @property
    def adhesion(self) -> str:
        """Name of the adhesion law."""
        return self.law.name

    @property
    def speed_kmh(self) -> float:
        """Train speed v, km/h."""
        return self.speed / KMH

    @property
    def description(self) -> str:
        """Description of the point: law, rail, speed, slip and mass."""
        return f"{self.adhesion}, {self.place}"

    @property
    def place(self) -> str:
        """Description of the point: rail, speed, slip and mass."""
        return f"{self.rail} rail, {self.speed_kmh:g} km/h, slip {self.slip:g}, M {self.vehicle.mass:g} kg"

    @property
    def sigma(self) -> float:
        """Slip velocity sigma, m/s."""
        return self.slip * self.speed

    @property
    def adhesion_coefficient(self) -> float:
        """Adhesion coefficient mu = Fa/N."""
        return self.adhesion_force / self.vehicle.wheel_load


@checked
def operating_point(
    law: AdhesionLaw,
    vehicle: Vehicle,
    speed: float,
    slip: float,
    *,
    rail: Rail | None = None,
    initial_speed_kmh: float | None = None,
) -> OperatingPoint:
    """Compute the adhesion state and the brake torque with which the slip ratio is constant.

    - law: adhesion law with the parameters for the rail condition.
    - vehicle: quarter car, SI.
    - speed: v, m/s, > 0.
    - slip: lambda, a ratio, 0 <= slip < 1.
    - rail: rail condition, used only as a label; by default that of the law.
    - initial_speed_kmh: initial speed v0 of the law's parameters, km/h, used only as a label.

    InputError: a law for another wheel load than the vehicle's. DomainError: a speed or slip outside the domain of the
    law. KinkError: slip 0 with a dynamic law, which has no unique steady state there.
    """
    if initial_speed_kmh is not None:
        number("initial_speed_kmh", initial_speed_kmh, "km/h", gt=0)
    if not (math.isfinite(slip) and 0.0 <= slip < 1.0):
        reason = "no brake torque holds a locked wheel at constant slip; " if slip == 1.0 else ""
        raise DomainError(f"slip: {slip:g} is not allowed; {reason}give 0 <= slip < 1")
    sigma = slip * speed
    law.check_domain(speed, sigma)
    load = law.of_wheel_load
    if load is not None and not math.isclose(load, vehicle.wheel_load, rel_tol=_SAME_LOAD):  # mu would be wrong
        raise InputError(
            f"adhesion {law.name!r}: its forces are for a wheel load of {load:g} N, but the vehicle has "
            f"{vehicle.wheel_load:g} N; give published_law(..., wheel_load=vehicle.wheel_load)"
        )
    if law.has_state and sigma == 0.0:
        reasons = [kink.reason for kink in law.kinks(speed, vehicle.wheel_load) if kink.slip == 0.0]
        reason = reasons[0] if reasons else "its steady state is undefined at slip 0"
        raise KinkError(f"slip: no operating point at slip 0 with adhesion {law.name!r}: {reason}; give a slip > 0")
    functions = numeric_plant(type(law))
    p = plant_parameters(law, vehicle)
    z = float(functions.rest_state(speed, sigma, 0.0, 0.0, 0.0, 0.0, p))
    force = float(functions.force(speed, sigma, z, 0.0, 0.0, 0.0, p))
    torque = float(functions.trim_torque(speed, sigma, z, 0.0, 0.0, 0.0, p))
    residual = _residual(functions, (speed, sigma, z, torque), p)
    if not residual <= _LARGEST_RESIDUAL:
        raise DomainError(
            f"operating point at slip {slip:g}, {speed / KMH:g} km/h: the steady_state of adhesion {law.name!r} is not "
            f"steady (residual {residual:.1e}, at most {_LARGEST_RESIDUAL:.0e}); correct it so that state_rate is 0"
        )
    state = z if law.has_state else None
    return OperatingPoint(
        law, vehicle, rail or law.rail, speed, slip, state, force, torque, residual, initial_speed_kmh
    )


def _residual(functions: NumericPlant, state: tuple[float, float, float, float], p: tuple[float, ...]) -> float:
    # rates that should be 0, divided by the size of the terms that cancel in them
    v, sigma, z, torque = state
    v_rate, sigma_rate, z_rate = (float(rate) for rate in functions.rates(v, sigma, z, torque, 0.0, 0.0, p))
    force = float(functions.force(v, sigma, z, 0.0, 0.0, 0.0, p))
    _, J, B, r = p[:4]
    size = r / J * (abs(torque) + r * abs(force) + B * v / r) + abs(v_rate)
    slip_residual = abs(sigma_rate - sigma / v * v_rate) / size if size > 0.0 else 0.0
    return max(slip_residual, abs(z_rate) / sigma if sigma > 0.0 else 0.0)


@dataclass(frozen=True)
class LinearPlant:
    """Plant linearised at an operating point, without the actuator; the input is the brake torque at the wheel.

    - point: the operating point.
    - A, B, C, D: ndarray, (n, n), (n, 1), (3, n), (3, 1); SI; deviations from the operating point.
    - states: "v" if the speed is a state, "sigma", and "z" for a dynamic law.
    - inputs, outputs: input "brake_torque"; outputs "sigma", "lambda", and "error" = `point.slip` v - sigma.
    """

    point: OperatingPoint
    A: Floats
    B: Floats
    C: Floats
    D: Floats
    states: tuple[str, ...]
    inputs: tuple[str, ...] = INPUTS
    outputs: tuple[str, ...] = OUTPUTS

    @property
    def speed_state(self) -> bool:
        """True if the speed is a state."""
        return "v" in self.states

    @property
    def poles(self) -> Complexes:
        """Eigenvalues of A, rad/s, rightmost first."""
        return _sorted_roots(self.A)

    @property
    def zeros(self) -> Complexes:
        """Zeros from brake torque to sigma, rad/s, rightmost first."""
        # eigenvalues of A without the row and the column of sigma, because the torque enters only sigma'
        others = [index for index, name in enumerate(self.states) if name != "sigma"]
        return _sorted_roots(self.A[np.ix_(others, others)])

    @property
    def gain(self) -> float:
        """Leading numerator coefficient r/J from brake torque to sigma, (m/s^2)/(N*m)."""
        return float(self.B[self.states.index("sigma"), 0])

    def transfer_function(self) -> tuple[Floats, Floats]:
        """Numerator and denominator from brake torque to sigma, highest power first, denominator monic."""
        return self.gain * _polynomial(self.zeros), _polynomial(self.poles)

    def to_control(self) -> control.StateSpace:
        """The linear plant as a python-control system with named states, inputs and outputs."""
        import control

        labels = {"states": list(self.states), "inputs": list(self.inputs), "outputs": list(self.outputs)}
        return control.ss(self.A, self.B, self.C, self.D, name=f"{self.point.adhesion}_{self.point.rail}", **labels)


def _sorted_roots(matrix: Floats) -> Complexes:
    roots = np.linalg.eigvals(matrix).astype(np.complex128)
    return roots[np.lexsort((roots.imag, -roots.real))]


def _polynomial(roots: Complexes) -> Floats:
    return np.atleast_1d(np.real(np.poly(roots))).astype(np.float64)  # roots come in conjugate pairs


@checked
def linearize_rolling(law: AdhesionLaw, vehicle: Vehicle, speed: float) -> LinearPlant:
    """Linearise at slip 0, where every braking run starts; z = 0 for a dynamic law.

    - law: adhesion law with the parameters for the rail condition.
    - vehicle: quarter car, SI.
    - speed: v, m/s, > 0.

    At slip 0 the railway bristle model acts as an undamped spring between wheel and rail; the poles of the plant are
    +-j sqrt(alpha (r^2/J + 1/M)). Errors as in `operating_point`; KinkError if the law has no derivative at slip 0.
    """
    if not law.has_state:
        return linearize(operating_point(law, vehicle, speed, 0.0))
    slipping = operating_point(law, vehicle, speed, _NEXT_TO_ZERO)
    unbraked = -vehicle.wheel.viscous_friction * speed / vehicle.wheel.radius
    point = replace(slipping, slip=0.0, adhesion_state=0.0, adhesion_force=0.0, brake_torque=unbraked, residual=0.0)
    jacobian = _jacobian(point, 0.0)
    if not np.isfinite(jacobian).all():
        raise KinkError(f"slip: 0 is a kink of adhesion {law.name!r}; linearise at a slip > 0")
    return _linear_plant(point, jacobian, speed_state=False)


@checked
def linearize(point: OperatingPoint, *, speed_state: bool = False) -> LinearPlant:
    """Linearise at an operating point by the analytic Jacobian of the plant.

    - point: from `operating_point`.
    - speed_state: if true, v is the first state; by default the speed is constant.

    KinkError: the law has no unique derivative at the slip of the point.
    """
    law = point.law
    for kink in law.kinks(point.speed, point.vehicle.wheel_load):
        if abs(point.slip - kink.slip) <= _KINK_TOLERANCE * max(kink.slip, point.slip):
            raise KinkError(
                f"slip: {point.slip:.10g} at {point.speed_kmh:g} km/h is a kink of adhesion {law.name!r}: "
                f"{kink.reason}; linearise on one side of it"
            )
    full = _jacobian(point, point.sigma)
    if point.slip == 0.0:
        step = _NEXT_TO_ZERO * point.speed
        limit = 2.0 * _jacobian(point, step) - _jacobian(point, 2.0 * step)
        # Jacobian and limit differ if the law's equations contain sign(sigma)
        if not np.allclose(full, limit, rtol=0.0, atol=_LIMIT_TOLERANCE * np.max(np.abs(limit))):
            raise KinkError(f"slip: 0 is a kink of adhesion {law.name!r}; linearise at a slip > 0")
    return _linear_plant(point, full, speed_state=speed_state)


def _jacobian(point: OperatingPoint, sigma: float) -> Floats:
    """Jacobian of the rates of v, sigma and z at the operating point, with the slip velocity replaced by `sigma`."""
    law = point.law
    functions, p = numeric_plant(type(law)), plant_parameters(law, point.vehicle)
    z = point.adhesion_state or 0.0
    rows = functions.jacobian(point.speed, sigma, z, point.brake_torque, 0.0, 0.0, p)
    return np.array([[float(entry) for entry in row] for row in rows])


def _linear_plant(point: OperatingPoint, full: Floats, *, speed_state: bool) -> LinearPlant:
    indices = [*([0] if speed_state else []), 1, *([2] if point.law.has_state else [])]
    v, slip = point.speed, point.slip
    outputs = np.array([[0.0, 1.0, 0.0], [-slip / v, 1.0 / v, 0.0], [slip, -1.0, 0.0]])
    A, B = full[np.ix_(indices, indices)], point.gain * full[np.ix_(indices, [3])]
    return LinearPlant(point, A, B, outputs[:, indices], np.zeros((3, 1)), tuple(STATES[index] for index in indices))


NONLINEAR_INPUTS = ("brake_torque", "disturbance_torque", "random_adhesion_torque")
NONLINEAR_OUTPUTS = (*OUTPUTS, "v", "omega")


@checked
def nonlinear_plant(law: AdhesionLaw, vehicle: Vehicle, *, reference_slip: float) -> control.NonlinearIOSystem:
    """Nonlinear plant, [Park2008] (1)-(4), as a python-control system.

    - law: adhesion law with the parameters for the rail condition.
    - vehicle: quarter car, SI.
    - reference_slip: lambda_d, a ratio, 0 <= reference_slip < 1; the output "error" is reference_slip v - sigma.

    States: v (m/s, > 0), sigma (m/s) and, for a dynamic law, z (m). Inputs: brake, disturbance and random adhesion
    torque, N*m. Outputs: sigma (m/s), lambda, error (m/s), v (m/s), omega (rad/s).
    """
    import control

    reference_slip = number("reference_slip", reference_slip, ge=0, lt=1)
    rates, p = numeric_plant(type(law)).rates, plant_parameters(law, vehicle)
    radius = vehicle.wheel.radius
    states = STATES[: 3 if law.has_state else 2]

    def update(t: float, x: Floats, u: Floats, params: object) -> Floats:
        z = x[2] if law.has_state else 0.0
        return np.array([float(rate) for rate in rates(x[0], x[1], z, u[0], u[1], u[2], p)[: len(states)]])

    def output(t: float, x: Floats, u: Floats, params: object) -> Floats:
        v, sigma = x[:2]
        return np.array([sigma, sigma / v, reference_slip * v - sigma, v, (v - sigma) / radius])

    labels = {"states": list(states), "inputs": list(NONLINEAR_INPUTS), "outputs": list(NONLINEAR_OUTPUTS)}
    return control.nlsys(update, output, name=f"{law.name}_plant", **labels)
