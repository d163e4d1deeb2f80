"""Table 3 of [Park2008] as far as it can be checked: its means and its improvement, from its own printed numbers."""

from __future__ import annotations

from dataclasses import dataclass

from railslip_ctrl.core.sources import cite

SPEEDS_KMH = (30, 60, 100, 140)
BEAM = (0.0130, 0.0085, 0.0132, 0.0093)
BRISTLE = (0.0080, 0.0080, 0.0102, 0.0077)
"""[Park2008] Table 3: mean absolute errors of the adhesion coefficient against the rig's mean, by initial speed."""

PRINTED_BEAM_MEAN = 0.011
PRINTED_BRISTLE_MEAN = 0.0083
PRINTED_IMPROVEMENT_PERCENT = 24.5
ADHESION_REGIME = (0.0193, 0.0138)
"""Beam and bristle, where adhesion rises with slip: [Park2008] Figs. 14 and 15."""

NOT_REPRODUCIBLE = (
    "The eight errors themselves cannot be computed again: they are against the mean of the rig's measurements, which "
    "[Park2008] prints only as marks in Fig. 13, and the sampling in slip over which they are averaged is not given. "
    "railslip identify does the same comparison for a log that one has."
)


@dataclass(frozen=True)
class Table3:
    """What follows from the printed errors of the adhesion coefficient (ratios), and findings.

    Attributes
    ----------
    beam_mean, bristle_mean : float
        Means of the printed rows.
    improvement_percent : float
        Of bristle over beam, %, from these means.
    improvement_of_printed_means_percent, improvement_in_adhesion_regime_percent : float
        The same from the printed means, and from the errors where adhesion rises with slip.
    not_reproducible : str
        What cannot be computed again, and why.
    source : str
        Where it is printed.
    """

    beam_mean: float
    bristle_mean: float
    improvement_percent: float
    improvement_of_printed_means_percent: float
    improvement_in_adhesion_regime_percent: float
    not_reproducible: str = NOT_REPRODUCIBLE
    source: str = cite("Park2008", "Table 3")

    @property
    def improvement_as_printed(self) -> bool:
        """Whether the improvement that the rows give is the printed one, to its last digit."""
        return abs(self.improvement_percent - PRINTED_IMPROVEMENT_PERCENT) <= 0.05

    @property
    def improvement_follows_from_printed_means(self) -> bool:
        """Whether the printed improvement is that of the printed means, to its last digit."""
        return abs(self.improvement_of_printed_means_percent - PRINTED_IMPROVEMENT_PERCENT) <= 0.05


def table3() -> Table3:
    """The arithmetic of Table 3."""
    beam, bristle = sum(BEAM) / len(BEAM), sum(BRISTLE) / len(BRISTLE)
    return Table3(
        beam_mean=beam,
        bristle_mean=bristle,
        improvement_percent=_improvement(beam, bristle),
        improvement_of_printed_means_percent=_improvement(PRINTED_BEAM_MEAN, PRINTED_BRISTLE_MEAN),
        improvement_in_adhesion_regime_percent=_improvement(*ADHESION_REGIME),
    )


def _improvement(before: float, after: float) -> float:
    return 100.0 * (1.0 - after / before)
