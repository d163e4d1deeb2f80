"""What python-control's margins say of the same loop with its dead time as Pade; for comparison only.

`control.stability_margins` reads the crossovers of the frequency response and does not ask whether the closed loop
is stable, so that it gives numbers for unstable loops too; the comparison shows them beside the exact verdict.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from .loop import DeadTimeLoop


@dataclass(frozen=True)
class PythonControlMargins:
    """`control.stability_margins` of the loop with a Pade dead time: gain margin (a factor), phase margin (deg),
    modulus margin 1/Ms, each as that function reports it, and whether it belongs to a stable loop at all."""

    pade_order: int
    gain: float
    phase_deg: float
    modulus: float
    stable: bool


def python_control_margins(loop: DeadTimeLoop, pade_order: int = 3) -> PythonControlMargins:
    """Ask python-control; imports it (and what it brings) when called."""
    import control

    system: Any = to_transfer_function(loop)
    if loop.dead_time > 0:
        system = system * control.tf(*control.pade(loop.dead_time, pade_order))
    gain, phase, modulus, *_ = control.stability_margins(system)
    return PythonControlMargins(pade_order, float(gain), float(phase), float(modulus), loop.is_stable())


def to_transfer_function(loop: DeadTimeLoop) -> Any:
    """G of the loop, without its dead time, as a python-control TransferFunction."""
    import control

    system = loop.system
    return control.zpk(system.zeros, system.poles, system.gain)
