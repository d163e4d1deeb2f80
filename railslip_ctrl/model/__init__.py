"""The plant: vehicle, adhesion laws, one statement in SymPy, its numeric code, linearisation.

Imports `core`. A newcomer begins with `plant`, the statement and the text of the functions that `numeric` and `kernels`
have of it; a new adhesion law is a file in `adhesion/`.
"""
