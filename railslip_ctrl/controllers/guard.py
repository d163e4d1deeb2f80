"""Guard between a controller and the brake: it handles bad samples, a stuck sensor, a locked wheel and torque limits.

Python (`ControlUnit`) and the generated C99 use the same functions. Their arguments are the guard's state `g`, the
measurement `m` and the guard's parameters `q`.
"""

from __future__ import annotations

import math
from enum import IntEnum
from types import SimpleNamespace
from typing import Any, NamedTuple, Self

from railslip_ctrl.core.arguments import checked
from railslip_ctrl.core.errors import InputError
from railslip_ctrl.core.units import quantity
from railslip_ctrl.model.vehicle import Rail, Record, Vehicle

from .base import PERIOD, Controller, Measurement, Situation
from .linear import full_brake_torque


class Status(IntEnum):
    """Action of the guard at a sample.

    - OK: the sample is good; the command is the controller's command, cut to the limits
    - HOLDING: the sample is bad; the command is the last command
    - RELEASING: samples have been bad for longer than the hold time; the command falls to 0
    - FAULT: samples have been bad for longer than the hold time; the command is 0
    - LOCKED: the wheel is locked while the train moves; the command is 0
    """

    OK = 0
    HOLDING = 1
    RELEASING = 2
    FAULT = 3
    LOCKED = 4


OK, HOLDING, RELEASING, FAULT, LOCKED = (float(status) for status in Status)


class Guard(Record):
    """Parameters of the guard, SI; `for_controller` sets torque limits and wheel radius to those of a controller."""

    period: float = quantity("s", "sampling period", gt=0)
    radius: float = quantity("m", "wheel radius", gt=0)
    torque_min: float = quantity("N*m", "smallest command", default=0.0, le=0)
    torque_max: float = quantity("N*m", "largest command", gt=0)
    speed_max: float = quantity("m/s", "largest plausible train speed", gt=0, default=150.0)
    wheel_speed_max: float = quantity("rad/s", "largest plausible wheel speed", gt=0, default=600.0)
    hold_time: float = quantity("s", "time for which the last command is held while samples are bad", ge=0, default=0.1)
    release_time: float = quantity("s", "time in which the largest command then falls to 0", gt=0, default=0.2)
    stuck_time: float = quantity(
        "s", "time without change of the measured wheel speed after which the sensor counts as stuck", gt=0, default=1.0
    )
    locked_share: float = quantity(
        "1", "share of the train speed below which the wheel counts as locked", gt=0, lt=1, default=0.02
    )
    lock_time: float = quantity("s", "time after which the brake of a locked wheel is released", ge=0, default=0.1)
    moving_speed: float = quantity("m/s", "train speed below which a locked wheel is allowed", ge=0, default=0.5)
    ahead_share: float = quantity(
        "1",
        "share of the train speed, in addition to moving_speed, by which the rim speed may exceed the train speed",
        gt=0,
        default=0.2,
    )

    class State(Record):
        """Values that the guard keeps from sample to sample."""

        status: float = quantity("1", "action at the last sample, as in `Status`", default=0.0)
        last_command: float = quantity("N*m", "command of the previous sample", default=0.0)
        last_wheel_speed: float = quantity("rad/s", "wheel speed of the previous sample", default=-1.0)
        same_time: float = quantity("s", "time for which the wheel speed has not changed", default=0.0)
        bad_time: float = quantity("s", "time for which samples have been bad", default=0.0)
        locked_time: float = quantity("s", "time for which the wheel has been locked", default=0.0)

    @classmethod
    def for_controller(cls, control: Controller, vehicle: Vehicle, period: float) -> Self:
        """Return the guard that checks the samples and commands of a controller; `period` is the sampling period, s.

        If the controller has no torque limit, the lower limit is 0 and the upper limit the vehicle's full brake torque.
        A lower limit above 0 becomes 0, because the guard must be able to release the brake.
        """
        least, most = control.least_torque, control.largest_torque
        radius = getattr(control, "radius", None)
        return cls(
            period=period,
            radius=vehicle.wheel.radius if radius is None else radius,
            torque_min=0.0 if math.isinf(least) else min(least, 0.0),
            torque_max=full_brake_torque(vehicle) if math.isinf(most) else most,
        )


_SAME_TIME = 1e-9  # relative tolerance for comparing times, because sums of periods have rounding errors


def is_good(g: Any, m: Any, q: Any) -> Any:
    """Return 1 if the controller may use a sample, else 0.

    A sample is bad if a speed is not finite, negative or above the sensor's range, or if the wheel speed has not
    changed for `stuck_time` while torque acts. It is also bad if the rim speed is far above the train speed,
    which braking cannot cause.
    """
    v, omega = m.train_speed, m.wheel_speed
    plausible = 1.0 if 0.0 <= v <= q.speed_max and 0.0 <= omega <= q.wheel_speed_max else 0.0  # 0 for NaN
    if plausible > 0.0 and q.radius * omega > (1.0 + q.ahead_share) * v + q.moving_speed:
        plausible = 0.0
    if plausible > 0.0 and omega > 0.0 and omega == g.last_wheel_speed and g.last_command > 0.0:
        g.same_time += q.period
    elif plausible > 0.0 and (omega != g.last_wheel_speed or omega == 0.0):
        g.same_time = 0.0
    if plausible > 0.0:
        g.last_wheel_speed = omega
    return 0.0 if g.same_time >= q.stuck_time * (1.0 - _SAME_TIME) else plausible


