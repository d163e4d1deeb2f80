"""Controllers: each kind is one class in one file; simulation, files, C code and verdicts are derived from the class.

Imports `sliding`, `loop`, `model` and `core`. Begin with `base` (the base class of the kinds) and `slide_protection` (a
short kind).

- `base`: base class of the kinds; `translate` reads the step of a kind and prints it as kernel text
- the kinds: `pi`, `linear` (transfer function, state space; `sampled` has their difference equations), `scheduled`,
  `slide_protection`, `sliding` (the published law), `predictive` (sliding mode with prediction over the dead time;
  `predictive_sampled` has its sampled loop), `seeking`, `torque_profile`
- `braking`: conversion of any linear system to a kind
- `user_step`: a user's Python object or function with a step; `step_calls` calls it from a kernel
- `systems`: linear controllers as systems, and the wheel-slip loop
- `guard`: handling of bad samples, locked wheels and limits
- `c_code`: a controller and its guard as C99 (`c_function`); `python_code`: a controller as Python
- `assumed`: force of the adhesion law that a controller assumes, as a function for its step
- `files`: registry of kinds, controller files, and conversion of any given controller
"""

from __future__ import annotations
