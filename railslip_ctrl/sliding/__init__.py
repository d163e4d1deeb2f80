"""The sliding-mode law of [Park2008], adaptive, derived from the plant in SymPy; its code in Python.

Imports `model` and `core`. Begin with `derivation`, the chain of steps; `proof` checks each. `sampled_law` makes the
law discrete, `code` writes it in the language of steps, which `controllers` prints as kernels and as C99. `law` has the
gains; `generate` writes the Python text that is committed, so that a run needs no SymPy.
"""
