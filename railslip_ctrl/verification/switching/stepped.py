"""The sliding-mode laws in steps, for `simulate`: the published one, and the layered one that knows its actuator."""

from __future__ import annotations

import math
from collections.abc import Callable

from railslip_ctrl.model.linearization import OperatingPoint
from railslip_ctrl.model.numeric import numeric_plant, plant_parameters

from .law import OMEGA_UNIT_FACTOR, FeedForward, SlidingGains
from .layered import LayeredDesign


class PublishedLaw:
    """[Park2008] (45) with (49) and the plant's own parameters; holds int e, theta and the adhesion model's state.

    Parameters
    ----------
    point : OperatingPoint
        Its slip is the reference, its law the adhesion model; the model's state starts at the point's.
    gains : SlidingGains
    feed_forward : FeedForward
    layer : float
        m/s; > 0 replaces the relay by K sat(s/layer).
    frozen : bool
        Whether the reference is held, so that sigma_d' = 0.
    """

    def __init__(
        self,
        point: OperatingPoint,
        gains: SlidingGains,
        *,
        feed_forward: FeedForward = FeedForward.MODEL,
        layer: float = 0.0,
        frozen: bool = True,
    ) -> None:
        self.point, self.gains, self.layer, self.frozen = point, gains, layer, frozen
        self.feed_forward = feed_forward
        self.integral, self.theta = 0.0, (0.0, 0.0)
        self.z = point.adhesion_state or 0.0
        self._functions, self._p = numeric_plant(type(point.law)), plant_parameters(point.law, point.vehicle)

    def command(self, v: float, sigma: float, v_rate: float, step: float) -> tuple[float, float]:
        """See `simulate.Controller`."""
        g, (M, J, B, r) = self.gains, self._p[:4]
        slip = self.point.slip
        e = slip * v - sigma
        s = e + g.rho * self.integral
        Ta, omega = r * self._force(v, sigma), (v - sigma) / r
        sigma_d_rate = 0.0 if self.frozen else slip * v_rate
        bracket = sigma_d_rate + (1 / (r * M) + r / J) * Ta - r * B / J * omega + g.rho * e
        bracket += self.theta[0] * Ta + self.theta[1] * omega
        torque = J / r * bracket + g.D * s + g.K * _switch(s, self.layer)
        self.integral += step * e
        self.theta = (self.theta[0] + step * g.k * s * Ta, self.theta[1] + step * OMEGA_UNIT_FACTOR * g.k * s * omega)
        self._advance_model(v, sigma, step)
        return torque, s

    def _force(self, v: float, sigma: float) -> float:
        z = self.z
        if self.feed_forward is FeedForward.OFF:
            return self.point.adhesion_force
        if self.feed_forward is FeedForward.REST:
            z = float(self._functions.rest_state(v, sigma, 0.0, 0.0, 0.0, 0.0, self._p))
        return float(self._functions.force(v, sigma, z, 0.0, 0.0, 0.0, self._p))

    def _advance_model(self, v: float, sigma: float, step: float) -> None:
        if self.point.law.has_state and self.feed_forward is FeedForward.MODEL:
            middle = self.z + 0.5 * step * self._z_rate(v, sigma, self.z)
            self.z += step * self._z_rate(v, sigma, middle)

    def _z_rate(self, v: float, sigma: float, z: float) -> float:
        return float(self._functions.rates(v, sigma, z, 0.0, 0.0, 0.0, self._p)[2])


class LayeredLaw:
    """Tb = hold + K sat(s_lead/layer), s_lead = (lead s + 1)/(lead_filter s + 1) applied to e + rho int e.

    Parameters
    ----------
    slip : float
        Reference slip ratio.
    hold : float or callable
        Torque around which the layer works, N*m: of the operating point, or a function of the speed, m/s.
    design : LayeredDesign

    The integral rests where the layer is left and e drives farther out of it; the torque is not below 0.
    """

    def __init__(self, slip: float, hold: float | Callable[[float], float], *, design: LayeredDesign) -> None:
        self.slip, self.hold, self.design = slip, hold, design
        self.integral, self.filtered = 0.0, 0.0  # at rest before t = 0

    def command(self, v: float, sigma: float, v_rate: float, step: float) -> tuple[float, float]:
        """See `simulate.Controller`; the surface returned is s_lead."""
        d = self.design
        e = self.slip * v - sigma
        s = e + d.rho * self.integral
        led = self.filtered + d.lead / d.lead_filter * (s - self.filtered)
        self.filtered += (1 - math.exp(-step / d.lead_filter)) * (s - self.filtered)
        if abs(led) < d.layer or led * e < 0.0:
            self.integral += step * e
        hold = self.hold(v) if callable(self.hold) else self.hold
        return max(0.0, hold + d.K * _switch(led, d.layer)), led


def _switch(s: float, layer: float) -> float:
    """sgn(s), or sat(s/layer)."""
    if layer > 0:
        return max(-1.0, min(1.0, s / layer))
    return math.copysign(1.0, s) if s else 0.0
