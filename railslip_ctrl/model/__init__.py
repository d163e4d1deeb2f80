"""Plant model: vehicles, adhesion laws, equations of motion and linearisation. Begin with `plant`.

The package imports only `core`. `plant` states the equations of motion in SymPy; the functions of `numeric` and the
source text in `kernels` are generated from them. `vehicle` has the records of a vehicle, which `vehicle_files` reads.
`linearization` gives the linear plant. To add an adhesion law, add a file to `adhesion/`.
"""
