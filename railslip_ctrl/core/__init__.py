"""Modules that all other packages of `railslip_ctrl` use; they import no other package. Begin with `errors`.

`errors` has the exceptions, `units` converts numbers with units, and `arguments` checks arguments of functions.
`records` has dataclasses that compare by content, `notation` the symbols and the cited sources. `user_files` reads the
user's files, `folders` manages output folders and the cache, `templates` fills numbers into texts, and `processes` runs
work on several cores.
"""
