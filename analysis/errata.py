"""Which equations and numbers of [Park2008] do not follow from the paper's own model, and by how much do they differ?

Each equation or number in question is entered as printed and compared with the derived or computed one, for a reference
slip velocity proportional to the train speed and for a constant one. The table also has the equations that agree.

    python analysis/errata.py
"""

from __future__ import annotations

from dataclasses import dataclass

from railslip_ctrl.paper.errata import Erratum, errata
from railslip_ctrl.sliding.derivation import derive


@dataclass(frozen=True)
class Errata:
    """Errata by place in the paper, for the proportional reference; True if the constant reference gives the same."""

    rows: dict[str, Erratum]
    all_steps_checked: bool
    same_for_constant_reference: bool

    @property
    def agreeing(self) -> tuple[str, ...]:
        """Places where the printed equation or number follows from the model."""
        return tuple(where for where, row in self.rows.items() if row.agrees)

    @property
    def disagreeing(self) -> tuple[str, ...]:
        """Places where the printed equation or number does not follow from the model."""
        return tuple(where for where, row in self.rows.items() if not row.agrees)


def run() -> Errata:
    """Derive the law for both references and compare it with the printed law."""
    derivations = [derive(reference=reference) for reference in ("proportional", "constant")]
    proportional, constant = (errata(derivation) for derivation in derivations)
    return Errata(
        rows={row.where: row for row in proportional},
        all_steps_checked=all(derivation.all_checked for derivation in derivations),
        same_for_constant_reference=[row.agrees for row in proportional] == [row.agrees for row in constant],
    )


def main() -> None:
    result = run()
    for where, row in result.rows.items():
        print(f"{'agrees ' if row.agrees else 'DIFFERS'}  {where:30s}  {row.sign_and_size}")
    print(f"{len(result.agreeing)} agree, {len(result.disagreeing)} do not")


if __name__ == "__main__":
    main()
