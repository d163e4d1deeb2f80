"""The peer of `test_page_speed`: a Bokeh server that does the work of the design page when its slider moves.

Exact margins and four plots of 600 points of the same loop, by the same functions.
"""

import numpy as np
from bokeh.io import curdoc
from bokeh.layouts import column, gridplot
from bokeh.models import ColumnDataSource, Div, Slider
from bokeh.plotting import figure

import railslip_ctrl as rs
from railslip_ctrl.design.assessment import slip_responses

HELD = {"dry": 0.1, "wet": 0.07}
point = rs.Envelope(reference=HELD, laws="bristle", loads="empty", speeds=100).points(nominal=True).plants[0].point
plant, brake = rs.linearize(point), point.vehicle.actuator
times = np.linspace(0.0, 12.0, 600)


def lines(kp: float) -> tuple[dict[str, dict[str, np.ndarray]], float]:
    """The lines of the plots, and Ms."""
    control = rs.PIController(rs.PIGains(kp=kp, ki=129.0), 0.6, 0.06)
    loop = rs.wheel_slip_loop(plant, control, brake)
    ms = loop.margins().ms
    omega = np.geomspace(*loop.feature_band(), 600)
    response = loop.response(omega)
    step, load = slip_responses(control, plant, brake, times, reference=1.0, torque=100.0)
    return {
        "nyquist": {"x": response.real, "y": response.imag},
        "size": {"x": omega, "y": 20 * np.log10(np.abs(response))},
        "phase": {"x": omega, "y": np.degrees(loop.phase(omega))},
        "step": {"x": times, "y": step.output},
        "load": {"x": times, "y": load.output},
    }, ms


found, worst = lines(330.0)
sources = {name: ColumnDataSource(data=data) for name, data in found.items()}
plots = [
    figure(width=400, height=290, x_axis_type="log" if name in ("size", "phase") else "linear") for name in sources
]
for plot, source in zip(plots, sources.values(), strict=True):
    plot.line("x", "y", source=source)
told, slider = Div(text=f"{worst}", name="ms"), Slider(start=100, end=600, step=0.1, value=330, name="kp")


def moved(attribute: str, old: float, new: float) -> None:
    """Draw the loop of the slider's gain."""
    data, ms = lines(float(new))
    for name, source in sources.items():
        source.data = data[name]
    told.text = f"{ms}"


slider.on_change("value", moved)
curdoc().add_root(column(slider, told, gridplot(plots, ncols=2)))
