"""The sliding-mode laws, derived from the plant in SymPy: [Park2008]'s adaptive law with its code, the predictive law.

Imports `model` and `core`. Begin with `derivation`, the chain of steps of the published law; `predictive` derives the
law for the actuator and the loop of its layer; `proof` checks each step. `sampled_law` makes the published law
discrete, `code` writes it in the language of steps, which `controllers` prints as kernels and as C99. `law` has the
gains; `generate` writes the Python text that is committed, so that a run needs no SymPy.
"""
