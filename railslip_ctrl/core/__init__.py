"""Foundations of all rooms: errors, units, argument checks, notation, files, processes.

The room imports nothing of the package. Begin with `errors`, then `units` (numbers with units) and `arguments` (their
checks). `records` has dataclasses that compare by content; `notation` has the symbols and the cited sources.
`user_files` reads the user's files, `folders` manages output folders and the cache, `templates` fills in texts, and
`processes` runs work on several cores.
"""
