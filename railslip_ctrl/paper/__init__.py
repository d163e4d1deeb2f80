"""The numbers of [Park2008] beside what the software obtains: tables, the units that reproduce them, errata.

Imports `verification`, `simulation`, `design`, `sliding`, `model` and `core`. Begin with `tables.table5`: `tables`
runs the four columns of Table 5, redraws the adhesion curves and has further facts of the runs. `reading` has the
rules of unit and interpretation that reproduce the table, and how much each changes it. `errata` compares `printed`
(equations and numbers as they stand in the source) with what is derived.
"""
