"""The sliding-mode law of [Park2008], adaptive, derived from the plant in SymPy; its code in Python and C.

Imports `model` and `core`. Begin with `derivation`, the chain of steps; `proof` checks each. `sampled_law` makes the
law discrete, `code` emits it as Python and C. `law` has the gains; `generate` writes the Python text that is
committed, so that a run needs no SymPy.
"""
