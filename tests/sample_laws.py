"""One parameter set of every adhesion law, for tests that run over all of them."""

from railslip_ctrl import MissingParametersError, Rail
from railslip_ctrl.model.adhesion import AdhesionLaw, law_class, law_names, published_law

# Magnitudes of a 34.5 kN wheel: some 10 kN of friction built up over a deflection of the order of 0.5 m, as
# in the published bristle model.
UNPUBLISHED = {
    "dahl": {"alpha": 2.2e4, "Fc": 9.8e3},
    "lugre": {"alpha": 2.2e4, "alpha1": 310.0, "alpha2": 21.0, "Fs": 1.13e4, "Fc": 6.1e3, "vs": 4.7},
    "tyre_lugre": {"alpha": 0.64, "alpha1": 0.009, "alpha2": 6e-4, "mu_s": 0.33, "mu_c": 0.17, "vs": 4.7},
}


def sample_law(name: str, rail: Rail = Rail.DRY) -> AdhesionLaw:
    """The published set at v0 = 100 km/h where there is one, else the set above."""
    if name in UNPUBLISHED:
        return law_class(name).model_validate(UNPUBLISHED[name]).on(rail)
    return published_law(name, rail)


def _has_sample(name: str) -> bool:
    try:
        sample_law(name)
    except MissingParametersError:
        return False
    return True


# A law added without published parameters joins these tests once a set for it stands above.
ALL_LAWS = tuple(name for name in law_names() if _has_sample(name))
DYNAMIC_LAWS = tuple(name for name in ALL_LAWS if law_class(name).has_state)
