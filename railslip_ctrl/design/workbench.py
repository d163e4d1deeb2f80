"""Controllers shaped by hand over an envelope, with cached results."""

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
from .envelope import Envelope, EnvelopePoints, SlipFunction
from .envelope_tuning import common_reference, operating_plants
from .gain_map import Screen, fastest
from .judging import envelope_for

_CACHE_SIZE = 200  # largest number of cached results, most of them small


class Workbench:
    """Envelope and controllers from which a design by hand begins.

    - envelope: operating points and tolerances of the design.
    - controller: controller from which the design begins; a rule computes the controllers of the other kinds.

    InputError if the envelope has no operating points, if neither `envelope` nor `controller` gives a reference slip
    and those of the adhesion laws differ, or if the controller has no named parameters.
    """

    def __init__(self, envelope: Envelope, controller: Any = None) -> None:
        envelope.check_files()
        self.envelope, self.given, self._cache = envelope, controller, dict[Any, Any]()
        if controller is not None:
            own = getattr(getattr(controller, "controller", controller), "reference", None)
            self.given = as_control(controller, envelope.vehicle, envelope.reference or own or self.reference)
            if not self.given.design_numbers():
                raise InputError(f"controller: {self.given.label} has no named parameters; give another controller")
        _ = self.reference

    @cached_property
    def reference(self) -> ReferenceSlip:
        """Reference slips of the envelope, else those of the given controller, else those of the adhesion laws."""
        own = self.envelope.reference or getattr(self.given, "reference", None)
        slips = own or common_reference(self.envelope, self.envelope.points(nominal=True))
        if slips is None:
            raise InputError(
                "envelope: the adhesion laws have different reference slips; give the envelope a reference, or --slip"
            )
        return slips

    @cached_property
    def kinds(self) -> dict[str, Controller]:
        """Controllers from which a design can begin, one of each kind, by the name of the kind."""
        linear = [name for name, kind in structures().items() if issubclass(kind, PI)]
        points = self.envelope.at(reference=self.reference).points(nominal=True)
        controllers: dict[str, Controller] = {}
        for name in (*linear, *BY_RULE, TransferFunction.kind):
            try:
                controllers[name] = begun(controller_kinds()[name], operating_plants(points), self.reference)
            except RailslipError:  # no lead without a lag, no rule without a dead time
                continue
        return controllers | ({} if self.given is None else {self.given.kind: self.given})

    def control(self, kind: str, values: Mapping[str, float], reference: ReferenceSlip | None = None) -> Controller:
        """Return the controller of a kind with reference slips and with `values` for the named parameters.

        InputError, with the parameter's name, for a value that the kind does not allow.
        """
        if kind not in self.kinds:
            raise InputError(f"kind: {shown(kind)} is not offered; choose one of {', '.join(self.kinds)}")
        first = self.kinds[kind]
        slips = self.envelope.reference or reference or self.reference
        return first.with_design_numbers(values, **({"reference": slips} if first.follows_reference else {}))

    def with_ratio_of(self, control: Controller) -> dict[str, Controller]:
        """Return `kinds`; a linear `control`, as a ratio of polynomials, replaces the entry "transfer function"."""
        if not isinstance(control, LinearControl) or control.kind == TransferFunction.kind:
            return self.kinds
        return {**self.kinds, TransferFunction.kind: begun(TransferFunction, control, self.reference)}

    def points(self, control: Controller, *, nominal: bool = True) -> tuple[Envelope, EnvelopePoints]:
        """Return the envelope for a controller, and the points of this envelope, with tolerances unless `nominal`."""
        slip_of = cast(SlipFunction, control.judged_slip) if control.finds_slip else None
        own = (control.kind, control.slip_numbers()) if slip_of else getattr(control, "reference", None)

        def made() -> tuple[Envelope, EnvelopePoints]:
            envelope = envelope_for(self.envelope, control)
            return envelope, envelope.points(nominal=nominal, slip_of=slip_of)

        cases: tuple[Envelope, EnvelopePoints] = self._cached((own, nominal), made)
        return cases

    def hardest(self, control: Controller, points: EnvelopePoints, from_kmh: float) -> int:
        """Return the index of the plant that is hardest to control among those with a speed >= `from_kmh`, km/h."""
        if not isinstance(control, LinearControl) or getattr(control.system, "period", None) is not None:
            return int(self.of_points(points, ("fastest", from_kmh), lambda cases: fastest(cases, from_kmh)))
        screen: Screen = self.of_points(points, "screen", Screen.of)
        return screen.hardest(control.system, from_kmh)

    def of_points(self, points: EnvelopePoints, name: Any, make: Callable[[EnvelopePoints], Any]) -> Any:
        """Return `make(points)`, cached under `name`."""
        return self._cached((id(points), name), lambda: (points, make(points)))[1]

    def _cached(self, key: Any, make: Callable[[], Any]) -> Any:
        if key not in self._cache:
            while len(self._cache) >= _CACHE_SIZE:
                self._cache.pop(next(iter(self._cache)), None)
            self._cache[key] = make()
        return self._cache[key]
