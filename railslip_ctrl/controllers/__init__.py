"""Controllers: one class in one file a kind, found by itself; what everything else about a kind follows from.

Imports `sliding`, `loop`, `model` and `core`. Begin with `base` (what a kind is) and `slide_protection` (a short one).

- `base`: the class that a kind derives from; `translate` reads its step and prints it as kernel text
- `pi`, `linear` (transfer function, state space; `sampled` has their difference equations), `scheduled`,
  `slide_protection`, `sliding` (the published law), `predictive` (sliding mode ahead of the dead time; its loop as
  it runs is in `predictive_sampled`), `seeking`, `torque_profile`: the kinds
- `braking`: any linear system as one of them
- `user_step`: a Python object or function of the user's with a step, called by `step_calls`
- `systems`: linear controllers as systems, and the loop that a controller closes around the wheel
- `guard`: bad samples, locked wheels and limits; `c_code` prints a controller and its guard as C99 (`c_function`)
- `python_code` prints a controller as Python
- `assumed`: the force of the adhesion law that a controller assumes, as a step has it
- `files`: the registry of kinds, their files, and whatever is given as a controller
"""

from __future__ import annotations
