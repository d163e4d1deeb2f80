"""Modules that all other parts of the package use: errors, units, argument checks, notation, files, processes.

They import no other part of the package. Begin with `errors`, then `units` (numbers with units) and
`arguments` (checks of arguments). `records` has dataclasses that compare by content; `notation` has the symbols and the
cited sources. `user_files` reads the user's files, `folders` manages output folders and the cache, `templates` fills in
texts, and `processes` runs work on several cores.
"""
