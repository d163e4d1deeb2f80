"""Comparison with [Park2008]: its tables, the interpretation of its units that reproduces Table 5, its errata.

Imports `verification`, `simulation`, `design`, `sliding`, `model` and `core`. Begin with `tables.table5`.

- `tables`: simulates the runs of Table 5, computes the adhesion curves and further facts of the published runs.
- `reading`: the choices of units and of other interpretations that reproduce Table 5, and the effect of each.
- `errata`: compares `printed`, the source's equations and numbers, with the derivation.
"""
