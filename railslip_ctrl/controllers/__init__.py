"""Controllers: each kind of controller is one class, with the control law as its method `step`.

Begin with `base` (the base class) and `slide_protection` (a short example). Simulation, C code and verdicts over an
envelope use every controller through the base class.

- kinds: `pi`, `linear`, `scheduled`, `slide_protection`, `sliding` (the published law), `predictive`, `seeking`,
  `torque_profile`, `user_step` (a user's object or function)
- loops: `systems` (transfer functions), `sampled` and `predictive_sampled` (exact sampled loops)
- controllers from objects and files: `braking` and `files`
- in the compiled simulation: `translate`, `step_calls` and `assumed`
- exported programs: `guard`, `c_code`, `c_function` and `python_code`
"""

from __future__ import annotations
