"""Section about the sliding-mode laws: their conditions, in words that match how each was decided."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable, Sequence

from railslip_ctrl.design_report import DesignReport
from railslip_ctrl.law_sources import words_at
from railslip_ctrl.sliding.verdict import Condition
from railslip_ctrl.sliding_verification import PUBLISHED_ADHESION, FullVerification

from .blocks import Block, Details, Facts, Items, Paragraph, Section
from .numbers import listed, short
from .typography import typeset

_SENTENCE_END = re.compile(r"(?<=\.) (?=[A-Za-z])")
PAPER_LAW = "paper-law"
"""Anchor of the appendix about the published law."""

_HELD = {"symbolic": "proved", "sampled": "held in all samples", "simulated": "held in all runs"}
_FAILED = {"symbolic": "refuted", "sampled": "failed in samples", "simulated": "failed in runs"}


def decided(one: Condition) -> str:
    """A condition's verdict in words that say no more than how it was reached allows."""
    if one.how is None:
        return "not decided"
    return (_HELD if one.holds else _FAILED)[one.how]


def tally(conditions: Sequence[Condition]) -> str:
    """How many hold and how many do not, by how that was decided, and how many were not decided."""
    held, failed, left = ([one for one in conditions if one.holds is holds] for holds in (True, False, None))
    parts = [f"{len(held)} of {len(conditions)} hold{_by_verdict(held)}"]
    parts += [f"{len(failed)} {'does' if len(failed) == 1 else 'do'} not{_by_verdict(failed)}"] if failed else []
    parts += [f"{len(left)} {'was' if len(left) == 1 else 'were'} not decided"] if left else []
    return "; ".join(parts)


def _by_verdict(conditions: Iterable[Condition]) -> str:
    counts = Counter(decided(one) for one in conditions)
    return f" ({', '.join(f'{count} {word}' for word, count in counts.items())})" if counts else ""


def claims_and_own(full: FullVerification) -> tuple[str, str]:
    """The tallies of what the paper claims or relies on, and of this project's own conditions; empty where none is."""
    conditions = full.verification.conditions
    claims, own = ([one for one in conditions if one.claimed is claimed] for claimed in (True, False))
    return tally(claims) if claims else "", tally(own) if own else ""


_HOW = (
    "Every claim is put as a condition and decided. Words say how: proved or refuted are symbolic, by SymPy or in "
    "closed "
    "form; held in all samples, or in all runs, is evidence over the set that is named under the condition, and no "
    "proof; not decided is what is about a law or a bound that does not exist. The set is this vehicle on the "
    "published bristle model at its reference slips, whatever adhesion law this report is about"
)


def sliding_section(report: DesignReport) -> Section:
    """Which conditions the layered law meets, this project's own sliding-mode design, each with its evidence."""
    intro = Paragraph(
        f"{_standing(report)} {_HOW}; railslip verify --law layered --adhesion decides them for another. Bounds by L1 "
        "norms: [DahlehPearson1987]."
    )
    return Section("sliding", "Sliding mode: the layered law", (intro, *_law_blocks(report, "layered")))


def paper_law_section(report: DesignReport) -> Section:
    """Which conditions the published law meets."""
    intro = Paragraph(
        f"About the law of [Park2008], not about what to use. {_HOW}, which the paper derives its law with. Limit "
        "cycles of a relay: [Tsypkin1984]."
    )
    return Section(PAPER_LAW, "Appendix: the published sliding-mode law", (intro, *_law_blocks(report, "paper")))


def _standing(report: DesignReport) -> str:
    """What the recommendation is, so that no condition that holds is taken for one."""
    taken = report.loops.recommended
    which = "none" if taken is None or report.endless(taken.name) else f"the design “{taken.name}”"
    return (
        f"The recommendation of this report is that of the verdict: {which}. The layered law is what to "
        "take where it has to be a sliding-mode law: it needs the rail's holding torque, which none of the others does."
    )


def decided_for(report: DesignReport) -> str:
    """For which adhesion the conditions were decided, where the report is about another; else empty."""
    points, published = [plant.point for plant in report.plants], PUBLISHED_ADHESION
    name = words_at(points[0])
    bristle = published.law if isinstance(published.law, str) else published.law.name
    if name != bristle:
        asked = f"the law {name}"
    elif any(point.slip != published.reference(point.rail, point.vehicle) for point in points):
        asked = f"slip {listed(dict.fromkeys(f'{point.slip:g}' for point in points))}"
    else:
        return ""
    return f"decided for the published {bristle} model at its reference slips, not for {asked} of this report"


def _law_blocks(report: DesignReport, name: str) -> list[Block]:
    full: FullVerification | None = getattr(report.sliding, name)
    if full is None:
        return [Paragraph(f"Not decided: {report.sliding.reasons[name]}.")]
    return _conditions(full, report.sliding.gains.get(name, ()))


def _conditions(full: FullVerification, gains: Sequence[tuple[str, float, str]]) -> list[Block]:
    verification = full.verification
    claims, own = claims_and_own(full)
    told = []
    if claims:
        told.append(f"Conditions that [Park2008] claims or relies on: {claims}.")
    if own:
        whose = "Conditions of this project: mended variants of the law, and what is asked of them" if claims else (
            "Conditions of this design, which is this project's own"
        )  # fmt: skip
        told.append(f"{whose}: {own}.")
    blocks: list[Block] = [Paragraph(" ".join(told), strong=True)]
    if full.conclusion:
        blocks.append(Items(tuple(typeset(one) for one in _SENTENCE_END.split(full.conclusion))))
    absent = verification.law == "layered" and verification.K == 0.0
    rows = [("K", "none, as there is no law" if absent else f"{short(verification.K)} N·m")]
    if verification.D is not None:
        rows.append(("D", f"{short(verification.D)} N·m/(m/s)"))
    rows += [(symbol, f"{short(value)} {unit}".removesuffix(" -")) for symbol, value, unit in gains]
    rows += [("Inertia scale", f"{verification.inertia_scale:g}"), ("Seed", str(verification.seed))]
    failing = [one.name for one in verification.failing]
    if failing:
        rows.append(("Do not hold", typeset(listed(failing))))
    undecided = [one.name for one in verification.undecided]
    if undecided:
        rows.append(("Not decided", typeset(listed(undecided))))
    blocks.append(Facts(tuple(rows)))
    blocks += [
        Details(
            typeset(one.name) + ("" if one.claimed or not claims else " (own)"),
            decided(one),
            (Paragraph(typeset(one.statement)), Paragraph(typeset(one.evidence))),
        )
        for one in verification.conditions
    ]
    return blocks
