"""The plant: vehicle, adhesion laws, one statement in SymPy, its numeric code, linearisation.

Imports `core`. Begin with `plant`, the statement; the functions of `numeric`, and in `kernels` their text for
compiled runs, are generated from it. `vehicle` has the records of vehicle, wheel and actuator, `vehicle_files` reads
them, `linearization` gives the plant at an operating point. A new adhesion law is a file in `adhesion/`.
"""
