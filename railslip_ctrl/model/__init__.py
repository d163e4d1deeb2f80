"""The plant: vehicle, adhesion laws, one statement in SymPy, its numeric code, linearisation.

Imports `core`. A newcomer begins with `plant`, the statement, which `generation` turns into the functions of `numeric`
and `kernels`; a new adhesion law is a file in `adhesion/`.
"""
