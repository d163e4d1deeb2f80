"""What every room needs: errors, units, checks of arguments, sources, notation, folders, results kept, processes.

Imports nothing of the package. A newcomer begins with `errors`.
"""