def valid_applied_torque(g: Any, m: Any, q: Any) -> Any:
    """Return the applied torque, N*m, cut to the torque limits; if it is not finite, the last command replaces it."""
    torque = m.applied_torque if math.isfinite(m.applied_torque) else g.last_command
    return min(max(torque, q.torque_min), q.torque_max)


def guarded(g: Any, m: Any, q: Any, good: float, wanted: float) -> Any:
    """Return the command to the brake, N*m, and store the guard's action in g; `wanted` is the controller's command."""
    if good > 0.0 and math.isfinite(wanted):
        torque = min(max(wanted, q.torque_min), q.torque_max)
        g.bad_time, g.status = 0.0, OK
    else:
        g.bad_time += q.period
        torque, g.status = g.last_command, HOLDING
        if g.bad_time > q.hold_time * (1.0 + _SAME_TIME):
            fall = q.torque_max * q.period / q.release_time
            torque = max(torque - fall, 0.0) if torque > 0.0 else min(torque + fall, 0.0)
            g.status = FAULT if torque == 0.0 else RELEASING
    if good > 0.0 and m.train_speed > q.moving_speed and q.radius * m.wheel_speed < q.locked_share * m.train_speed:
        g.locked_time += q.period
    elif good > 0.0:
        g.locked_time = 0.0
    if g.locked_time > q.lock_time * (1.0 + _SAME_TIME):
        torque, g.status = min(torque, 0.0), LOCKED
    g.last_command = torque
    return torque


class Command(NamedTuple):
    """Result of a sample: command `torque` to the brake, N*m, and action `status` of the guard."""

    torque: float
    status: Status


class ControlUnit:
    """A controller and its guard, called sample by sample as in the generated C99 program.

    - control: the controller.
    - vehicle: provides the vehicle parameters that the controller does not set itself.
    - speed: train speed when the brake is applied, m/s.
    - rail: rail for which the controller's parameters, for example the reference slip, are computed.

    InputError if the controller is a user's Python object or function, or for a parameter that `Guard` does not allow.
    """

    @checked
    def __init__(self, control: Controller, vehicle: Vehicle, speed: float, *, rail: Rail = Rail.DRY) -> None:
        self.control = control.believing(vehicle)
        self.period = PERIOD if control.period is None else control.period
        self.guard = Guard.for_controller(self.control, vehicle, self.period)
        self._q = SimpleNamespace(**dict(self.guard))
        self._g = SimpleNamespace(**dict(Guard.State()))
        self._x = mutable(self.control.start(speed, self.period))
        self._p = SimpleNamespace(**step_parameters(self.control, rail, self.period))
        self._step = self.control.whole_step
        self._samples = 0

    @property
    def state(self) -> SimpleNamespace:
        """Present state of the controller, with the fields of its class `State`."""
        return self._x

    def step(self, train_speed: float, wheel_speed: float, applied_torque: float) -> Command:
        """Return the command of one sample.

        - train_speed: measured train speed, m/s.
        - wheel_speed: measured wheel speed, rad/s.
        - applied_torque: torque that the brake applied since the previous sample, N*m; 0 in the first sample.
        """
        m = Measurement(self._samples * self.period, train_speed, wheel_speed, applied_torque)
        good, wanted = is_good(self._g, m, self._q), 0.0
        m = m._replace(applied_torque=valid_applied_torque(self._g, m, self._q))
        if good > 0.0:
            try:
                wanted = self._step(self._x, m, self._p)
            except (ArithmeticError, ValueError):  # where C computes an infinite number or NaN
                wanted = math.nan
        torque = guarded(self._g, m, self._q, good, wanted)
        self._samples += 1
        return Command(float(torque), Status(int(self._g.status)))


def mutable(state: Any) -> SimpleNamespace:
    """Return a copy of a controller state whose fields can be changed."""
    fields = dict(state) if isinstance(state, Record) else vars(state)
    return SimpleNamespace(**{name: list(x) if isinstance(x, tuple) else x for name, x in fields.items()})


def step_parameters(control: Controller, rail: Rail, period: float) -> dict[str, Any]:
    """Return names and values of the parameters that `step` of the controller reads on a rail; `period` is in s.

    InputError if a controller that tracks a reference slip has none.
    """
    if control.reference is None and control.follows_reference:
        raise InputError(f"controller {control.label} has no reference slip; give `reference`")
    law = control.model_law
    situation = Situation(rail, period, law.on(rail) if law is not None else None)
    slip = math.nan if control.reference is None else control.reference.on(rail)
    numbers = {**control.parameters(situation), **control.outside_numbers(situation), "reference_slip": slip}
    return {name: math.nan if value is None else value for name, value in numbers.items()} | {"period": period}
