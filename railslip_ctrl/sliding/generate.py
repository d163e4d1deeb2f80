"""`make generate`: write what is generated from the statement and committed."""

from __future__ import annotations

from pathlib import Path

from railslip_ctrl.model.adhesion import law_classes
from railslip_ctrl.model.numeric import generate

from .generated import LAW_FILE, generate_law

GENERATED = LAW_FILE.parent


def main() -> None:
    """Write the functions of every adhesion law, and the derived sliding-mode law."""
    for name, law in law_classes().items():
        _write(GENERATED / f"{name}.py", generate(law))
    _write(LAW_FILE, generate_law())


def _write(target: Path, text: str) -> None:
    target.write_text(text, encoding="utf-8")
    print(target.relative_to(GENERATED.parents[1]))


if __name__ == "__main__":
    main()
