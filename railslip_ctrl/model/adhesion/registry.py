"""Finding the laws: every module of this package that defines an `AdhesionLaw` is one, without being listed."""

from __future__ import annotations

import importlib
import pkgutil
import sys
from collections.abc import Iterator

from railslip_ctrl.core.arguments import checked
from railslip_ctrl.core.errors import InputError
from railslip_ctrl.core.units import shown
from railslip_ctrl.model.parameters import INITIAL_SPEED_KMH, PARK2008, Rail

from .base import AdhesionLaw

_NOT_LAWS = frozenset({"base", "files", "modules", "registry"})


def _laws() -> Iterator[type[AdhesionLaw]]:
    for info in pkgutil.iter_modules(sys.modules[__package__].__path__):
        if info.name in _NOT_LAWS:
            continue
        module = importlib.import_module(f".{info.name}", __package__)
        for value in vars(module).values():
            if isinstance(value, type) and issubclass(value, AdhesionLaw) and value.__module__ == module.__name__:
                yield value


def law_classes() -> dict[str, type[AdhesionLaw]]:
    """The laws by name, in alphabetical order."""
    return {law.name: law for law in sorted(_laws(), key=lambda law: law.name)}


def law_names() -> tuple[str, ...]:
    """Names of the laws, in alphabetical order."""
    return tuple(law_classes())


@checked
def law_class(name: str) -> type[AdhesionLaw]:
    """The law of a name, hyphen or underscore ("tyre-lugre" is "tyre_lugre").

    Raises
    ------
    InputError
        No law of that `name`; lists the names.
    """
    laws = law_classes()
    key = name.strip().lower().replace("-", "_")
    if key not in laws:
        raise InputError(f"adhesion: {shown(name)} is not a law; choose one of {', '.join(laws)}")
    return laws[key]


@checked
def published_law(
    name: str,
    rail: Rail | str,
    initial_speed_kmh: float = INITIAL_SPEED_KMH,
    wheel_load: float = PARK2008.wheel_load,
) -> AdhesionLaw:
    """The published parameter set of a law by name.

    Slip velocity sigma = v - r omega and adhesion force Fa are positive in braking ([Park2008] (1), (2)). Parameters
    that were identified at the rig's wheel load of 34 500 N are taken to another so that mu(slip) stays what was
    measured: this project's assumption, [Park2008] has that load alone.

    Parameters
    ----------
    name : str
        One of `law_names`, hyphen or underscore. [Park2008] gives parameters for "beam" ((5)-(10), Table 1), "bristle"
        ((19)-(24), (30)-(32)) and its "curve" (Fig. 17); `source` of a law names its own.
    rail : Rail or str
        Condition the parameters are for: "dry" or "wet".
    initial_speed_kmh : float
        Speed v0 at which the brake was applied, km/h, 30 to 140: a parameter of the run, not the speed of the moment
        ([Park2008] (30)-(32), Table 1). Laws that are not published over v0 do not use it.
    wheel_load : float
        Wheel load N, N, > 0; the published vehicle's 34 500 N unless given. `operating_point` refuses the law for a
        vehicle of another.

    Returns
    -------
    AdhesionLaw
        A frozen record of the law, its fields in SI, with the reference slips where the source has them.

    Raises
    ------
    InputError
        No law of that name, no such rail condition, or a number outside its range.
    MissingParametersError
        The source gives no parameters for this law.
    """
    law = law_class(name).published(Rail.of(rail), initial_speed_kmh, wheel_load)
    return law.model_copy(update={"of_wheel_load": wheel_load}) if law.has_forces() else law
