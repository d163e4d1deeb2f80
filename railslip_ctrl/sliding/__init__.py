"""The adaptive sliding-mode law of [Park2008], derived from the plant in SymPy, and its code in Python and C.

`derivation` has the chain of steps, on the checks of `proof`; `sampled_law` makes it discrete, `code` prints it;
`law` has gains and the committed Python text, without SymPy. Imports `model` and `core`. Begin with `derivation`.
"""
