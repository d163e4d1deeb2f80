"""Plant model: vehicle, adhesion laws, equations of motion in SymPy, numeric code, linearisation.

The package imports only `core`. Begin with `plant`, which states the equations of motion. The numeric functions
(`numeric`) and their text for compiled runs (`kernels`) are generated from it. `vehicle` has the records of vehicle,
wheel and actuator, `vehicle_files` reads them from files, and `linearization` gives the linear plant at an operating
point. A new adhesion law is a file in `adhesion/`.
"""
