"""Controllers: each kind is one class in one file; simulation, files, C code and verdicts follow from it.

Imports `sliding`, `loop`, `model` and `core`. Begin with `base` (the base class of the kinds) and `slide_protection` (a
short kind).

- `base`: the class that a kind derives from; `translate` reads its step and prints it as kernel text
- `pi`, `linear` (transfer function, state space; `sampled` has their difference equations), `scheduled`,
  `slide_protection`, `sliding` (the published law), `predictive` (sliding mode ahead of the dead time; its sampled
  loop is in `predictive_sampled`), `seeking`, `torque_profile`: the kinds
- `braking`: makes a kind of any linear system
- `user_step`: a user's Python object or function with a step, called by `step_calls`
- `systems`: linear controllers as systems, and the loop that a controller closes around the wheel
- `guard`: bad samples, locked wheels and limits; `c_code` prints a controller and its guard as C99 (`c_function`)
- `python_code` prints a controller as Python
- `assumed`: the force of the adhesion law that a controller assumes, as a function for its step
- `files`: the registry of kinds, their files, and the conversion of any given controller
"""

from __future__ import annotations
