"""How a log is identified: what its user may say of it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from railslip_ctrl.model.vehicle import Rail

from .logs import BLOCK_BYTES
from .observed import Observer


@dataclass(frozen=True)
class Options:
    """How to identify; None takes it from the log. See `railslip identify --help`.

    Parameters
    ----------
    model : str
        A model's name, or "best": of those with a formula the one with the lowest BIC.
    rail : Rail
    initial_speed, slip_acceleration, time_constant : float or None
        v0, m/s; R of the ramps, m/s^2; tau of the `observer`, s.
    columns, units : mapping
        Header and unit of a quantity's column, by quantity.
    delays, zeros : mapping
        By how much a quantity's column is late, s, and what it reads where it should read nought, SI; by quantity.
    fixed, bounds : mapping
        Value (SI), or lowest and highest, of a parameter, by name.
    block_bytes : int
        How much of a log is read at a time.
    """

    model: str = "best"
    rail: Rail = Rail.DRY
    initial_speed: float | None = None
    slip_acceleration: float | None = None
    time_constant: float | None = None
    observer: Observer = Observer.CORRECTED
    columns: Mapping[str, str] = field(default_factory=dict)
    units: Mapping[str, str] = field(default_factory=dict)
    delays: Mapping[str, float] = field(default_factory=dict)
    zeros: Mapping[str, float] = field(default_factory=dict)
    fixed: Mapping[str, float] = field(default_factory=dict)
    bounds: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    block_bytes: int = BLOCK_BYTES
