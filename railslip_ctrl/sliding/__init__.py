"""The adaptive sliding-mode law, derived from the plant in SymPy, and its code in Python and C.

Imports `model` and `core`. A newcomer begins with `derivation`.
"""
