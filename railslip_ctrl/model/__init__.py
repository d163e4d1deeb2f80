"""The plant: vehicle, adhesion laws, the one statement in SymPy, the numeric code made of it, the linearisation.

Imports `core`. A newcomer begins with `plant`, the statement; a new adhesion law is a file in `adhesion/`.
"""
