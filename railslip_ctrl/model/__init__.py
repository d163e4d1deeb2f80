"""Plant model: vehicle, adhesion laws, equations of motion in SymPy, numeric code, linearisation.

The package imports only `core`. Begin with `plant`, which states the equations of motion. The numeric functions
(`numeric`) and their text for compiled runs (`kernels`) are generated from these equations. `vehicle` has the records
of vehicle, wheel and actuator, `vehicle_files` reads them from files, and `linearization` gives the linear plant at an
operating point. To add an adhesion law, add a file to `adhesion/`.
"""
