"""Derivation in SymPy of two sliding-mode laws: the adaptive law of [Park2008], with its code, and the predictive law.

Imports `model` and `core`. Begin with `derivation`.
"""
