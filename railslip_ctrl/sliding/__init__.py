"""Derivation in SymPy of two sliding-mode laws: the adaptive law of [Park2008], with its code, and the predictive law.

Imports `model` and `core`. Begin with `derivation` (the published law) and `predictive` (the law for a plant with
actuator). `proof` checks their steps. `sampled_law` and `code` make Python code of the published law; `generate` writes
the committed code, so that a run does not import SymPy. `law` has the gains.
"""
