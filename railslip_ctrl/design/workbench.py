"""Controllers shaped by hand over an envelope: each kind as it begins, a controller by its numbers, operating points.

What is made of the operating points is kept, as every change of a number asks for them again.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import cached_property
from typing import Any, cast

from railslip_ctrl.controllers.base import Controller
from railslip_ctrl.controllers.files import as_control, controller_kinds, structures
from railslip_ctrl.controllers.linear import LinearControl, TransferFunction
from railslip_ctrl.controllers.pi import PI
from railslip_ctrl.core.errors import InputError, RailslipError
from railslip_ctrl.core.units import shown
from railslip_ctrl.model.adhesion import ReferenceSlip

from .catalogue import BY_RULE, begun
from .envelope import Envelope, EnvelopePoints, HeldSlip
from .envelope_tuning import held_slips, operating_plants
from .gain_map import Screen
from .judging import envelope_for

_KEPT = 200  # of what was made of operating points, most of it small


class Workbench:
    """An `envelope` that a design must hold, and the controller that it begins with; left out, a PI-lead by its rule.

    InputError for an envelope without points or slips, or a controller without numbers by name.
    """

    def __init__(self, envelope: Envelope, controller: Any = None) -> None:
        envelope.check_files()
        self.envelope, self.given, self._made = envelope, controller, dict[Any, Any]()
        if controller is not None:
            own = getattr(getattr(controller, "controller", controller), "reference", None)
            self.given = as_control(controller, envelope.vehicle, envelope.reference or own or self.reference)
            if not self.given.design_numbers():
                raise InputError(f"controller: {self.given.label} has no numbers by name; give one that has")
        _ = self.reference

    @cached_property
    def reference(self) -> ReferenceSlip:
        """The slip ratios with which a design begins."""
        own = self.envelope.reference or getattr(self.given, "reference", None)
        held = own or held_slips(self.envelope, self.envelope.points(nominal=True))
        if held is None:
            raise InputError("envelope: its laws hold different slips; give it a reference, or give --slip")
        return held

    @cached_property
    def kinds(self) -> dict[str, Controller]:
        """The kinds that are shaped, by name, each as it begins."""
        linear = [name for name, kind in structures().items() if issubclass(kind, PI)]
        points = self.envelope.at(reference=self.reference).points(nominal=True)
        found: dict[str, Controller] = {}
        for name in (*linear, *BY_RULE, TransferFunction.kind):
            try:
                found[name] = begun(controller_kinds()[name], operating_plants(points), self.reference)
            except RailslipError:  # no lead without a lag, no rule without a dead time
                continue
        return found | ({} if self.given is None else {self.given.kind: self.given})

    def control(self, kind: str, values: Mapping[str, float], reference: ReferenceSlip | None = None) -> Controller:
        """The controller of a kind with numbers by name, at slips held.

        InputError, which names the number, for one that its kind does not allow.
        """
        if kind not in self.kinds:
            raise InputError(f"kind: {shown(kind)} is not offered; choose one of {', '.join(self.kinds)}")
        begins = self.kinds[kind]
        held = self.envelope.reference or reference or self.reference
        return begins.with_design_numbers(values, **({"reference": held} if begins.follows_reference else {}))

    def with_ratio_of(self, control: Controller) -> dict[str, Controller]:
        """`kinds`, with the transfer function that a linear controller is."""
        if not isinstance(control, LinearControl) or control.kind == TransferFunction.kind:
            return self.kinds
        return {**self.kinds, TransferFunction.kind: begun(TransferFunction, control, self.reference)}

    def points(self, control: Controller, *, nominal: bool = True) -> tuple[Envelope, EnvelopePoints]:
        """The envelope that a controller is judged over, and its cases."""
        held = cast(HeldSlip, control.held_slip) if control.finds_slip else None
        own = (control.kind, control.slip_numbers()) if held else getattr(control, "reference", None)

        def made() -> tuple[Envelope, EnvelopePoints]:
            envelope = envelope_for(self.envelope, control)
            return envelope, envelope.points(nominal=nominal, held=held)

        found: tuple[Envelope, EnvelopePoints] = self._kept((own, nominal), made)
        return found

    def hardest(self, control: Controller, points: EnvelopePoints, from_kmh: float) -> int:
        """The number of the plant whose loop is looked at, from a speed (km/h) up."""
        linear = isinstance(control, LinearControl) and getattr(control.system, "period", None) is None
        return self.of_points(points, "screen", Screen.of).hardest(control.system if linear else None, from_kmh)  # type: ignore[attr-defined, no-any-return]

    def of_points(self, points: EnvelopePoints, name: Any, make: Callable[[EnvelopePoints], Any]) -> Any:
        """What is made of some points once. They are kept with it, so that no others have their id."""
        return self._kept((id(points), name), lambda: (points, make(points)))[1]

    def _kept(self, key: Any, make: Callable[[], Any]) -> Any:
        if key not in self._made:
            while len(self._made) >= _KEPT:
                self._made.pop(next(iter(self._made)), None)
            self._made[key] = make()
        return self._made[key]
