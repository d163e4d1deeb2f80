"""What every room needs: errors, units, argument checks, notation, files, processes.

Imports nothing of the package. Begin with `errors`, then `units` (numbers with units) and `arguments` (their checks).
`records` has dataclasses that compare by content, `notation` the symbols and the cited sources; `user_files` reads what
a user gives, `folders` has those for output and cache, `templates` fills texts, `processes` runs on every core.
"""
