"""The numbers of [Park2008] beside what the software obtains: tables, the reading, errata.

`tables` runs the four columns of Table 5, redraws the adhesion curves and tells what else the runs show, `reading` has
the rules under which they come out and what each is worth, `errata` compares `printed` (the equations as they stand in
the source) with what is derived. May import every room but `report` and `cli`. Begin with `tables.table5`.
"""
