"""Generated Python code of the derived law, written by `make generate` and committed, so that a run needs no SymPy.

The generated file contains a hash of its sources. If the sources have another hash, the law is derived again.
"""

from __future__ import annotations

from functools import cache
from typing import Any

from railslip_ctrl.model.adhesion import law_classes
from railslip_ctrl.model.numeric import generate as generate_plant

from .law import PACKAGE, module_of, sources_hash

LAW_FILE = PACKAGE / "model" / "_generated" / "sliding_law.py"

_HEAD = "# mypy: ignore-errors\n"


@cache
def law_source() -> str:
    """Return the Python source of the law of [Park2008] (45), with the adhesion torque Ta as an argument."""
    if LAW_FILE.is_file():
        text = LAW_FILE.read_text(encoding="utf-8")
        if f" {sources_hash()}." in text:
            return text.removeprefix(_HEAD)
    return generate_law().removeprefix(_HEAD)


@cache
def generated_law() -> Any:
    """Return the module of the generated law, with `Parameters`, `State`, `start`, `control` and `law_step`."""
    return module_of(law_source())


def generate_law() -> str:
    """Derive the law and return the text of the committed file `LAW_FILE`."""
    from .code import generate
    from .derivation import derive

    return _HEAD + generate(derive()).python


def main() -> None:
    """Write the generated code of every adhesion law and of the derived sliding-mode law."""
    texts = {f"{name}.py": generate_plant(law) for name, law in law_classes().items()}
    for name, text in {**texts, LAW_FILE.name: generate_law()}.items():
        target = LAW_FILE.parent / name
        target.write_text(text, encoding="utf-8")
        print(target.relative_to(LAW_FILE.parents[2]))


if __name__ == "__main__":
    main()
