"""Derivation in SymPy of two sliding-mode laws: the adaptive law of [Park2008], with its code, and the predictive law.

Imports `model` and `core`. Begin with `derivation`.

- `derivation`: the published law, step by step.
- `predictive`: the law for a plant with actuator, and its loop.
- `proof`: symbols, and the machine checks of each step.
- `sampled_law`: the published law in discrete time.
- `code`: the sampled law as Python code, from which `controllers` makes kernels and C99.
- `law`: the gains of the published law.
- `generate`: writes the committed Python code, so that a run does not import SymPy.
"""
