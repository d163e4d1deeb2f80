"""What every room needs: errors, units, argument checks, sources, files, cache.

Imports nothing of the package. A newcomer begins with `errors`.
"""
