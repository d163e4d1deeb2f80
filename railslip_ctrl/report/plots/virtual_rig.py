"""The course of a test on the virtual rig, as [Park2008] Fig. 12."""

from __future__ import annotations

from matplotlib.figure import Figure

from railslip_ctrl.core.units import KMH
from railslip_ctrl.identification.logs import Rows

from .style import legend_below, line_style, new_figure, panels


def rig_test_figure(log: Rows, *, radius: float, title: str) -> Figure:
    """Speeds of train and wheel rim (km/h), slip ratio and brake torque (kN*m) over time; `radius` in m."""
    figure = new_figure(6.0, title)
    speeds, slip, torque = panels(figure, 3, sharex=True)[:, 0]
    time, v, omega, brake = (
        log.columns[name] for name in ("time", "train_speed", "wheel_angular_speed", "brake_torque")
    )
    speeds.plot(time, v / KMH, label="train, v", **line_style(0))
    speeds.plot(time, radius * omega / KMH, label="wheel rim, rω", **line_style(1))
    speeds.set_ylabel("speed (km/h)")
    legend_below(speeds, 0.04, columns=2)
    slip.plot(time, 1.0 - radius * omega / v, **line_style(0))
    slip.set_ylabel("slip ratio λ (-)")
    torque.plot(time, brake / 1e3, **line_style(0))
    torque.set_ylabel("brake torque (kN·m)")
    torque.set_xlabel("time (s)")
    return figure
