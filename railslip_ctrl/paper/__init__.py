"""Comparison of [Park2008] with our results: tables, units and errata.

Begin with `tables.table5`. `reading` contains the assumptions on units and details that reproduce Table 5.
"""
