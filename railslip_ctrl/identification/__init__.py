"""From a log to a model: adhesion observers, reading and checking logs, fits, a virtual rig to try them on.

Imports `simulation` and what is below. A newcomer begins with `identify`.
"""
