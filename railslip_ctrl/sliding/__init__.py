"""Derivation in SymPy of the sliding-mode laws: the adaptive law of [Park2008], with its code, and the predictive law.

Imports `model` and `core`. Begin with `derivation`, the derivation of the published law.

- `derivation`, `predictive`: the published law step by step; the law for a plant with actuator, and its loop.
- `proof`: symbols, and the machine checks of each step.
- `sampled_law`, `code`: the published law in discrete time, and as Python code, from which `controllers` makes kernels
  and C99.
- `law`: the gains.
- `generate`: writes the committed Python code, so that a run needs no SymPy.
"""
