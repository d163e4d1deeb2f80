"""Controllers: each kind of controller is one class, with the control law as its method `step`.

Begin with `base` (the base class) and `slide_protection` (a short kind). Simulation, C code and verdicts over an
envelope use only this class.
"""

from __future__ import annotations
