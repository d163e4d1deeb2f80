"""Controllers: each kind of controller is one class, with the control law as its method `step`.

Simulation, controller files, C code and robustness verdicts need nothing but this class. This package imports
`sliding`, `loop`, `model` and `core`. Begin with `base` (the base class) and `slide_protection` (a short kind).

- `base`: base class of the controllers; `translate` translates `step` for the compiled simulation
- one module for each kind: `pi`, `linear` (transfer function, state space; `sampled` has their difference equations),
  `scheduled`, `slide_protection`, `sliding` (the published law), `predictive` (sliding mode with prediction over the
  dead time; `predictive_sampled` has its sampled loop), `seeking`, `torque_profile`
- `braking`: makes a controller from any linear system
- `user_step`: a user's Python object or function as a controller; `step_calls` calls it from the compiled simulation
- `systems`: transfer functions of linear controllers, and the wheel-slip loop
- `guard`: handles bad samples and locked wheels, and limits the torque
- `c_code`: writes a controller and its guard as C99 (`c_function`); `python_code`: writes a controller as Python
- `assumed`: force of the adhesion law that a controller assumes, as a function that `step` can call
- `files`: reads controller files, lists the kinds, and converts any controller object to a `Controller`
"""

from __future__ import annotations
